"""The command line's `nightglass report scenes` and `report ledger`: error against run time."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from pipeline.commands.options import Json, Output, print_json


def report_scenes(
    output: Output = Path("report"),
    scene: Annotated[
        list[str] | None, typer.Option("--scene", help="only this scene (may be repeated)")
    ] = None,
    rungs: Annotated[
        str | None, typer.Option(help="accuracy targets, as accuracy.noise_fraction: 0.5,0.05")
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="smaller frames, two rungs")] = False,
    catalog: Annotated[
        Path | None, typer.Option(help="catalogue of stars; default: a synthetic one is made")
    ] = None,
    as_json: Json = False,
) -> None:
    """Error against run time of whole scenes, and of each approximation: page, JSON, figures."""
    from pipeline.commands.pages import stage_progress
    from pipeline.studies.scenes.report import report_scenes as study_all
    from pipeline.studies.scenes.tables import print_study

    with stage_progress(as_json or not sys.stderr.isatty()) as listen:
        study = study_all(output, tuple(scene or ()), rungs, quick, catalog, listen)
    if as_json:
        print_json(study)
    else:
        print_study(study)


def report_ledger(
    output: Output = Path("ledger"),
    rule: Annotated[
        list[str] | None, typer.Option("--rule", help="only this component (may be repeated)")
    ] = None,
    as_json: Json = False,
) -> None:
    """Every rule of the plan measured: the bound, the error of an omission, the seconds saved."""
    from pipeline.commands.pages import stage_progress
    from pipeline.studies.ledger.report import print_ledger
    from pipeline.studies.ledger.report import report_ledger as study_all

    with stage_progress(as_json or not sys.stderr.isatty()) as listen:
        study = study_all(output, tuple(rule or ()), listen)
    if as_json:
        print_json(study)
    else:
        print_ledger(study)
