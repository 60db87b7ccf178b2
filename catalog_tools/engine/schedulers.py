"""Schedulers: where the graph runs, behind one small interface."""

from __future__ import annotations

import itertools
import logging
import os
from collections.abc import Iterable, Iterator
from concurrent.futures import (
    FIRST_COMPLETED,
    Future,
    ThreadPoolExecutor,
    wait,
)
from contextlib import contextmanager
from typing import Protocol

from ..errors import BadInput
from .ahead import AHEAD, Graph, Key, Progress, Tasks, Value, Work, cores, outcome
from .clusters import check_address, connected, slurm
from .heap import ALLOCATION, one_heap

LOCAL_KINDS = ("threads", "synchronous", "processes", "slurm")
TASKS_PER_WINDOW = 256
CHATTY = ("distributed", "distributed.client", "tornado", "tornado.application")


class Scheduler(Protocol):
    """Runs graphs whose tasks are tuples (function, arguments...).

    least_task_s : CPU seconds that a task should last at least, so that sending it costs little
    """

    workers: int
    least_task_s: float

    def share(self, value: Value) -> Value:
        """Make a value available to all tasks, sent at most once to each worker."""

    def keep(self, graph: Tasks) -> Tasks:
        """Compute every task of a graph and keep the results for later graphs."""

    def run(self, graph: Tasks, keys: list[Key], done: Progress) -> list[Value]:
        """Compute `keys`; `done` hears the kind (first part of the key) of each finished task."""

    def stream(self, graphs: Iterable[Graph], done: Progress) -> None:
        """Compute the keys of very many graphs, their results dropped; `done` as in `run`.

        A graph is taken when there is little left of those before.
        """

    def each(
        self, function: Work, shared: Value, items: Iterable[Value]
    ) -> Iterator[tuple[Value, Value]]:
        """(item, function(shared, item) or the error that it raised) as they are done.

        Items are taken a few ahead of the results, so that there may be any number of them.
        """


class LocalScheduler:
    """Dask's threaded or synchronous scheduler: nothing to start."""

    least_task_s = 0.05

    def __init__(self, kind: str, workers: int) -> None:
        self.kind, self.workers = kind, workers
        one_heap()

    def share(self, value: Value) -> Value:
        return value

    def keep(self, graph: Tasks) -> Tasks:
        keys = list(graph)
        return dict(zip(keys, self.run(graph, keys, lambda _: None), strict=True))

    def run(self, graph: Tasks, keys: list[Key], done: Progress) -> list[Value]:
        from dask.callbacks import Callback
        from dask.local import get_sync
        from dask.threaded import get

        def finished(key: Key, *_: object) -> None:
            done(key[0] if isinstance(key, tuple) else str(key))

        with Callback(posttask=finished):
            if self.kind == "synchronous":
                return list(get_sync(graph, keys))
            pool = ThreadPoolExecutor(self.workers)
            try:
                return list(get(graph, keys, num_workers=self.workers, pool=pool))
            finally:  # interrupted or not, nothing runs on behind the caller's back
                pool.shutdown(wait=True, cancel_futures=True)

    def stream(self, graphs: Iterable[Graph], done: Progress) -> None:
        for graph, keys in graphs:
            self.run(graph, keys, done)

    def each(
        self, function: Work, shared: Value, items: Iterable[Value]
    ) -> Iterator[tuple[Value, Value]]:
        if self.kind == "synchronous":
            for item in items:
                yield item, outcome(function, shared, item)
            return
        pool, left = ThreadPoolExecutor(self.workers), iter(items)
        running: dict[Future[Value], Value] = {}
        try:
            while True:
                for item in itertools.islice(left, AHEAD * self.workers - len(running)):
                    running[pool.submit(outcome, function, shared, item)] = item
                if not running:
                    return
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    yield running.pop(future), future.result()
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


@contextmanager
def open_scheduler(kind: str, workers: int | None) -> Iterator[Scheduler]:
    """The scheduler named by `--scheduler`: threads, synchronous, processes, slurm, an address."""
    count = workers or cores()
    if kind in ("threads", "synchronous"):
        yield LocalScheduler(kind, 1 if kind == "synchronous" else count)
        return
    _check_address(kind)
    set_up_dask()
    from distributed import Client, LocalCluster

    from .cluster_scheduler import ClusterScheduler

    if kind == "processes":
        with (
            LocalCluster(
                n_workers=count,
                threads_per_worker=1,
                processes=True,
                host="127.0.0.1",
                dashboard_address=None,
                silence_logs=50,
                scheduler_sync_interval=60,
                scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},  # not 8787 of all networks
            ) as cluster,
            Client(cluster) as client,
        ):
            yield ClusterScheduler(client, count)
        return
    with slurm(workers) if kind == "slurm" else connected(kind) as client:
        yield ClusterScheduler(client, max(1, sum(client.nthreads().values())))


def set_up_dask() -> None:
    """Dask's settings as our clients and workers want them, and silence: what goes wrong we say."""
    for name, value in ALLOCATION.items():
        os.environ.setdefault(name, value)
    import dask
    import distributed  # noqa: F401 (with it the levels that are set below)

    dask.config.set(
        {
            "distributed.worker.multiprocessing-method": "spawn",
            "distributed.scheduler.allowed-failures": 3,
            "distributed.worker.profile.enabled": False,
            # By default 1 to 1000 times a second, in every process: a tenth of a short job.
            "distributed.admin.tick.interval": "5s",
            "distributed.admin.system-monitor.interval": "5s",
            "distributed.admin.system-monitor.gil.enabled": False,
            "distributed.worker.memory.monitor-interval": "1s",
            "distributed.client.scheduler-info-interval": "10s",
            # what tasks share goes in one graph
            "distributed.admin.large-graph-warning-threshold": "1TB",
            "distributed.logging": dict.fromkeys(CHATTY, "critical"),
        }
    )
    for name in CHATTY:
        logging.getLogger(name).setLevel(logging.CRITICAL)


def _check_address(kind: str) -> None:
    """An open scheduler runs anybody's code: beyond loopback only TLS is accepted, and nowhere else
    where Dask's settings require encryption."""
    if kind not in LOCAL_KINDS:
        check_address(kind, LOCAL_KINDS)
    if kind == "processes" or kind.startswith("tcp:"):
        import dask.config

        setting = "distributed.comm.require-encryption"
        if dask.config.get(setting, None):
            allowed = f"threads, or tls:// with certificates: {setting} is set for Dask"
            raise BadInput("--scheduler", kind, allowed)
