"""Which facets may stand before another: their shadows on a plane, sorted into square bins."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

MOST_BINS = 512  # along one side
ENTRIES = 6  # per facet on average, at most: else fewer bins


class FacetBins(NamedTuple):
    """Facets of a mesh seen along a direction.

    flat_m : (F, 3, 3) corners as x, y on the plane and height towards the viewer
    low, high : (F, 3) their least and greatest
    first, facet : facets of bin k are facet[first[k]:first[k + 1]]; k = row * columns + column
    origin, side_m, shape : of the bins
    """

    flat_m: Array
    low: Array
    high: Array
    first: Ints
    facet: Ints
    x0: float
    y0: float
    side_m: float
    rows: int
    columns: int


def plane_axes(direction: Array) -> Array:
    """Rows x, y, z (3, 3), right-handed, z along a unit vector."""
    z = np.asarray(direction, float)
    hint = np.eye(3)[np.argmin(np.abs(z))]
    x = hint - (hint @ z) * z
    x /= np.sqrt(x @ x)
    return np.stack([x, np.cross(z, x), z])


def binned(corners_m: Array, axes: Array, hides: NDArray[np.bool_]) -> FacetBins:
    """Facets (F, 3, 3) in bins across the rows x and y of `axes` (3, 3), z towards the viewer.

    hides : (F,) the facets that go into bins
    """
    flat, low, high = _laid_out(corners_m, axes)
    x0, y0, x1, y1 = low[:, 0].min(), low[:, 1].min(), high[:, 0].max(), high[:, 1].max()
    wide, tall = max(x1 - x0, 1e-300), max(y1 - y0, 1e-300)
    count = max(16.0, min(float(len(flat)), float(MOST_BINS**2)))
    while True:
        side = max(np.sqrt(wide * tall / count), max(wide, tall) / MOST_BINS)
        columns, rows = int(wide / side) + 1, int(tall / side) + 1
        many = _count(low, high, hides, x0, y0, side, rows, columns)
        if many[-1] <= ENTRIES * len(flat) + 4096 or count <= 1.0:
            break
        count /= 4.0
    facet = _fill(low, high, hides, x0, y0, side, columns, many)
    return FacetBins(flat, low, high, many, facet, x0, y0, side, rows, columns)


@njit(cache=True, nogil=True)
def _laid_out(corners, axes):
    """Corners in other axes, and their range in each facet."""
    count = corners.shape[0]
    flat, low, high = np.empty((count, 3, 3)), np.empty((count, 3)), np.empty((count, 3))
    for f in range(count):
        for a in range(3):
            for i in range(3):
                v = corners[f, i, 0] * axes[a, 0] + corners[f, i, 1] * axes[a, 1]
                v += corners[f, i, 2] * axes[a, 2]
                flat[f, i, a] = v
                low[f, a] = v if i == 0 else min(low[f, a], v)
                high[f, a] = v if i == 0 else max(high[f, a], v)
    return flat, low, high


@njit(cache=True, nogil=True)
def _count(low, high, hides, x0, y0, side, rows, columns):
    """Running number of entries before each bin (bins + 1,)."""
    first = np.zeros(rows * columns + 1, np.int64)
    for f in range(low.shape[0]):
        if not hides[f]:
            continue
        for r in range(int((low[f, 1] - y0) / side), int((high[f, 1] - y0) / side) + 1):
            for c in range(int((low[f, 0] - x0) / side), int((high[f, 0] - x0) / side) + 1):
                first[r * columns + c + 1] += 1
    for k in range(rows * columns):
        first[k + 1] += first[k]
    return first


@njit(cache=True, nogil=True)
def _fill(low, high, hides, x0, y0, side, columns, first):
    """Facets of each bin, by rising number."""
    at = first[:-1].copy()
    facet = np.empty(first[-1], np.int64)
    for f in range(low.shape[0]):
        if not hides[f]:
            continue
        for r in range(int((low[f, 1] - y0) / side), int((high[f, 1] - y0) / side) + 1):
            for c in range(int((low[f, 0] - x0) / side), int((high[f, 0] - x0) / side) + 1):
                facet[at[r * columns + c]] = f
                at[r * columns + c] += 1
    return facet
