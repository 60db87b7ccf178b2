"""The scheduler of a distributed cluster: tasks sent under names of their own, tried again."""

from __future__ import annotations

import itertools
import pickle
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager
from dataclasses import dataclass, is_dataclass
from uuid import uuid4

from distributed import Client, Future, as_completed, get_worker
from distributed.client import ClosedClientError
from distributed.scheduler import KilledWorker

from ..errors import Incomplete, NightglassError, TryLater
from .ahead import AHEAD, Graph, Key, Progress, Tasks, Value, Work, outcome
from .code import code_digest

MOST_TRIES = 3  # of a task, on a cluster
FEWEST_WAITING = 64  # tasks of a stream, so that a cluster that scales itself sees work


class ClusterScheduler:
    """A distributed cluster: a LocalCluster of processes, or the one at an address."""

    least_task_s = 1.0

    def __init__(self, client: Client, workers: int) -> None:
        self.client, self.workers = client, workers
        self.where = str(client.scheduler.addr) if client.scheduler else "(closed)"

    def share(self, value: Value) -> Value:
        """As a task, which is run again where it is wanted and every worker that had it is gone."""
        return self.keep({("shared", 0): (_same, value)})["shared", 0]

    def keep(self, graph: Tasks) -> Tasks:
        futures = self._submit(graph, list(graph))
        self._wait(futures, lambda _: None)
        return dict(zip(graph, futures, strict=True))

    def run(self, graph: Tasks, keys: list[Key], done: Progress) -> list[Value]:
        futures = self._submit(graph, keys)
        self._wait(futures, done)
        with self._reached():
            return list(self.client.gather(futures))

    def stream(self, graphs: Iterable[Graph], done: Progress) -> None:
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
        self, function: Work, shared: Value, items: Iterable[Value]
    ) -> Iterator[tuple[Value, Value]]:
        left = iter(items)
        running: dict[Key, Value] = {}
        sent = self.share(shared)
        done = as_completed([], loop=self.client.loop, raise_errors=False)

        def fill() -> None:
            most = AHEAD * max(1, self._threads())
            for item in itertools.islice(left, max(0, most - len(running))):
                [future] = self._submit(
                    {("item", 0): (outcome, function, sent, item)}, [("item", 0)]
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
        try:
            yield
        except (OSError, CancelledError, ClosedClientError) as error:
            told = " ".join(str(error).split())[:120]
            raise TryLater(f"the scheduler at {self.where} was lost ({told})") from None

    def _submit(self, graph: Tasks, keys: list[Key]) -> list[Future]:
        """Submit under names that no other run on this scheduler uses: it shares by name."""
        names, once = {key: _unique(key, uuid4().hex) for key in graph}, Once()
        graph = {names[key]: _tried(_renamed(task, names), once) for key, task in graph.items()}
        with self._reached():
            return list(self.client.get(graph, [names[key] for key in keys], sync=False))

    def _wait(self, futures: list[Future], done: Progress) -> None:
        for future in as_completed(futures, loop=self.client.loop, raise_errors=False):
            self._told(future, done)

    def _told(self, future: Future, done: Progress) -> None:
        """Tell of a future that has ended. Raises its error, Incomplete where it will not end."""
        if future.status == "cancelled":
            raise TryLater(f"the scheduler at {self.where} was lost, with what it had to do")
        if future.status == "error":
            error = future.exception()
            if isinstance(error, KilledWorker):
                raise Incomplete(f"a task keeps killing its workers: {error}") from None
            raise error
        done(str(future.key[0] if isinstance(future.key, tuple) else future.key))


def _same(value: Value) -> Value:
    return value


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
        self._kept: dict[int, tuple[Value, Packed]] = {}

    def pack(self, value: Value) -> Value:
        """The value itself where it is no dataclass."""
        if not is_dataclass(value) or isinstance(value, type):
            return value
        if id(value) not in self._kept:
            packed = Packed(uuid4().hex, pickle.dumps(value, pickle.HIGHEST_PROTOCOL))
            self._kept[id(value)] = value, packed
        return self._kept[id(value)][1]


def _tried(task: Value, once: Once) -> Value:
    if type(task) is tuple and callable(task[0]):
        return (_try, code_digest(), task[0], *map(once.pack, task[1:]))
    return task


def _try(wanted: str, function: Callable[..., Value], *arguments: Value) -> Value:
    """Call it; what fails is tried again, but not what one of our messages explains.

    wanted : digest of the code that sent it; a worker that has other code refuses
    """
    if wanted != code_digest():
        raise TryLater(
            f"the worker {get_worker().address} runs other code of nightglass, numpy, scipy or "
            "numba: start it anew with that of this process"
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


def _unique(key: Key, token: str) -> tuple[Key, ...]:
    kind, *rest = key if isinstance(key, tuple) else (key,)
    return (kind, token, *rest)


def _renamed(task: Value, names: dict[Key, tuple[Key, ...]]) -> Value:
    """A task with the keys in it exchanged; tuples and lists are looked into, as Dask does."""
    if type(task) in (tuple, list):
        try:
            if task in names:
                return names[task]
        except TypeError:  # what can't be hashed is no key
            pass
        return type(task)(_renamed(part, names) for part in task)
    return task
