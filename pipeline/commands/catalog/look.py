"""The command line's `catalog info`, `forms` and `cone`: what a catalogue holds."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import pyarrow.csv
import pyarrow.parquet
import typer

from catalog_tools.catalogue import open_catalogue
from catalog_tools.coverage import coverage_of
from catalog_tools.errors import BadInput
from catalog_tools.forms import known_forms, load_form
from catalog_tools.info import info as facts
from catalog_tools.query import query
from catalog_tools.storage.durable import MAKE_ROOM, full_disk_told, whole_file
from pipeline.commands.catalog.shared import CataloguePlace, note, numbers
from pipeline.commands.options import Json, print_mapping
from pipeline.errors import check_new


def forms(as_json: Json = False) -> None:
    """The kinds of tables that are known by name."""
    print_mapping({name: load_form(name).description for name in known_forms()}, as_json)


def info(catalogue: CataloguePlace, as_json: Json = False) -> None:
    """What a catalogue holds."""
    print_mapping(facts(open_catalogue(catalogue)), as_json)


def cone(
    catalogue: CataloguePlace,
    ra_deg: Annotated[
        float | None, typer.Option("--ra", min=-360, max=360, help="centre of a cone, degrees")
    ] = None,
    dec_deg: Annotated[
        float | None, typer.Option("--dec", min=-90, max=90, help="centre of a cone, degrees")
    ] = None,
    radius_deg: Annotated[
        float | None, typer.Option("--radius", help="of the cone, degrees: above 0, up to 180")
    ] = None,
    corner: Annotated[
        list[str] | None, typer.Option(help="RA,DEC of a polygon; three or more, instead of a cone")
    ] = None,
    faintest_g_mag: Annotated[
        float | None, typer.Option("--faintest", help="G magnitude; default: all stars")
    ] = None,
    epoch_jyear: Annotated[
        float | None,
        typer.Option(
            "--epoch",
            help="Julian year at which stars must lie in it; the ra and dec written stay those of "
            "the catalogue's own epoch",
        ),
    ] = None,
    output: Annotated[Path | None, typer.Option("-o", help=".csv or .parquet")] = None,
) -> None:
    """Stars in a cone or a polygon, to the screen (CSV) or a file."""
    corners = [numbers("--corner", text, 2, "56.75,24.1") for text in corner or []]
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
    looked = f"{report.rows_read} rows in {report.leaves} shard(s)"
    print(f"{rows.num_rows} stars of {looked} ({report.bytes_read / 1e6:.3g} MB)", file=sys.stderr)
    if not corners:
        _note_coverage(opened, centre)


def _note_coverage(catalogue: Any, centre: Any) -> None:
    """Say so where a cone lies outside of what the catalogue covers."""
    coverage = coverage_of(catalogue)
    fraction = coverage.fraction_of_cone(*centre)
    if fraction < 0.99:
        text = f"the catalogue covers {100.0 * fraction:.3g}% of this cone (by {coverage.source})"
        note(text)


def _write_table(rows: Any, output: Path | None) -> None:
    """A table to a .csv or .parquet file, or as CSV to the screen."""
    if output is None:
        pyarrow.csv.write_csv(rows, sys.stdout.buffer)
        return
    check_new(output)
    if output.suffix not in (".csv", ".parquet"):
        raise BadInput("-o", str(output), "a path ending in .csv or .parquet")
    with full_disk_told(output, MAKE_ROOM), whole_file(output) as own:
        if output.suffix == ".csv":
            pyarrow.csv.write_csv(rows, own)
        else:
            pyarrow.parquet.write_table(rows, own)
