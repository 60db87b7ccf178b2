"""Adaptive nested HEALPix leaves from a counting pass.

In the nested scheme a pixel's parent is `pixel >> 2`: the rows of a leaf are a range of order-29
pixels.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .columns import HEALPIX_ORDER
from .geometry.healpix import pixels_of

Pixels = NDArray[np.int64]

COUNT_ORDER = 9  # 3.1 million pixels of 0.013 deg2
DEEPEST_ORDER = 18  # pixels of 0.8 arcsec
ROWS_PER_LEAF = 1_000_000


class Cell(NamedTuple):
    """A leaf to be: its pixel, and the half-open range of order-29 pixels that it covers."""

    order: int
    pixel: int
    first_29: int
    end_29: int
    rows: int


def healpix_29(ra_deg: NDArray[np.float64], dec_deg: NDArray[np.float64]) -> Pixels:
    """Nested pixels of order 29 (0.4 mas) of ICRS positions [deg]."""
    return pixels_of(HEALPIX_ORDER, ra_deg, dec_deg)


def positions_of(pixels_29: Pixels) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Right ascension and declination [deg] of the centres of order-29 pixels."""
    import healpy

    ra_deg, dec_deg = healpy.pix2ang(1 << HEALPIX_ORDER, pixels_29, nest=True, lonlat=True)
    return ra_deg, dec_deg


def coarser(pixels_29: Pixels, order: int) -> Pixels:
    """The pixels of a lower order that hold order-29 pixels."""
    return pixels_29 >> (2 * (HEALPIX_ORDER - order))


def coarser_counts(pixels_29: Pixels) -> tuple[Pixels, Pixels]:
    """The pixels of COUNT_ORDER that occur, ascending, and how often."""
    pixels, counts = np.unique(coarser(pixels_29, COUNT_ORDER), return_counts=True)
    return pixels, counts.astype(np.int64)


def choose_leaves(
    counts: Pixels, rows_per_leaf: int, rows_between: Callable[[int, int], int] | None = None
) -> list[Cell]:
    """The largest pixels with at most `rows_per_leaf` rows; empty ones are omitted.

    counts : (12 * 4**order,) rows in each pixel of some order, nested. Sparse input thus stays in
    few leaves, and dense regions get small pixels. A pixel of that order that still holds too many
    is cut further by `rows_between(first_29, end_29)`, which counts rows by order-29 pixels; down
    to DEEPEST_ORDER, where a leaf may hold more.
    """
    finest = (counts.size // 12).bit_length() // 2
    pyramid = [counts]
    while len(pyramid) <= finest:
        pyramid.append(pyramid[-1].reshape(-1, 4).sum(axis=1))
    pyramid.reverse()
    alive = np.ones(12, bool)
    cells: list[Cell] = []
    for order, rows in enumerate(pyramid):
        small = rows <= rows_per_leaf
        for pixel in np.flatnonzero(alive & small & (rows > 0)).tolist():
            cells.append(_cell(order, pixel, int(rows[pixel])))
        alive = np.repeat(alive & ~small, 4) if order < finest else alive & ~small
    crowded = [_cell(finest, pixel, int(counts[pixel])) for pixel in np.flatnonzero(alive).tolist()]
    cells += crowded if rows_between is None else _cut(crowded, rows_per_leaf, rows_between)
    return sorted(cells, key=lambda cell: cell.first_29)


def _cut(
    crowded: list[Cell], rows_per_leaf: int, rows_between: Callable[[int, int], int]
) -> Iterator[Cell]:
    """Cells cut into quarters until they hold few enough rows, or are as small as may be."""
    while crowded:
        cell = crowded.pop()
        if cell.rows <= rows_per_leaf or cell.order == DEEPEST_ORDER:
            yield cell
            continue
        children = (_cell(cell.order + 1, 4 * cell.pixel + i, 0) for i in range(4))
        counted = (c._replace(rows=rows_between(c.first_29, c.end_29)) for c in children)
        crowded += [c for c in counted if c.rows]


def _cell(order: int, pixel: int, rows: int) -> Cell:
    shift = 2 * (HEALPIX_ORDER - order)
    return Cell(order, pixel, pixel << shift, (pixel + 1) << shift, rows)
