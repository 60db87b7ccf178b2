"""Teams, keys, audit, usage, uploads, leases; jobs with seals. Jobs of the first form go along."""

from __future__ import annotations

import json
from typing import Any

import sqlalchemy as sa
from alembic import op

from service.tables import APPEND_ONLY, counters, jobs, metadata, scene_crc, seal_of

revision, down_revision = "0002", "0001"
SAME = (
    "number", "id", "name", "phase", "scene", "idempotency_key", "body_sha256", "submitted_s",
    "started_s", "ended_s", "tiles_done", "tiles_total", "attempt", "deaths", "content_digest",
    "version",
)  # fmt: skip


def upgrade() -> None:
    """Make the tables, and take the rows of an earlier one over as team `local`."""
    db = op.get_bind()
    old: list[dict[str, Any]] = []
    if sa.inspect(db).has_table("jobs"):
        old = [dict(row._mapping) for row in db.exec_driver_sql("SELECT * FROM jobs")]
        op.drop_table("jobs")
    metadata.create_all(db)
    for statement in APPEND_ONLY[db.dialect.name]:
        op.execute(statement)
    db.execute(
        sa.insert(counters),
        [{"name": "jobs", "value": max((row["number"] for row in old), default=0)}],
    )
    if old:
        db.execute(sa.insert(jobs), [_taken_over(row) for row in old])


def _taken_over(row: dict[str, Any]) -> dict[str, Any]:
    scene = json.loads(row["scene"])
    rows, columns = scene["sensor"]["shape"] if "sensor" in scene else (0, 0)
    frames = scene.get("exposure", {}).get("frames", 1)
    new = {name: row[name] for name in SAME} | {
        "team": "local", "owner": "local", "kind": "scene", "run_id": None,
        "scene_crc": scene_crc(row["scene"]), "pixel_frames": rows * columns * frames,
        "bytes_kept": 0, "destruction_s": None, "duration_s": None, "error": row["error"],
        "cancel_asked": bool(row["cancel_asked"]), "deleted": bool(row["deleted"]),
    }  # fmt: skip
    return new | {"seal": seal_of(new)}
