"""A job table that could not be opened: for lack of room, or for something else."""

from __future__ import annotations

import errno
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

from pipeline.errors import DiskFull
from service.store import database


@pytest.mark.parametrize(
    ("reason", "code", "told"),
    [
        ("unable to open database file", errno.ENOSPC, "full (No space left on device); make room"),
        ("unable to open database file", errno.EDQUOT, "full (Disk quota exceeded); make room"),
        ("unable to open database file", errno.EACCES, None),
        ("unable to open database file", 0, None),
        ("database or disk is full", 0, "full (No space left on device); make room"),
        ("disk I/O error", 0, "full (No space left on device); make room"),
        ("file is not a database", errno.ENOSPC, None),
    ],
)
def test_sqlite_says_or_hides_that_there_is_no_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, reason: str, code: int, told: str | None
) -> None:
    """Where it only says that a file cannot be opened, one is written beside the table, and what
    that met is told."""
    made = database.tempfile.TemporaryFile

    def temporary(**given: Any) -> Any:
        assert given["dir"] == tmp_path
        if code:
            raise OSError(code, "no")
        return made(**given)

    monkeypatch.setattr(database.tempfile, "TemporaryFile", temporary)
    url = sa.make_url(f"sqlite:///{tmp_path}/jobs.sqlite")
    error = sa.exc.OperationalError("begin", {}, Exception(reason))
    said = database._not_opened(error, url, "sqlite", "jobs.sqlite")
    assert isinstance(said, DiskFull) == (told is not None)
    assert (told or f"a database that answers; {reason}") in str(said)
