"""How much of a worker's memory each pass may take: rows in a piece, in a bucket, in a leaf."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass

import pyarrow as pa

from ..errors import BadInput
from ..partition import Cell

DEFAULT_BYTES = 2 << 30
BASE_BYTES = 160 << 20  # Python, numpy, pyarrow, healpy, distributed (measured)
READING_BYTES = 50 << 20  # one CSV file in blocks, with its decompression (measured)
PIECE_ROW_BYTES = 180  # a row held, sorted and written
LEAF_ROW_BYTES = 200  # a row gathered, arranged and encoded
BUCKET_ROW_BYTES = 24  # a source_id sorted among others
LEAST_BYTES = 256 << 20
MOST_PIECE_ROWS = 500_000
MOST_BUCKET_ROWS = 4_000_000


@dataclass(frozen=True)
class Budget:
    """Bytes that a worker may take in all."""

    worker_bytes: int = DEFAULT_BYTES

    def __post_init__(self) -> None:
        if self.worker_bytes < LEAST_BYTES:
            raise BadInput("memory", self.worker_bytes, f"at least {LEAST_BYTES} bytes (256 MiB)")

    @property
    def piece_rows(self) -> int:
        """Rows that are held while reading."""
        spare = self.worker_bytes - BASE_BYTES - READING_BYTES
        return min(MOST_PIECE_ROWS, spare // PIECE_ROW_BYTES)

    @property
    def file_bytes(self) -> int:
        """What reading one file may take beside the rows that are held."""
        return self.worker_bytes - BASE_BYTES - self.piece_rows * PIECE_ROW_BYTES

    @property
    def bucket_rows(self) -> int:
        """source_ids that are sorted at a time."""
        return min(MOST_BUCKET_ROWS, (self.worker_bytes - BASE_BYTES) // BUCKET_ROW_BYTES // 2)

    @property
    def leaf_rows(self) -> int:
        """Rows of the largest leaf that can be written."""
        return (self.worker_bytes - BASE_BYTES) // LEAF_ROW_BYTES

    def check(self, rows_per_leaf: int) -> None:
        """Refuse leaves that would not fit."""
        if not 1 <= rows_per_leaf <= self.leaf_rows:
            allowed = f"1 to {self.leaf_rows} with {self.worker_bytes} bytes a worker (--memory)"
            raise BadInput("rows_per_leaf", rows_per_leaf, allowed)

    def check_leaves(self, cells: Sequence[Cell]) -> None:
        """Refuse rows that lie so close together that their leaf would not fit."""
        largest = max(cells, key=lambda cell: cell.rows, default=None)
        if largest is not None and largest.rows > self.leaf_rows:
            what = f"{largest.rows} rows in one pixel of order {largest.order}"
            allowed = f"at most {self.leaf_rows} with {self.worker_bytes} bytes a worker (--memory)"
            raise BadInput("source", what, allowed)


def give_back() -> None:
    """Hand memory that the last task freed back to the system, before the next one takes more."""
    pa.default_memory_pool().release_unused()
    libc = ctypes.CDLL(None)
    if hasattr(libc, "malloc_trim"):  # glibc
        libc.malloc_trim(0)
