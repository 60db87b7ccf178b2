"""Modes of spread sources, times response and streak, folded to the frequencies of the pixels.

Pixels sample the light: frequencies that differ by whole cycles per pixel look alike in them and
add up. Nothing is cut at the pixels' own limit; that aliasing is what a detector does.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pipeline.physics.drawing.spectral_threads import each, strips
from pipeline.physics.motion.streak import Path

Array = NDArray[np.float64]

ROWS = 64  # rows of the pixels' spectrum, and those of opposite frequency, made at a time
SERIES_BELOW = 0.3  # of the half phase: there sin(h)/h by its series, to 2e-10


def fold_modes(
    spectrum: NDArray[np.complexfloating],
    period_x: int,
    modes: NDArray[np.complexfloating],
    table: NDArray,
    path: Path | None,
    threads: int = 1,
) -> None:
    """Add modes x table x streak to the real FFT of a (period_y, period_x) pixel image, in place.

    spectrum : (period_y, period_x // 2 + 1)
    modes : (points_y, >= keep_x + 1), row k mod points_y is frequency k / period_y [cycles/px]
    table : (2 keep_y + 1, keep_x + 1) real or complex, rows from -keep_y to keep_y
    path : motion in pixels, exact for uniform motion along each segment; None for none
    """
    keep_y, keep_x = table.shape[0] // 2, table.shape[1] - 1
    segments = np.zeros((0, 5)) if path is None else segments_of(path)
    fy = np.arange(-keep_y, keep_y + 1) / len(spectrum)
    fx = np.arange(keep_x + 1) / period_x
    along_y = _along(fy, segments[:, 0], segments[:, 2])
    along_x = _along(fx, segments[:, 1], segments[:, 3])
    parts = strips(len(spectrum) // 2 + 1, ROWS)

    def fold(k: int) -> None:
        rows = (parts[k].start, parts[k].stop)
        _fold(spectrum, rows, period_x, modes, table, segments, fy, fx, along_y, along_x)

    each(fold, len(parts), threads)


def segments_of(path: Path) -> Array:
    """(segments, 5): length on each axis (y, x), middle (y, x) and share of the light."""
    x, y = path.x_px, path.y_px
    parts = (np.diff(y), np.diff(x), 0.5 * (y[1:] + y[:-1]), 0.5 * (x[1:] + x[:-1]), path.weight)
    return np.ascontiguousarray(np.stack(parts, axis=1))


@njit(cache=True, nogil=True)
def _along(f, lengths, middles):
    """Sines and cosines of half phases and turns of each segment at frequencies of one axis."""
    sines, cosines = np.empty((lengths.size, f.size)), np.empty((lengths.size, f.size))
    turns = np.empty((lengths.size, f.size), np.complex128)
    for k in range(lengths.size):
        for j in range(f.size):
            h, turn = np.pi * f[j] * lengths[k], -2.0 * np.pi * f[j] * middles[k]
            sines[k, j], cosines[k, j] = np.sin(h), np.cos(h)
            turns[k, j] = complex(np.cos(turn), np.sin(turn))
    return sines, cosines, turns


@njit(cache=True, nogil=True)
def _sinc(h, sine):
    """sin(h) / h, given the sine."""
    q = h * h
    near = 1.0 - q / 6.0 * (1.0 - q / 20.0 * (1.0 - q / 42.0))
    return near if abs(h) < SERIES_BELOW else sine / h


@njit(cache=True, nogil=True)
def _sweep_row(row, i, fy, fx, segments, along_y, along_x):
    """row x transfer of the path at (fy[i], fx): sum of w sinc(f.d) exp(-2 pi i f.m)."""
    (sin_y, cos_y, turn_y), (sin_x, cos_x, turn_x) = along_y, along_x
    swept = np.zeros(fx.size, np.complex128)
    for k in range(segments.shape[0]):
        a, b = np.pi * fy[i] * segments[k, 0], np.pi * segments[k, 1]
        sin_a, cos_a, turn = sin_y[k, i], cos_y[k, i], segments[k, 4] * turn_y[k, i]
        for j in range(fx.size):
            sine = sin_a * cos_x[k, j] + cos_a * sin_x[k, j]
            swept[j] += _sinc(a + b * fx[j], sine) * (turn * turn_x[k, j])
    for j in range(fx.size):
        row[j] *= swept[j]


@njit(cache=True, nogil=True)
def _sweep_row_centred(row, i, fy, fx, segments, along_y, along_x):
    """The same for one segment about the origin, whose transfer is real."""
    sin_a, cos_a, sin_x, cos_x = along_y[0][0, i], along_y[1][0, i], along_x[0][0], along_x[1][0]
    a, b, share = np.pi * fy[i] * segments[0, 0], np.pi * segments[0, 1], segments[0, 4]
    for j in range(fx.size):
        sine = sin_a * cos_x[j] + cos_a * sin_x[j]
        row[j] *= row.real.dtype.type(share * _sinc(a + b * fx[j], sine))


@njit(cache=True, nogil=True)
def _fold(out, rows, period_x, modes, table, segments, fy, fx, along_y, along_x):
    """Fold onto the rows r and -r of the output for r in `rows`: no others are written."""
    period_y, keep_y, row = out.shape[0], table.shape[0] // 2, np.empty(fx.size, modes.dtype)
    centred = segments.shape[0] == 1 and segments[0, 2] == 0.0 and segments[0, 3] == 0.0
    for r in range(rows[0], rows[1]):
        for sign in (1, -1):
            if sign == -1 and (2 * r) % period_y == 0:
                continue
            first = (sign * r + keep_y) % period_y - keep_y
            for i in range(first, keep_y + 1, period_y):
                source, response = modes[i % modes.shape[0]], table[i + keep_y]
                for j in range(row.size):
                    row[j] = source[j] * response[j]
                if centred:
                    _sweep_row_centred(row, i + keep_y, fy, fx, segments, along_y, along_x)
                elif segments.shape[0]:
                    _sweep_row(row, i + keep_y, fy, fx, segments, along_y, along_x)
                _add_row(out[i % period_y], out[-i % period_y], period_x, row)


@njit(cache=True, nogil=True)
def _add_row(here, mirror, period_x, row):
    """Add a row of frequencies to the row that it looks like, its conjugate to the opposite one."""
    half, n = period_x // 2, row.size
    for start in range(0, n, period_x):
        for j in range(min(half + 1, n - start)):
            here[j] += row[start + j]
        for j in range(max(0, start + period_x - n + 1), half + 1):
            mirror[j] += np.conj(row[start + period_x - j])
