"""What a pixel's well does to its charge: blooming along columns, and a response that bends."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]


@njit(cache=True, nogil=True)
def bloom(charge_e, full_well_e):
    """Let charge above the full well run along its column, in place.

    charge_e, full_well_e : (ny, nx) electrons, whole columns
    Half of each pixel's excess runs towards higher rows, half towards lower ones, and fills what
    room it meets; where both meet, the one towards higher rows fills first. What reaches an end of
    the column leaves the array. Charge is conserved but for that.
    """
    rows, columns = charge_e.shape
    halves = np.empty(rows)
    for x in range(columns):
        any_ = False
        for y in range(rows):
            over = charge_e[y, x] - full_well_e[y, x]
            halves[y] = 0.5 * over if over > 0.0 else 0.0
            if over > 0.0:
                charge_e[y, x] = full_well_e[y, x]
                any_ = True
        if not any_:
            continue
        carried = 0.0
        for y in range(rows):
            put = min(carried, full_well_e[y, x] - charge_e[y, x])
            charge_e[y, x] += put
            carried = carried - put + halves[y]
        carried = 0.0
        for y in range(rows - 1, -1, -1):
            put = min(carried, full_well_e[y, x] - charge_e[y, x])
            charge_e[y, x] += put
            carried = carried - put + halves[y]


def measured_e(charge_e: Array, true_e: Array, read_e: Array) -> Array:
    """Charge as the read-out measures it: straight lines through (true_e, read_e), both increasing.

    Beyond the tables' ends the nearest line goes on.
    """
    out = np.interp(charge_e, true_e, read_e)
    slope = (read_e[-1] - read_e[-2]) / (true_e[-1] - true_e[-2])
    above = charge_e > true_e[-1]
    if above.any():
        out[above] = read_e[-1] + slope * (charge_e[above] - true_e[-1])
    return out


def collected_e(signal_e: Array, true_e: Array, read_e: Array) -> Array:
    """The inverse of `measured_e`; signals below the first point (noise) go on with its line."""
    out = measured_e(signal_e, read_e, true_e)
    slope = (true_e[1] - true_e[0]) / (read_e[1] - read_e[0])
    below = signal_e < read_e[0]
    out[below] = true_e[0] + slope * (signal_e[below] - read_e[0])
    return out
