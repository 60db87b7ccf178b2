"""The command line's `catalog demo`: synthetic catalogues."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from catalog_tools.documents import JsonObject
from catalog_tools.errors import BadInput
from catalog_tools.info import info as facts
from catalog_tools.synthetic.csv import write_csv_files
from catalog_tools.synthetic.sample import make_sample
from catalog_tools.synthetic.synthetic import make_demo
from pipeline.commands.catalog.shared import Overwrite, numbers
from pipeline.commands.options import Json, Output, Workers, print_mapping
from pipeline.commands.pages import is_quiet, stage_progress


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
    if rows is not None and (field or faintest_g_mag != 10.0):
        raise BadInput("--rows", rows, "without --faintest and --field: a sample goes to G = 21")
    if as_csv:
        _write_csv(output, rows, seed, workers, overwrite, as_json)
        return
    fields = [numbers("--field", text, 4, "56.75,24.1,1.0,20") for text in field or []]
    with stage_progress(is_quiet(as_json)) as progress:
        shared: JsonObject = {
            "seed": seed,
            "workers": workers or 2,
            "progress": progress,
            "overwrite": overwrite,
        }
        if rows is not None:
            made = make_sample(output, rows, **shared)
        else:
            made = make_demo(output, faintest_g_mag=faintest_g_mag, deep_fields=fields, **shared)
    print_mapping(facts(made.catalogue), as_json)


def _write_csv(
    output: Path, rows: int | None, seed: int, workers: int | None, overwrite: bool, as_json: bool
) -> None:
    if rows is None or overwrite:
        raise BadInput("--as-csv", True, "together with --rows N, and without --overwrite")
    with stage_progress(is_quiet(as_json)) as progress:
        written = write_csv_files(output, rows, seed=seed, workers=workers, progress=progress)
    print_mapping(asdict(written), as_json)
