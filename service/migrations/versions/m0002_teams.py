"""Teams, keys, audit, usage, uploads, leases; jobs with seals. Jobs of the first form go along.

Everything is written out here as it was in the second form: later forms change
service/store/tables.py, and this file must not change with it.
"""

from __future__ import annotations

import json
from typing import Any

import sqlalchemy as sa
from alembic import op

revision, down_revision = "0002", "0001"
SAME = (
    "number",
    "id",
    "name",
    "phase",
    "scene",
    "idempotency_key",
    "body_sha256",
    "submitted_s",
    "started_s",
    "ended_s",
    "tiles_done",
    "tiles_total",
    "attempt",
    "deaths",
    "content_digest",
    "version",
)
# The audit table only grows: the database itself refuses every other change.
APPEND_ONLY = {
    "sqlite": [
        "CREATE TRIGGER audit_no_update BEFORE UPDATE ON audit "
        "BEGIN SELECT RAISE(ABORT, 'the audit table is append-only'); END",
        "CREATE TRIGGER audit_no_delete BEFORE DELETE ON audit "
        "BEGIN SELECT RAISE(ABORT, 'the audit table is append-only'); END",
    ],
    "postgresql": [
        "CREATE FUNCTION audit_is_append_only() RETURNS trigger LANGUAGE plpgsql AS "
        "$$ BEGIN RAISE EXCEPTION 'the audit table is append-only'; END $$",
        "CREATE TRIGGER audit_append_only BEFORE UPDATE OR DELETE OR TRUNCATE ON audit "
        "FOR EACH STATEMENT EXECUTE FUNCTION audit_is_append_only()",
    ],
}


def upgrade() -> None:
    """Make the tables, and take the rows of an earlier one over as team `local`."""
    db = op.get_bind()
    old = [dict(row._mapping) for row in db.exec_driver_sql("SELECT * FROM jobs")]
    op.drop_table("jobs")
    jobs, counters = _make_jobs()
    _make_audit(db.dialect.name)
    _make_the_rest()
    last = max((row["number"] for row in old), default=0)
    op.bulk_insert(counters, [{"name": "jobs", "value": last}])
    if old:
        op.bulk_insert(jobs, [_taken_over(row) for row in old])


def _make_jobs() -> tuple[sa.Table, sa.Table]:
    jobs = op.create_table(
        "jobs",
        sa.Column("number", sa.BigInteger, primary_key=True, autoincrement=False),
        sa.Column("id", sa.String(32), nullable=False, unique=True),
        sa.Column("team", sa.String(64), nullable=False),
        sa.Column("owner", sa.String(128), nullable=False),
        sa.Column("kind", sa.String(8), nullable=False),
        sa.Column("name", sa.String(128), nullable=False),
        sa.Column("run_id", sa.String(128)),
        sa.Column("phase", sa.String(9), nullable=False),
        sa.Column("scene", sa.Text, nullable=False),
        sa.Column("scene_crc", sa.BigInteger, nullable=False),
        sa.Column("idempotency_key", sa.String(255)),
        sa.Column("body_sha256", sa.String(64), nullable=False),
        sa.Column("pixel_frames", sa.BigInteger, nullable=False),
        sa.Column("bytes_kept", sa.BigInteger, nullable=False),
        sa.Column("submitted_s", sa.Double, nullable=False),
        sa.Column("started_s", sa.Double),
        sa.Column("ended_s", sa.Double),
        sa.Column("destruction_s", sa.Double),
        sa.Column("duration_s", sa.Double),
        sa.Column("tiles_done", sa.Integer),
        sa.Column("tiles_total", sa.Integer),
        sa.Column("attempt", sa.Integer, nullable=False),
        sa.Column("deaths", sa.Integer, nullable=False),
        sa.Column("cancel_asked", sa.Boolean, nullable=False),
        sa.Column("deleted", sa.Boolean, nullable=False),
        sa.Column("error", sa.Text),
        sa.Column("content_digest", sa.String(64)),
        sa.Column("version", sa.Integer, nullable=False),
        sa.Column("seal", sa.BigInteger, nullable=False),
        sa.UniqueConstraint("team", "idempotency_key", name="one_job_per_key"),
    )
    op.create_index("jobs_by_team", "jobs", ["team", "phase", "bytes_kept"])
    op.create_index("jobs_by_phase", "jobs", ["phase", "number"])
    op.create_index("jobs_to_remove", "jobs", ["deleted", "number"])
    counters = op.create_table(
        "counters",
        sa.Column("name", sa.String(16), primary_key=True),
        sa.Column("value", sa.BigInteger, nullable=False),
    )
    return jobs, counters


def _make_audit(kind: str) -> None:
    number = sa.BigInteger().with_variant(sa.Integer, "sqlite")
    op.create_table(
        "audit",
        sa.Column("number", number, primary_key=True, autoincrement=True),
        sa.Column("at_s", sa.Double, nullable=False),
        sa.Column("team", sa.String(64), nullable=False),
        sa.Column("actor", sa.String(128), nullable=False),
        sa.Column("action", sa.String(24), nullable=False),
        sa.Column("thing", sa.String(64)),
        sa.Column("detail", sa.String(400)),
    )
    op.create_index("audit_by_thing", "audit", ["thing", "action"])
    for statement in APPEND_ONLY[kind]:
        op.execute(statement)


def _make_the_rest() -> None:
    op.create_table(
        "keys",
        sa.Column("id", sa.String(16), primary_key=True),
        sa.Column("team", sa.String(64), nullable=False),
        sa.Column("name", sa.String(128), nullable=False),
        sa.Column("hash", sa.String(255), nullable=False),
        sa.Column("created_s", sa.Double, nullable=False),
        sa.Column("expires_s", sa.Double),
        sa.Column("revoked_s", sa.Double),
    )
    op.create_table(
        "uploads",
        sa.Column("team", sa.String(64), primary_key=True),
        sa.Column("id", sa.String(80), primary_key=True),
        sa.Column("name", sa.String(128), nullable=False),
        sa.Column("bytes", sa.BigInteger, nullable=False),
        sa.Column("created_s", sa.Double, nullable=False),
    )
    op.create_table(
        "usage",
        sa.Column("team", sa.String(64), primary_key=True),
        sa.Column("day", sa.Integer, primary_key=True),
        sa.Column("jobs", sa.BigInteger, nullable=False),
        sa.Column("pixel_frames", sa.BigInteger, nullable=False),
    )
    op.create_table(
        "leases",
        sa.Column("name", sa.String(16), primary_key=True),
        sa.Column("holder", sa.String(64), nullable=False),
        sa.Column("epoch", sa.BigInteger, nullable=False),
        sa.Column("until_s", sa.Double, nullable=False),
    )


def _taken_over(row: dict[str, Any]) -> dict[str, Any]:
    scene = json.loads(row["scene"])
    rows, columns = scene["sensor"]["shape"] if "sensor" in scene else (0, 0)
    frames = scene.get("exposure", {}).get("frames", 1)
    error = row["error"]
    return {name: row[name] for name in SAME} | {
        "team": "local",
        "owner": "local",
        "kind": "scene",
        "run_id": None,
        "scene_crc": 0,  # this and the seal go in the third form
        "seal": 0,
        "pixel_frames": rows * columns * frames,
        "bytes_kept": 0,
        "destruction_s": None,
        "duration_s": None,
        "error": error if error is None or isinstance(error, str) else json.dumps(error),
        "cancel_asked": bool(row["cancel_asked"]),
        "deleted": bool(row["deleted"]),
    }
