"""Pieces between reading and writing: sorted runs of rows on disk, column by column.

A piece is one plain file: the columns of PIECE one after another, little-endian, rows by HEALPix
index, NaN for an absent float; and the source_ids once more, ascending, to find repeated ones. So
any run of any column is one seek and one read, and costs no more memory than itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import google_crc32c
import numpy as np

from .columns import HEALPIX_COLUMN, STORED
from .errors import Damaged
from .judging import PLACE_COLUMN, Columns

IDS = "source_id, ascending"
PIECE: dict[str, np.dtype] = {
    **{field.name: np.dtype(field.type.to_pandas_dtype()) for field in STORED},
    PLACE_COLUMN: np.dtype(np.int64),
    IDS: np.dtype(np.int64),
}
ROW_BYTES = sum(kind.itemsize for kind in PIECE.values())


class Piece(NamedTuple):
    """One sorted run: its batch and file, and the ranges of pixels and source_ids it holds."""

    batch: int
    name: str
    rows: int
    first_29: int
    last_29: int
    first_id: int
    last_id: int
    crc32c: int


def write_piece(folder: Path, batch: int, number: int, rows: Columns) -> Piece:
    """Sort rows (in any order; the dictionary is emptied) and write them as a piece of a batch."""
    name = f"{batch:06d}-{number:04d}.rows"
    places = np.argsort(rows[HEALPIX_COLUMN], kind="stable")
    ids = np.sort(rows["source_id"])
    crc, count = 0, places.size
    first_29, last_29 = rows[HEALPIX_COLUMN][places[[0, -1]]].tolist()
    with (folder / name).open("wb") as file:
        for column, kind in PIECE.items():
            values = ids if column == IDS else rows.pop(column)[places]
            data = np.ascontiguousarray(values, kind).data.cast("B")
            crc = google_crc32c.extend(crc, bytes(data))
            file.write(data)
    return Piece(batch, name, count, first_29, last_29, int(ids[0]), int(ids[-1]), crc)


def is_whole(folder: Path, piece: Piece) -> bool:
    """Whether a piece's file is as it was written."""
    try:
        crc = 0
        with (folder / piece.name).open("rb") as file:
            while data := file.read(1 << 20):
                crc = google_crc32c.extend(crc, data)
            return file.tell() == piece.rows * ROW_BYTES and crc == piece.crc32c
    except OSError:
        return False


def column(
    folder: Path, piece: Piece, name: str, start: int = 0, stop: int | None = None
) -> np.ndarray:
    """Rows [start, stop) of one column of a piece, read into memory."""
    stop = piece.rows if stop is None else stop
    offset = _offset(piece, name) + start * PIECE[name].itemsize
    values = np.fromfile(folder / piece.name, PIECE[name], stop - start, offset=offset)
    if values.size != stop - start:
        raise Damaged(str(folder / piece.name), "is shorter than it was written")
    return values


def mapped(folder: Path, piece: Piece, name: str) -> np.ndarray:
    """A column of a piece, memory-mapped: for a few look-ups."""
    shape = (piece.rows,)
    return np.memmap(folder / piece.name, PIECE[name], "r", _offset(piece, name), shape)


def _offset(piece: Piece, name: str) -> int:
    """Where a column begins in the piece's file."""
    names = list(PIECE)
    return piece.rows * sum(PIECE[n].itemsize for n in names[: names.index(name)])


class Pieces:
    """All pieces of an ingest, by the ranges that they hold."""

    def __init__(self, folder: Path, pieces: Sequence[Piece]) -> None:
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

    def runs(self, first_29: int, end_29: int) -> list[tuple[int, int, int]]:
        """(piece, start, stop) of the rows whose order-29 pixels are in a half-open range."""
        found = []
        for i in self.with_pixels(first_29, end_29).tolist():
            piece = self.pieces[i]
            if first_29 <= piece.first_29 and piece.last_29 < end_29:
                found.append((i, 0, piece.rows))
                continue
            pixels = mapped(self.folder, piece, HEALPIX_COLUMN)
            start, stop = np.searchsorted(pixels, [first_29, end_29]).tolist()
            if stop > start:
                found.append((i, start, stop))
        return found

    def rows_between(self, first_29: int, end_29: int) -> int:
        """How many rows have order-29 pixels in a half-open range."""
        return sum(stop - start for _, start, stop in self.runs(first_29, end_29))

    def gather(self, runs: Sequence[tuple[int, int, int]], name: str) -> np.ndarray:
        """One column of all rows of some runs."""
        parts = [column(self.folder, self.pieces[i], name, a, b) for i, a, b in runs]
        return np.concatenate(parts) if parts else np.empty(0, PIECE[name])

    def ids_between(self, number: int, low: int | None, high: int | None) -> np.ndarray:
        """Ascending source_ids of a piece in [low, high)."""
        piece = self.pieces[number]
        ids = mapped(self.folder, piece, IDS)
        start = 0 if low is None else int(np.searchsorted(ids, low))
        stop = piece.rows if high is None else int(np.searchsorted(ids, high))
        return column(self.folder, piece, IDS, start, stop)
