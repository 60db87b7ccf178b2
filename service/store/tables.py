"""The tables: jobs, audit, keys, uploads, usage, leases."""

from __future__ import annotations

import sqlalchemy as sa

HEAD = "0003"  # the newest migration (service/migrations/versions)

metadata = sa.MetaData()
jobs = sa.Table(
    "jobs",
    metadata,
    sa.Column("number", sa.BigInteger, primary_key=True, autoincrement=False),
    sa.Column("id", sa.String(32), nullable=False, unique=True),
    sa.Column("team", sa.String(64), nullable=False),
    sa.Column("owner", sa.String(128), nullable=False),
    sa.Column("kind", sa.String(8), nullable=False),
    sa.Column("name", sa.String(128), nullable=False),
    sa.Column("run_id", sa.String(128)),
    sa.Column("phase", sa.String(9), nullable=False),
    sa.Column("scene", sa.Text, nullable=False),
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
    sa.UniqueConstraint("team", "idempotency_key", name="one_job_per_key"),
    sa.Index("jobs_by_team", "team", "phase", "bytes_kept"),
    sa.Index("jobs_by_phase", "phase", "number"),
    sa.Index("jobs_to_remove", "deleted", "number"),
)
counters = sa.Table(
    "counters",
    metadata,
    sa.Column("name", sa.String(16), primary_key=True),
    sa.Column("value", sa.BigInteger, nullable=False),
)
audit = sa.Table(
    "audit",
    metadata,
    sa.Column(
        "number",
        sa.BigInteger().with_variant(sa.Integer, "sqlite"),
        primary_key=True,
        autoincrement=True,
    ),
    sa.Column("at_s", sa.Double, nullable=False),
    sa.Column("team", sa.String(64), nullable=False),
    sa.Column("actor", sa.String(128), nullable=False),
    sa.Column("action", sa.String(24), nullable=False),
    sa.Column("thing", sa.String(64)),
    sa.Column("detail", sa.String(400)),
    sa.Index("audit_by_thing", "thing", "action"),
)
keys = sa.Table(
    "keys",
    metadata,
    sa.Column("id", sa.String(16), primary_key=True),
    sa.Column("team", sa.String(64), nullable=False),
    sa.Column("name", sa.String(128), nullable=False),
    sa.Column("hash", sa.String(255), nullable=False),
    sa.Column("created_s", sa.Double, nullable=False),
    sa.Column("expires_s", sa.Double),
    sa.Column("revoked_s", sa.Double),
)
uploads = sa.Table(
    "uploads",
    metadata,
    sa.Column("team", sa.String(64), primary_key=True),
    sa.Column("id", sa.String(80), primary_key=True),
    sa.Column("name", sa.String(128), nullable=False),
    sa.Column("bytes", sa.BigInteger, nullable=False),
    sa.Column("created_s", sa.Double, nullable=False),
)
usage = sa.Table(
    "usage",
    metadata,
    sa.Column("team", sa.String(64), primary_key=True),
    sa.Column("day", sa.Integer, primary_key=True),  # days since 1970-01-01, UTC
    sa.Column("jobs", sa.BigInteger, nullable=False),
    sa.Column("pixel_frames", sa.BigInteger, nullable=False),
)
leases = sa.Table(
    "leases",
    metadata,
    sa.Column("name", sa.String(16), primary_key=True),
    sa.Column("holder", sa.String(64), nullable=False),
    sa.Column("epoch", sa.BigInteger, nullable=False),
    sa.Column("until_s", sa.Double, nullable=False),
)
