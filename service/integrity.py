"""Is the job table what was written? Rows against their seals, and against the audit table."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import sqlalchemy as sa

from pipeline.errors import BadInput
from service.jobs.jobs import job_of
from service.settings import read_settings
from service.store.database import connect
from service.store.tables import audit, jobs, scene_crc


@dataclass(frozen=True)
class Fault:
    """One thing that is wrong: which job (None: the database itself), and what."""

    job: str | None
    reason: str


def find_faults(engine: sa.Engine, deep: bool = False) -> list[Fault]:
    """Everything that is wrong with the job table; `deep` also asks SQLite to check its pages."""
    try:
        with engine.connect() as db:
            pages = list(_bad_pages(db)) if deep else []
            return [*pages, *_bad_rows(db), *_missing_rows(db)]
    except sa.exc.DatabaseError as error:
        return [Fault(None, f"the job table cannot be read: {error.orig}")]


def _bad_pages(db: sa.Connection) -> Iterator[Fault]:
    if db.dialect.name != "sqlite":
        return
    for (told,) in db.exec_driver_sql("PRAGMA integrity_check"):
        if told != "ok":
            yield Fault(None, f"jobs.sqlite: {' '.join(told.split())}")


def _bad_rows(db: sa.Connection) -> Iterator[Fault]:
    """Rows whose seal or scene is not what was written."""
    rows = db.execution_options(yield_per=500).execute(sa.select(jobs)).mappings()
    for row in rows:
        if job_of(row).damaged:
            yield Fault(row["id"], "its row is not what was written")
        elif scene_crc(row["scene"]) != row["scene_crc"]:
            yield Fault(row["id"], "its scene is not what was written")


def _missing_rows(db: sa.Connection) -> Iterator[Fault]:
    """Jobs that were acknowledged, never removed, and are not there (or under another id)."""
    removed = sa.select(audit.c.thing).where(audit.c.action == "removed")
    there = sa.select(jobs.c.id)
    query = sa.select(audit.c.thing).where(
        audit.c.action == "submit", audit.c.thing.not_in(removed), audit.c.thing.not_in(there)
    )
    for (job_id,) in db.execute(query):
        yield Fault(job_id, "its row is missing from the job table")


def main() -> int:
    """`python -m service.integrity`: print every fault; 0 where there is none, else 2."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--home", type=Path)
    settings = read_settings(parser.parse_args().home)
    try:
        engine = connect(settings.database_url)
    except BadInput as error:
        print(error, file=sys.stderr)
        return 2
    faults = find_faults(engine, deep=True)
    for fault in faults:
        print(f"job {fault.job}: {fault.reason}" if fault.job else fault.reason)
    if not faults:
        print("the job table is whole")
    return 2 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
