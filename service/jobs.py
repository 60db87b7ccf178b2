"""The durable job record: one row a job in SQLite, and the table of what may follow what."""

from __future__ import annotations

import json
import time
import uuid
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

import sqlalchemy as sa

from pipeline.errors import BadInput
from service.problems import KeyReused, NotReady, NotThere, QueueFull


class Phase(StrEnum):
    """Phases of a job, as in IVOA UWS 1.1."""

    PENDING = "PENDING"
    QUEUED = "QUEUED"
    EXECUTING = "EXECUTING"
    COMPLETED = "COMPLETED"
    ERROR = "ERROR"
    ABORTED = "ABORTED"


P = Phase
NEXT: dict[Phase, frozenset[Phase]] = {
    P.PENDING: frozenset({P.QUEUED, P.ABORTED}),
    P.QUEUED: frozenset({P.EXECUTING, P.ABORTED}),
    P.EXECUTING: frozenset({P.COMPLETED, P.ERROR, P.ABORTED}),
    P.COMPLETED: frozenset(),
    P.ERROR: frozenset(),
    P.ABORTED: frozenset(),
}
FINAL = frozenset(phase for phase, after in NEXT.items() if not after)
FORMAT = 1  # PRAGMA user_version of the database

metadata = sa.MetaData()
jobs = sa.Table(
    "jobs", metadata,
    sa.Column("number", sa.Integer, primary_key=True),
    sa.Column("id", sa.String(32), nullable=False, unique=True),
    sa.Column("name", sa.String(128), nullable=False),
    sa.Column("phase", sa.String(9), nullable=False, index=True),
    sa.Column("scene", sa.Text, nullable=False),
    sa.Column("idempotency_key", sa.String(255), unique=True),
    sa.Column("body_sha256", sa.String(64), nullable=False),
    sa.Column("submitted_s", sa.Float, nullable=False),
    sa.Column("started_s", sa.Float),
    sa.Column("ended_s", sa.Float),
    sa.Column("tiles_done", sa.Integer),
    sa.Column("tiles_total", sa.Integer),
    sa.Column("attempt", sa.Integer, nullable=False, default=0),
    sa.Column("deaths", sa.Integer, nullable=False, default=0),
    sa.Column("cancel_asked", sa.Boolean, nullable=False, default=False),
    sa.Column("deleted", sa.Boolean, nullable=False, default=False),
    sa.Column("error", sa.JSON(none_as_null=True)),
    sa.Column("content_digest", sa.String(64)),
    sa.Column("version", sa.Integer, nullable=False, default=1),
    sqlite_autoincrement=True,
)  # fmt: skip
SHOWN = tuple(c for c in jobs.c if c.name not in ("scene", "idempotency_key", "body_sha256"))


@dataclass(frozen=True)
class Job:
    """One row of the table, without its scene. Times are Unix seconds; absent is None.

    attempt : how often a worker took it up; the fence against writes of an earlier worker
    deaths : workers in a row that died without finishing a tile
    version : grows with every change; the ETag
    """

    number: int
    id: str
    name: str
    phase: Phase
    submitted_s: float
    started_s: float | None
    ended_s: float | None
    tiles_done: int | None
    tiles_total: int | None
    attempt: int
    deaths: int
    cancel_asked: bool
    deleted: bool
    error: dict[str, Any] | None
    content_digest: str | None
    version: int


class JobStore:
    """The job table. Every method is one transaction; an answer means that it is on disk."""

    def __init__(self, database: Path) -> None:
        self._engine = sa.create_engine(f"sqlite:///{database}", connect_args={"timeout": 30.0})
        sa.event.listen(self._engine, "connect", _configure)
        sa.event.listen(self._engine, "begin", _begin)
        self._writer = self._engine.execution_options(writes=True)
        with self._writer.begin() as db:
            found = db.exec_driver_sql("PRAGMA user_version").scalar_one()
            if found not in (0, FORMAT):
                raise BadInput("--home", f"jobs.sqlite of format {found}", f"format {FORMAT}")
            metadata.create_all(db)
            db.exec_driver_sql(f"PRAGMA user_version = {FORMAT}")

    def close(self) -> None:
        self._engine.dispose()

    def submit(
        self, name: str, scene: dict[str, Any], body_sha256: str, key: str | None, limit: int
    ) -> tuple[Job, bool]:
        """Queue a job; or, where `key` was used before, the job that it made (and False).

        KeyReused where the key came with another body, QueueFull beyond `limit` waiting jobs.
        """
        with self._writer.begin() as db:
            if key is not None:
                known = db.execute(sa.select(jobs).where(jobs.c.idempotency_key == key)).first()
                if known is not None:
                    if known.body_sha256 != body_sha256:
                        raise KeyReused("this Idempotency-Key was used with another body")
                    return self._one(db, known.id), False
            waiting = db.execute(sa.select(sa.func.count()).where(jobs.c.phase == P.QUEUED))
            if waiting.scalar_one() >= limit:
                raise QueueFull(f"{limit} jobs are waiting already; try again later")
            job_id = uuid.uuid4().hex
            values = {"id": job_id, "name": name, "phase": P.QUEUED, "submitted_s": time.time()}
            values |= {"scene": json.dumps(scene), "body_sha256": body_sha256}
            db.execute(sa.insert(jobs).values(**values, idempotency_key=key))
            return self._one(db, job_id), True

    def get(self, job_id: str) -> Job:
        """A job. NotThere where there is none (or it was deleted)."""
        with self._engine.connect() as db:
            return self._one(db, job_id)

    def scene(self, job_id: str, hidden: bool = False) -> dict[str, Any]:
        """The scene of a job, defaults filled in; `hidden`: of a deleted one, too."""
        with self._engine.connect() as db:
            self._one(db, job_id, hidden)
            query = sa.select(jobs.c.scene).where(jobs.c.id == job_id)
            return json.loads(db.execute(query).scalar_one())

    def listing(self, phases: Sequence[Phase], after: int, limit: int) -> list[Job]:
        """Jobs in order of submission, after a job number."""
        query = sa.select(*SHOWN).where(jobs.c.number > after, ~jobs.c.deleted)
        if phases:
            query = query.where(jobs.c.phase.in_(phases))
        with self._engine.connect() as db:
            return [_job(row) for row in db.execute(query.order_by(jobs.c.number).limit(limit))]

    def newest(self, limit: int) -> list[Job]:
        """The jobs submitted last, newest first."""
        query = sa.select(*SHOWN).where(~jobs.c.deleted).order_by(jobs.c.number.desc())
        with self._engine.connect() as db:
            return [_job(row) for row in db.execute(query.limit(limit))]

    def counts(self) -> dict[Phase, int]:
        """How many jobs are in each phase."""
        query = sa.select(jobs.c.phase, sa.func.count()).where(~jobs.c.deleted)
        with self._engine.connect() as db:
            found = {row[0]: row[1] for row in db.execute(query.group_by(jobs.c.phase))}
        return {phase: found.get(phase, 0) for phase in Phase}

    def cancel(self, job_id: str) -> Job:
        """Abort a waiting job, or ask the dispatcher to stop a running one; again is no error."""
        with self._writer.begin() as db:
            job = self._one(db, job_id)
            if job.phase in (P.COMPLETED, P.ERROR):
                raise NotReady(f"the job is {job.phase}: there is nothing left to cancel")
            if job.phase == P.EXECUTING and not job.cancel_asked:
                self._change(db, job, cancel_asked=True)
            elif job.phase in (P.PENDING, P.QUEUED):
                self._move(db, job, P.ABORTED)
            return self._one(db, job_id)

    def delete(self, job_id: str) -> None:
        """Hide a job and free its key; the dispatcher stops it and removes what it made."""
        with self._writer.begin() as db:
            job = self._one(db, job_id)
            self._change(db, job, deleted=True, cancel_asked=True, idempotency_key=None)
            if job.phase in (P.PENDING, P.QUEUED):
                self._move(db, job, P.ABORTED)

    # What only the dispatcher calls.

    def claim(self) -> Job | None:
        """The next job to run, now EXECUTING: one that an earlier process left, else the oldest."""
        with self._writer.begin() as db:
            for phase in (P.EXECUTING, P.QUEUED):
                query = sa.select(*SHOWN).where(jobs.c.phase == phase).order_by(jobs.c.number)
                row = db.execute(query.limit(1)).first()
                if row is None:
                    continue
                job = _job(row)
                changes = {"attempt": job.attempt + 1, "started_s": job.started_s or time.time()}
                if phase == P.QUEUED:
                    self._move(db, job, P.EXECUTING, **changes)
                else:
                    self._change(db, job, **changes)
                return self._one(db, job.id, hidden=True)
        return None

    def seen(self, job: Job) -> Job:
        """A job as it is now, deleted or not."""
        with self._engine.connect() as db:
            return self._one(db, job.id, hidden=True)

    def progress(self, job: Job, done: int, total: int) -> None:
        """Tiles done; written only for the attempt that runs."""
        with self._writer.begin() as db:
            self._change(db, job, tiles_done=done, tiles_total=total)

    def died(self, job: Job, deaths: int) -> None:
        """Record that a worker died (`deaths` in a row without a tile)."""
        with self._writer.begin() as db:
            self._change(db, job, deaths=deaths)

    def finish(self, job: Job, phase: Phase, **values: Any) -> None:
        """Bring a running job to its end."""
        with self._writer.begin() as db:
            self._move(db, job, phase, **values)

    def deleted(self) -> list[str]:
        """Ids of deleted jobs that no longer run."""
        query = sa.select(jobs.c.id).where(jobs.c.deleted, jobs.c.phase != P.EXECUTING)
        with self._engine.connect() as db:
            return list(db.execute(query).scalars())

    def forget(self, job_id: str) -> None:
        """Remove the row of a deleted job."""
        with self._writer.begin() as db:
            db.execute(sa.delete(jobs).where(jobs.c.id == job_id, jobs.c.deleted))

    def _one(self, db: sa.Connection, job_id: str, hidden: bool = False) -> Job:
        row = db.execute(sa.select(*SHOWN).where(jobs.c.id == job_id)).first()
        if row is None or (row.deleted and not hidden):
            raise NotThere("there is no such job")
        return _job(row)

    def _move(self, db: sa.Connection, job: Job, to: Phase, **values: Any) -> None:
        """Change the phase, as NEXT allows."""
        if to not in NEXT[job.phase]:
            raise NotReady(f"a job that is {job.phase} cannot become {to}")
        if to in FINAL:
            values["ended_s"] = time.time()
        self._change(db, job, phase=to, **values)

    def _change(self, db: sa.Connection, job: Job, **values: Any) -> None:
        """Update the row if it still is in the phase and attempt that the caller knows."""
        same = (jobs.c.id == job.id, jobs.c.phase == job.phase, jobs.c.attempt == job.attempt)
        query = sa.update(jobs).where(*same).values(**values, version=jobs.c.version + 1)
        if db.execute(query).rowcount != 1:
            raise NotReady("the job was changed by someone else meanwhile")


def _job(row: Any) -> Job:
    return Job(**{**row._asdict(), "phase": Phase(row.phase)})


def _configure(connection: Any, _: Any) -> None:
    """Write-ahead log, synced at every commit; transactions are begun by `_begin`."""
    connection.isolation_level = None
    for pragma in ("journal_mode = WAL", "synchronous = FULL", "busy_timeout = 30000"):
        connection.execute(f"PRAGMA {pragma}").close()


def _begin(connection: sa.Connection) -> None:
    """Writers take the lock at once, so that none fails half-way; readers never wait."""
    writes = connection.get_execution_options().get("writes")
    connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")
