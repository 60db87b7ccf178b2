"""The command line's `nightglass report ledger`: each rule of the plan measured."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pipeline.commands.options import Json, Output, print_json
from pipeline.commands.pages import is_quiet, stage_progress
from pipeline.studies.ledger import report as ledger
from pipeline.studies.written import with_nulls


def report_ledger(
    output: Output = Path("ledger"),
    rule: Annotated[
        list[str] | None, typer.Option("--rule", help="only this component (may be repeated)")
    ] = None,
    as_json: Json = False,
) -> None:
    """Every rule of the plan measured: the bound, the error of an omission, the seconds saved."""
    with stage_progress(is_quiet(as_json)) as listen:
        study = ledger.report_ledger(output, tuple(rule or ()), listen)
    if as_json:
        print_json(with_nulls(study))
    else:
        ledger.print_ledger(study)
