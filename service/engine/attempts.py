"""Attempts at a job: give it to an engine's process, report how far it is, bring the outcome."""

from __future__ import annotations

import fcntl
import json
import logging
import os
import queue
import shutil
import time
from collections.abc import Callable
from pathlib import Path

from catalog_tools.documents import JsonObject
from catalog_tools.engine.code import code_digest
from pipeline.store.layout import BEGUN, COMPLETE, LOCK
from service.engine.cluster import SchedulerHealth
from service.engine.processes import POLL_S, Answers, worker
from service.jobs.jobs import Job, Phase, Queue
from service.scenes.sweeps import engine_sweep
from service.scenes.uploads import engine_scene, names_of
from service.settings import Settings
from service.store.named_files import files_in

log = logging.getLogger("nightglass.service")
FIRST_PAUSE_S, MOST_PAUSE_S = 1.0, 60.0  # before a job is tried again
LATER = "try later"  # kind of an error whose job is tried again
DEATHS = 3  # workers in a row that may die on a job without finishing a tile


class Attempt:
    """Runs a claimed job until it ends, is cancelled, or `go_on` says no."""

    def __init__(
        self,
        settings: Settings,
        store: Queue,
        job: Job,
        go_on: Callable[[], bool],
        scheduler: SchedulerHealth,
    ) -> None:
        self._settings, self._store, self._job, self._go_on = settings, store, job, go_on
        self._product, self._scheduler = settings.product(job.id), scheduler

    @property
    def _said(self) -> JsonObject:
        return {"job": self._job.id, "attempt": self._job.attempt}

    def run(self) -> None:
        """The whole attempt; another one, from the last tile, whenever what the engine needs is
        not there. Raises NotReady where a later attempt has taken the job over."""
        pause_s, until_s = FIRST_PAUSE_S, 0.0
        while (later := self._attempt()) is not None:
            now = self._store.seen(self._job)
            if not until_s or (now.tiles_done or 0) > (self._job.tiles_done or 0):
                pause_s, until_s = FIRST_PAUSE_S, time.monotonic() + self._settings.scheduler_s
            log.warning("tried again later: %s", later["message"], extra=self._said)
            if not self._pause(pause_s, until_s):
                self._finish(Phase.ERROR, error=later)
                return
            if not self._go_on():
                return  # it stays EXECUTING; the next dispatcher goes on with it
            self._job = self._store.again(self._job, later["message"])
            pause_s = min(2.0 * pause_s, MOST_PAUSE_S)

    def _pause(self, pause_s: float, until_s: float) -> bool:
        """Wait, and until the scheduler answers; False where that is not in time."""
        wake_s = time.monotonic() + pause_s
        while self._go_on() and not self._must_stop():
            if time.monotonic() > until_s:
                return False
            if time.monotonic() > wake_s and not self._scheduler.fault():
                return True
            time.sleep(POLL_S)
        return True

    def _attempt(self) -> JsonObject | None:
        """One attempt; its error where it is to be tried again later."""
        job, outcome = self._job, None
        log.info("begins", extra=self._said)
        if not job.cancel_asked and self._alone():
            with worker(self._settings, self._order()) as answers:
                outcome = self._watch(answers)
        if outcome is not None:
            return self._take(outcome)
        if not self._go_on():
            return None  # it stays EXECUTING; the next dispatcher goes on with it
        if self._must_stop():
            self._finish(Phase.ABORTED, error=self._why_stopped())
        else:
            self.count_death()
        return None

    def _take(self, outcome: JsonObject) -> JsonObject | None:
        """End the job as its worker tells; the error where it is to be tried again later."""
        if "error" in outcome:
            if outcome["error"]["kind"] == LATER:
                return dict(outcome["error"])
            self._finish(Phase.ERROR, error=outcome["error"])
        elif (self._product / COMPLETE).is_file():
            tiles, digest = outcome["tiles"], outcome["content_digest"]
            done = {"tiles_done": tiles, "tiles_total": tiles, "content_digest": digest}
            self._finish(Phase.COMPLETED, **done, bytes_kept=bytes_of(self._product))
        else:
            self._finish(Phase.ERROR, error=fault("the product was not sealed"))
        return None

    def fail(self) -> None:
        """End the job after a fault of the runner itself."""
        self._finish(Phase.ERROR, error=fault("an internal fault of the runner"))

    def _finish(self, phase: Phase, **values: object) -> None:
        values = {name: value for name, value in values.items() if value is not None}
        if phase != Phase.COMPLETED:
            values["bytes_kept"] = bytes_of(self._product)
        self._store.finish(self._job, phase, **values)
        log.info("ends: %s", phase, extra=self._said)

    def _alone(self) -> bool:
        """Wait until no earlier worker holds the product's lock; False where it must not be run.

        OSError where it can't be asked: waiting would not help.
        """
        while self._go_on() and not self._must_stop():
            try:
                with (self._product / LOCK).open("r+") as handle:
                    fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                return True
            except FileNotFoundError:
                return True
            except BlockingIOError:
                log.warning("an earlier worker still holds the product", extra=self._said)
                time.sleep(POLL_S)
        return False

    def _order(self) -> JsonObject:
        """What the worker is to do: go on with an unfinished product, or begin one.

        What other code began, before the service was upgraded, is begun anew.
        """
        resume = _begun_by(self._product / BEGUN) == code_digest()
        if self._product.exists() and not resume:
            shutil.rmtree(self._product)
        settings = self._settings
        scene = self._store.scene(self._job.id, hidden=True)
        files = names_of(self._store.engine, self._job.team, files_in(json.dumps(scene)))
        return {
            "do": "render" if self._job.kind == "scene" else self._job.kind,
            "scene": engine_sweep(scene, settings)
            if self._job.kind == "sweep"
            else engine_scene(scene, settings),
            "product": os.path.relpath(self._product, settings.catalogues.resolve()),
            "resume": resume,
            "workers": settings.workers,
            "scheduler": settings.scheduler,
            "most_cpu_s": settings.job_cpu_s,
            "files": files,
        } | self._said

    def _watch(self, answers: Answers) -> JsonObject | None:
        """The worker's outcome; None where it died or has to be ended."""
        while self._go_on():
            try:
                answer = answers.get(timeout=POLL_S)
            except queue.Empty:
                if self._must_stop():
                    return None
                continue
            if answer is None or "outcome" in answer:
                return answer
            self._store.progress(self._job, answer["done"], answer["total"])
            if self._must_stop():
                return None
        return None

    def _must_stop(self) -> bool:
        now = self._store.seen(self._job)
        return now.cancel_asked or _too_long(now)

    def _why_stopped(self) -> JsonObject | None:
        now = self._store.seen(self._job)
        if now.cancel_asked or not _too_long(now):
            return None
        return fault(f"it ran longer than the {now.duration_s:g} s that it was given")

    def count_death(self) -> None:
        """A worker that died is replaced, unless one after the other they die without a tile."""
        job, now = self._job, self._store.seen(self._job)
        progressed = (now.tiles_done or 0) > (job.tiles_done or 0)
        deaths = 1 if progressed else job.deaths + 1
        log.warning("its worker died (%d in a row)", deaths, extra=self._said)
        if deaths >= DEATHS:
            reason = f"{deaths} workers in a row died on this job (out of memory?)"
            self._finish(Phase.ERROR, error=fault(reason))
        else:
            self._store.died(job, deaths)


def _too_long(job: Job) -> bool:
    """Whether a job runs for longer than it may by now: its limit may change while it runs."""
    limit, started = job.duration_s, job.started_s
    return bool(limit and started and time.time() > started + limit)


def fault(message: str) -> JsonObject:
    """An error of a job that is not its author's."""
    return {"kind": "fault", "message": message, "errors": []}


def _begun_by(record: Path) -> str | None:
    """The code that began a product, sweep or study; None where none was begun, or none says so."""
    try:
        begun: JsonObject = json.loads(record.read_bytes())
    except (FileNotFoundError, ValueError):
        return None
    return begun.get("code")


def bytes_of(folder: Path) -> int:
    """Bytes of all files below a folder; 0 where there is none."""
    total = 0
    for root, _, names in os.walk(folder):
        for name in names:
            try:
                total += Path(root, name).lstat().st_size
            except FileNotFoundError:
                continue
    return total
