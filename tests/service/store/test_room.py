"""A job table that could not be opened: for lack of room, or for something else."""

from __future__ import annotations

import errno
from pathlib import Path
from typing import Any

import pytest

from service.store import database


@pytest.mark.parametrize(
    ("reason", "code", "full"),
    [
        ("unable to open database file", errno.ENOSPC, True),
        ("unable to open database file", errno.EDQUOT, True),
        ("unable to open database file", errno.EACCES, False),
        ("unable to open database file", 0, False),
        ("database or disk is full", 0, True),
        ("disk I/O error", 0, True),
        ("file is not a database", errno.ENOSPC, False),
    ],
)
def test_sqlite_says_or_hides_that_there_is_no_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, reason: str, code: int, full: bool
) -> None:
    """Where it only says that a file cannot be opened, one is written beside the table."""
    made = database.tempfile.TemporaryFile

    def temporary(**given: Any) -> Any:
        assert given["dir"] == tmp_path
        if code:
            raise OSError(code, "no")
        return made(**given)

    monkeypatch.setattr(database.tempfile, "TemporaryFile", temporary)
    assert database._no_room(str(tmp_path / "jobs.sqlite"), reason) is full
