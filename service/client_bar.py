"""The client's progress bar: on stderr, where that is a terminal."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from catalog_tools.documents import JsonObject


@contextmanager
def bar(name: str, unit: str = "") -> Iterator[Callable[[JsonObject], None] | None]:
    """A listener for a job's facts (or bytes done and total, as MB) that shows them."""
    if not sys.stderr.isatty():
        yield None
        return
    from pipeline.commands.pages import progress_bar

    with progress_bar(unit) as shown:
        task = shown.add_task(name, total=None)

        def listen(facts: JsonObject) -> None:
            done, total = facts.get("tiles_done"), facts.get("tiles_total")
            told = f"{name}: {facts['phase'].lower()}" if "phase" in facts else name
            shown.update(task, description=told, completed=done or 0, total=total)

        yield listen
