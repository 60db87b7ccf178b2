"""The command line: `nightglass render`, `plan`, `catalog` and the rest; imports lazily."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

os.environ.setdefault("MALLOC_TRIM_THRESHOLD_", "65536")

app = typer.Typer(
    name="nightglass",
    help="Electro-optical scene simulator for Space Domain Awareness.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
catalog = typer.Typer(help="Make and look at star catalogues.", no_args_is_help=True)
app.add_typer(catalog, name="catalog")

SceneFile = Annotated[Path, typer.Argument(help="scene file, YAML or JSON", metavar="SCENE")]
ProductPath = Annotated[Path, typer.Argument(help="product directory", metavar="PRODUCT")]
Output = Annotated[Path, typer.Option("-o", "--output", help="where the result goes")]
Json = Annotated[bool, typer.Option("--json", help="machine-readable result on stdout")]
Overrides = Annotated[
    list[str] | None, typer.Option("--set", help="override a key: --set sensor.read_noise_e=3")
]
SchedulerName = Annotated[
    str,
    typer.Option(help="threads, synchronous, processes, or the tcp:// or tls:// of a scheduler"),
]
Workers = Annotated[int | None, typer.Option(min=1, help="threads or processes; default: all")]


def main() -> None:
    """Run the command line; every error is one message and an exit code (DESIGN section 6)."""
    try:
        sys.exit(app(standalone_mode=False) or 0)
    except SystemExit:
        raise
    except BaseException as error:
        sys.exit(_explain(error))


def _explain(error: BaseException) -> int:
    """Print what went wrong on one line (or a few) and return the exit code."""
    from pipeline.errors import NightglassError, exit_code

    if isinstance(error, typer.Exit):
        return error.exit_code
    if hasattr(error, "format_message"):  # a usage error of the command line itself
        print(f"nightglass: {error.format_message()} (see --help)", file=sys.stderr)
        return 2
    if isinstance(error, KeyboardInterrupt | typer.Abort):
        print("nightglass: interrupted; go on with --resume", file=sys.stderr)
        return 130
    if isinstance(error, OSError) and error.errno is not None:
        print(f"nightglass: {error.filename or ''}: {error.strerror}", file=sys.stderr)
        return 3 if error.errno == 28 else 1
    if isinstance(error, NightglassError):
        print(f"nightglass: {error}", file=sys.stderr)
        return exit_code(error)
    if os.environ.get("NIGHTGLASS_DEBUG"):
        raise error
    name = type(error).__name__
    print(
        f"nightglass: internal fault: {name}: {error}\n"
        "(this is a bug; NIGHTGLASS_DEBUG=1 shows where)",
        file=sys.stderr,
    )
    return 1


@app.command()
def render(
    scene: SceneFile,
    output: Output,
    set_: Overrides = None,
    scheduler: SchedulerName = "threads",
    workers: Workers = None,
    resume: Annotated[bool, typer.Option("--resume", help="go on with an unfinished one")] = False,
    replace: Annotated[bool, typer.Option("--replace", help="remove an old product first")] = False,
    as_json: Json = False,
) -> None:
    """Render a scene into a product directory."""
    from pipeline.run import Options
    from pipeline.run import render as run
    from pipeline.spec.load import load_scene

    loaded = load_scene(scene, set_ or [])
    options = Options(scheduler, workers, resume, replace)
    with _progress(quiet=as_json) as listen:
        report = run(loaded, output, options, listen)
    if as_json:
        _print_json(report)
    else:
        _print_report(report, output)


@app.command()
def plan(scene: SceneFile, set_: Overrides = None, as_json: Json = False) -> None:
    """Show what a scene needs: tiles, shards, time, memory, and each decision with its bound."""
    from pipeline.run import plan_scene
    from pipeline.spec.load import load_scene

    summary = plan_scene(load_scene(scene, set_ or []))
    if as_json:
        _print_json(summary)
    else:
        from pipeline.pages import print_plan

        print_plan(summary)


@app.command()
def check(product: ProductPath, as_json: Json = False) -> None:
    """Verify a product whole: markers, chunk checksums, tables. Exit 3 if it is not complete."""
    from pipeline.store.product import check as verify

    verdict = verify(product)
    if as_json:
        _print_json(verdict.__dict__ | {"whole": verdict.whole})
    else:
        state = "whole" if verdict.whole else "complete" if verdict.complete else "NOT complete"
        print(f"{product}: {state}, {verdict.tiles} of {verdict.tiles_expected} tiles verified")
        for fault in verdict.faults:
            print(f"  damaged: {fault}")
    raise typer.Exit(0 if verdict.whole else 3)


@app.command()
def export(
    product: ProductPath,
    to: Annotated[str, typer.Option("--to", help="fits or png")],
    output: Output,
    frame: Annotated[int | None, typer.Option(min=0, help="one frame; default: all")] = None,
    layer: Annotated[str, typer.Option(help="which layer")] = "dn",
) -> None:
    """Write frames as FITS (with WCS and times) or PNG."""
    from pipeline.export.files import export_frames

    for path in export_frames(product, to, output, frame, layer):
        print(path)


@app.command()
def schema() -> None:
    """Print the JSON Schema of a scene."""
    from pipeline.spec.scene import Scene

    _print_json(Scene.model_json_schema(by_alias=True))


@app.command(name="color-fit")
def color_fit(scene: SceneFile, set_: Overrides = None, as_json: Json = False) -> None:
    """Show the colour correction from Gaia G to the sensor's band, with its residuals."""
    from pipeline.inputs.colour_fit import describe, gather_colour_fit, gather_colour_points
    from pipeline.inputs.folders import cache_folder
    from pipeline.run import gather_response
    from pipeline.spec.load import load_scene

    response, band, digest = gather_response(load_scene(scene, set_ or []))
    fit = gather_colour_fit(response, band, digest, cache_folder())
    described = describe(fit, gather_colour_points(response) if as_json else None)
    if as_json:
        _print_json(described)
    else:
        for key, value in described.items():
            print(f"{key:>24}  {value}")


@app.command()
def serve(
    host: Annotated[str, typer.Option(help="address to listen on")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535)] = 8765,
    home: Annotated[
        Path | None,
        typer.Option(help="folder of jobs, products, catalogues; default: NIGHTGLASS_HOME"),
    ] = None,
) -> None:
    """Serve the REST interface."""
    from importlib import import_module

    import_module("service.main").serve(host, port, home)


@app.command()
def demo(
    output: Output = Path("demo"),
    replace: Annotated[bool, typer.Option("--replace", help="remove an old demo first")] = False,
) -> None:
    """Make the demo catalogue, render the demo scene, and say what came out."""
    from pipeline.demo import run_demo
    from pipeline.pages import print_product

    with _progress(quiet=False) as listen:
        product, report = run_demo(output, replace, listen, lambda text: print(text, flush=True))
    _print_report(report, product)
    print_product(product)


@catalog.command(name="ingest")
def catalog_ingest(
    sources: Annotated[list[Path], typer.Argument(help="Gaia files: CSV, CSV.gz, FITS, VOTable")],
    output: Output,
    name: Annotated[str, typer.Option(help="name of the catalogue")] = "gaia_dr2",
    rows_per_leaf: Annotated[int, typer.Option(min=1, help="largest shard")] = 1_000_000,
    workers: Workers = None,
    overwrite: Annotated[bool, typer.Option("--overwrite")] = False,
    as_json: Json = False,
) -> None:
    """Repartition Gaia files into HEALPix Parquet shards (HATS)."""
    from catalog_tools.info import info
    from catalog_tools.ingest import ingest

    with _stages(quiet=as_json) as progress:
        report = ingest(
            list(sources), output, name=name, rows_per_leaf=rows_per_leaf, workers=workers,
            progress=progress, overwrite=overwrite,
        )  # fmt: skip
    result = {"rows_in": report.rows_in, "rejected": report.rejected} | info(report.catalogue)
    _print_mapping(result, as_json)


@catalog.command(name="info")
def catalog_info(
    catalogue: Annotated[Path, typer.Argument(metavar="CATALOGUE")], as_json: Json = False
) -> None:
    """What a catalogue holds."""
    from catalog_tools.catalogue import open_catalogue
    from catalog_tools.info import info

    _print_mapping(info(open_catalogue(catalogue)), as_json)


@catalog.command(name="cone")
def catalog_cone(
    catalogue: Annotated[Path, typer.Argument(metavar="CATALOGUE")],
    ra_deg: Annotated[float, typer.Option("--ra", min=-360, max=360)],
    dec_deg: Annotated[float, typer.Option("--dec", min=-90, max=90)],
    radius_deg: Annotated[float, typer.Option("--radius", min=0, max=180)],
    faintest_g_mag: Annotated[float | None, typer.Option("--faintest")] = None,
    epoch_jyear: Annotated[float | None, typer.Option("--epoch", help="Julian year")] = None,
    output: Annotated[Path | None, typer.Option("-o", help=".csv or .parquet")] = None,
) -> None:
    """Stars in a cone, to the screen (CSV) or a file."""
    from catalog_tools.catalogue import open_catalogue
    from catalog_tools.query import cone
    from pipeline.export.files import write_table

    rows, report = cone(
        open_catalogue(catalogue), ra_deg, dec_deg, radius_deg, faintest_g_mag, epoch_jyear
    )
    write_table(rows, output)
    print(f"{rows.num_rows} stars; {report}", file=sys.stderr)


@catalog.command(name="demo")
def catalog_demo(
    output: Output,
    faintest_g_mag: Annotated[float, typer.Option("--faintest", help="all-sky limit, G")] = 10.0,
    field: Annotated[
        list[str] | None, typer.Option(help="deep field RA,DEC,RADIUS,G in degrees and mag")
    ] = None,
    seed: Annotated[int, typer.Option(min=0)] = 2,
    overwrite: Annotated[bool, typer.Option("--overwrite")] = False,
    as_json: Json = False,
) -> None:
    """Make a SYNTHETIC all-sky catalogue from published star counts; no star of it is real."""
    from catalog_tools.info import info
    from catalog_tools.synthetic import make_demo

    fields = [_deep_field(text) for text in field or []]
    with _stages(quiet=as_json) as progress:
        report = make_demo(
            output, faintest_g_mag=faintest_g_mag, deep_fields=fields, seed=seed,
            progress=progress, overwrite=overwrite,
        )  # fmt: skip
    _print_mapping(info(report.catalogue), as_json)


def _deep_field(text: str) -> tuple[float, float, float, float]:
    from pipeline.errors import BadInput

    try:
        ra, dec, radius, faintest = (float(part) for part in text.split(","))
    except ValueError:
        raise BadInput("--field", text, "RA,DEC,RADIUS,G such as 56.75,24.1,1.0,20") from None
    return ra, dec, radius, faintest


def _progress(quiet: bool) -> Any:
    """A bar of tiles on stderr; nothing when it is no terminal or not wanted."""
    from pipeline.pages import tile_progress

    return tile_progress(quiet or not sys.stderr.isatty())


def _stages(quiet: bool) -> Any:
    from pipeline.pages import stage_progress

    return stage_progress(quiet or not sys.stderr.isatty())


def _print_json(value: Any) -> None:
    print(json.dumps(value, indent=2, allow_nan=False))


def _print_mapping(value: dict[str, Any], as_json: bool) -> None:
    if as_json:
        _print_json(value)
        return
    for key, item in value.items():
        print(f"{key:>28}  {item}")


def _print_report(report: dict[str, Any], product: Path) -> None:
    seconds = report["seconds"]
    errors = report["errors"]
    print(
        f"{product}: {report['frames']} frame(s), {report['tiles']} tile(s) "
        f"in {seconds['plan_s'] + seconds['draw_s'] + seconds['finish_s']:.2f} s"
    )
    print(
        f"  error bound at the noise floor {errors['bound_of_all_approximations_sigma']:.3f} sigma "
        f"(asked {errors['asked_sigma']}), WCS to {errors['wcs_residual_px']:.1e} px"
    )
    if errors["common_streak_px"] > 0:
        share = errors["common_streak_px"]
        print(f"  stars share streaks that differ by up to {share:.1e} px at their ends")
    if errors["wing_error_of_brightest_e"] > errors["asked_sigma"] * errors["noise_floor_e"]:
        print(
            f"  the brightest source ({errors['brightest_source_e']:.2g} e-) may err by "
            f"{errors['wing_error_of_brightest_e']:.2g} e- in a pixel of its wing: above the target"
        )
    for remark in report["remarks"]:
        print(f"  note: {remark}")
