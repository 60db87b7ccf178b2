"""Stars of one pixel: what tables err by adds up where they stand at the same phase."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]


def crowd_light(x_px: Array, y_px: Array, light_e: Array) -> Array:
    """Light of each star and of all that are no brighter in its pixel, (n,) [e-].

    Where it keeps to a limit, so do all of a pixel together for which it does.
    x_px, y_px, light_e : (n,) places and light of the stars; equals count in their order
    """
    out = np.abs(light_e)
    if len(out) < 2:
        return out
    pixel = pixel_numbers(x_px, y_px)
    order = np.argsort(pixel)
    same = pixel[order[1:]] == pixel[order[:-1]]
    if same.any():
        beside = np.zeros(len(out), bool)
        beside[order[1:][same]] = beside[order[:-1][same]] = True
        found = np.flatnonzero(beside)
        found = found[np.lexsort((out[found], pixel[found]))]
        out[found] = _sums(pixel[found], out[found])
    return out


def pixel_numbers(x_px: Array, y_px: Array) -> NDArray[np.int64]:
    """Numbers (n,) of the pixels in which places are, row by row; alike only in one pixel."""
    row, column = (np.floor(v).astype(np.int64) for v in (y_px, x_px))
    row, column = row - row.min(initial=0), column - column.min(initial=0)
    return np.asarray(row * (column.max(initial=0) + 1) + column)


@njit(cache=True, nogil=True)
def _sums(group, value):
    """Sums of values (n,) up to each within its group, one after the other."""
    out = value.copy()
    for i in range(1, len(out)):
        if group[i] == group[i - 1]:
            out[i] += out[i - 1]
    return out
