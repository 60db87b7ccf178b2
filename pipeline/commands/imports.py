"""The command line's `nightglass import ...`: scenes of other simulators."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pipeline.commands.options import Json, print_json
from pipeline.importers.imported import Imported
from pipeline.importers.satsim import read_satsim
from pipeline.importers.simsit import read_simsit
from pipeline.lines import fold

import_app = typer.Typer(
    help="Scenes of other simulators.", no_args_is_help=True, add_completion=False
)
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
    """A SatSim configuration (JSON) as a scene; prints what was converted and what was not."""
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
    """A SImSiT configuration (YAML) as a scene; prints what was converted and what was not."""
    _write(read_simsit(file, epoch, catalogue, seed), output, as_json)


def _write(imported: Imported, output: Path, as_json: bool) -> None:
    imported.write(output)
    if as_json:
        print_json({"scene": str(output), **imported.as_dict()})
        return
    print(output)
    for line in imported.lines():
        print(fold(line, "      ", "  "))
