"""Take queued jobs to the engine one at a time, bring the outcome back, go on after a restart."""

from __future__ import annotations

import contextlib
import fcntl
import json
import logging
import os
import queue
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from typing import Any, BinaryIO

from pipeline.spec.scene import Scene
from pipeline.store.layout import BEGUN, COMPLETE
from service.jobs import Job, JobStore, Phase
from service.problems import EngineFault, PlanTooSlow, Refused
from service.settings import Settings

log = logging.getLogger("nightglass.service")

POLL_S = 0.2
DEATHS = 3  # workers in a row that may die on a job without finishing a tile


class Dispatcher:
    """One thread that runs the jobs of a data folder, in the process that holds its lock.

    The lock (flock) is inherited by the worker process: should this process be killed, nobody
    else can take its jobs up until its worker, too, is gone.
    """

    def __init__(self, settings: Settings, store: JobStore) -> None:
        self._settings, self._store = settings, store
        self.stopping, self._work = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run, name="dispatcher", daemon=True)
        self.leads = False

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        """End the worker and the thread. A job that runs stays EXECUTING and is resumed later."""
        self.stopping.set()
        self._work.set()
        self._thread.join()

    def wake(self) -> None:
        """There is something to do."""
        self._work.set()

    @property
    def alive(self) -> bool:
        return self._thread.is_alive()

    def _run(self) -> None:
        with self._settings.dispatcher_lock.open("w") as lock:
            while not self.stopping.is_set():
                if not self.leads:
                    with contextlib.suppress(BlockingIOError):
                        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                        self.leads = True
                busy = self.leads and self._step(lock.fileno())
                if not busy:
                    self._work.wait(POLL_S)
                    self._work.clear()
            self.leads = False

    def _step(self, lock_fd: int) -> bool:
        """Do one thing; False where there was nothing to do. A fault here never ends the thread."""
        try:
            for job_id in self._store.deleted():
                shutil.rmtree(self._settings.product(job_id), ignore_errors=True)
                self._store.forget(job_id)
            job = self._store.claim()
            if job is not None:
                self._guarded(job, lock_fd)
            return job is not None
        except Exception:
            log.exception("the dispatcher could not go on; it tries again")
            self.stopping.wait(1.0)
            return False

    def _guarded(self, job: Job, lock_fd: int) -> None:
        """Run a job; a fault of the runner ends that job, not the queue behind it."""
        try:
            self._execute(job, lock_fd)
        except Exception:
            log.exception("job %s: the runner failed", job.id)
            self._store.finish(job, Phase.ERROR, error=_fault("an internal fault of the runner"))

    def _execute(self, job: Job, lock_fd: int) -> None:
        """Run one attempt of a job until it ends, is cancelled, or the service stops."""
        outcome: dict[str, Any] | None = None
        if not job.cancel_asked:
            with _worker(self._settings, self._order(job), lock_fd) as answers:
                outcome = self._watch(job, answers)
        if outcome is None and self.stopping.is_set():
            return
        if outcome is None and self._store.seen(job).cancel_asked:
            self._store.finish(job, Phase.ABORTED)
        elif outcome is None:
            self._count_death(job)
        elif "error" in outcome:
            self._store.finish(job, Phase.ERROR, error=outcome["error"])
        elif (self._settings.product(job.id) / COMPLETE).is_file():
            tiles = outcome["tiles"]
            digest = outcome["content_digest"]
            self._store.finish(
                job, Phase.COMPLETED, tiles_done=tiles, tiles_total=tiles, content_digest=digest
            )
        else:
            self._store.finish(job, Phase.ERROR, error=_fault("the product was not sealed"))

    def _order(self, job: Job) -> dict[str, Any]:
        """What the worker is to do: go on with an unfinished product, or begin one."""
        product = self._settings.product(job.id)
        resume = (product / BEGUN).is_file()
        if product.exists() and not resume:
            shutil.rmtree(product)
        return {
            "do": "render",
            "scene": self._store.scene(job.id, hidden=True),
            "product": os.path.relpath(product, self._settings.catalogues.resolve()),
            "resume": resume,
            "workers": self._settings.workers,
        }

    def _watch(
        self, job: Job, answers: queue.Queue[dict[str, Any] | None]
    ) -> dict[str, Any] | None:
        """The worker's outcome; None where it died, was cancelled, or the service stops."""
        while not self.stopping.is_set():
            try:
                answer = answers.get(timeout=POLL_S)
            except queue.Empty:
                if self._store.seen(job).cancel_asked:
                    return None
                continue
            if answer is None or "outcome" in answer:
                return answer
            self._store.progress(job, answer["done"], answer["total"])
            if self._store.seen(job).cancel_asked:
                return None
        return None

    def _count_death(self, job: Job) -> None:
        """A worker that died is replaced, unless job after job it kills them without a tile."""
        now = self._store.seen(job)
        progressed = (now.tiles_done or 0) > (job.tiles_done or 0)
        deaths = 1 if progressed else job.deaths + 1
        log.warning("job %s: worker of attempt %d died (%d)", job.id, job.attempt, deaths)
        if deaths >= DEATHS:
            reason = f"{deaths} workers in a row died on this job (out of memory?)"
            self._store.finish(job, Phase.ERROR, error=_fault(reason))
        else:
            self._store.died(job, deaths)


def _fault(message: str) -> dict[str, Any]:
    return {"kind": "fault", "message": message, "errors": []}


@contextlib.contextmanager
def _worker(
    settings: Settings, order: dict[str, Any], *inherited: int
) -> Iterator[queue.Queue[dict[str, Any] | None]]:
    """A worker process with its order given, and a queue of its answers (None: it has ended).

    Leaving the block ends the process, whatever it does: a product survives that at any moment.
    """
    environment = os.environ | {"MALLOC_TRIM_THRESHOLD_": "65536"}
    process = subprocess.Popen(
        [sys.executable, "-P", "-m", "service.worker"], cwd=settings.catalogues, env=environment,
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, pass_fds=inherited, start_new_session=True,
    )  # fmt: skip
    assert process.stdin is not None
    assert process.stdout is not None
    answers: queue.Queue[dict[str, Any] | None] = queue.Queue()
    reader = threading.Thread(target=_read, args=(process.stdout, answers), daemon=True)
    reader.start()
    try:
        with contextlib.suppress(BrokenPipeError):
            process.stdin.write(json.dumps(order).encode() + b"\n")
            process.stdin.flush()
        yield answers
    finally:
        process.kill()
        process.wait()
        reader.join()
        with contextlib.suppress(BrokenPipeError):
            process.stdin.close()
        process.stdout.close()


def _read(stream: BinaryIO, answers: queue.Queue[dict[str, Any] | None]) -> None:
    for line in stream:
        with contextlib.suppress(ValueError):  # a line cut off by the worker's death
            answers.put(json.loads(line))
    answers.put(None)


def plan_dry(scene: Scene, settings: Settings, stopping: threading.Event) -> dict[str, Any]:
    """The plan of a scene, made in a worker so that the service stays quick and can stop it.

    Raises Refused, PlanTooSlow, EngineFault.
    """
    order = {"do": "plan", "scene": scene.as_dict()}
    deadline = time.monotonic() + settings.plan_s
    outcome = None
    with _worker(settings, order) as answers:
        while not stopping.is_set():
            try:
                outcome = answers.get(timeout=POLL_S)
                break
            except queue.Empty:
                if time.monotonic() > deadline:
                    raise PlanTooSlow(f"planning took over {settings.plan_s:g} s") from None
    if outcome is None:
        raise EngineFault("the planner stopped without an answer")
    if "error" in outcome:
        error = outcome["error"]
        raise Refused(error) if error["kind"] == "bad input" else EngineFault(error["message"])
    return outcome["plan"]
