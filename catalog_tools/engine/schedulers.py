"""Schedulers: where the graph runs, behind one small interface."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from concurrent.futures import (
    FIRST_COMPLETED,
    Future,
    ThreadPoolExecutor,
    wait,
)
from contextlib import contextmanager
from typing import Protocol

from .addresses import check_scheduler
from .ahead import AHEAD, Graph, Key, Progress, Tasks, Value, Work, cores, outcome
from .heap import one_heap

TASKS_PER_WINDOW = 256


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
        from dask import callbacks, local, threaded

        def finished(key: Key, *_: object) -> None:
            done(key[0] if isinstance(key, tuple) else str(key))

        with callbacks.Callback(posttask=finished):
            if self.kind == "synchronous":
                return list(local.get_sync(graph, keys))
            pool = ThreadPoolExecutor(self.workers)
            try:
                return list(threaded.get(graph, keys, num_workers=self.workers, pool=pool))
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
    check_scheduler(kind)
    from .cluster_scheduler import ClusterScheduler
    from .clusters import cluster

    with cluster(kind, workers, count) as (client, tasks_at_once):
        yield ClusterScheduler(client, tasks_at_once)
