"""The command line's `nightglass catalog ...`: make, prove, search and fetch star catalogues."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from catalog_tools.documents import JsonObject
from catalog_tools.errors import BadInput, Damaged
from pipeline.commands.options import Json, Output, SchedulerName, Workers, print_mapping

catalog = typer.Typer(help="Make and look at star catalogues.", no_args_is_help=True)

Place = Annotated[str, typer.Argument(metavar="CATALOGUE", help="folder, s3:// or http:// URL")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="replace a catalogue that is there")]


@catalog.command()
def ingest(
    sources: Annotated[list[Path], typer.Argument(help="files of stars, or folders of them")],
    output: Output,
    form: Annotated[
        str | None, typer.Option(help="what the columns mean: a form's name, or a column map .toml")
    ] = None,
    name: Annotated[str | None, typer.Option(help="name of the catalogue")] = None,
    rows_per_leaf: Annotated[int, typer.Option(min=1, help="largest shard")] = 1_000_000,
    memory: Annotated[str, typer.Option(help="the most one worker may take")] = "2GiB",
    scheduler: SchedulerName = "threads",
    workers: Workers = None,
    restart: Annotated[bool, typer.Option("--restart", help="discard unfinished work")] = False,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Repartition files of stars into HEALPix Parquet shards (HATS); goes on where it stopped."""
    from catalog_tools.engine.schedulers import open_scheduler
    from catalog_tools.info import info
    from catalog_tools.ingest.ingest import ingest as run

    memory_bytes = _bytes(memory)
    with _stages(as_json) as progress, open_scheduler(scheduler, workers) as where:
        report = run(
            list(sources),
            output,
            form=form,
            name=name,
            rows_per_leaf=rows_per_leaf,
            memory_bytes=memory_bytes,
            scheduler=where,
            progress=progress,
            overwrite=overwrite,
            restart=restart,
        )
    for note in report.notes:
        print(f"note: {note}", file=sys.stderr)
    print_mapping({"continued_batches": report.continued, **info(report.catalogue)}, as_json)


@catalog.command()
def forms(as_json: Json = False) -> None:
    """The kinds of tables that are known by name."""
    from catalog_tools.forms import known_forms, load_form

    print_mapping({name: load_form(name).description for name in known_forms()}, as_json)


@catalog.command()
def info(catalogue: Place, as_json: Json = False) -> None:
    """What a catalogue holds."""
    from catalog_tools.catalogue import open_catalogue
    from catalog_tools.info import info as facts

    print_mapping(facts(open_catalogue(catalogue)), as_json)


@catalog.command()
def verify(catalogue: Place, workers: Workers = None, as_json: Json = False) -> None:
    """Prove a catalogue whole: every byte, every row's place, every count."""
    from dataclasses import asdict

    from catalog_tools.catalogue import open_catalogue
    from catalog_tools.verify.verify import verify as run

    with _stages(as_json) as progress:
        report = run(open_catalogue(catalogue), workers=workers, progress=progress)
    found = [f"{finding.path}: {finding.what}" for finding in report.findings]
    told = asdict(report) | {"whole": report.whole, "findings": found}
    if not report.notes and not as_json:
        del told["notes"]
    print_mapping(told, as_json)
    if found:
        raise Damaged(catalogue, f"{len(found)} problem(s): {'; '.join(found[:3])}")


@catalog.command()
def starlight(
    catalogue: Place,
    order: Annotated[
        int | None, typer.Option(min=0, max=9, help="HEALPix order of the map (default 6 or 7)")
    ] = None,
    scheduler: SchedulerName = "threads",
    workers: Workers = None,
    as_json: Json = False,
) -> None:
    """Sum the light of all stars once, so that scenes can leave faint ones to a smooth sky."""
    from catalog_tools.catalogue import open_catalogue
    from catalog_tools.engine.schedulers import open_scheduler
    from catalog_tools.query.starlight import STARLIGHT_NAME, make_starlight

    opened = open_catalogue(catalogue)
    with _stages(as_json) as progress, open_scheduler(scheduler, workers) as where:
        made = make_starlight(opened, order=order, scheduler=where, progress=progress)
    print_mapping(
        {"map": f"{opened.path}/{STARLIGHT_NAME}", "order": made.order, "stars": opened.rows},
        as_json,
    )


@catalog.command()
def cone(
    catalogue: Place,
    ra_deg: Annotated[
        float | None, typer.Option("--ra", min=-360, max=360, help="centre of a cone, degrees")
    ] = None,
    dec_deg: Annotated[
        float | None, typer.Option("--dec", min=-90, max=90, help="centre of a cone, degrees")
    ] = None,
    radius_deg: Annotated[
        float | None, typer.Option("--radius", min=0, max=180, help="of the cone, degrees")
    ] = None,
    corner: Annotated[
        list[str] | None, typer.Option(help="RA,DEC of a polygon; three or more, instead of a cone")
    ] = None,
    faintest_g_mag: Annotated[
        float | None, typer.Option("--faintest", help="G magnitude; default: all stars")
    ] = None,
    epoch_jyear: Annotated[float | None, typer.Option("--epoch", help="Julian year")] = None,
    output: Annotated[Path | None, typer.Option("-o", help=".csv or .parquet")] = None,
) -> None:
    """Stars in a cone or a polygon, to the screen (CSV) or a file."""
    from catalog_tools.catalogue import open_catalogue
    from catalog_tools.query import query

    corners = [_numbers("--corner", text, 2, "56.75,24.1") for text in corner or []]
    centre = (ra_deg, dec_deg, radius_deg)
    if corners and centre == (None, None, None):
        opened = open_catalogue(catalogue)
        rows, report = query.polygon(opened, corners, faintest_g_mag, epoch_jyear)
    elif ra_deg is None or dec_deg is None or radius_deg is None or corners:
        raise BadInput("--ra, --dec, --radius", centre, "all three, or else three --corner RA,DEC")
    else:
        opened = open_catalogue(catalogue)
        rows, report = query.cone(opened, ra_deg, dec_deg, radius_deg, faintest_g_mag, epoch_jyear)
    _write_table(rows, output)
    print(f"{rows.num_rows} stars; {report}", file=sys.stderr)
    if not corners:
        _note_coverage(opened, centre)


@catalog.command()
def demo(
    output: Output,
    faintest_g_mag: Annotated[float, typer.Option("--faintest", help="all-sky limit, G")] = 10.0,
    field: Annotated[
        list[str] | None, typer.Option(help="deep field RA,DEC,RADIUS,G in degrees and mag")
    ] = None,
    rows: Annotated[
        int | None, typer.Option(min=1, help="a sample of so many stars to G = 21")
    ] = None,
    as_csv: Annotated[bool, typer.Option("--as-csv", help="files like Gaia DR2's instead")] = False,
    seed: Annotated[int, typer.Option(min=0, help="of all draws")] = 2,
    workers: Workers = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Make a SYNTHETIC all-sky catalogue from published star counts; no star of it is real."""
    from catalog_tools.info import info as facts

    if rows is not None and (field or faintest_g_mag != 10.0):
        raise BadInput("--rows", rows, "without --faintest and --field: a sample goes to G = 21")
    if as_csv:
        _write_csv(output, rows, seed, workers, overwrite, as_json)
        return
    fields = [_numbers("--field", text, 4, "56.75,24.1,1.0,20") for text in field or []]
    with _stages(as_json) as progress:
        shared: JsonObject = {
            "seed": seed,
            "workers": workers or 2,
            "progress": progress,
            "overwrite": overwrite,
        }
        if rows is not None:
            from catalog_tools.synthetic.sample import make_sample

            made = make_sample(output, rows, **shared)
        else:
            from catalog_tools.synthetic.synthetic import make_demo

            made = make_demo(output, faintest_g_mag=faintest_g_mag, deep_fields=fields, **shared)
    print_mapping(facts(made.catalogue), as_json)


def _write_csv(
    output: Path, rows: int | None, seed: int, workers: int | None, overwrite: bool, as_json: bool
) -> None:
    from dataclasses import asdict

    from catalog_tools.synthetic.csv import write_csv_files

    if rows is None or overwrite:
        raise BadInput("--as-csv", True, "together with --rows N, and without --overwrite")
    with _stages(as_json) as progress:
        written = write_csv_files(output, rows, seed=seed, workers=workers, progress=progress)
    print_mapping(asdict(written), as_json)


@catalog.command()
def fetch(
    release: Annotated[str, typer.Argument(help="gaia-dr2 or gaia-dr3")],
    destination: Annotated[Path, typer.Option("--dest", help="folder; ingest takes it as it is")],
    cone: Annotated[
        list[str] | None, typer.Option(help="RA,DEC,RADIUS, also with ,G; repeatable")
    ] = None,
    everything: Annotated[bool, typer.Option("--all", help="every file (DR2: 588 GB)")] = False,
    base_url: Annotated[str | None, typer.Option(help="a mirror: http, https, file")] = None,
    tap: Annotated[str | None, typer.Option(help="'archive' or a TAP URL: the rows only")] = None,
    faintest_g_mag: Annotated[float | None, typer.Option("--faintest", help="with --tap")] = None,
    connections: Annotated[int, typer.Option(min=1, max=32, help="at once")] = 4,
    verify: Annotated[bool, typer.Option("--verify", help="hash present files again")] = False,
    as_json: Json = False,
) -> None:
    """Download the archive's files, or a cone's rows; the same command goes on where it stopped."""
    from dataclasses import asdict

    from catalog_tools.fetch.fetch import fetch as run

    with _stages(as_json) as progress:
        report = run(
            release,
            destination,
            cones=cone or [],
            everything=everything,
            base_url=base_url,
            tap_url=tap,
            faintest_g_mag=faintest_g_mag,
            connections=connections,
            progress=progress,
            verify=verify,
        )
    for note in report.notes:
        print(f"note: {note}", file=sys.stderr)
    print_mapping({**asdict(report), "files": len(report.files)}, as_json)


def _note_coverage(catalogue: Any, centre: Any) -> None:
    """Say so where a cone lies outside of what the catalogue covers."""
    from catalog_tools.coverage import coverage_of

    coverage = coverage_of(catalogue)
    fraction = coverage.fraction_of_cone(*centre)
    if fraction < 0.99:
        text = f"the catalogue covers {100.0 * fraction:.3g}% of this cone (by {coverage.source})"
        print(f"note: {text}", file=sys.stderr)


def _numbers(option: str, text: str, count: int, example: str) -> Any:
    """Numbers parted by commas."""
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) != count:
        raise BadInput(option, text, f"{count} numbers such as {example}")
    return numbers


def _bytes(text: str) -> int:
    """A size such as 2GiB or 500MB."""
    from dask.utils import parse_bytes

    try:
        if not text[:1].isdigit():
            raise ValueError(text)
        return int(parse_bytes(text))
    except (ValueError, OverflowError):
        raise BadInput("--memory", text, "a size such as 2GiB or 500MB") from None


def _stages(quiet: bool) -> Any:
    """A bar for each stage on stderr; nothing when it is no terminal or not wanted."""
    from pipeline.commands.pages import stage_progress

    return stage_progress(quiet or not sys.stderr.isatty())


def _write_table(rows: Any, output: Path | None) -> None:
    """A table to a .csv or .parquet file, or as CSV to the screen."""
    import pyarrow.csv
    import pyarrow.parquet

    if output is None:
        pyarrow.csv.write_csv(rows, sys.stdout.buffer)
    elif output.exists():
        raise BadInput("-o", str(output), "a path that does not exist yet")
    elif output.suffix == ".csv":
        pyarrow.csv.write_csv(rows, output)
    elif output.suffix == ".parquet":
        pyarrow.parquet.write_table(rows, output)
    else:
        raise BadInput("-o", str(output), "a path ending in .csv or .parquet")
