"""Find source_ids that occur more than once, and choose the row that stays: bounded in memory."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Literal

import numpy as np

from ..columns import HEALPIX_COLUMN, HEALPIX_ORDER, NAMES
from ..geometry.healpix import centres_of
from ..geometry.sphere import directions, separation_rad
from ..storage.durable import whole_file
from .judging import PLACE_COLUMN, Columns
from .pieces import Pieces, column, some_ids

SAME_PLACE_ARCSEC = 1.0
IDS_NAME, PIXELS_NAME = "repeated-ids.i8", "repeated-pixels.i8"


def find(pieces: Pieces, folder: Path, bucket_rows: int) -> None:
    """Write all source_ids that occur more than once in the pieces, and where each one stays.

    The lowest order-29 pixel wins: a choice by content, not by order of arrival, so that the
    result is the same for any order of the sources and any number of workers. About twice
    `bucket_rows` ids are in memory at a time, however many are repeated.
    """
    with whole_file(folder / IDS_NAME) as path, path.open("wb") as file:
        for low, high in pairwise(_bucket_edges(pieces, bucket_rows)):
            file.write(_repeated_between(pieces, low, high, bucket_rows).tobytes())
    ids = _mapped(folder / IDS_NAME, "r")
    with whole_file(folder / PIXELS_NAME) as path:
        with path.open("wb") as file:
            for start in range(0, ids.size, bucket_rows):
                count = min(bucket_rows, ids.size - start)
                file.write(np.full(count, np.iinfo(np.int64).max).tobytes())
        _fill_in_lowest_pixels(pieces, ids, _mapped(path, "r+"))


class Repeated:
    """The repeated source_ids that `find` wrote, memory-mapped."""

    def __init__(self, folder: Path) -> None:
        self.ids = _mapped(folder / IDS_NAME, "r")
        self.pixels = _mapped(folder / PIXELS_NAME, "r")

    def surplus(self, rows: Columns) -> np.ndarray:
        """Places of the rows of a leaf (columns of PIECE but IDS) that don't stay, ascending."""
        none = np.empty(0, np.int64)
        ids = rows["source_id"]
        if not self.ids.size or not ids.size:
            return none
        at = np.minimum(np.searchsorted(self.ids, ids), self.ids.size - 1)
        mine = np.flatnonzero(np.asarray(self.ids)[at] == ids)
        if not mine.size:
            return none
        at = at[mine]
        values = [_comparable(rows[name][mine]) for name in (PLACE_COLUMN, *reversed(NAMES))]
        order = np.lexsort((*values, at))
        mine, at = mine[order], at[order]
        wins = rows[HEALPIX_COLUMN][mine] == self.pixels[at]
        stays = np.zeros(mine.size, bool)
        first = np.unique(at[wins], return_index=True)[1]
        stays[np.flatnonzero(wins)[first]] = True
        return np.sort(mine[~stays])

    def stand_elsewhere(self, rows: Columns, surplus: np.ndarray) -> np.ndarray:
        """Which of the surplus rows (n,) stand apart from the row that stays by more than
        SAME_PLACE_ARCSEC: no repetition of it, but another star, or a place gone wrong."""
        if not surplus.size:
            return np.zeros(0, bool)
        at = np.searchsorted(self.ids, rows["source_id"][surplus])
        stays = directions(*centres_of(HEALPIX_ORDER, self.pixels[at]))
        apart = separation_rad(stays, directions(rows["ra"][surplus], rows["dec"][surplus]))
        return np.asarray(np.degrees(apart) * 3600.0 > SAME_PLACE_ARCSEC)


def _comparable(values: np.ndarray) -> np.ndarray:
    """Values in which NaN has a place: behind all numbers."""
    return np.where(np.isnan(values), np.inf, values) if values.dtype.kind == "f" else values


def _bucket_edges(pieces: Pieces, bucket_rows: int) -> list[int | None]:
    """Edges that cut the ids into buckets of about `bucket_rows`; None stands for no bound."""
    if not pieces.rows:
        return []
    buckets = -(-pieces.rows // bucket_rows)
    if buckets == 1:
        return [None, None]
    ids = np.sort(np.concatenate([some_ids(pieces.folder, piece) for piece in pieces.pieces]))
    cuts = ids[[ids.size * i // buckets for i in range(1, buckets)]]
    return [None, *np.unique(cuts).tolist(), None]


def _repeated_between(
    pieces: Pieces, low: int | None, high: int | None, bucket_rows: int
) -> np.ndarray:
    """The ids in [low, high) that occur more than once, ascending."""
    held, count = [np.empty(0, np.int64)], 0
    repeated = np.empty(0, np.int64)
    numbers = pieces.with_ids(low, high).tolist()
    for place, number in enumerate(numbers, 1):
        held.append(pieces.ids_between(number, low, high))
        count += held[-1].size
        if count > bucket_rows or place == len(numbers):
            ids = np.concatenate(held)
            held.clear()
            ids.sort(kind="stable")  # merges the sorted runs
            again = ids[1:] == ids[:-1]
            if again.any():
                repeated = np.union1d(repeated, ids[1:][again])
                ids = np.unique(ids)
            held, count = [ids], 0
    return repeated


def _fill_in_lowest_pixels(pieces: Pieces, repeated: np.ndarray, lowest: np.ndarray) -> None:
    if not repeated.size:
        return
    low, high = int(repeated[0]), int(repeated[-1])
    for number in pieces.with_ids(low, high + 1).tolist():
        piece = pieces.pieces[number]
        ids = column(pieces.folder, piece, "source_id")
        pixels = column(pieces.folder, piece, HEALPIX_COLUMN)
        at = np.minimum(np.searchsorted(repeated, ids), repeated.size - 1)
        hit = repeated[at] == ids
        np.minimum.at(lowest, at[hit], pixels[hit])


def _mapped(path: Path, mode: Literal["r", "r+"]) -> np.ndarray:
    """The numbers of a file, memory-mapped: their pages are the system's to take back."""
    if not path.stat().st_size:
        return np.empty(0, np.int64)
    return np.memmap(path, np.int64, mode)
