"""The data folder that a job table is of: the jobs of another have their files elsewhere."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

import sqlalchemy as sa

from pipeline.errors import BadInput
from service.store.database import writing
from service.store.tables import counters

NAME = "home"  # in the table of counters
FILE = "home.id"


def check_home(engine: sa.Engine, home: Path) -> None:
    """Tie a job table to a data folder, once. BadInput where it is tied to another."""
    own = int.from_bytes(made_once(home / FILE)[:7])
    with writing(engine) as db:
        found = db.execute(sa.select(counters.c.value).where(counters.c.name == NAME)).scalar()
        if found is None:
            db.execute(sa.insert(counters), [{"name": NAME, "value": own}])
            return
    if found != own:
        shown = engine.url.render_as_string(hide_password=True)
        allowed = f"a job table of its own for {home}: this one has the jobs of another data folder"
        raise BadInput("NIGHTGLASS_DATABASE", shown, f"{allowed} (which has another {FILE})")


def made_once(path: Path) -> bytes:
    """32 random bytes that a file holds, made by whoever comes first."""
    if not path.exists():
        part = path.with_name(f".{path.name}-{os.getpid()}-{os.urandom(4).hex()}")
        with os.fdopen(os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
            file.write(os.urandom(32))
        with contextlib.suppress(FileExistsError):
            path.hardlink_to(part)
        part.unlink()
    return path.read_bytes()
