"""The command line's `nightglass report accuracy`: engines and peers."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pipeline.commands.options import Json, Output, print_json
from pipeline.commands.pages import is_quiet, stage_progress
from pipeline.studies.accuracy import report as accuracy
from pipeline.studies.accuracy import tables as accuracy_tables
from pipeline.studies.written import with_nulls


def report_accuracy(
    output: Output = Path("accuracy"),
    stars: Annotated[int, typer.Option(min=1, max=10_000_000, help="stars to time")] = 20_000,
    quick: Annotated[bool, typer.Option("--quick", help="less work, fewer settings")] = False,
    peers: Annotated[bool, typer.Option(help="other simulators, where installed")] = True,
    satsim_python: Annotated[str | None, typer.Option(help="a Python that has SatSim")] = None,
    as_json: Json = False,
) -> None:
    """Error against CPU time of every engine and installed peer: JSON, table, figure."""
    with stage_progress(is_quiet(as_json)) as listen:
        study = accuracy.report_accuracy(
            output, stars, quick=quick, peers=peers, satsim_python=satsim_python, progress=listen
        )
    if as_json:
        print_json(with_nulls(study))
    else:
        accuracy_tables.print_study(study)
