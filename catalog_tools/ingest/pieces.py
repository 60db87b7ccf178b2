"""Pieces between reading and writing: sorted runs of rows on disk, column by column.

A piece is one plain file: the columns of PIECE one after another, little-endian, rows by HEALPix
index, NaN for an absent float; and the source_ids once more, ascending, to find repeated ones. So
any run of any column is one seek and one read, and costs no more memory than itself. Behind them
stands the index: a crc32c for each BLOCK_ROWS rows of each column, by which every read is checked,
and the first value of each block of the two sorted columns, by which rows are found.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import google_crc32c
import numpy as np

from ..columns import HEALPIX_COLUMN, STORED
from ..errors import Damaged
from .judging import PLACE_COLUMN, Columns

IDS = "source_id, ascending"
PIECE: dict[str, np.dtype] = {
    **{field.name: np.dtype(field.type.to_pandas_dtype()) for field in STORED},
    PLACE_COLUMN: np.dtype(np.int64),
    IDS: np.dtype(np.int64),
}
ROW_BYTES = sum(kind.itemsize for kind in PIECE.values())
BLOCK_ROWS = 2048
CHANGED = "it is not as it was written; run the same command again: its rows are read anew"
Run = tuple[int, int, int]  # a piece, and the half-open range of its rows
INDEX = np.dtype([("crc32c", "<u4", len(PIECE)), ("first_29", "<i8"), ("first_id", "<i8")])


class SortedRun(NamedTuple):
    """One sorted run: its batch and file, and the ranges of pixels and source_ids it holds.

    crc32c : of the file's index, and so of all its content.
    """

    batch: int
    name: str
    rows: int
    first_29: int
    last_29: int
    first_id: int
    last_id: int
    crc32c: int


def write_piece(folder: Path, batch: int, name: str, rows: Columns) -> SortedRun:
    """Sort rows (in any order; the dictionary is emptied) and write them as a piece of a batch."""
    places = np.argsort(rows[HEALPIX_COLUMN], kind="stable")
    ids = np.sort(rows["source_id"])
    count = places.size
    pixels = rows[HEALPIX_COLUMN][places]
    index = np.zeros(-(-count // BLOCK_ROWS), INDEX)
    index["first_29"], index["first_id"] = pixels[::BLOCK_ROWS], ids[::BLOCK_ROWS]
    with (folder / name).open("wb") as file:
        for i, (column, kind) in enumerate(PIECE.items()):
            values = ids if column == IDS else rows.pop(column)[places]
            data = np.ascontiguousarray(values, kind)
            index["crc32c"][:, i] = _checksums(data)
            file.write(data.data.cast("B"))
        file.write(index.tobytes())
    crc = google_crc32c.value(index.tobytes())
    ends = int(pixels[0]), int(pixels[-1]), int(ids[0]), int(ids[-1])
    return SortedRun(batch, name, count, *ends, crc)


def is_whole(folder: Path, piece: SortedRun) -> bool:
    """Whether a piece's file is as it was written."""
    try:
        _index.cache_clear()
        for name in PIECE:
            column(folder, piece, name)
    except (Damaged, OSError):
        return False
    return True


def column(
    folder: Path, piece: SortedRun, name: str, start: int = 0, stop: int | None = None
) -> np.ndarray:
    """Rows [start, stop) of one column of a piece, read into memory; Damaged where they changed."""
    stop = piece.rows if stop is None else stop
    names, size = list(PIECE), PIECE[name].itemsize
    block, end = start // BLOCK_ROWS, -(-stop // BLOCK_ROWS)
    first, last = block * BLOCK_ROWS, min(end * BLOCK_ROWS, piece.rows)
    before = piece.rows * sum(PIECE[n].itemsize for n in names[: names.index(name)])
    data = _read(folder, piece, before + first * size, (last - first) * size)
    values = np.frombuffer(data, PIECE[name])
    expected = _index(folder, piece)["crc32c"][block:end, names.index(name)]
    if _checksums(values) != expected.tolist():
        raise _damaged(folder, piece)
    return values[start - first : stop - first]


def search(folder: Path, piece: SortedRun, name: str, values: Sequence[int]) -> list[int]:
    """Where values belong in a sorted column (HEALPIX_COLUMN or IDS), before equal ones."""
    firsts = _index(folder, piece)["first_id" if name == IDS else "first_29"]
    found = []
    for value in values:
        start = max(int(np.searchsorted(firsts, value)) - 1, 0) * BLOCK_ROWS
        held = column(folder, piece, name, start, min(start + BLOCK_ROWS, piece.rows))
        found.append(start + int(np.searchsorted(held, value)))
    return found


def some_ids(folder: Path, piece: SortedRun) -> np.ndarray:
    """One source_id of each block, ascending: they tell how ids are spread."""
    return _index(folder, piece)["first_id"]


def _checksums(values: np.ndarray) -> list[int]:
    """crc32c of each block."""
    starts = range(0, values.size, BLOCK_ROWS)
    return [google_crc32c.value(values[i : i + BLOCK_ROWS].tobytes()) for i in starts]


@lru_cache(maxsize=256)
def _index(folder: Path, piece: SortedRun) -> np.ndarray:
    """What proves a piece (INDEX), a record a block."""
    size = -(-piece.rows // BLOCK_ROWS) * INDEX.itemsize
    data = _read(folder, piece, piece.rows * ROW_BYTES, size)
    if google_crc32c.value(data) != piece.crc32c:
        raise _damaged(folder, piece)
    return np.frombuffer(data, INDEX)


def _read(folder: Path, piece: SortedRun, offset: int, size: int) -> bytes:
    try:
        with (folder / piece.name).open("rb", buffering=0) as file:
            file.seek(offset)
            data = file.read(size)
    except FileNotFoundError:
        data = b""
    if len(data) != size:
        raise _damaged(folder, piece)
    return data


def _damaged(folder: Path, piece: SortedRun) -> Damaged:
    return Damaged(str(folder / piece.name), CHANGED)


class Pieces:
    """All pieces of an ingest, by the ranges that they hold."""

    def __init__(self, folder: Path, pieces: Sequence[SortedRun]) -> None:
        self.folder, self.pieces = folder, tuple(pieces)
        ends = [(p.first_29, p.last_29, p.first_id, p.last_id, p.rows) for p in pieces]
        self._ends = np.array(ends, np.int64).reshape(-1, 5)

    @property
    def rows(self) -> int:
        """Rows of all pieces."""
        return int(self._ends[:, 4].sum())

    def with_pixels(self, first_29: int, end_29: int) -> np.ndarray:
        """Numbers of the pieces that may hold order-29 pixels of a half-open range."""
        return np.flatnonzero((self._ends[:, 0] < end_29) & (self._ends[:, 1] >= first_29))

    def with_ids(self, low: int | None, high: int | None) -> np.ndarray:
        """Numbers of the pieces that may hold source_ids in [low, high); None is no bound."""
        fits = np.ones(len(self.pieces), bool)
        if low is not None:
            fits &= self._ends[:, 3] >= low
        if high is not None:
            fits &= self._ends[:, 2] < high
        return np.flatnonzero(fits)

    def runs(self, first_29: int, end_29: int) -> list[Run]:
        """(piece, start, stop) of the rows whose order-29 pixels are in a half-open range."""
        found = []
        for i in self.with_pixels(first_29, end_29).tolist():
            piece = self.pieces[i]
            if first_29 <= piece.first_29 and piece.last_29 < end_29:
                found.append((i, 0, piece.rows))
                continue
            start, stop = search(self.folder, piece, HEALPIX_COLUMN, [first_29, end_29])
            if stop > start:
                found.append((i, start, stop))
        return found

    def rows_between(self, first_29: int, end_29: int) -> int:
        """How many rows have order-29 pixels in a half-open range."""
        return sum(stop - start for _, start, stop in self.runs(first_29, end_29))

    def gather(self, runs: Sequence[Run], name: str) -> np.ndarray:
        """One column of all rows of some runs."""
        parts = [column(self.folder, self.pieces[i], name, a, b) for i, a, b in runs]
        return np.concatenate(parts) if parts else np.empty(0, PIECE[name])

    def ids_between(self, number: int, low: int | None, high: int | None) -> np.ndarray:
        """Ascending source_ids of a piece in [low, high)."""
        piece = self.pieces[number]
        start = 0 if low is None else search(self.folder, piece, IDS, [low])[0]
        stop = piece.rows if high is None else search(self.folder, piece, IDS, [high])[0]
        return column(self.folder, piece, IDS, start, stop)
