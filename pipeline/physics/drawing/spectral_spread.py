"""Spreading of sources onto a periodic grid by Kaiser-Bessel weights, sorted by place first.

The weight of a grid point `u` cells from a source is I0(b sqrt(1 - (2u/w)^2)) / I0(b) within w/2
cells, evaluated as one polynomial a cell. Its transform is known in closed form, so that the error
that the grid makes (frequencies that differ by whole turns per cell look alike) is a sum of known
terms: Fourmont 2003 (J. Fourier Anal. Appl. 9, 431), Barnett et al. 2019 (SIAM J. Sci. Comput. 41,
C479).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy
from numba import njit
from numpy.typing import NDArray

from pipeline.physics.drawing.spectral_threads import each, strips

Array = NDArray[np.float64]

JUMP_PARTS = 1.2  # two ends, half a jump each, with the overshoot of their series
EXTRA_DEGREE = 2  # of the polynomials above the width: 4e-7 at width 5, 3e-11 at 8, 4e-14 at 10
CHECKED = 255  # places in a cell where the error of the weights is looked at
BATCH = 256  # sources whose weights are made together
BIN_CELLS = (16, 128)  # rows (more than any width) and columns of a bin: it fits in a cache
SORTED_TOGETHER = 65536  # sources that one thread sorts at a time


@dataclass(frozen=True)
class Kernel:
    """A Kaiser-Bessel kernel of `width` grid cells and shape parameter `beta`."""

    width: int
    beta: float

    def value(self, u_cells: Array) -> Array:
        """Weight of a grid point `u_cells` from the source; 1 at 0, 0 beyond half the width."""
        z = 2.0 * np.asarray(u_cells, float) / self.width
        inside = np.sqrt(np.clip(1.0 - z * z, 0.0, None))
        i0 = scipy.special.i0
        return np.where(np.abs(z) <= 1.0, i0(self.beta * inside) / i0(self.beta), 0.0)

    def transform(self, turns: Array) -> Array:
        """Fourier transform at `turns` cycles per cell: w sinh(s) / (s I0(b)) (Fourmont 2003)."""
        square = self.beta**2 - (np.pi * self.width * np.asarray(turns, float)) ** 2
        root = np.sqrt(np.abs(square))
        safe = np.maximum(root, 1e-6)
        grown = np.where(square > 0, np.sinh(np.minimum(safe, self.beta)), np.sin(safe)) / safe
        return self.width * grown / scipy.special.i0(self.beta)

    def alias_ratio(self, turns: Array, single: bool) -> Array:
        """Bound of what a unit at other frequencies adds at `turns`, over what belongs there: (n,).

        Sums |transform| at the four nearest frequencies that look alike, what the farther ones can
        hold at once (the kernel jumps by 1 / I0(b) at its ends, and a Fourier series overshoots a
        jump by 9%), and what the weights may err by.
        """
        peak = scipy.special.i0(self.beta)
        rest = JUMP_PARTS / peak + self.weight_error(single)
        return _alias_ratio(np.asarray(turns, float), self.width, self.beta, peak, rest)

    def weight_error(self, single: bool) -> float:
        """Largest error of the weights of one axis together: polynomials and their arithmetic."""
        return _polynomials(self)[1][0 if single else 1]

    def polynomials(self) -> Array:
        """(degree + 1, width) coefficients of the weights, highest power first.

        Weight j belongs to the j-th grid point of a source's `width`, t in -1 ... 1 along the cell.
        """
        return _polynomials(self)[0]


@njit(cache=True, nogil=True)
def _transform(turns, width, beta, scale):
    """`Kernel.transform` at one frequency."""
    square = beta**2 - (np.pi * width * turns) ** 2
    root = max(np.sqrt(abs(square)), 1e-6)
    return width / scale * (np.sinh(root) if square > 0.0 else np.sin(root)) / root


@njit(cache=True, nogil=True)
def _alias_ratio(turns, width, beta, scale, rest):
    out = np.empty(turns.size)
    for k in range(turns.size):
        other = rest
        for step in (-2.0, -1.0, 1.0, 2.0):
            other += abs(_transform(turns[k] + step, width, beta, scale))
        out[k] = other / _transform(turns[k], width, beta, scale)
    return out


@lru_cache(maxsize=512)
def _polynomials(kernel: Kernel) -> tuple[Array, list[float]]:
    """Chebyshev interpolants of the weights, and their errors in float32 and float64."""
    nodes, to_power = _chebyshev(kernel.width + EXTRA_DEGREE)
    middle = np.arange(kernel.width) - (kernel.width - 1) / 2.0
    out = to_power @ kernel.value(middle - nodes[:, None] / 2.0)
    t = np.linspace(-1.0, 1.0, CHECKED + 2)[1:-1, None]
    exact = kernel.value(middle - t / 2.0)
    errors = [
        float(np.abs(_horner(out.astype(kind), t.astype(kind)) - exact).sum(axis=1).max())
        for kind in (np.float32, np.float64)
    ]
    return out, errors


@lru_cache(maxsize=16)
def _chebyshev(degree: int) -> tuple[Array, Array]:
    """Chebyshev nodes, and the matrix from values there to powers of t, highest first."""
    k = np.arange(degree + 1)
    angle = np.pi * (k + 0.5) / (degree + 1)
    series = 2.0 / (degree + 1) * np.cos(k[:, None] * angle[None, :])
    series[0] *= 0.5
    powers = np.zeros((degree + 1, degree + 1))
    for n in k:
        one = np.polynomial.chebyshev.cheb2poly(np.eye(degree + 1)[n, : n + 1])
        powers[degree - np.arange(one.size), n] = one
    return np.cos(angle), powers @ series


def _horner(coefficients: NDArray, t: NDArray) -> NDArray:
    """Weights (points, width) as `_weights` evaluates them, at t (points, 1)."""
    out = np.broadcast_to(coefficients[0], (t.shape[0], coefficients.shape[1]))
    for row in coefficients[1:]:
        out = out * t + row
    return out


def spread_onto(
    grid: NDArray[np.floating],
    columns: int,
    kernel: Kernel,
    y_cells: Array,
    x_cells: Array,
    light_e: Array,
    threads: int = 1,
) -> None:
    """Add sources to a grid in place, bin by bin of place and in their order within a bin.

    grid : (ny, at least `columns`) float32 or float64, C order
    y_cells, x_cells, light_e : (n,) places in cells; sources whose kernel does not fit in the first
        `columns` columns are omitted
    Rows of bins are spread side by side: first every other one, then those between them, as a
    kernel reaches into the next row of bins.
    """
    ny, nx = grid.shape[0], columns
    bins = -(-ny // BIN_CELLS[0]), -(-nx // BIN_CELLS[1])
    parts = strips(y_cells.size, SORTED_TOGETHER)
    keys, counts = np.empty(y_cells.size, np.int32), np.zeros((len(parts), bins[0] * bins[1]), int)

    def count(k: int) -> None:
        y, x = y_cells[parts[k]], x_cells[parts[k]]
        _count(y, x, keys[parts[k]], kernel.width, (ny, nx), bins[1], counts[k])

    each(count, len(parts), threads)
    totals = counts.sum(axis=0)
    ends = np.cumsum(totals)
    first = ends - totals + np.cumsum(counts, axis=0) - counts
    sources = np.empty((int(ends[-1]), 3))

    def place(k: int) -> None:
        y, x, light = y_cells[parts[k]], x_cells[parts[k]], light_e[parts[k]]
        _place(y, x, light, keys[parts[k]], kernel.width, first[k], sources)

    each(place, len(parts), threads)
    rows = np.concatenate([[0], ends[bins[1] - 1 :: bins[1]]])
    coefficients = kernel.polynomials().astype(grid.dtype)
    for parity in (0, 1):

        def spread(k: int, parity: int = parity) -> None:
            row = 2 * k + parity
            _spread(grid, coefficients, sources[rows[row] : rows[row + 1]])

        each(spread, (bins[0] + 1 - parity) // 2, threads)


@njit(cache=True, nogil=True)
def _count(ys, xs, keys, width, shape, bin_columns, counts):
    """Bin of each source, -1 where it does not fit, and how many there are in each bin.

    A source at g lends weights to the points from floor(g - width / 2 + 1) on.
    """
    shift = 0.5 * width - 1.0
    for i in range(ys.size):
        y, x = ys[i] - shift, xs[i] - shift
        keys[i] = -1
        if y >= 0.0 and x >= 0.0 and y < shape[0] - width + 1 and x < shape[1] - width + 1:
            keys[i] = (int(y) // BIN_CELLS[0]) * bin_columns + int(x) // BIN_CELLS[1]
            counts[keys[i]] += 1


@njit(cache=True, nogil=True)
def _place(ys, xs, light, keys, width, first, out):
    """(y, x, light) of each source to its place: its kernel starts at floor(y), floor(x)."""
    shift = 0.5 * width - 1.0
    for i in range(ys.size):
        if keys[i] >= 0:
            j = first[keys[i]]
            out[j, 0], out[j, 1], out[j, 2] = ys[i] - shift, xs[i] - shift, light[i]
            first[keys[i]] = j + 1


@njit(cache=True, nogil=True)
def _weights(coefficients, t, out):
    """Weights (width, n) of n sources by Horner's rule, all sources of a batch at a time."""
    for i in range(out.shape[0]):
        row = out[i]
        for s in range(t.size):
            row[s] = coefficients[0, i]
        for d in range(1, coefficients.shape[0]):
            c = coefficients[d, i]
            for s in range(t.size):
                row[s] = row[s] * t[s] + c


@njit(cache=True, nogil=True)
def _spread(grid, coefficients, sources):
    width, kind = coefficients.shape[1], grid.dtype.type
    ty, tx = np.zeros(BATCH, grid.dtype), np.zeros(BATCH, grid.dtype)
    wy, wx = np.empty((width, BATCH), grid.dtype), np.empty((width, BATCH), grid.dtype)
    along = np.empty(width, grid.dtype)
    for first in range(0, sources.shape[0], BATCH):
        batch = sources[first : first + BATCH]
        for s in range(batch.shape[0]):
            ty[s] = kind(2.0 * (batch[s, 0] - np.floor(batch[s, 0])) - 1.0)
            tx[s] = kind(2.0 * (batch[s, 1] - np.floor(batch[s, 1])) - 1.0)
        _weights(coefficients, ty, wy)
        _weights(coefficients, tx, wx)
        for s in range(batch.shape[0]):
            iy, ix, light = int(batch[s, 0]), int(batch[s, 1]), kind(batch[s, 2])
            for j in range(width):
                along[j] = wx[j, s]
            for i in range(width):
                a = light * wy[i, s]
                row = grid[iy + i, ix : ix + width]
                for j in range(width):
                    row[j] += a * along[j]
