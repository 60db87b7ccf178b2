"""How much of a streaked response lies at which frequencies, to bound what an error there does."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numba import njit
from numpy.typing import NDArray

from pipeline.physics.drawing.spectral_fold import segments_of
from pipeline.physics.fast_sizes import fast_size
from pipeline.physics.motion.streak import Path, pieces
from pipeline.physics.psf.response import Core, taper

Array = NDArray[np.float64]

ROLL_FROM = 0.85  # of the band: where the kept frequencies begin to fade
DARK = 1e-12  # of the largest |transfer|: rows and columns of cells below it are omitted
TOGETHER = 2.0  # neighbouring pieces of a streak whose errors meet in one pixel
MOST_CELLS = 400  # per axis: far more than the errors need that are weighed with them
FINE_SAMPLES = 1024  # cores up to this size get cells half as wide as their samples need


@dataclass(frozen=True, eq=False)
class TransferBand:
    """|transfer| of a streaked response in cells of frequency.

    fy (n,), fx (m,) : middles of the cells [cycles/px], rising from 0
    weight (n, m) : integral of |transfer| over each cell, all signs together; their sum bounds
        every pixel, per unit light
    """

    fy: Array
    fx: Array
    weight: Array

    def kept(self, limit: float) -> tuple[Array, Array]:
        """Share of each frequency that is kept: `roll_off` at fy (n,) and fx (m,)."""
        return roll_off(self.fy, limit), roll_off(self.fx, limit)

    def integral(self, y: Array, x: Array) -> float:
        """Integral of y(fy) x(fx) |transfer|, added up in a fixed order."""
        return float(_integral(y, self.weight, x))

    def cut(self, limit: float) -> float:
        """Integral of what `roll_off` leaves out."""
        y, x = self.kept(limit)
        return self.integral(1.0 - y, np.ones(x.size)) + self.integral(y, 1.0 - x)

    def limit_for(self, error: float, least: float) -> float:
        """Smallest limit from `least` on that leaves out at most `error`, or the band's end."""
        low, high = 0.0, float(self.fx[-1])
        while high > least and high - low > 1e-3 * high:
            middle = 0.5 * (low + high)
            low, high = (low, middle) if self.cut(middle) <= error else (middle, high)
        return max(high, least)


@njit(cache=True, nogil=True)
def _integral(y, weight, x):
    columns, out = np.zeros(x.size), 0.0
    for i in range(y.size):
        for j in range(x.size):
            columns[j] += y[i] * weight[i, j]
    for j in range(x.size):
        out += columns[j] * x[j]
    return out


def roll_off(f: Array, limit: float) -> Array:
    """1 up to ROLL_FROM of the limit, 0 from the limit on, smooth between.

    A sharp end would ring along rows and columns over the whole block.
    """
    return taper(np.abs(f), ROLL_FROM * limit, limit)


def band_of(core: Core, path: Path, longest_px: float) -> TransferBand:
    """Cells of frequency of a core swept along a path that is cut at `longest_px`."""
    os, n = core.oversampling, core.samples.shape[0]
    size = fast_size(2 * n if n <= FINE_SAMPLES else n, real=True)
    step = os / size
    amount = np.abs(scipy.fft.rfft2(core.samples, s=(size, size), workers=1)) / os**2
    fy, fx = scipy.fft.fftfreq(size, 1.0 / os), np.arange(size // 2 + 1) * step
    bright = amount > DARK * amount.max()
    rows, columns = bright.any(axis=1), bright.any(axis=0)
    fy, fx, amount = fy[rows], fx[columns], amount[np.ix_(rows, columns)]
    amount *= step**2 * np.where(fx > 0.0, 2.0, 1.0)
    amount *= sweep_bound(fy, fx, step, path, longest_px)
    width = step * -(-fx.size // MOST_CELLS)
    fy, amount = _merged(np.abs(fy), amount, width)
    fx, turned = _merged(fx, amount.T, width)
    return TransferBand(fy, fx, np.ascontiguousarray(turned.T))


def _merged(f: Array, amount: Array, width: float) -> tuple[Array, Array]:
    """Sums of the rows of `amount` whose frequency is the same to `width`, and their middles."""
    cell = np.rint(f / width).astype(int)
    out = np.zeros((cell.max() + 1, amount.shape[1]))
    np.add.at(out, cell, amount)
    middles: Array = np.arange(len(out), dtype=float) * width
    return middles, out


def sweep_bound(fy: Array, fx: Array, step: float, path: Path, longest_px: float) -> Array:
    """Bound of |transfer of the path|, averaged over cells `step` wide: (n, m).

    Equal pieces of a straight streak lie end to end: the error of one dies out within a few pixels
    of it, so that a pixel sees TOGETHER of them. Unequal pieces count in full.
    """
    if path.length_px == 0:
        return np.ones((fy.size, fx.size))
    shares: dict[Path, list[float]] = {}
    for _, _, piece, share in pieces(path, longest_px):
        shares.setdefault(piece, []).append(share)
    out = np.zeros((fy.size, fx.size))
    for piece, parts in shares.items():
        share = min(sum(parts), TOGETHER * max(parts))
        for dy, dx, _, _, weight in segments_of(piece):
            out += share * weight * _mean_envelope(fy, fx, step, dy, dx)
    return np.minimum(out, 1.0)


def _mean_envelope(fy: Array, fx: Array, step: float, dy: float, dx: float) -> Array:
    """Mean of min(1, 1 / |pi (fy dy + fx dx)|) over cells: second differences of its integral.

    It bounds |sinc(f.d)|, whose lobes may be narrower than a cell.
    """
    middle = fy[:, None] * dy + fx[None, :] * dx
    a, b = (max(0.5 * step * abs(d), 1e-2) for d in (dy, dx))
    corners = (
        _twice_integrated(middle + a + b)
        - _twice_integrated(middle + a - b)
        - _twice_integrated(middle - a + b)
        + _twice_integrated(middle - a - b)
    )
    return np.clip(corners / (4.0 * a * b), 0.0, 1.0)


def _twice_integrated(u: Array) -> Array:
    """Second integral of min(1, 1 / |pi u|)."""
    v = np.abs(u)
    far = (0.5 / np.pi + v * np.log(np.maximum(np.pi * v, 1.0))) / np.pi
    return np.where(v <= 1.0 / np.pi, 0.5 * v * v, far)


def peak_light(core: Core, path: Path) -> float:
    """Light in the brightest pixel of a source of unit light that moves along `path`.

    Taken at the middles of up to 16 segments, by the line integral of the core's samples: what an
    error relative to a source's peak is multiplied by for `plan_spectral`.
    """
    segments = segments_of(path)
    tried = segments[:: -(-len(segments) // 16)]
    return max(sum(_line_light(core, s, y, x) for s in segments) for _, _, y, x, _ in tried)


def _line_light(core: Core, segment: Array, y: float, x: float) -> float:
    """Light of a segment in a pixel at (y, x), bilinearly between the samples."""
    dy, dx, my, mx, share = segment
    os, size = core.oversampling, core.samples.shape[0]
    count = 2 * int(np.ceil(np.hypot(dy, dx) * os)) + 1
    t = (np.arange(count) + 0.5) / count - 0.5
    v, u = (a * os + size // 2 for a in (y - my - t * dy, x - mx - t * dx))
    on = (v >= 0) & (u >= 0) & (v < size - 1) & (u < size - 1)
    v, u = v[on], u[on]
    i, j = v.astype(int), u.astype(int)
    b, a = v - i, u - j
    upper = (1.0 - a) * core.samples[i, j] + a * core.samples[i, j + 1]
    lower = (1.0 - a) * core.samples[i + 1, j] + a * core.samples[i + 1, j + 1]
    return float(share * ((1.0 - b) * upper + b * lower).sum() / count)
