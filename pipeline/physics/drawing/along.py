"""One source along a path of its own, without a table: its swept core at its exact place."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pipeline.physics.motion.streak import Path, sinc_of
from pipeline.physics.psf.response import Core, frequencies, stamp_of

Array = NDArray[np.float64]


def stamp_along(
    core: Core,
    spectrum: NDArray[np.complex128],
    half: tuple[int, int],
    period: tuple[int, int],
    path: Path,
    y_px: float,
    x_px: float,
) -> tuple[int, int, Array]:
    """Stamp of unit light whose path is around (y, x): (first row, first column, (rows, cols)).

    core : with its `spectrum` at rest, and the `half` window and `period` [px] that hold it swept
    by the path (psf/response.py). The path's transfer function, the shift to (y, x) and the sum
    over the spectrum's copies along y are taken in one pass: nothing of the whole spectrum's size
    is made for a source.
    """
    iy, ix = int(np.floor(y_px)), int(np.floor(x_px))
    fy, fx = frequencies(core, *period)
    x, y = path.x_px + (x_px - ix), path.y_px + (y_px - iy)
    rows = _swept_rows(spectrum, fy, fx, x, y, path.weight, period[0]) / core.oversampling
    return iy - half[0], ix - half[1], stamp_of(rows, half, period, core.oversampling)


@njit(cache=True, nogil=True, error_model="numpy")
def _swept_rows(spectrum, fy, fx, x, y, weight, rows):
    """Spectrum times the transfer function of a path (motion/streak.py), its rows folded."""
    out = np.zeros((rows, fx.size), np.complex128)
    for k in range(weight.size):
        dx, dy = np.pi * (x[k + 1] - x[k]), np.pi * (y[k + 1] - y[k])
        mx, my = np.pi * (x[k + 1] + x[k]), np.pi * (y[k + 1] + y[k])
        across, sines, cosines = fx * dx, np.sin(fx * dx), np.cos(fx * dx)
        turns = weight[k] * (np.cos(fx * mx) - 1j * np.sin(fx * mx))
        for i in range(fy.size):
            half_y = fy[i] * dy
            sin_y, cos_y = np.sin(half_y), np.cos(half_y)
            turn = complex(np.cos(fy[i] * my), -np.sin(fy[i] * my))
            row, line = out[i % rows], spectrum[i]
            for j in range(fx.size):
                sinc = sinc_of(half_y + across[j], sin_y * cosines[j] + cos_y * sines[j])
                row[j] += sinc * (line[j] * (turn * turns[j]))
    return out
