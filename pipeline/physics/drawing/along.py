"""Cores swept by a path, without a table: as a spectrum, or one source at its exact place."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pipeline.physics.motion.streak import Path, transfer
from pipeline.physics.psf.response import Core, CoreGrid, core_spectrum, frequencies, stamp_of

Array = NDArray[np.float64]

NO_LIGHT = 1e-12  # of a spectrum's light at frequency 0: a band's samples below are left out


def swept_spectrum(core: Core, path: Path, period: tuple[int, int]) -> NDArray[np.complex128]:
    """Real FFT of a core swept by a path, on a period (y, x) [px] that holds it.

    What is left out (NO_LIGHT) is at most 1e-12 `oversampling`^2 of the light in any pixel.
    """
    spectrum = core_spectrum(core, *period)
    if not path.length_px and not path.x_px[0] and not path.y_px[0]:
        return spectrum
    fy, fx = frequencies(core, *period)
    return _swept(spectrum, lit_columns(spectrum), fy, fx, path.x_px, path.y_px, path, len(fy))


def stamp_along(
    core: CoreGrid,
    spectrum: NDArray[np.complex128],
    columns: NDArray[np.int64],
    half: tuple[int, int],
    period: tuple[int, int],
    path: Path,
    y_px: float,
    x_px: float,
) -> tuple[int, int, Array]:
    """Stamp of unit light whose path is around (y, x): (first row, first column, (rows, cols)).

    core : with its `spectrum` at rest and the `columns` of it that hold light (`lit_columns`), and
        the `half` window and `period` [px] that hold it swept by the path (psf/response.py)

    The path's transfer function, the shift to (y, x) and the sum over the spectrum's copies along
    y are taken in one pass: nothing of the whole spectrum's size is made for a source. What
    `swept_spectrum` leaves out is left out here.
    """
    iy, ix = int(np.floor(y_px)), int(np.floor(x_px))
    fy, fx = frequencies(core, *period)
    x, y = path.x_px + (x_px - ix), path.y_px + (y_px - iy)
    rows = _swept(spectrum, columns, fy, fx, x, y, path, period[0]) / core.oversampling
    return iy - half[0], ix - half[1], stamp_of(rows, half, period, core.oversampling)


def _swept(
    spectrum: NDArray[np.complex128],
    columns: NDArray[np.int64],
    fy: Array,
    fx: Array,
    x: Array,
    y: Array,
    path: Path,
    rows: int,
) -> NDArray[np.complex128]:
    """Spectrum times the transfer function of a path through (y, x), folded to so many rows.

    Of each row as many columns as hold light: an oversampled spectrum is mostly empty.
    """
    lit = int(columns.max())
    return _folded(spectrum, transfer(fy, fx[:lit], x, y, path.weight, columns), columns, rows)


@njit(cache=True, nogil=True)
def lit_columns(spectrum):
    """How many columns (n,) of each row of a spectrum hold light."""
    rows, count = spectrum.shape
    out, least = np.zeros(rows, np.int64), (NO_LIGHT * abs(spectrum[0, 0])) ** 2
    for i in range(rows):
        for j in range(count - 1, -1, -1):
            if spectrum[i, j].real ** 2 + spectrum[i, j].imag ** 2 >= least:
                out[i] = j + 1
                break
    return out


@njit(cache=True, nogil=True)
def _folded(spectrum, swept, columns, rows):
    """Product of both, the copies of each row summed."""
    out = np.zeros((rows, spectrum.shape[1]), np.complex128)
    for i in range(columns.size):
        to, one, other = out[i % rows], spectrum[i], swept[i]
        for j in range(columns[i]):
            to[j] += one[j] * other[j]
    return out
