"""Take jobs in: many submissions in one durable commit, with keys and quotas looked at in it."""

from __future__ import annotations

import asyncio
import queue
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any
from uuid import uuid4

import sqlalchemy as sa
from pydantic_core import to_json

from catalog_tools.documents import JsonObject
from service.jobs.jobs import LOCAL, SHOWN, Job, JobStore, Phase, audit_line, job_of
from service.jobs.quotas import DAY_S, TeamLimits, Used, count, refuse, used_by
from service.problems import KeyReused, NotAllowed, NotReady
from service.store.database import now_s, writing
from service.store.named_files import check_files
from service.store.tables import audit, counters, jobs

MOST_AT_ONCE = 512
Answer = tuple[Job, bool] | Exception
Row = Any  # of the job table
Known = dict[tuple[str, str | None], Row]  # by team and key


@dataclass(frozen=True)
class Ask:
    """A submission that has passed every check which needs no table; its scene as data or text."""

    name: str
    scene: JsonObject | str
    body_sha256: str
    key: str | None = None
    team: str = LOCAL
    owner: str = LOCAL
    kind: str = "scene"
    pixel_frames: int = 0
    phase: Phase = Phase.QUEUED
    run_id: str | None = None
    destruction_s: float | None = None
    duration_s: float | None = None


def submit_many(store: JobStore, asks: Sequence[Ask], limits: TeamLimits) -> list[Answer]:
    """Queue jobs, all in one transaction: for each (job, True), or where its key was used before
    (the job that it made, False), or the refusal: KeyReused, QueueFull, NotAllowed for a file that
    is gone. On disk when it returns.
    """
    with writing(store.engine) as db:
        now = now_s(db)
        day = int(now // DAY_S)
        known = _known(db, asks)
        used = {team: used_by(db, team, day) for team in set(map(attrgetter("team"), asks))}
        taken = [_take_in(db, ask, now, known, used[ask.team], limits) for ask in asks]
        rows = [t[0] for t in taken if isinstance(t, tuple) and t[1]]
        if rows:
            _number(db, rows)
            db.execute(sa.insert(jobs), rows)
            lines = [audit_line(now, r["team"], r["owner"], "submit", r["id"]) for r in rows]
            db.execute(sa.insert(audit), lines)
            for team, of_team in used.items():
                count(db, team, day, of_team)
    return [t if isinstance(t, Exception) else (job_of(t[0]), t[1]) for t in taken]


def _take_in(
    db: sa.Connection, ask: Ask, now: float, known: Known, used: Used, limits: TeamLimits
) -> tuple[Row, bool] | Exception:
    """A new row, counted in `used` and `known`, and True; a known row and False; or a refusal."""
    place = (ask.team, ask.key)
    if ask.key is not None and place in known:
        return _replay(ask, known[place])
    refusal = refuse(used, ask.pixel_frames, limits)
    if refusal is not None:
        return refusal
    row = _row(ask, now)
    try:
        check_files(db, ask.team, row["scene"])
    except NotAllowed as error:
        return error
    used.new_jobs += 1
    used.new_pixel_frames += ask.pixel_frames
    if ask.key is not None:
        known[place] = row
    return row, True


def run_pending(store: JobStore, job_id: str, limits: TeamLimits, team: str, actor: str) -> Job:
    """Queue a job that was PENDING; QueueFull where the team's quota does not allow it."""
    with writing(store.engine) as db:
        job = store._one(db, job_id, team)
        if job.phase != Phase.PENDING:
            raise NotReady(f"the job is {job.phase}: it cannot be started again")
        used = used_by(db, team, int(now_s(db) // DAY_S))
        used.waiting -= 1  # itself
        refusal = refuse(used, 0, limits)
        if refusal is not None:
            raise refusal
        store._move(db, job, Phase.QUEUED)
        db.execute(sa.insert(audit), [audit_line(now_s(db), team, actor, "run", job_id)])
        return store._one(db, job_id)


def _known(db: sa.Connection, asks: Sequence[Ask]) -> Known:
    given = {ask.key for ask in asks if ask.key is not None}
    if not given:
        return {}
    query = sa.select(*SHOWN).where(jobs.c.idempotency_key.in_(given))
    query = query.where(jobs.c.team.in_({ask.team for ask in asks}))
    return {(r["team"], r["idempotency_key"]): r for r in db.execute(query).mappings()}


def _replay(ask: Ask, row: Row) -> tuple[Row, bool] | Exception:
    if row["body_sha256"] != ask.body_sha256:
        return KeyReused("this Idempotency-Key was used with another body")
    return row, False


def _row(ask: Ask, now: float) -> JsonObject:
    text = ask.scene
    if not isinstance(text, str):
        text = to_json(text, inf_nan_mode="constants").decode()
    return {
        "number": 0,
        "id": uuid4().hex,
        "team": ask.team,
        "owner": ask.owner,
        "kind": ask.kind,
        "name": ask.name,
        "run_id": ask.run_id,
        "phase": ask.phase.value,
        "scene": text,
        "idempotency_key": ask.key,
        "body_sha256": ask.body_sha256,
        "pixel_frames": ask.pixel_frames,
        "bytes_kept": 0,
        "submitted_s": now,
        "started_s": None,
        "ended_s": None,
        "destruction_s": ask.destruction_s,
        "duration_s": ask.duration_s,
        "tiles_done": None,
        "tiles_total": None,
        "attempt": 0,
        "deaths": 0,
        "cancel_asked": False,
        "deleted": False,
        "error": None,
        "content_digest": None,
        "version": 1,
    }


def _number(db: sa.Connection, rows: list[JsonObject]) -> None:
    """Number new rows; never a number twice, in the order of commits."""
    last = db.execute(NUMBER, {"more": len(rows)}).scalar_one()
    for number, row in enumerate(rows, last - len(rows) + 1):
        row["number"] = number


# Statements are made once: SQLAlchemy takes longer to make one than the database to run it.
NUMBER = (
    sa.update(counters)
    .where(counters.c.name == "jobs")
    .values(value=counters.c.value + sa.bindparam("more", type_=sa.BigInteger))
    .returning(counters.c.value)
)


class Intake:
    """One thread that commits what has come since its last commit; an fsync serves many requests.

    `put` is awaited by requests; it returns when the job is on disk.
    """

    def __init__(self, store: JobStore, limits: TeamLimits) -> None:
        self._store, self._limits = store, limits
        self._waiting: queue.SimpleQueue[tuple[Ask, asyncio.Future[Answer]] | None]
        self._waiting = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._run, name="intake", daemon=True)
        self.commits, self.jobs = 0, 0

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        """Commit what waits, then end."""
        self._waiting.put(None)
        self._thread.join()

    async def put(self, ask: Ask) -> tuple[Job, bool]:
        """The job and whether it is new; raises what submit_many refuses with."""
        future: asyncio.Future[Answer] = asyncio.get_running_loop().create_future()
        self._waiting.put((ask, future))
        answer = await future
        if isinstance(answer, Exception):
            raise answer
        return answer

    def _run(self) -> None:
        last = False
        while not last:
            # Nothing is waited for: what comes while this commit runs is the next one, and the
            # requests behind it are read meanwhile. A pause would let them all fall into step.
            batch = [self._waiting.get()]
            while len(batch) < MOST_AT_ONCE:
                try:
                    batch.append(self._waiting.get_nowait())
                except queue.Empty:
                    break
            last = None in batch
            pairs = [pair for pair in batch if pair is not None]
            if pairs:
                self._commit(pairs)

    def _commit(self, pairs: list[tuple[Ask, asyncio.Future[Answer]]]) -> None:
        try:
            answers = submit_many(self._store, [ask for ask, _ in pairs], self._limits)
        except Exception as error:
            answers = [error for _ in pairs]
        self.commits += 1
        self.jobs += len(pairs)
        loop = pairs[0][1].get_loop()
        futures = [future for _, future in pairs]
        if not loop.is_closed():
            loop.call_soon_threadsafe(_settle, futures, answers)


def _settle(futures: list[asyncio.Future[Answer]], answers: list[Answer]) -> None:
    for future, answer in zip(futures, answers, strict=True):
        if not future.done():  # the client may have gone
            future.set_result(answer)
