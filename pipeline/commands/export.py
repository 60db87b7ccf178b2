"""The command line's `nightglass export` and `nightglass import`: others' formats, both ways."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pipeline.commands.options import Json, Output, print_json
from pipeline.lines import fold

if TYPE_CHECKING:
    from pipeline.importers.imported import Imported

import_app = typer.Typer(help="Scenes of other simulators.", no_args_is_help=True)


def export(
    product: Annotated[Path, typer.Argument(help="product directory", metavar="PRODUCT")],
    to: Annotated[str, typer.Option("--to", help="fits, png, gif, mp4, satnet, coco or masks")],
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
    from pipeline.export.formats import ExportRequest, export_product

    request = ExportRequest(frame, layer, stars_snr, threshold, light, fps)
    for path in export_product(product, to, output, request):
        print(path)


SceneOut = Annotated[Path, typer.Option("-o", "--output", help="the scene file to write (YAML)")]
PeerFile = Annotated[Path, typer.Argument(help="the other simulator's scene file", metavar="FILE")]


@import_app.command("satsim")
def import_satsim(
    file: PeerFile,
    output: SceneOut,
    epoch: Annotated[str, typer.Option(help="UTC of the first exposure, where FILE has none")] = (
        "2019-07-20T09:00:00Z"
    ),
    catalogue: Annotated[str | None, typer.Option(help="star catalogue; default: no stars")] = None,
    seed: Annotated[int, typer.Option(min=0, help="for values that FILE draws at random")] = 0,
    as_json: Json = False,
) -> None:
    """A SatSim configuration (JSON) as a scene; prints what was converted and what was left."""
    from pipeline.importers.satsim import read_satsim

    _write(read_satsim(file, epoch, catalogue, seed), output, as_json)


@import_app.command("simsit")
def import_simsit(
    file: PeerFile,
    output: SceneOut,
    epoch: Annotated[str, typer.Option(help="UTC of the first exposure")] = "2010-07-01T05:00:00Z",
    catalogue: Annotated[str | None, typer.Option(help="star catalogue; default: no stars")] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="default: FILE's own")] = None,
    as_json: Json = False,
) -> None:
    """A SImSiT configuration (YAML) as a scene; prints what was converted and what was left."""
    from pipeline.importers.simsit import read_simsit

    _write(read_simsit(file, epoch, catalogue, seed), output, as_json)


def _write(imported: Imported, output: Path, as_json: bool) -> None:
    imported.write(output)
    if as_json:
        print_json({"scene": str(output), **imported.as_dict()})
        return
    print(output)
    for line in imported.lines():
        print(fold(line, "      ", "  "))
