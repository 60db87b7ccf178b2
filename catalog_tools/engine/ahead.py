"""Run a function over items on a few threads, a bounded number ahead of the results' taker."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")
Progress = Callable[[str], None]  # called with the kind of each task that is done
Value = Any  # what tasks take and give: whatever can be pickled
Key = Any  # of a task: text, or a tuple of text and numbers
Tasks = dict[Key, Value]  # by key: tuples (function, arguments...)
Work = Callable[[Value, Value], Value]  # of what all share, and an item
Graph = tuple[Tasks, list[Key]]  # tasks, and the keys that are wanted
AHEAD = 3  # items in work or waiting for each thread


def cores() -> int:
    """Processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def threads(count: int) -> Iterator[Executor | None]:
    """A pool of threads; none for 0, where the caller's own is quicker."""
    if count:
        with ThreadPoolExecutor(count) as pool:
            yield pool
    else:
        yield None


def ahead(
    pool: Executor | None, function: Callable[[Item], Result], items: Iterable[Item], most: int
) -> Iterator[Result]:
    """Results in the items' order; at most `most` are in work or waiting to be taken.

    Without a pool each is computed when it is asked for.
    """
    if pool is None:
        yield from map(function, items)
        return
    waiting: deque[Future[Result]] = deque()
    try:
        for item in items:
            waiting.append(pool.submit(function, item))
            if len(waiting) >= most:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        for future in waiting:
            future.cancel()


def outcome(function: Work, shared: Value, item: Value) -> Value:
    """What a function gives, or the error that it raises."""
    try:
        return function(shared, item)
    except Exception as error:
        return error
