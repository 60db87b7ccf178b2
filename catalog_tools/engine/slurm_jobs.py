"""Slurm's jobs as workers: what sbatch refuses is told, and a job that has ended is followed."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import dask
from dask_jobqueue import SLURMCluster
from dask_jobqueue.slurm import SLURMJob
from distributed import Adaptive, Client, Scheduler, Security
from distributed.core import Status

from ..errors import BadInput, TryLater

LOOK_S = 20.0  # Slurm is asked so often which jobs there are
MOST_IN_VAIN = 20  # jobs in a row that end before their worker came
SETTINGS = "settings in jobqueue.slurm of Dask's configuration"
OF_THE_MOMENT = ("contact", "timed out", "temporarily")  # sbatch's words for what may pass


class SlurmJob(SLURMJob):
    """A job of Slurm; one that sbatch refuses counts as one that has ended."""

    refusal: Exception | None = None
    came = False  # a worker of it has been at the scheduler

    async def start(self) -> None:
        try:
            await super().start()
        except (OSError, RuntimeError, ValueError) as error:
            self.refusal, self.status = error, Status.running

    async def close(self) -> None:
        await super().close()
        self.status = Status.closed


class Jobs(SLURMCluster):
    """A cluster that knows which of its jobs Slurm still has."""

    job_cls = SlurmJob
    scheduler: Scheduler
    _numbers = itertools.count()
    looked_s = -LOOK_S
    lost = ""  # why the last job that is gone has ended
    in_queue = ""  # state and reason of the jobs that are there
    refusal: Exception | None = None
    in_vain = 0  # jobs in a row that ended before their worker came
    given_up = ""  # why no more jobs are asked for

    def _new_worker_name(self, _: int) -> str:
        """A name that none had before: the scheduler may still know the worker of an ended job."""
        return f"{self._name}-{next(self._numbers)}"

    async def forget_ended(self) -> None:
        """Forget the jobs that Slurm does not have any more, so that others take their place.

        Where one after the other ends before its worker came, the scheduler is closed.
        """
        names = self._workers_there()
        if not self.workers or time.monotonic() - self.looked_s < LOOK_S:
            return
        self.looked_s = time.monotonic()
        submitted = any(job.job_id for job in self.workers.values())
        queue = await _queue() if submitted else {}
        if queue is not None:
            self._keep_those_of(queue)
        if self.in_vain >= MOST_IN_VAIN and not names:
            self.given_up = f"{self.in_vain} jobs in a row ended before a worker came"
            await self.scheduler.close()

    def _keep_those_of(self, queue: dict[str, str]) -> None:
        known = dict(self.workers)
        there = [job.job_id for job in known.values() if job.job_id in queue]
        self.in_queue = "; ".join(f"job {number}: {queue[number]}" for number in there)
        for name, job in known.items():
            if job.job_id not in queue:
                self.lost, self.refusal = f"Slurm's job {job.job_id}", job.refusal
                self.in_vain = 0 if job.came else self.in_vain + 1
                job.status = Status.closed
                self.workers.pop(name, None)
                self.worker_spec.pop(name, None)

    def _workers_there(self) -> set[str]:
        """Names of the workers at the scheduler; their jobs have come."""
        names = {str(worker.name) for worker in self.scheduler.workers.values()}
        jobs = names | {_job_of(name) for name in names}
        for name in jobs & self.workers.keys():
            self.workers[name].came = True
        return names


async def _queue() -> dict[str, str] | None:
    """State and reason of each job that Slurm has of this user; None where it does not answer."""
    try:
        told = await SlurmJob._call(["squeue", "--me", "--noheader", "--format=%i %T (%r)"])
    except (OSError, RuntimeError):
        return None
    return dict(line.strip().split(" ", 1) for line in told.splitlines())


class FollowsJobs(Adaptive):
    """Asks for as many jobs as there is work for, and for others where some have ended."""

    cluster: Jobs

    async def adapt(self) -> None:
        await self.cluster.forget_ended()
        await super().adapt()


def _job_of(worker: str) -> str:
    """The job of a worker that is one of several processes of a job."""
    return worker.rpartition("-")[0]


@contextmanager
def cluster_of_jobs(folder: Path, most: int) -> Iterator[Jobs]:
    """A scheduler here and from one to `most` jobs of Slurm; certificates in a folder.

    Raises BadInput for settings that cannot be used, TryLater where jobs end one after the other
    before a worker comes.
    """
    settings = dask.config.get("jobqueue.slurm")
    if settings["cores"] is None or settings["memory"] is None:
        where = "copy deploy/slurm/jobqueue.yaml to ~/.config/dask"
        raise BadInput("--scheduler", "slurm", f"{SETTINGS}: cores and memory ({where})")
    processes = settings["processes"]
    grouped = bool(processes) and processes > 1
    try:
        cluster = Jobs(
            security=Security.temporary(),
            protocol="tls://",
            shared_temp_directory=str(folder),
            # not 8787 of all networks
            scheduler_options={"dashboard_address": "127.0.0.1:0"}
            | (settings["scheduler-options"] or {}),
            worker_extra_args=["--no-dashboard", *(settings["worker-extra-args"] or ())],
            **({"processes": processes} if grouped else {}),
        )
    except (ValueError, RuntimeError, OSError) as error:
        told = " ".join(str(error).split())
        raise BadInput("--scheduler", "slurm", f"{SETTINGS}; {told}") from None
    # Jobs are forgotten when Slurm has them no more, not when their workers are silent.
    with cluster, dask.config.set({"distributed.deploy.lost-worker-timeout": "3650 days"}):
        key = {"worker_key": lambda worker: _job_of(str(worker.name))} if grouped else {}
        cluster.adapt(Adaptive=FollowsJobs, minimum_jobs=1, maximum_jobs=most, **key)
        with _why_given_up(cluster):
            yield cluster


@contextmanager
def _why_given_up(cluster: Jobs) -> Iterator[None]:
    """Say that jobs ended in vain where that is why the scheduler was lost. Raises TryLater."""
    try:
        yield
    except TryLater as error:
        if not cluster.given_up:
            raise
        last = cluster.refusal and _refused(cluster.refusal)
        why = last or f"last {cluster.lost}, whose log says why"
        raise TryLater(f"{cluster.given_up}: {why}") from error


def wait_for_a_job(client: Client, cluster: Jobs, patience_s: float) -> None:
    """Wait until a first worker is there.

    Raises BadInput where sbatch refuses the job, TryLater where none starts in time, or one ends
    before its worker came.
    """
    deadline = time.monotonic() + patience_s
    while not client.nthreads():
        if cluster.refusal is not None:
            raise _refused(cluster.refusal)
        if cluster.lost:
            raise TryLater(f"{cluster.lost} ended before its worker came; its log says why")
        if time.monotonic() > deadline:
            queue = f" ({cluster.in_queue})" if cluster.in_queue else ""
            raise TryLater(f"Slurm started no job in time{queue}")
        time.sleep(0.1)


def _refused(error: Exception) -> BadInput | TryLater:
    """What to say where sbatch takes no job."""
    if isinstance(error, FileNotFoundError):
        return BadInput("--scheduler", "slurm", "a machine that has Slurm's command sbatch")
    lines = str(error).strip().splitlines() or [type(error).__name__]
    told = lines[-1].removeprefix("sbatch: error: ")
    if any(words in told for words in OF_THE_MOMENT):
        return TryLater(f"sbatch takes no job now ({told})")
    return BadInput("--scheduler", "slurm", f"{SETTINGS} that sbatch takes ({told})")
