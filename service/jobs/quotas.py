"""What one team may have, and what it has: jobs that wait, pixels x frames a day, bytes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa

from service.jobs.phases import WAITING
from service.problems import QueueFull
from service.store.database import now_s
from service.store.tables import jobs, uploads, usage

DAY_S = 86_400.0


@dataclass(frozen=True)
class TeamLimits:
    """What one team may have: jobs that wait, pixels x frames a day, bytes of products."""

    queued_jobs: int = 1 << 40
    pixel_frames_day: int = 1 << 62
    bytes_kept: int = 1 << 62


@dataclass
class Used:
    """What a team has, while a batch is taken in."""

    waiting: int
    pixel_frames: int
    bytes_kept: int
    new_jobs: int = 0
    new_pixel_frames: int = 0


def ask_more(db: sa.Connection, team: str, pixel_frames: int, limits: TeamLimits | None) -> None:
    """Count what a job that waits asks for beside what it was submitted with. QueueFull."""
    day = int(now_s(db) // DAY_S)
    used = used_by(db, team, day)
    used.waiting -= 1  # itself
    refusal = refuse(used, pixel_frames, limits or TeamLimits())
    if refusal is not None:
        raise refusal
    used.new_pixel_frames = pixel_frames
    count(db, team, day, used)


def check_room(db: sa.Connection, team: str, limits: TeamLimits | None) -> None:
    """QueueFull where a team may have no further job that waits."""
    refusal = refuse(used_by(db, team, int(now_s(db) // DAY_S)), 0, limits or TeamLimits())
    if refusal is not None:
        raise refusal


def used_by(db: sa.Connection, team: str, day: int) -> Used:
    """What a team has waiting, has asked for today, and keeps on disk."""
    row = db.execute(USED, {"of": team, "on": day}).one()
    return Used(row[0], int(row[1] or 0), int(row[2] or 0) + int(row[3] or 0))


def _used() -> sa.Select[Any]:
    """One statement, made once: jobs waiting, pixels x frames today, bytes of products, files."""
    of: sa.BindParameter[str] = sa.bindparam("of")
    on: sa.BindParameter[int] = sa.bindparam("on")
    waiting = sa.select(sa.func.count()).where(
        jobs.c.team == of, jobs.c.phase.in_([p.value for p in WAITING])
    )
    today = sa.select(usage.c.pixel_frames).where(usage.c.team == of, usage.c.day == on)
    kept = sa.select(sa.func.sum(jobs.c.bytes_kept)).where(jobs.c.team == of)
    files = sa.select(sa.func.sum(uploads.c.bytes)).where(uploads.c.team == of)
    return sa.select(*(query.scalar_subquery() for query in (waiting, today, kept, files)))


USED = _used()


def refuse(used: Used, pixel_frames: int, limits: TeamLimits) -> QueueFull | None:
    """Which quota one more job would break, if any."""
    if used.waiting + used.new_jobs >= limits.queued_jobs:
        return QueueFull(f"{limits.queued_jobs} jobs are waiting already; try again later")
    asked = used.pixel_frames + used.new_pixel_frames + pixel_frames
    if asked > limits.pixel_frames_day:
        most = limits.pixel_frames_day
        return QueueFull(
            f"a team may ask for {most} pixels x frames a day (UTC); with this it would be {asked}"
        )
    if used.bytes_kept >= limits.bytes_kept:
        most = limits.bytes_kept
        return QueueFull(f"a team may keep {most} bytes of products; delete some jobs first")
    return None


def count(db: sa.Connection, team: str, day: int, used: Used) -> None:
    """Add to the day's account of a team."""
    if not (used.new_jobs or used.new_pixel_frames):
        return
    new = {"jobs": used.new_jobs, "pixel_frames": used.new_pixel_frames}
    more = {"of": team, "on": day, "more_jobs": new["jobs"], "more_pixels": new["pixel_frames"]}
    if db.execute(COUNT, more).rowcount == 0:
        db.execute(sa.insert(usage), [{"team": team, "day": day} | new])


COUNT = (
    sa.update(usage)
    .where(usage.c.team == sa.bindparam("of"), usage.c.day == sa.bindparam("on"))
    .values(
        jobs=usage.c.jobs + sa.bindparam("more_jobs", type_=sa.BigInteger),
        pixel_frames=usage.c.pixel_frames + sa.bindparam("more_pixels", type_=sa.BigInteger),
    )
)
