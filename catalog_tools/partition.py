"""Adaptive nested HEALPix leaves from a counting pass.

healpy (GPL-2.0-only, 1.6 s to import) turns angles into pixels; everything else about the nested
scheme is shifting bits: a pixel's parent is `pixel >> 2`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .columns import HEALPIX_ORDER

Pixels = NDArray[np.int64]

COUNT_ORDER = 9  # 3.1 million pixels of 0.013 deg2: the finest leaves
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
    import healpy

    pixels: Pixels = healpy.ang2pix(1 << HEALPIX_ORDER, ra_deg, dec_deg, nest=True, lonlat=True)
    return pixels


def positions_of(pixels_29: Pixels) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Right ascension and declination [deg] of the centres of order-29 pixels."""
    import healpy

    ra_deg, dec_deg = healpy.pix2ang(1 << HEALPIX_ORDER, pixels_29, nest=True, lonlat=True)
    return ra_deg, dec_deg


def coarser(pixels_29: Pixels, order: int) -> Pixels:
    """The pixels of a lower order that hold order-29 pixels."""
    return pixels_29 >> (2 * (HEALPIX_ORDER - order))


def count(pixels_29: Pixels) -> tuple[Pixels, Pixels]:
    """The pixels of COUNT_ORDER that occur, ascending, and how often."""
    pixels, counts = np.unique(coarser(pixels_29, COUNT_ORDER), return_counts=True)
    return pixels, counts.astype(np.int64)


def choose_leaves(counts: Pixels, rows_per_leaf: int) -> list[Cell]:
    """The largest pixels with at most `rows_per_leaf` rows; empty ones are left out.

    counts : (12 * 4**order,) rows in each pixel of some order, nested. Sparse input thus stays in
    few leaves, and dense regions get small pixels. A pixel of the counting order becomes a leaf
    even where it holds more.
    """
    finest = (counts.size // 12).bit_length() // 2
    pyramid = [counts]
    while len(pyramid) <= finest:
        pyramid.append(pyramid[-1].reshape(-1, 4).sum(axis=1))
    pyramid.reverse()
    alive = np.ones(12, bool)
    cells = []
    for order, rows in enumerate(pyramid):
        small = (rows <= rows_per_leaf) | (order == finest)
        shift = 2 * (HEALPIX_ORDER - order)
        for pixel in np.flatnonzero(alive & small & (rows > 0)).tolist():
            cells.append(Cell(order, pixel, pixel << shift, (pixel + 1) << shift, int(rows[pixel])))
        alive = np.repeat(alive & ~small, 4)
    return sorted(cells, key=lambda cell: cell.first_29)
