"""Which numbers occur more than once among very many: bounded in memory, on disk in between."""

from __future__ import annotations

import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import Incomplete

Ids = NDArray[np.int64]

BUCKET_ROWS = 4_000_000  # 32 MB of numbers in memory at a time, and as much again to sort them
MULTIPLIER = np.uint64(0x9E3779B97F4A7C15)  # 2**64 over the golden ratio: spreads any numbers


@contextmanager
def temporary_distinct(expected: int) -> Iterator[Distinct]:
    """A Distinct in a temporary folder of its own; Incomplete where that has no room."""
    try:
        folder = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
    except OSError as error:
        raise _no_room("no temporary folder", error) from None
    with folder as name:
        yield Distinct(Path(name), expected)


class Distinct:
    """Numbers spread over files in a folder, 8 bytes each: equal ones come into the same file."""

    def __init__(self, folder: Path, expected: int) -> None:
        self._folder, self._lock = folder, threading.Lock()
        self._bits = max(0, (expected // BUCKET_ROWS).bit_length())

    def add(self, ids: Ids) -> None:
        """Take in more numbers (n,); from any thread."""
        if not self._bits:
            parts = {0: ids}
        else:
            bucket = (ids.view(np.uint64) * MULTIPLIER) >> np.uint64(64 - self._bits)
            order = np.argsort(bucket, kind="stable")
            numbers, starts = np.unique(bucket[order], return_index=True)
            parts = dict(zip(numbers.tolist(), np.split(ids[order], starts[1:]), strict=False))
        with self._lock, _room(self._folder):
            for number, part in parts.items():
                with self._path(number).open("ab") as file:
                    file.write(np.ascontiguousarray(part).tobytes())

    def repeated(self) -> Iterator[int]:
        """The numbers that were taken in more than once."""
        for number in range(1 << self._bits):
            if self._path(number).exists():
                with _room(self._folder):
                    ids = np.fromfile(self._path(number), np.int64)
                ids.sort()
                yield from np.unique(ids[1:][ids[1:] == ids[:-1]]).tolist()

    def _path(self, number: int) -> Path:
        return self._folder / f"{number:05d}.ids"


@contextmanager
def _room(folder: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise _no_room(str(folder.parent), error) from None


def _no_room(where: str, error: OSError) -> Incomplete:
    """One message: what, why, and what helps."""
    text = f"{where}: the source_ids (8 bytes a row) could not be kept there ({error.strerror})"
    return Incomplete(f"{text}; make room, or set TMPDIR to a folder that has it")
