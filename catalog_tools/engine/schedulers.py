"""Schedulers: where the graph runs, behind one small interface."""

from __future__ import annotations

import itertools
import logging
import os
import pickle
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import (
    FIRST_COMPLETED,
    CancelledError,
    Future,
    ThreadPoolExecutor,
    wait,
)
from contextlib import contextmanager
from dataclasses import dataclass, is_dataclass
from functools import cache
from importlib.metadata import version
from typing import Any, Protocol
from uuid import uuid4

from ..errors import BadInput, Incomplete, NightglassError, TryLater
from .ahead import cores
from .clusters import check_address, connected, slurm
from .heap import ALLOCATION, one_heap

Progress = Callable[[str], None]  # called with the kind of each task that is done
Graph = tuple[dict[Any, Any], list[Any]]  # tasks by key, and the keys that are wanted
LOCAL_KINDS = ("threads", "synchronous", "processes", "slurm")
TASKS_PER_WINDOW = 256
MOST_TRIES = 3  # of a task, on a cluster
CHATTY = ("distributed", "distributed.client", "tornado", "tornado.application")
AHEAD = 3  # items in work or waiting for each thread
FEWEST_WAITING = 64  # tasks of a stream, so that a cluster that scales itself sees work


class Scheduler(Protocol):
    """Runs graphs whose tasks are tuples (function, arguments...).

    least_task_s : CPU seconds that a task should last at least, so that sending it costs little
    """

    workers: int
    least_task_s: float

    def share(self, value: Any) -> Any:
        """Make a value available to all tasks, sent at most once to each worker."""

    def keep(self, graph: dict[Any, Any]) -> dict[Any, Any]:
        """Compute every task of a graph and keep the results for later graphs."""

    def run(self, graph: dict[Any, Any], keys: list[Any], done: Progress) -> list[Any]:
        """Compute `keys`; `done` hears the kind (first part of the key) of each finished task."""

    def stream(self, graphs: Iterable[Graph], done: Progress) -> None:
        """Compute the keys of very many graphs, their results dropped; `done` as in `run`.

        A graph is taken when there is little left of those before.
        """

    def each(
        self, function: Callable[[Any, Any], Any], shared: Any, items: Iterable[Any]
    ) -> Iterator[tuple[Any, Any]]:
        """(item, function(shared, item) or the error that it raised) as they are done.

        Items are taken a few ahead of the results, so that there may be any number of them.
        """


class LocalScheduler:
    """Dask's threaded or synchronous scheduler: nothing to start."""

    least_task_s = 0.05

    def __init__(self, kind: str, workers: int) -> None:
        self.kind, self.workers = kind, workers
        one_heap()

    def share(self, value: Any) -> Any:
        return value

    def keep(self, graph: dict[Any, Any]) -> dict[Any, Any]:
        keys = list(graph)
        return dict(zip(keys, self.run(graph, keys, lambda _: None), strict=True))

    def run(self, graph: dict[Any, Any], keys: list[Any], done: Progress) -> list[Any]:
        from dask.callbacks import Callback
        from dask.local import get_sync
        from dask.threaded import get

        def finished(key: Any, *_: Any) -> None:
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
        self, function: Callable[[Any, Any], Any], shared: Any, items: Iterable[Any]
    ) -> Iterator[tuple[Any, Any]]:
        if self.kind == "synchronous":
            for item in items:
                yield item, _outcome(function, shared, item)
            return
        pool, left = ThreadPoolExecutor(self.workers), iter(items)
        running: dict[Future[Any], Any] = {}
        try:
            while True:
                for item in itertools.islice(left, AHEAD * self.workers - len(running)):
                    running[pool.submit(_outcome, function, shared, item)] = item
                if not running:
                    return
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    yield running.pop(future), future.result()
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


class ClusterScheduler:
    """A distributed cluster: a LocalCluster of processes, or the one at an address."""

    least_task_s = 1.0

    def __init__(self, client: Any, workers: int) -> None:
        self.client, self.workers = client, workers
        self.where = str(client.scheduler.addr) if client.scheduler else "(closed)"

    def share(self, value: Any) -> Any:
        """As a task, which is run again where it is wanted and every worker that had it is gone."""
        return self.keep({("shared", 0): (_same, value)})["shared", 0]

    def keep(self, graph: dict[Any, Any]) -> dict[Any, Any]:
        futures = self._submit(graph, list(graph))
        self._wait(futures, lambda _: None)
        return dict(zip(graph, futures, strict=True))

    def run(self, graph: dict[Any, Any], keys: list[Any], done: Progress) -> list[Any]:
        futures = self._submit(graph, keys)
        self._wait(futures, done)
        with self._reached():
            return list(self.client.gather(futures))

    def stream(self, graphs: Iterable[Graph], done: Progress) -> None:
        from distributed import as_completed

        ended = as_completed([], loop=self.client.loop, raise_errors=False)
        left, running, most = iter(graphs), 0, FEWEST_WAITING
        while running or most:
            while running < most:
                graph, keys = next(left, ({}, []))
                ended.update(self._submit(graph, keys) if keys else [])
                running += len(keys)
                most = max(FEWEST_WAITING, AHEAD * self._threads()) if keys else 0
            if running:
                self._told(next(ended), done)
                running -= 1

    def each(
        self, function: Callable[[Any, Any], Any], shared: Any, items: Iterable[Any]
    ) -> Iterator[tuple[Any, Any]]:
        from distributed import as_completed

        left = iter(items)
        running: dict[Any, Any] = {}
        sent = self.share(shared)
        done = as_completed([], loop=self.client.loop, raise_errors=False)

        def fill() -> None:
            most = AHEAD * max(1, self._threads())
            for item in itertools.islice(left, max(0, most - len(running))):
                [future] = self._submit(
                    {("item", 0): (_outcome, function, sent, item)}, [("item", 0)]
                )
                running[future.key] = item
                done.add(future)

        fill()
        while running:
            future = next(done)
            with self._reached():
                result = future.exception() if future.status == "error" else future.result()
            if isinstance(result, TryLater):
                raise result
            yield running.pop(future.key), result
            fill()

    def _threads(self) -> int:
        """Threads of all workers that are there now: they come and go."""
        with self._reached():
            return sum(self.client.nthreads().values())

    @contextmanager
    def _reached(self) -> Iterator[None]:
        """While the cluster is spoken to: what fails then is no task's fault. Raises TryLater."""
        from distributed.client import ClosedClientError

        try:
            yield
        except (OSError, CancelledError, ClosedClientError) as error:
            told = " ".join(str(error).split())[:120]
            raise TryLater(f"the scheduler at {self.where} was lost ({told})") from None

    def _submit(self, graph: dict[Any, Any], keys: list[Any]) -> list[Any]:
        """Submit under names that no other run on this scheduler uses: it shares by name."""
        names, once = {key: _unique(key, uuid4().hex) for key in graph}, Once()
        graph = {names[key]: _tried(_renamed(task, names), once) for key, task in graph.items()}
        with self._reached():
            return list(self.client.get(graph, [names[key] for key in keys], sync=False))

    def _wait(self, futures: list[Any], done: Progress) -> None:
        from distributed import as_completed

        for future in as_completed(futures, loop=self.client.loop, raise_errors=False):
            self._told(future, done)

    def _told(self, future: Any, done: Progress) -> None:
        """Tell of a future that has ended. Raises its error, Incomplete where it will not end."""
        from distributed.scheduler import KilledWorker

        if future.status == "cancelled":
            raise TryLater(f"the scheduler at {self.where} was lost, with what it had to do")
        if future.status == "error":
            error = future.exception()
            if isinstance(error, KilledWorker):
                raise Incomplete(f"a task keeps killing its workers: {error}") from None
            raise error
        done(future.key[0] if isinstance(future.key, tuple) else str(future.key))


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


def _same(value: Any) -> Any:
    return value


def _outcome(function: Callable[[Any, Any], Any], shared: Any, item: Any) -> Any:
    """What a function gives, or the error that it raises."""
    try:
        return function(shared, item)
    except Exception as error:
        return error


@dataclass(frozen=True)
class Packed:
    """A value that tasks share, pickled: Dask would pickle it anew for every task, twice, with a
    frame of its own for each of its arrays."""

    name: str
    data: bytes

    def __dask_tokenize__(self) -> str:
        return self.name


class Once:
    """Packs each dataclass among the arguments of tasks once, however many tasks it goes to."""

    def __init__(self) -> None:
        self._kept: dict[int, tuple[Any, Packed]] = {}

    def pack(self, value: Any) -> Any:
        """The value itself where it is no dataclass."""
        if not is_dataclass(value) or isinstance(value, type):
            return value
        if id(value) not in self._kept:
            packed = Packed(uuid4().hex, pickle.dumps(value, pickle.HIGHEST_PROTOCOL))
            self._kept[id(value)] = value, packed
        return self._kept[id(value)][1]


def _tried(task: Any, once: Once) -> Any:
    if type(task) is tuple and callable(task[0]):
        return (_try, _version(), task[0], *map(once.pack, task[1:]))
    return task


@cache
def _version() -> str:
    return version("nightglass")


def _try(wanted: str, function: Callable[..., Any], *arguments: Any) -> Any:
    """Call it; what fails is tried again, but not what one of our messages explains.

    wanted : the version that sent it; a worker that has another one refuses
    """
    if wanted != _version():
        from distributed import get_worker

        raise TryLater(
            f"the worker {get_worker().address} has version {_version()} of nightglass, not "
            f"{wanted}: start it anew with that version"
        )
    arguments = tuple(pickle.loads(a.data) if type(a) is Packed else a for a in arguments)
    for _ in range(MOST_TRIES - 1):
        try:
            return function(*arguments)
        except NightglassError:
            raise
        except Exception:  # a file server's bad moment
            continue
    return function(*arguments)


def _unique(key: Any, token: str) -> tuple[Any, ...]:
    kind, *rest = key if isinstance(key, tuple) else (key,)
    return (kind, token, *rest)


def _renamed(task: Any, names: dict[Any, Any]) -> Any:
    """A task with the keys in it exchanged; tuples and lists are looked into, as Dask does."""
    if type(task) in (tuple, list):
        try:
            if task in names:
                return names[task]
        except TypeError:  # what can't be hashed is no key
            pass
        return type(task)(_renamed(part, names) for part in task)
    return task


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
