"""`nightglass selftest`: run the cases and write them as a table, JSON, or a page of the docs."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

from catalog_tools.documents import JsonObject
from pipeline.errors import BadInput
from pipeline.lines import fold, markdown_table
from pipeline.studies.selftest import attitude, frames, light, many, places, stars
from pipeline.studies.selftest.case import LimitingCase, Outcome, every, run_case

HEADS = ("case", "what", "right answer by", "right", "ours", "error", "allowed", "s")


def all_cases() -> tuple[LimitingCase, ...]:
    """Every case, in the order of the page."""
    return every((places, attitude, light, frames, stars, many))


def chosen(pattern: str | None) -> tuple[LimitingCase, ...]:
    """Cases whose name holds a text; all without one. BadInput where none does."""
    cases = all_cases()
    kept = tuple(c for c in cases if pattern is None or pattern in c.name)
    if not kept:
        raise BadInput("--only", pattern, f"part of a name: {', '.join(c.name for c in cases)}")
    return kept


def run_cases(
    cases: tuple[LimitingCase, ...], listen: Callable[[str, int, int], None] | None
) -> list[Outcome]:
    """Run cases one after another in a temporary folder; `listen` hears how many are done."""
    outcomes = []
    with tempfile.TemporaryDirectory(prefix="nightglass-selftest-") as folder:
        for i, one in enumerate(cases):
            if listen is not None:
                listen("cases", i, len(cases))
            outcomes.append(run_case(one, Path(folder) / one.name))
    return outcomes


def as_data(outcomes: list[Outcome]) -> JsonObject:
    """All outcomes as plain data."""
    return {
        "passed": all(o.passed for o in outcomes),
        "cases": [o.as_dict() for o in outcomes],
        "seconds": round(sum(o.seconds for o in outcomes), 2),
    }


def print_table(outcomes: list[Outcome]) -> None:
    """Each case, on stdout: its verdict and error, then the right answer and ours."""
    for o in outcomes:
        error = f"{o.found.error:.2g}" if o.found else "none"
        text = f"{o.case.name}: error {error}, allowed {o.case.allowed:.2g} {o.case.unit}"
        print(
            fold(f"{text}, {o.seconds:.2f} s", "        ", "ok      " if o.passed else "FAILED  ")
        )
        told = f"right {o.found.right}; ours {o.found.ours}" if o.found else str(o.fault)
        print(fold(told, "          "))
    failed = sum(not o.passed for o in outcomes)
    print(
        f"{len(outcomes) - failed} of {len(outcomes)} cases hold"
        + (f"; {failed} FAILED" if failed else "")
    )


def markdown(outcomes: list[Outcome]) -> str:
    """The page docs/extremes.md."""
    rows = [
        (
            o.case.name,
            o.case.what,
            o.case.source,
            o.found.right if o.found else "",
            o.found.ours if o.found else o.fault,
            f"{o.found.error:.2g}" if o.found else "-",
            f"{o.case.allowed:.2g} {o.case.unit}",
            f"{o.seconds:.2f}",
        )
        for o in outcomes
    ]
    return (
        "# Limiting cases\n\n"
        "What the product gives at the limits of arithmetic, geometry and formats, beside the "
        "right answer and where that comes from. Made by `nightglass selftest --markdown "
        "docs/extremes.md`; `nightglass selftest` runs the same cases on your machine.\n\n"
        + markdown_table(HEADS, rows, len(HEADS))
    )
