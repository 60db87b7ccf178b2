"""The first form: one table of jobs, without teams."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision, down_revision = "0001", None


def upgrade() -> None:
    """Nothing in an empty database: the second form makes its tables anew."""
    if not sa.inspect(op.get_bind()).has_table("jobs"):
        return
