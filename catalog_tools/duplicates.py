"""Find source_ids that occur more than once, and choose the row that stays: bounded in memory."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np

from .columns import HEALPIX_COLUMN, NAMES
from .judging import PLACE_COLUMN, Columns
from .pieces import IDS, Pieces, column, mapped

SAMPLE = 512  # one id of so many tells how ids are spread


def find(pieces: Pieces, folder: Path, bucket_rows: int) -> None:
    """Write all source_ids that occur more than once in the pieces, and where each one stays.

    The lowest order-29 pixel wins: a choice by content, not by order of arrival, so that the
    result is the same for any order of the sources and any number of workers. `bucket_rows` ids
    are in memory at a time.
    """
    found = [np.empty(0, np.int64)]
    for low, high in pairwise(_bucket_edges(pieces, bucket_rows)):
        parts = [pieces.ids_between(i, low, high) for i in pieces.with_ids(low, high).tolist()]
        if not parts:
            continue
        ids = np.concatenate(parts)
        del parts
        ids.sort(kind="stable")  # merges the sorted runs
        found.append(np.unique(ids[1:][ids[1:] == ids[:-1]]))
    repeated = np.concatenate(found)
    np.save(folder / "repeated-ids.npy", repeated)
    np.save(folder / "repeated-pixels.npy", _lowest_pixels(pieces, repeated))


class Repeated:
    """The repeated source_ids that `find` wrote, memory-mapped."""

    def __init__(self, folder: Path) -> None:
        self.ids = np.load(folder / "repeated-ids.npy", mmap_mode="r")
        self.pixels = np.load(folder / "repeated-pixels.npy", mmap_mode="r")

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
    samples = [
        np.asarray(mapped(pieces.folder, piece, IDS)[SAMPLE // 2 :: SAMPLE])
        for piece in pieces.pieces
    ]
    ids = np.sort(np.concatenate(samples))
    if not ids.size:
        return [None, None]
    cuts = ids[[ids.size * i // buckets for i in range(1, buckets)]]
    return [None, *np.unique(cuts).tolist(), None]


def _lowest_pixels(pieces: Pieces, repeated: np.ndarray) -> np.ndarray:
    lowest = np.full(repeated.size, np.iinfo(np.int64).max)
    if not repeated.size:
        return lowest
    low, high = int(repeated[0]), int(repeated[-1])
    for number in pieces.with_ids(low, high + 1).tolist():
        piece = pieces.pieces[number]
        ids = column(pieces.folder, piece, "source_id")
        pixels = column(pieces.folder, piece, HEALPIX_COLUMN)
        at = np.minimum(np.searchsorted(repeated, ids), repeated.size - 1)
        hit = repeated[at] == ids
        np.minimum.at(lowest, at[hit], pixels[hit])
    return lowest
