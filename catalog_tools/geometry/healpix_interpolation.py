"""The four nested HEALPix pixels around a direction, and their weights for a smooth map.

Bilinear between the two rings of pixel centres above and below a direction, as healpy's
`get_interp_weights` does (a test compares them), without its import. Continuous everywhere.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .healpix import pixels_of

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


def neighbours(order: int, directions: Floats) -> tuple[Ints, Floats]:
    """Nested pixels (4, n) of an order around unit vectors (n, 3), and weights that sum to 1.

    Rings are numbered 1 to 4 nside - 1 from the north (Gorski et al. 2005, equations 4 to 9);
    beyond the first and the last one the mean of their four pixels stands at the pole.
    """
    nside = 1 << order
    z = np.clip(directions[:, 2], -1.0, 1.0)
    phi = np.arctan2(directions[:, 1], directions[:, 0])
    theta = np.arctan2(np.hypot(directions[:, 0], directions[:, 1]), directions[:, 2])
    above = _ring_above(nside, z)
    below = above + 1
    pixels, weights = np.empty((4, z.size), np.int64), np.empty((4, z.size))
    for half, ring in ((0, above), (2, below)):
        real = np.clip(ring, 1, 4 * nside - 1)
        pixels[half : half + 2], weights[half : half + 2] = _along(order, real, phi)
    upper, lower = (_theta(nside, np.clip(r, 1, 4 * nside - 1)) for r in (above, below))
    north, south = above < 1, below > 4 * nside - 1
    upper, lower = np.where(north, 0.0, upper), np.where(south, np.pi, lower)
    share = (theta - upper) / (lower - upper)
    weights[:2] *= 1.0 - share
    weights[2:] *= share
    for pole, own, other in ((north, 0, 2), (south, 2, 0)):
        if pole.any():
            _spread_over_pole(order, pixels, weights, pole, own, other)
    return pixels, weights


def _spread_over_pole(
    order: int, pixels: Ints, weights: Floats, pole: NDArray[np.bool_], own: int, other: int
) -> None:
    """Give the pole's weight to all four pixels of the ring around it, in equal parts."""
    quarter = 0.25 * weights[own : own + 2, pole].sum(axis=0)
    ring = 1 if own == 0 else (4 << order) - 1
    first = (_column(order, ring, pixels[other, pole]) + 2) % 4
    second = (_column(order, ring, pixels[other + 1, pole]) + 2) % 4
    around = _ring_pixels(order, np.full(4, ring), np.arange(4))
    pixels[own, pole], pixels[own + 1, pole] = around[first], around[second]
    weights[own, pole] = weights[own + 1, pole] = quarter
    weights[other, pole] += quarter
    weights[other + 1, pole] += quarter


def _column(order: int, ring: int, pixels: Ints) -> Ints:
    """Places (n,) in a polar ring of four pixels."""
    around = _ring_pixels(order, np.full(4, ring), np.arange(4))
    return np.argmax(pixels[:, None] == around[None, :], axis=1)


def _along(order: int, ring: Ints, phi: Floats) -> tuple[Ints, Floats]:
    """The two pixels (2, n) of a ring on both sides of a longitude, and their weights."""
    count, shift = _ring_size(1 << order, ring)
    place = phi * count / (2.0 * np.pi) - shift
    left = np.floor(place)
    share = place - left
    columns = left.astype(np.int64) % count
    both = np.stack([columns, (columns + 1) % count])
    pixels = np.stack([_ring_pixels(order, ring, c) for c in both])
    return pixels, np.stack([1.0 - share, share])


def _ring_pixels(order: int, ring: Ints, column: Ints) -> Ints:
    """Nested pixels (n,) of places in rings."""
    count, shift = _ring_size(1 << order, ring)
    ra_deg = (column + shift) * 360.0 / count
    return pixels_of(order, ra_deg, 90.0 - np.degrees(_theta(1 << order, ring)))


def _ring_size(nside: int, ring: Ints) -> tuple[Ints, Floats]:
    """Pixels of rings, and the place of the first one's centre in units of their spacing."""
    polar = np.minimum(ring, 4 * nside - ring)
    count = 4 * np.minimum(polar, nside)
    shifted = (polar < nside) | ((ring - nside) % 2 == 0)
    return count, np.where(shifted, 0.5, 0.0)


def _theta(nside: int, ring: Ints) -> Floats:
    """Colatitudes of rings, from half-angles near the poles (no cancellation)."""
    polar = np.minimum(ring, 4 * nside - ring).astype(float)
    cap = 2.0 * np.arcsin(np.minimum(polar / (nside * np.sqrt(6.0)), 1.0))
    belt = np.arccos(np.clip(2.0 * (2.0 * nside - ring) / (3.0 * nside), -1.0, 1.0))
    inside = polar < nside
    return np.where(inside, np.where(ring > 2 * nside, np.pi - cap, cap), belt)


def _ring_above(nside: int, z: Floats) -> Ints:
    """The ring whose centres lie just north of z; 0 beyond the first."""
    belt = np.floor(nside * (2.0 - 1.5 * z))
    cap = np.floor(nside * np.sqrt(3.0 * (1.0 - np.abs(z))))
    south = np.where(4 * nside - cap - 1 < 0, 0, 4 * nside - cap - 1)
    polar = np.where(z > 0, cap, south)
    return np.where(np.abs(z) <= 2.0 / 3.0, belt, polar).astype(np.int64)
