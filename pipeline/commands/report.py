"""The command line's `nightglass report ...` and `selftest`: errors, run times, finders."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from pipeline.commands.options import Json, Output, print_json
from pipeline.commands.pages import stage_progress
from pipeline.commands.product import ProductPath
from pipeline.studies.accuracy import report as accuracy
from pipeline.studies.accuracy import tables as accuracy_tables
from pipeline.studies.detection import study as detection
from pipeline.studies.detection import tables as detection_tables
from pipeline.studies.ledger import report as ledger
from pipeline.studies.scenes import report as scenes
from pipeline.studies.scenes import tables as scene_tables
from pipeline.studies.selftest.report import as_data, chosen, markdown, print_table, run_cases


def report_accuracy(
    output: Output = Path("accuracy"),
    stars: Annotated[int, typer.Option(min=1, max=10_000_000, help="stars to time")] = 20_000,
    quick: Annotated[bool, typer.Option("--quick", help="less work, fewer settings")] = False,
    peers: Annotated[bool, typer.Option(help="other simulators, where installed")] = True,
    satsim_python: Annotated[str | None, typer.Option(help="a Python that has SatSim")] = None,
    as_json: Json = False,
) -> None:
    """Error against CPU time of every engine and installed peer: JSON, table, figure."""
    with stage_progress(as_json or not sys.stderr.isatty()) as listen:
        study = accuracy.report_accuracy(
            output, stars, quick=quick, peers=peers, satsim_python=satsim_python, progress=listen
        )
    if as_json:
        print_json(study)
    else:
        accuracy_tables.print_study(study)


def report_detection(
    product: ProductPath,
    output: Output = Path("detection"),
    threshold: Annotated[float, typer.Option(help="least signal-to-noise, in sigma")] = 5.0,
    frames: Annotated[int | None, typer.Option(min=1, help="the first so many")] = None,
    as_json: Json = False,
) -> None:
    """Completeness and false alarms of public finders on a product: JSON, table, figure."""
    with stage_progress(as_json or not sys.stderr.isatty()) as listen:
        study = detection.report_detection(product, output, threshold, frames, listen)
    if as_json:
        print_json(study)
    else:
        detection_tables.print_study(study)


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
    with stage_progress(as_json or not sys.stderr.isatty()) as listen:
        study = scenes.report_scenes(output, tuple(scene or ()), levels, quick, catalog, listen)
    if as_json:
        print_json(study)
    else:
        scene_tables.print_study(study)


def report_ledger(
    output: Output = Path("ledger"),
    rule: Annotated[
        list[str] | None, typer.Option("--rule", help="only this component (may be repeated)")
    ] = None,
    as_json: Json = False,
) -> None:
    """Every rule of the plan measured: the bound, the error of an omission, the seconds saved."""
    with stage_progress(as_json or not sys.stderr.isatty()) as listen:
        study = ledger.report_ledger(output, tuple(rule or ()), listen)
    if as_json:
        print_json(study)
    else:
        ledger.print_ledger(study)


def selftest(
    only: Annotated[str | None, typer.Option(help="part of a case's name")] = None,
    page: Annotated[Path | None, typer.Option("--markdown", help="also write a page")] = None,
    as_json: Json = False,
) -> None:
    """Limiting cases against answers known from elsewhere. Exit 1 where one fails."""
    cases = chosen(only)
    with stage_progress(as_json or not sys.stderr.isatty()) as listen:
        outcomes = run_cases(cases, listen)
    if page is not None:
        page.write_text(markdown(outcomes), encoding="utf-8")
    if as_json:
        print_json(as_data(outcomes))
    else:
        print_table(outcomes)
    if not all(o.passed for o in outcomes):
        raise typer.Exit(1)
