"""The job table as one caller sees it: every method is bound to the caller's team."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

from catalog_tools.documents import Arguments, JsonObject
from service.accounts.auth import Caller
from service.jobs.jobs import Job, JobStore, Phase
from service.jobs.quotas import TeamLimits
from service.jobs.submissions import Ask, run_pending
from service.settings import Settings


def limits_of(settings: Settings) -> TeamLimits:
    """What one team may have."""
    return TeamLimits(settings.queued_jobs, settings.pixel_frames_day, settings.bytes_kept)


def pixel_frames_of(scene: JsonObject) -> int:
    """Frames x pixels that a scene asks for (0 where it is not a whole scene yet)."""
    try:
        rows, columns = scene["sensor"]["shape"]
        each, dwells = scene["exposure"]["frames"], scene.get("dwells")
        frames = each if dwells is None else sum(d.get("frames") or each for d in dwells)
        return int(rows) * int(columns) * int(frames)
    except (AttributeError, KeyError, TypeError, ValueError):
        return 0


class TeamStore:
    """What routes work with: no method shows, changes or counts another team's job."""

    def __init__(self, store: JobStore, caller: Caller, limits: TeamLimits) -> None:
        self._store, self._caller, self._limits = store, caller, limits
        self.team = caller.team

    def get(self, job_id: str) -> Job:
        """A job. NotThere where there is none of this team."""
        return self._store.get(job_id, self.team)

    def scene(self, job_id: str) -> JsonObject:
        """The scene of a job, defaults filled in."""
        return self._store.scene(job_id, team=self.team)

    def listing(self, phases: Sequence[Phase], after: int, limit: int) -> list[Job]:
        """Jobs in order of submission, after a job number."""
        return self._store.listing(phases, after, limit, self.team)

    def newest(self, limit: int, phases: Collection[Phase] = (), after_s: float = 0.0) -> list[Job]:
        """The jobs submitted last, newest first: of these phases (none: of all), after a time."""
        return self._store.newest(limit, self.team, phases, after_s)

    def known(self, key: str, body_sha256: str) -> Job | None:
        """The job that a key made with this body; None where it made none."""
        return self._store.known(key, body_sha256, self.team)

    def counts(self) -> dict[Phase, int]:
        """How many jobs are in each phase."""
        return self._store.counts(self.team)

    def cancel(self, job_id: str) -> Job:
        """Abort a waiting job, or ask the dispatcher to stop a running one."""
        return self._store.cancel(job_id, self.team, self._caller.actor)

    def retry(self, job_id: str) -> Job:
        """Queue a job again that ended as ERROR, not by its scene. QueueFull beyond a quota."""
        return self._store.retry(job_id, self.team, self._caller.actor, self._limits)

    def delete(self, job_id: str) -> None:
        """Stop a job, and remove it with all that it made."""
        self._store.delete(job_id, self.team, self._caller.actor)

    def amend(self, job_id: str, **values: Any) -> Job:
        """Change run_id, destruction_s, duration_s; of a PENDING job also name and scene."""
        if "scene" in values and "pixel_frames" not in values:
            values["pixel_frames"] = pixel_frames_of(values["scene"])
        return self._store.amend(job_id, self.team, self._limits, **values)

    def run(self, job_id: str) -> Job:
        """Queue a PENDING job. NotReady where it is not PENDING, QueueFull beyond a quota."""
        return run_pending(self._store, job_id, self._limits, self.team, self._caller.actor)

    def ask(
        self,
        name: str,
        scene: JsonObject | str,
        body_sha256: str,
        key: str | None,
        **more: Any,
    ) -> Ask:
        """A submission of this caller (`more`: kind, phase, run_id, destruction_s, ...; a scene
        as text comes with its pixel_frames)."""
        whose: Arguments = {"team": self.team, "owner": self._caller.actor}
        if isinstance(scene, dict):
            more.setdefault("pixel_frames", pixel_frames_of(scene))
        return Ask(name=name, scene=scene, body_sha256=body_sha256, key=key, **whose, **more)
