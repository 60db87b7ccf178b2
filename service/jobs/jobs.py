"""The durable job record: one row a job."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import sqlalchemy as sa

from catalog_tools.documents import JsonObject
from service.jobs.phases import FINAL, MENDABLE, NEXT, WAITING, P, Phase
from service.jobs.quotas import TeamLimits, ask_more, check_room
from service.problems import NotReady, NotThere, cut
from service.store.database import connect, now_s, sqlite_url, writing
from service.store.leases import holds
from service.store.named_files import check_files
from service.store.tables import audit, jobs

LOCAL = "local"  # the team of a service without keys
SHOWN = tuple(c for c in jobs.c if c.name != "scene")
AMENDABLE = frozenset({"run_id", "destruction_s", "duration_s"})


@dataclass(frozen=True)
class Job:
    """One row of the table, without its scene. Times are Unix seconds; absent is None.

    team, owner : who may see it; which key or person submitted it
    kind : "scene", "study" or "sweep"; run_id : the client's own name for it
    pixel_frames, bytes_kept : what it asks for, what its product takes on disk
    destruction_s, duration_s : when it will be removed; how long it may run
    attempt : how often a worker took it up; the fence against writes of an earlier worker
    deaths : workers in a row that died without finishing a tile
    version : grows with every change; the ETag
    """

    number: int
    id: str
    team: str
    owner: str
    kind: str
    name: str
    run_id: str | None
    phase: Phase
    pixel_frames: int
    bytes_kept: int
    submitted_s: float
    started_s: float | None
    ended_s: float | None
    destruction_s: float | None
    duration_s: float | None
    tiles_done: int | None
    tiles_total: int | None
    attempt: int
    deaths: int
    cancel_asked: bool
    deleted: bool
    error: JsonObject | None
    content_digest: str | None
    version: int


FIELDS = tuple(f.name for f in fields(Job) if f.name not in ("phase", "error"))


def record(
    db: sa.Connection, team: str, actor: str, action: str, thing: str | None, detail: str = ""
) -> None:
    """Append a line to the audit table, in the transaction of what it tells."""
    db.execute(sa.insert(audit), [audit_line(now_s(db), team, actor, action, thing, detail)])


def audit_line(
    at_s: float, team: str, actor: str, action: str, thing: str | None, detail: str = ""
) -> JsonObject:
    """A row of the audit table."""
    line = {"at_s": at_s, "team": team, "actor": actor, "action": action}
    return line | {"thing": thing, "detail": cut(detail) if detail else None}


class JobStore:
    """The job table. Every method is one transaction; an answer means that it is on disk.

    `team` restricts a method to the jobs of a team; None is for the service itself.
    """

    def __init__(self, database: Path | str) -> None:
        url = sqlite_url(database) if isinstance(database, Path) else database
        self.engine = connect(url)

    def close(self) -> None:
        self.engine.dispose()

    def get(self, job_id: str, team: str | None = None) -> Job:
        """A job. NotThere where there is none (or it was deleted, or is another team's)."""
        with self.engine.connect() as db:
            return self._one(db, job_id, team)

    def scene(self, job_id: str, hidden: bool = False, team: str | None = None) -> JsonObject:
        """The scene of a job, defaults filled in; `hidden`: of a deleted one, too."""
        with self.engine.connect() as db:
            self._one(db, job_id, team, hidden)
            return json.loads(_text(db, job_id))

    def listing(
        self, phases: Sequence[Phase], after: int, limit: int, team: str | None = None
    ) -> list[Job]:
        """Jobs in order of submission, after a job number."""
        query = sa.select(*SHOWN).where(jobs.c.number > after, ~jobs.c.deleted)
        if phases:
            query = query.where(jobs.c.phase.in_(phases))
        return self._jobs(_of(query, team).order_by(jobs.c.number).limit(limit))

    def newest(
        self,
        limit: int,
        team: str | None = None,
        phases: Collection[Phase] = (),
        after_s: float = 0.0,
    ) -> list[Job]:
        """The jobs submitted last, newest first: of these phases (none: of all), after a time."""
        query = sa.select(*SHOWN).where(~jobs.c.deleted, jobs.c.submitted_s > after_s)
        if phases:
            query = query.where(jobs.c.phase.in_(phases))
        return self._jobs(_of(query, team).order_by(jobs.c.number.desc()).limit(limit))

    def known(self, key: str, body_sha256: str, team: str) -> Job | None:
        """The job that a team's key made with this body; None where it made none."""
        same = (jobs.c.idempotency_key == key, jobs.c.body_sha256 == body_sha256)
        return next(iter(self._jobs(_of(sa.select(*SHOWN).where(*same), team))), None)

    def counts(self, team: str | None = None) -> dict[Phase, int]:
        """How many jobs are in each phase."""
        query = sa.select(jobs.c.phase, sa.func.count()).where(~jobs.c.deleted)
        query = _of(query, team).group_by(jobs.c.phase)
        with self.engine.connect() as db:
            found: dict[str, int] = dict(db.execute(query).all())
        return {phase: found.get(phase, 0) for phase in Phase}

    def versions(self, ids: Iterable[str]) -> dict[str, int]:
        """The version of each of these jobs that is there; one query for all who watch."""
        query = sa.select(jobs.c.id, jobs.c.version).where(jobs.c.id.in_(list(ids)))
        with self.engine.connect() as db:
            return dict(db.execute(query.where(~jobs.c.deleted)).all())

    def cancel(self, job_id: str, team: str | None = None, actor: str = LOCAL) -> Job:
        """Abort a waiting job, or ask the dispatcher to stop a running one; again is no error."""
        with writing(self.engine) as db:
            job = self._one(db, job_id, team)
            if job.phase in (P.COMPLETED, P.ERROR):
                raise NotReady(f"the job is {job.phase}: there is nothing left to cancel")
            if job.phase == P.EXECUTING and not job.cancel_asked:
                self._change(db, job, cancel_asked=True)
            elif job.phase in WAITING:
                self._move(db, job, P.ABORTED)
            record(db, job.team, actor, "cancel", job_id)
            return self._one(db, job_id)

    def retry(
        self,
        job_id: str,
        team: str | None = None,
        actor: str = LOCAL,
        limits: TeamLimits | None = None,
    ) -> Job:
        """Queue a job again that ended as ERROR, not by its scene; what it has drawn is kept.

        QueueFull beyond a quota, NotAllowed where a file that it names is gone.
        """
        with writing(self.engine) as db:
            job = self._one(db, job_id, team)
            if not can_be_retried(job):
                raise NotReady(
                    f"job {job.id} is {job.phase}: only one that ended as ERROR, not by its "
                    "scene, is run again"
                )
            check_room(db, job.team, limits)
            check_files(db, job.team, _text(db, job_id))
            changes = dict.fromkeys(("error", "started_s", "ended_s"))
            self._move(db, job, P.QUEUED, deaths=0, cancel_asked=False, **changes)
            record(db, job.team, actor, "retry", job_id)
            return self._one(db, job_id)

    def delete(self, job_id: str, team: str | None = None, actor: str = LOCAL) -> None:
        """Hide a job and free its key; the dispatcher stops it and removes what it made."""
        with writing(self.engine) as db:
            job = self._one(db, job_id, team)
            changes: dict[str, object] = {"deleted": True, "idempotency_key": None}
            if job.phase in WAITING:
                self._move(db, job, P.ABORTED, cancel_asked=True, **changes)
            else:
                self._change(db, job, cancel_asked=True, **changes)
            record(db, job.team, actor, "delete", job_id)

    def amend(
        self, job_id: str, team: str | None = None, limits: TeamLimits | None = None, **values: Any
    ) -> Job:
        """Change what a client may change of a job: run_id, destruction_s, duration_s, and of one
        that is PENDING also its name, scene and pixel_frames, which count as asked for today where
        they are more than before. NotReady for anything else, QueueFull beyond a quota."""
        with writing(self.engine) as db:
            job = self._one(db, job_id, team)
            fixed = set(values) - AMENDABLE
            if fixed and (job.phase != P.PENDING or fixed - {"name", "scene", "pixel_frames"}):
                raise NotReady(f"the job is {job.phase}: its scene can no longer be changed")
            if values.get("pixel_frames", 0) > job.pixel_frames:
                ask_more(db, job.team, values["pixel_frames"] - job.pixel_frames, limits)
            if "scene" in values:
                text = json.dumps(values["scene"])
                check_files(db, job.team, text)
                values["scene"] = text
            self._change(db, job, **values)
            return self._one(db, job_id)

    def seen(self, job: Job) -> Job:
        """A job as it is now, deleted or not."""
        with self.engine.connect() as db:
            return self._one(db, job.id, hidden=True)

    def _jobs(self, query: sa.Select[Any]) -> list[Job]:
        with self.engine.connect() as db:
            return [job_of(row) for row in db.execute(query).mappings()]

    def _one(
        self, db: sa.Connection, job_id: str, team: str | None = None, hidden: bool = False
    ) -> Job:
        if "\0" in job_id:  # PostgreSQL takes none
            raise NotThere("there is no such job")
        row = db.execute(_of(sa.select(*SHOWN).where(jobs.c.id == job_id), team)).mappings().first()
        if row is None or (row["deleted"] and not hidden):
            raise NotThere("there is no such job")
        return job_of(row)

    def _move(self, db: sa.Connection, job: Job, to: Phase, **values: object) -> None:
        """Change the phase, as NEXT allows."""
        if to not in NEXT[job.phase]:
            raise NotReady(f"a job that is {job.phase} cannot become {to}")
        if to in FINAL:
            values["ended_s"] = now_s(db)
        self._change(db, job, phase=to.value, **values)

    def _change(self, db: sa.Connection, job: Job, **values: object) -> None:
        """Update the row if it still is in the phase and attempt that the caller knows."""
        if isinstance(values.get("error"), dict):
            values["error"] = json.dumps(values["error"])
        same = (
            jobs.c.id == job.id,
            jobs.c.phase == job.phase.value,
            jobs.c.attempt == job.attempt,
        )
        change = sa.update(jobs).where(*same).values(values | {"version": jobs.c.version + 1})
        if db.execute(change).rowcount != 1:
            raise NotReady("the job was changed by someone else meanwhile")


def _text(db: sa.Connection, job_id: str) -> str:
    """The scene of a job, as it is stored."""
    return str(db.execute(sa.select(jobs.c.scene).where(jobs.c.id == job_id)).scalar_one())


def _of(query: sa.Select[Any], team: str | None) -> sa.Select[Any]:
    return query if team is None else query.where(jobs.c.team == team)


def can_be_retried(job: Job) -> bool:
    """Whether a job ended by what has nothing to do with its scene."""
    kind = (job.error or {}).get("kind")
    return job.phase == P.ERROR and kind in MENDABLE


def job_of(row: Mapping[Any, Any]) -> Job:
    """A row of the table as a Job."""
    error = json.loads(row["error"]) if row["error"] else None
    return Job(**{name: row[name] for name in FIELDS}, phase=Phase(row["phase"]), error=error)


class Queue(JobStore):
    """The job table as the dispatcher uses it: claim, report, finish, remove."""

    def claim(
        self,
        busy: Collection[str] = (),
        team_limit: int = 1 << 30,
        turns: Mapping[str, float] | None = None,
        holder: str | None = None,
    ) -> Job | None:
        """The next job to run, now EXECUTING: one that an earlier process left, else a queued one.

        busy : ids that the caller runs itself; team_limit : jobs of one team at once
        turns : when each team last had its turn, so that a long queue of one delays no other
        holder : who must hold the dispatcher's lease for this (None: not asked)
        """
        with writing(self.engine) as db:
            if holder is not None and not holds(db, holder):
                return None
            left = sa.select(*SHOWN).where(jobs.c.phase == P.EXECUTING, jobs.c.id.not_in(busy))
            row = db.execute(left.order_by(jobs.c.number).limit(1)).mappings().first()
            if row is None:
                row = self._next(db, team_limit, turns or {})
            if row is None:
                return None
            job = job_of(row)
            changes = {"attempt": job.attempt + 1, "started_s": job.started_s or now_s(db)}
            if job.phase == P.QUEUED:
                self._move(db, job, P.EXECUTING, **changes)
            else:
                self._change(db, job, **changes)
            return self._one(db, job.id, hidden=True)

    def _next(
        self, db: sa.Connection, team_limit: int, turns: Mapping[str, float]
    ) -> sa.RowMapping | None:
        """The oldest queued job of the team whose turn it is."""

        def grouped(phase: Phase, what: sa.ColumnElement[int]) -> dict[str, int]:
            query = sa.select(jobs.c.team, what).where(jobs.c.phase == phase)
            return dict(db.execute(query.group_by(jobs.c.team)).all())

        running = grouped(P.EXECUTING, sa.func.count())
        first = grouped(P.QUEUED, sa.func.min(jobs.c.number))
        ready = [
            (turns.get(team, 0.0), number)
            for team, number in first.items()
            if running.get(team, 0) < team_limit
        ]
        if not ready:
            return None
        query = sa.select(*SHOWN).where(jobs.c.number == min(ready)[1])
        return db.execute(query).mappings().first()

    def again(self, job: Job, why: str) -> Job:
        """Begin the next attempt at a running job, and note why the last one ended."""
        with writing(self.engine) as db:
            self._change(db, job, attempt=job.attempt + 1)
            record(db, job.team, "service", "again", job.id, why)
            return self._one(db, job.id, hidden=True)

    def progress(self, job: Job, done: int, total: int) -> None:
        """Tiles done; written only for the attempt that runs."""
        with writing(self.engine) as db:
            self._change(db, job, tiles_done=done, tiles_total=total)

    def died(self, job: Job, deaths: int) -> None:
        """Record that a worker died (`deaths` in a row without a tile)."""
        with writing(self.engine) as db:
            self._change(db, job, deaths=deaths)

    def finish(self, job: Job, phase: Phase, **values: Any) -> None:
        """Bring a running job to its end."""
        with writing(self.engine) as db:
            self._move(db, job, phase, **values)
            message = (values.get("error") or {}).get("message", "")
            record(db, job.team, "service", phase.value.lower(), job.id, message)

    def overdue(self) -> list[str]:
        """Ids of jobs whose time of destruction has come."""
        with self.engine.connect() as db:
            query = sa.select(jobs.c.id).where(~jobs.c.deleted, jobs.c.destruction_s < now_s(db))
            return list(db.execute(query).scalars())

    def deleted(self) -> list[str]:
        """Ids of deleted jobs that no longer run."""
        query = sa.select(jobs.c.id).where(jobs.c.deleted, jobs.c.phase != P.EXECUTING)
        with self.engine.connect() as db:
            return list(db.execute(query).scalars())

    def forget(self, job_id: str) -> None:
        """Remove the row of a deleted job."""
        with writing(self.engine) as db:
            query = sa.select(jobs.c.team).where(jobs.c.id == job_id, jobs.c.deleted)
            team = db.execute(query).scalar()
            if team is not None:
                db.execute(sa.delete(jobs).where(jobs.c.id == job_id))
                record(db, team, "service", "removed", job_id)
