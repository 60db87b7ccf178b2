"""Nested HEALPix pixels of directions, in numpy: Gorski et al. 2005, ApJ 622, 759, section 4.

healpy gives the same pixels (a test compares them), but takes 1.6 s and 70 MB to import, in each
worker. It stays the tool for discs and maps.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

CHUNK = 1 << 15  # rows at a time: the temporaries stay in the cache
FINEST_ORDER = 29  # of pixels whose numbers fit in 63 bits

# Steps that move the lower 32 bits of a number to its even bits.
_SPREAD = (
    (16, 0x0000FFFF0000FFFF),
    (8, 0x00FF00FF00FF00FF),
    (4, 0x0F0F0F0F0F0F0F0F),
    (2, 0x3333333333333333),
    (1, 0x5555555555555555),
)


def pixels_of(order: int, ra_deg: ArrayLike, dec_deg: ArrayLike) -> NDArray[np.int64]:
    """Nested pixels (n,) of an order (0 to 29) of directions (n,) [deg].

    Right ascension may be any finite angle; declination is between -90 and 90.
    """
    ra, dec = np.atleast_1d(np.asarray(ra_deg, float)), np.atleast_1d(np.asarray(dec_deg, float))
    pixels = np.empty(ra.shape, np.int64)
    for start in range(0, ra.size, CHUNK):
        rows = slice(start, start + CHUNK)
        pixels[rows] = _chunk(order, ra[rows], dec[rows])
    return pixels


def _chunk(order: int, ra_deg: np.ndarray, dec_deg: np.ndarray) -> np.ndarray:
    z = np.sin(np.radians(dec_deg))
    quarter = (ra_deg * (1.0 / 90.0)) % 4.0
    quarter[quarter >= 4.0] = 0.0  # a tiny negative angle, rounded up by the remainder
    face, x, y = _equatorial(order, z, quarter)
    polar = np.flatnonzero(np.abs(z) > 2.0 / 3.0)
    if polar.size:
        cosine = np.cos(np.radians(dec_deg[polar]))
        face[polar], x[polar], y[polar] = _polar(order, z[polar], cosine, quarter[polar])
    return (face << (2 * order)) | _even_bits(x) | (_even_bits(y) << 1)


def _equatorial(
    order: int, z: np.ndarray, quarter: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Base pixel and place within it: equations 7 and 8, counted along the two diagonals."""
    sides = 1 << order
    across, along = sides * (0.5 + quarter), (0.75 * sides) * z
    falling = (across - along).astype(np.int64)
    rising = (across + along).astype(np.int64)
    down, up = falling >> order, rising >> order
    face = np.where(down == up, (down & 3) | 4, np.where(down < up, down, up + 8))
    return face, rising & (sides - 1), sides - 1 - (falling & (sides - 1))


def _polar(
    order: int, z: np.ndarray, cosine: np.ndarray, quarter: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The same in the polar caps: equations 4 to 6; sqrt(3 (1 - |z|)) without cancellation."""
    sides = 1 << order
    base = quarter.astype(np.int64)
    within = quarter - base
    out = sides * cosine * np.sqrt(3.0 / (1.0 + np.abs(z)))
    falling = np.minimum((within * out).astype(np.int64), sides - 1)
    rising = np.minimum(((1.0 - within) * out).astype(np.int64), sides - 1)
    north = z >= 0.0
    face = np.where(north, base, base + 8)
    x = np.where(north, sides - 1 - rising, falling)
    y = np.where(north, sides - 1 - falling, rising)
    return face, x, y


def centres_of(order: int, pixels: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Right ascension and declination (n,) [deg] of the centres of nested pixels (n,): equations
    4 to 9, by half-angles in the polar caps."""
    nside = 1 << order
    face, x, y = _face_and_place(order, np.asarray(pixels, np.int64))
    ring = ((2 + face // 4) << order) - x - y - 1  # from the north, 1 to 4 nside - 1
    polar = np.minimum(np.minimum(ring, 4 * nside - ring), nside)  # quarter of the ring's pixels
    cap = 90.0 - np.degrees(2.0 * np.arcsin(np.minimum(polar / (nside * np.sqrt(6.0)), 1.0)))
    belt = np.degrees(np.arcsin(np.clip((2 * nside - ring) * (2.0 / 3.0 / nside), -1.0, 1.0)))
    dec_deg = np.where(polar < nside, np.where(ring < 2 * nside, cap, -cap), belt)
    eighth = np.where(face // 4 == 1, 2 * (face & 3), 2 * (face & 3) + 1) * polar + x - y
    return (eighth * 45.0 / polar) % 360.0, dec_deg


def neighbours_of(order: int, pixels: ArrayLike) -> NDArray[np.int64]:
    """The 8 nested pixels around each of some pixels (n,): (8, n); -1 where only 7 meet."""
    face, x, y = _face_and_place(order, np.asarray(pixels, np.int64))
    out = [
        _stepped(order, face, x + dx, y + dy)
        for dx in (-1, 0, 1)
        for dy in (-1, 0, 1)
        if (dx, dy) != (0, 0)
    ]
    return np.stack(out)


# The base pixel beyond each edge and corner of a base pixel, by row (north, belt, south) and by
# the step (x, y) over its border: how much it lies to the east within its own row, that row, and
# whether the axes (x, y) are exchanged there, or counted from the other end (figure 4).
_BEYOND: dict[tuple[int, int, int], tuple[int, int, bool, bool]] = {
    (0, 1, 0): (1, 0, True, True),
    (0, 0, 1): (3, 0, True, True),
    (0, 1, 1): (2, 0, False, True),
    (0, -1, 0): (0, 1, False, False),
    (0, 0, -1): (1, 1, False, False),
    (0, -1, -1): (0, 2, False, False),
    (1, 1, 0): (0, 0, False, False),
    (1, 0, 1): (3, 0, False, False),
    (1, -1, 0): (3, 2, False, False),
    (1, 0, -1): (0, 2, False, False),
    (1, 1, -1): (1, 1, False, False),
    (1, -1, 1): (3, 1, False, False),
    (2, 1, 0): (1, 1, False, False),
    (2, 0, 1): (0, 1, False, False),
    (2, 1, 1): (0, 0, False, False),
    (2, -1, 0): (3, 2, True, True),
    (2, 0, -1): (1, 2, True, True),
    (2, -1, -1): (2, 2, False, True),
}
_CROSSED = np.full((4, 3, 3, 3), -1)  # the same by number; a step of -1 counts from the end
for _way, _there in _BEYOND.items():
    _CROSSED[(slice(None), *_way)] = _there


def _stepped(order: int, face: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Pixels at places (x, y) that may lie one step outside of their base pixels; -1 for none."""
    side = 1 << order
    over_x, over_y = x >> order, y >> order  # -1, 0 or 1
    px, py = x & (side - 1), y & (side - 1)
    pixel = (face << (2 * order)) | _even_bits(px) | (_even_bits(py) << 1)
    outside = np.flatnonzero((over_x | over_y) != 0)
    if not outside.size:
        return pixel
    face, px, py, dx, dy = (v[outside] for v in (face, px, py, over_x, over_y))
    east, beyond, exchanged, turned = _CROSSED[:, face // 4, dx, dy]
    px = np.where((turned > 0) & (dx != 0), side - 1 - px, px)
    py = np.where((turned > 0) & (dy != 0), side - 1 - py, py)
    px, py = np.where(exchanged > 0, py, px), np.where(exchanged > 0, px, py)
    there = 4 * beyond + ((face + east) & 3)
    far = (there << (2 * order)) | _even_bits(px) | (_even_bits(py) << 1)
    pixel[outside] = np.where(beyond < 0, -1, far)
    return pixel


def _face_and_place(order: int, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Base pixel and place within it of nested pixels."""
    x, y = (_from_even_bits(pixels >> bit, order) for bit in (0, 1))
    return pixels >> (2 * order), x, y


def _from_even_bits(values: np.ndarray, order: int) -> np.ndarray:
    """The lowest `order` even bits of integers, side by side."""
    values = values & 0x5555555555555555 & ((1 << (2 * order)) - 1)
    for (shift, _), mask in zip(reversed(_SPREAD), _GATHERED, strict=True):
        values = (values | (values >> shift)) & mask
    return values


_GATHERED = tuple(mask for _, mask in reversed(_SPREAD[:-1])) + (0x00000000FFFFFFFF,)


def _even_bits(values: np.ndarray) -> np.ndarray:
    """The bits of integers below 2**31 moved to the even places."""
    for shift, mask in _SPREAD:
        values = (values | (values << shift)) & mask
    return values
