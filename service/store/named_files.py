"""Uploaded files that stored scenes name: found, and kept as long as a job needs them."""

from __future__ import annotations

import json
import re

import sqlalchemy as sa

from pipeline.spec.load import path_holders
from service.problems import NotAllowed, NotReady
from service.store.tables import jobs, uploads

PREFIX = "upload:"
ID = re.compile(r"[0-9a-f]{32}\.[a-z0-9]{1,8}")
NO_FILES = "upload:ID of a file sent to /v1/files; no path or URL is taken"
NO_SUCH = "upload:ID of a file of your team's; there is no such file (GET /v1/files lists them)"
UNENDED = ("PENDING", "QUEUED", "EXECUTING")
MOST_NAMED = 8


def files_in(text: str) -> dict[str, str]:
    """Ids of the uploads that a stored scene or sweep names, each with a field that names it."""
    if PREFIX not in text:
        return {}
    data = json.loads(text)
    found = {}
    for holders in (path_holders(data), path_holders(data.get("scene"))):  # of a sweep: its base
        for name, holder, key in holders:
            value = holder.get(key)
            if isinstance(value, str) and value.startswith(PREFIX):
                found[value.removeprefix(PREFIX)] = name
    return found


def check_files(db: sa.Connection, team: str, text: str) -> None:
    """NotAllowed where a scene that is about to be stored names a file that is gone."""
    for file_id, name in files_in(text).items():
        query = sa.select(uploads.c.id).where(uploads.c.team == team, uploads.c.id == file_id)
        if db.execute(query).first() is None:
            mistake = (name, PREFIX + file_id, NO_SUCH)
            raise NotAllowed(f"{name}: allowed: {NO_SUCH}", (mistake,))


def check_unused(db: sa.Connection, team: str, file_id: str) -> None:
    """NotReady where a job that has not ended names the file: it keeps what it needs."""
    query = (
        sa.select(jobs.c.id, jobs.c.scene)
        .where(
            jobs.c.team == team,
            jobs.c.phase.in_(UNENDED),
            ~jobs.c.deleted,
            jobs.c.scene.contains(PREFIX + file_id),
        )
        .order_by(jobs.c.number)
    )
    held = [row.id for row in db.execute(query) if file_id in files_in(row.scene)]
    if held:
        named = ", ".join(held[:MOST_NAMED])
        more = f" and {len(held) - MOST_NAMED} more" if len(held) > MOST_NAMED else ""
        raise NotReady(f"jobs that have not ended name this file: {named}{more}")
