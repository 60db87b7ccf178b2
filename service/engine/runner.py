"""Take queued jobs to the engine: one process at a time leads, by a lease that it must renew."""

from __future__ import annotations

import logging
import os
import shutil
import socket
import threading
import time
import uuid

import sqlalchemy as sa

from service.engine.attempts import Attempt
from service.engine.cluster import SchedulerHealth
from service.engine.processes import POLL_S
from service.jobs.jobs import Job, Queue
from service.problems import NotReady
from service.settings import Settings
from service.store.leases import give_up, take

log = logging.getLogger("nightglass.service")
HOUSEKEEPING_S = 1.0
LEADERLESS = 3  # lengths of the lease without a leader that are no fault yet


class Dispatcher:
    """Runs jobs while this process holds the lease; ends its workers when it has lost it.

    Three fences keep an earlier dispatcher from doing harm: jobs are claimed only with the lease,
    rows are written only by the attempt that claimed them last, and the engine draws into a
    product only under the product's own lock.
    """

    def __init__(self, settings: Settings, store: Queue) -> None:
        self._settings, self._store = settings, store
        self.holder = f"{socket.gethostname()[:32]}:{os.getpid()}:{uuid.uuid4().hex[:8]}"
        self.stopping, self._work = threading.Event(), threading.Event()
        self.scheduler = SchedulerHealth(settings.scheduler)
        self._renewed_s = float("-inf")
        self._led_s = time.monotonic()  # when somebody was last known to lead
        self._busy: dict[str, threading.Thread] = {}
        self._turns: dict[str, float] = {}
        self._threads = [
            threading.Thread(target=run, name=name, daemon=True)
            for name, run in (
                ("dispatcher", self._run),
                ("lease", self._renew),
                ("housekeeping", self._keep),
            )
        ]

    def start(self) -> None:
        for thread in self._threads:
            thread.start()

    def stop(self) -> None:
        """End workers and threads. A job that runs stays EXECUTING and is resumed later."""
        self.stopping.set()
        self._work.set()
        for thread in [*self._threads, *self._busy.values()]:
            if thread.ident is not None:
                thread.join()
        if self._renewed_s > float("-inf"):
            try:
                give_up(self._store.engine, self.holder)
            except sa.exc.DBAPIError:
                log.warning("the lease could not be given up; it runs out by itself")

    def wake(self) -> None:
        """There is something to do."""
        if not self._work.is_set():
            self._work.set()

    @property
    def alive(self) -> bool:
        return all(thread.is_alive() for thread in self._threads)

    @property
    def running(self) -> int:
        return len(self._busy)

    @property
    def leads(self) -> bool:
        """Whether the lease is held, by this process's own clock."""
        return time.monotonic() - self._renewed_s < self._settings.lease_s

    @property
    def leaderless_s(self) -> float:
        """How long nobody has been known to run jobs; 0 as long as that is no fault."""
        silent_s = time.monotonic() - self._led_s
        return silent_s if silent_s > LEADERLESS * self._settings.lease_s else 0.0

    def _go_on(self) -> bool:
        return self.leads and not self.stopping.is_set()

    def _renew(self) -> None:
        while not self.stopping.is_set():
            asked_s = time.monotonic()
            try:
                if take(self._store.engine, self.holder, self._settings.lease_s):
                    if not self.leads:
                        log.info("this process runs the jobs now")
                        self._work.set()
                    self._renewed_s = asked_s
                else:
                    self._renewed_s = float("-inf")
                self._led_s = asked_s
            except Exception:
                log.exception("the lease could not be renewed; it is tried again")
            self.stopping.wait(self._settings.lease_s / 5)

    def _run(self) -> None:
        while not self.stopping.is_set():
            if not (self._go_on() and self._step()):
                self._work.wait(POLL_S)
                self._work.clear()

    def _step(self) -> bool:
        """Start one job; False where there is nothing to start. A fault never ends the thread."""
        self._busy = {job_id: t for job_id, t in self._busy.items() if t.is_alive()}
        if len(self._busy) >= self._settings.slots:
            return False
        limit = 0 if self.scheduler.fault() else self._settings.running_jobs  # queued jobs wait
        try:
            job = self._store.claim(list(self._busy), limit, self._turns, self.holder)
        except Exception:
            log.exception("no job could be claimed; it is tried again")
            self.stopping.wait(1.0)
            return False
        if job is None:
            return False
        self._turns[job.team] = time.monotonic()
        thread = threading.Thread(target=self._guarded, args=(job,), name=job.id, daemon=True)
        self._busy[job.id] = thread
        thread.start()
        return True

    def _guarded(self, job: Job) -> None:
        """Run a job; a fault of the runner ends that job, not the queue behind it."""
        attempt = Attempt(self._settings, self._store, job, self._go_on, self.scheduler)
        said = {"job": job.id, "attempt": job.attempt}
        try:
            try:
                attempt.run()
            except (NotReady, sa.exc.DBAPIError):
                raise
            except Exception:
                log.exception("the runner failed", extra=said)
                attempt.fail()
        except NotReady as error:
            log.warning("this attempt is over: %s", error, extra=said)
        except sa.exc.DBAPIError:
            log.exception("the job table cannot be written; the job is taken up again", extra=said)
            self.stopping.wait(1.0)
        finally:
            self._work.set()

    def _keep(self) -> None:
        """Remove what was deleted, and what has outlived its time."""
        while not self.stopping.wait(HOUSEKEEPING_S):
            if not self.leads:
                continue
            try:
                for job_id in self._store.overdue():
                    self._store.delete(job_id, actor="service")
                for job_id in self._store.deleted():
                    if job_id not in self._busy:
                        shutil.rmtree(self._settings.product(job_id), ignore_errors=True)
                        self._store.forget(job_id)
            except NotReady:
                continue  # it changed in between
            except Exception:
                log.exception("housekeeping failed; it is tried again")
