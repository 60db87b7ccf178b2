"""Jobs without checksums of their rows and scenes: the database has its own."""

from __future__ import annotations

from alembic import op

revision, down_revision = "0003", "0002"


def upgrade() -> None:
    """Drop both columns; the rows stay as they are."""
    op.drop_column("jobs", "seal")
    op.drop_column("jobs", "scene_crc")
