"""Find source_ids that occur more than once, and choose the row that stays: bounded in memory."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pyarrow as pa

from .columns import HEALPIX_COLUMN, NAMES
from .judging import ROW_COLUMN
from .pieces import Piece, ids_of, read_arrow

BUCKET_ROWS = 8_000_000


class Duplicated:
    """Repeated source_ids and, for each, the order-29 pixel whose row stays (the lowest).

    Choosing by content, not by order of arrival, makes the result the same for any order of the
    sources and any number of workers.
    """

    def __init__(self, ids: np.ndarray, winners_29: np.ndarray) -> None:
        self.ids, self.winners_29 = ids, winners_29

    def part(self, table: pa.Table) -> tuple[pa.Table, pa.Table]:
        """Split a leaf's rows (with a `_source` column) into those that stay and the surplus."""
        if not self.ids.size:
            return table, table.slice(0, 0)
        ids = table["source_id"].to_numpy()
        at = np.minimum(np.searchsorted(self.ids, ids), self.ids.size - 1)
        repeated = self.ids[at] == ids
        if not repeated.any():
            return table, table.slice(0, 0)
        at = at[repeated]
        once, group = table.filter(pa.array(~repeated)), table.filter(pa.array(repeated))
        group = group.append_column("_place", pa.array(at))
        keys = [*NAMES, "_source", ROW_COLUMN]
        group = group.sort_by([("_place", "ascending"), *((key, "ascending") for key in keys)])
        at = group["_place"].to_numpy()
        wins = group[HEALPIX_COLUMN].to_numpy() == self.winners_29[at]
        places, first = np.unique(at[wins], return_index=True)
        stays = np.zeros(group.num_rows, bool)
        stays[np.flatnonzero(wins)[first]] = places.size > 0
        group = group.drop_columns("_place")
        return pa.concat_tables([once, group.filter(pa.array(stays))]), group.filter(
            pa.array(~stays)
        )


def find(pieces: Sequence[Piece]) -> Duplicated:
    """All source_ids that occur more than once in the pieces taken together."""
    total = sum(piece.rows for piece in pieces)
    if not total:
        return Duplicated(np.empty(0, np.int64), np.empty(0, np.int64))
    found = []
    edges = _bucket_edges(pieces, total)
    for low, high in pairwise(edges):
        ids = np.sort(np.concatenate([_between(p, low, high) for p in pieces]))
        found.append(np.unique(ids[1:][ids[1:] == ids[:-1]]))
    repeated = np.concatenate(found)
    return Duplicated(repeated, _lowest_pixels(pieces, repeated))


def _bucket_edges(pieces: Sequence[Piece], total: int) -> list[int | None]:
    """Edges that cut the ids into buckets of about BUCKET_ROWS; None stands for no bound."""
    buckets = -(-total // BUCKET_ROWS)
    if buckets == 1:
        return [None, None]
    samples = np.sort(np.concatenate([np.asarray(ids_of(p)[::64]) for p in pieces]))
    cuts = samples[[samples.size * i // buckets for i in range(1, buckets)]]
    return [None, *np.unique(cuts).tolist(), None]


def _between(piece: Piece, low: int | None, high: int | None) -> np.ndarray:
    if (low is not None and piece.last_id < low) or (high is not None and piece.first_id >= high):
        return np.empty(0, np.int64)
    ids = ids_of(piece)
    start = 0 if low is None else int(np.searchsorted(ids, low))
    stop = ids.size if high is None else int(np.searchsorted(ids, high))
    return np.asarray(ids[start:stop])


def _lowest_pixels(pieces: Sequence[Piece], repeated: np.ndarray) -> np.ndarray:
    lowest = np.full(repeated.size, np.iinfo(np.int64).max)
    for piece in pieces:
        if repeated.size and piece.first_id <= repeated[-1] and piece.last_id >= repeated[0]:
            table = read_arrow(piece.path)
            ids, pixels = table["source_id"].to_numpy(), table[HEALPIX_COLUMN].to_numpy()
            at = np.minimum(np.searchsorted(repeated, ids), repeated.size - 1)
            hit = repeated[at] == ids
            np.minimum.at(lowest, at[hit], pixels[hit])
    return lowest
