"""The command line's `nightglass report scenes`: whole scenes, error against run time."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pipeline.commands.options import Json, Output, print_json
from pipeline.commands.pages import is_quiet, stage_progress
from pipeline.studies.scenes import report as scenes
from pipeline.studies.scenes import tables as scene_tables
from pipeline.studies.written import with_nulls


def report_scenes(
    output: Output = Path("report"),
    scene: Annotated[
        list[str] | None, typer.Option("--scene", help="only this scene (may be repeated)")
    ] = None,
    levels: Annotated[
        str | None, typer.Option(help="accuracy targets, as accuracy.noise_fraction: 0.5,0.05")
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="smaller frames, two levels")] = False,
    catalog: Annotated[
        Path | None, typer.Option(help="catalogue of stars; default: a synthetic one is made")
    ] = None,
    as_json: Json = False,
) -> None:
    """Error against run time of whole scenes, and of each approximation: page, JSON, figures."""
    with stage_progress(is_quiet(as_json)) as listen:
        study = scenes.report_scenes(output, tuple(scene or ()), levels, quick, catalog, listen)
    if as_json:
        print_json(with_nulls(study))
    else:
        scene_tables.print_study(study)
