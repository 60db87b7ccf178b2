"""The command line's `nightglass export`: frames and labels in others' formats."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pipeline.commands.options import Output
from pipeline.export.formats import FORMATS, ExportRequest, export_product

NAMED = f"{', '.join(FORMATS[:-1])} or {FORMATS[-1]}"


def export(
    product: Annotated[Path, typer.Argument(help="product directory", metavar="PRODUCT")],
    to: Annotated[str, typer.Option("--to", help=NAMED)],
    output: Output,
    frame: Annotated[int | None, typer.Option(min=0, help="one frame; default: all")] = None,
    layer: Annotated[str, typer.Option(help="which layer")] = "dn",
    stars_snr: Annotated[
        float | None,
        typer.Option(help="label stars from this signal-to-noise on; default: targets alone"),
    ] = None,
    threshold: Annotated[
        float, typer.Option(help="least light of a mask's pixel, in sigma of an empty pixel")
    ] = 1.0,
    light: Annotated[
        str, typer.Option(help="masks' classes from `response` and path, or noise-free `layers`")
    ] = "response",
    fps: Annotated[float, typer.Option(help="frames a second of a movie")] = 5.0,
) -> None:
    """Write frames as FITS (WCS, times), PNG, GIF, MP4; labels as SatNet, COCO, or masks."""
    request = ExportRequest(frame, layer, stars_snr, threshold, light, fps)
    for path in export_product(product, to, output, request):
        print(path)
