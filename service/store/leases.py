"""The dispatcher's lease: one process at a time runs jobs, and another takes over when it ends."""

from __future__ import annotations

import logging

import sqlalchemy as sa

from service.store.database import now_s, writing
from service.store.tables import leases

NAME = "dispatcher"
log = logging.getLogger("nightglass.service")


def take(engine: sa.Engine, holder: str, lease_s: float) -> bool:
    """Take or renew the lease; False where another holds it. A new holder raises the epoch.

    A lease that ends later than one taken now would was written by a clock that ran ahead, and
    counts as expired: nobody would run jobs for as long as it did.
    """
    with writing(engine) as db:
        now = now_s(db)
        found = db.execute(sa.select(leases).where(leases.c.name == NAME)).first()
        until = now + lease_s
        if found is None:
            row = {"name": NAME, "holder": holder, "epoch": 1, "until_s": until}
            db.execute(sa.insert(leases), [row])
            return True
        if found.holder != holder and found.until_s > now:
            if found.until_s <= until:
                return False
            ahead_s = found.until_s - until
            log.warning("the lease ends %.0f s too late (a clock ran ahead): taken over", ahead_s)
        epoch = found.epoch + (found.holder != holder)
        values = {"holder": holder, "epoch": epoch, "until_s": until}
        db.execute(sa.update(leases).where(leases.c.name == NAME).values(**values))
        return True


def give_up(engine: sa.Engine, holder: str) -> None:
    """Let go of the lease, so that another process need not wait for its end."""
    mine = (leases.c.name == NAME, leases.c.holder == holder)
    with writing(engine) as db:
        db.execute(sa.update(leases).where(*mine).values(until_s=0.0))


def holds(db: sa.Connection, holder: str) -> bool:
    """Whether this holder has the lease now."""
    mine = (leases.c.name == NAME, leases.c.holder == holder, leases.c.until_s > now_s(db))
    return db.execute(sa.select(leases.c.epoch).where(*mine)).first() is not None
