"""The client's progress bar at a terminal: a job's phase and tiles, or the bytes of a fetch."""

from __future__ import annotations

import sys
from typing import Any

import pytest

from pipeline.commands import pages
from service.client_bar import bar


def test_a_job_and_a_fetch(monkeypatch: pytest.MonkeyPatch) -> None:
    """A fetch tells no phase, and a job that waits no tiles: both are shown, none is an error."""
    drawn: list[Any] = []

    def kept(unit: str) -> Any:
        drawn.append(pages.Progress(disable=True))
        return drawn[-1]

    monkeypatch.setattr(pages, "progress_bar", kept)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    for name, phase, done, total, told in (
        ("leo", {"phase": "QUEUED"}, None, None, "leo: queued"),
        ("leo", {"phase": "EXECUTING"}, 2, 8, "leo: executing"),
        ("fetching leo", {}, 3, 40, "fetching leo"),
    ):
        with bar(name) as listen:
            assert listen is not None
            listen({**phase, "tiles_done": done, "tiles_total": total})
        (task,) = drawn[-1].tasks
        assert (task.description, task.completed, task.total) == (told, done or 0, total)


def test_none_where_no_one_looks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: False)
    with bar("leo") as listen:
        assert listen is None
