"""The command line's `nightglass selftest`: limiting cases."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pipeline.commands.options import Json, print_json
from pipeline.commands.pages import is_quiet, stage_progress
from pipeline.errors import BadInput
from pipeline.studies.selftest.report import as_data, chosen, markdown, print_table, run_cases


def selftest(
    only: Annotated[str | None, typer.Option(help="part of a case's name")] = None,
    page: Annotated[Path | None, typer.Option("--markdown", help="also write a page")] = None,
    as_json: Json = False,
) -> None:
    """Limiting cases against answers known from elsewhere. Exit 1 where one fails."""
    cases = chosen(only)
    if page is not None and (page.is_dir() or not page.parent.is_dir()):
        raise BadInput("--markdown", str(page), "a file in a folder that exists")
    with stage_progress(is_quiet(as_json)) as listen:
        outcomes = run_cases(cases, listen)
    if page is not None:
        page.write_text(markdown(outcomes), encoding="utf-8")
    if as_json:
        print_json(as_data(outcomes))
    else:
        print_table(outcomes)
    if not all(o.passed for o in outcomes):
        raise typer.Exit(1)
