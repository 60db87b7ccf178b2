"""Responses that are a column times a row, tabulated along each axis alone.

A Gaussian in square pixels is such a product. Its tables are so small that
they hold many phases: interpolated cubically they err by some 1e-9 of the peak.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from pipeline.physics.psf.pupil import Blur, Gaussian
from pipeline.physics.psf.response import ROW_STEP, SPAN_FLOOR, compact_core, window

Array = NDArray[np.float64]

PHASES = 64  # a pixel, at least
WIDER = 1.5
LEBESGUE = 1.25  # largest sum of |weights| of cubic interpolation in its middle interval


@dataclass(frozen=True, eq=False)
class ProductResponse:
    """Stamps `column x row` at phases k / `phases` of a pixel, k = -1 ... phases + 1.

    row0, column0 : first row and column relative to the source's reference pixel floor(y), floor(x)
    columns, rows : (phases + 3, n) float64 whose products are light per pixel per unit light; n
        of the rows is a multiple of ROW_STEP
    linear_error, cubic_error : both the largest error of cubic interpolation, per unit light, with
        what the response differs from a product
    peak : largest value
    """

    phases: int
    row0: int
    column0: int
    columns: Array
    rows: Array
    linear_error: float
    cubic_error: float
    peak: float

    @property
    def reach_px(self) -> float:
        """Largest distance on either axis from floor(position) to a pixel of the stamp."""
        ends = [(self.row0, self.columns.shape[1]), (self.column0, self.rows.shape[1])]
        return float(max(max(-first, first + n) for first, n in ends) + 1)

    @property
    def nbytes(self) -> int:
        return self.columns.nbytes + self.rows.nbytes


def is_product(blur: Blur, streak_px: float) -> bool:
    """Whether a source that moves by so much is drawn as column times row."""
    return isinstance(blur.optics, Gaussian) and not streak_px


def product_table(blur: Blur, radius_px: float, phases: int = PHASES) -> ProductResponse:
    """Tabulate a response at rest that is a column times a row, up to a radius on either axis.

    Values between the samples come from trigonometric interpolation, exact for a band-limited
    response. What the samples differ from the product of their sums is part of the stated errors;
    so they reach WIDER than the table, for a core is round.
    """
    core = compact_core(blur, WIDER * radius_px)
    sums, light = (core.samples.sum(axis=1), core.samples.sum(axis=0)), core.samples.sum()
    off = float(np.abs(core.samples - np.outer(*sums) / light).max())
    period, half = window(core, 0.0, 0.0)[2], int(np.ceil(radius_px)) + 1
    fines = [_fine(s, core.oversampling, phases, period) for s in sums]
    most = [float(np.abs(f).max()) for f in fines]
    peak = most[0] * most[1] / light
    (row0, columns), (column0, rows) = (
        _at_phases(f, phases, half, SPAN_FLOOR * m) for f, m in zip(fines, most, strict=True)
    )
    spare = -rows.shape[1] % ROW_STEP
    rows = np.pad(rows, ((0, 0), (0, spare))) / light
    wrong = [
        3.0 / 128.0 * float(np.abs(np.diff(np.r_[f, f[:4]], 4)).max()) / m
        for f, m in zip(fines, most, strict=True)
    ]
    error = off + peak * (LEBESGUE * wrong[0] + wrong[1] + SPAN_FLOOR)
    return ProductResponse(phases, row0, column0, columns, rows, error, error, peak)


def _fine(sums: Array, oversampling: int, phases: int, period: int) -> Array:
    """Sums over one axis, periodic, at `phases` a pixel: [0] is the middle."""
    n, wide = sums.size, period * oversampling
    grid = np.zeros(wide)
    grid[(np.arange(n) - n // 2) % wide] = sums
    fine = max(phases, oversampling)
    spectrum = scipy.fft.rfft(grid)[: wide // 2]
    return scipy.fft.irfft(spectrum, n=period * fine)[:: fine // phases] * (fine / oversampling)


def _at_phases(fine: Array, phases: int, half: int, floor: float) -> tuple[int, Array]:
    """(first pixel, (phases + 3, n) values): pixel d at phase k stands at d - k / phases."""
    pixels, k = np.arange(-half, half + 2), np.arange(-1, phases + 2)
    values = fine[(pixels[None, :] * phases - k[:, None]) % fine.size]
    lit = np.flatnonzero((np.abs(values) > floor).any(axis=0))
    return int(pixels[lit[0]]), np.ascontiguousarray(values[:, lit[0] : lit[-1] + 1])
