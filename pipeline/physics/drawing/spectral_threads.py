"""Strips of an array on a few threads: fixed strips and no shared sums, so the same bits always."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor


def each(task: Callable[[int], None], count: int, threads: int) -> None:
    """Call task(0) ... task(count - 1), each once, on up to `threads` threads.

    Tasks write to places of their own. The first error raised by one is raised here.
    """
    if threads <= 1 or count <= 1:
        for k in range(count):
            task(k)
        return
    with ThreadPoolExecutor(min(threads, count)) as pool:
        for _ in pool.map(task, range(count)):
            pass


def strips(size: int, width: int) -> list[slice]:
    """Slices of `width` (the last one shorter) that cover `size`."""
    return [slice(i, min(i + width, size)) for i in range(0, size, width)]
