"""Pixel responses: the compact core of a star's light, tabulated at sub-pixel phases.

A star's light is split once, smoothly: `core = response x taper`, `wing = response - core`. The
core is zero beyond a radius and is drawn as stamps; the wing is smooth and is drawn on a coarse
grid (physics/drawing/wings.py). Their sum is the whole response, so that no light is lost or
counted twice whatever the radius is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numba import njit
from numpy.typing import NDArray

from pipeline.physics.fast_sizes import fast_size
from pipeline.physics.psf.pupil import Blur

Array = NDArray[np.float64]

BAND_FLOOR = 1e-9
SPAN_FLOOR = 1e-8  # of the peak: pixels below it in every phase are omitted from a stamp
MARGIN_PX = 3
ROW_STEP = 4  # pixels that a processor adds at once: a stamp's rows are filled up to it
TAPER_BAND = 0.3  # cycles/px that the taper adds to the band of the response
TAPER_FROM = 0.7  # of the radius: where the taper begins; the best of 0.5 to 0.85 as measured


@dataclass(frozen=True, eq=False)
class CoreGrid:
    """How the compact part of a response is sampled: all that serves its spectrum.

    oversampling : samples per px; radius_px : where the core ends
    """

    oversampling: int
    radius_px: float


@dataclass(frozen=True, eq=False)
class Core(CoreGrid):
    """The compact part of a response on a fine grid.

    samples : (n, n) light that a pixel collects whose centre is there, per unit light of the
        source; spacing 1/`oversampling` px, centred at [n // 2, n // 2], zero beyond radius_px
    light : fraction of the source's light in the core
    """

    samples: Array
    light: float


@dataclass(frozen=True)
class PixelResponse:
    """Stamps at phases k / `phases` of a pixel, k = -1 ... phases + 1, on both axes.

    row0 : first stamp row relative to the source's reference pixel floor(y)
    starts, stops : (rows,) first and last-plus-one column relative to floor(x)
    offsets : (rows + 1,) where each row begins in the last axis of `values`; its length is that of
        the row, filled with zeros up to a multiple of ROW_STEP
    values : (phases + 3, phases + 3, offsets[-1]) float32, light per pixel per unit light
    linear_error, cubic_error : largest error of interpolating between phases, per unit light
    peak : largest value
    """

    phases: int
    row0: int
    starts: NDArray[np.int64]
    stops: NDArray[np.int64]
    offsets: NDArray[np.int64]
    values: NDArray[np.float32]
    linear_error: float
    cubic_error: float
    peak: float

    @property
    def nbytes(self) -> int:
        return self.values.nbytes

    @property
    def reach_px(self) -> float:
        """Largest distance on either axis from floor(position) to a pixel of the stamp."""
        rows = max(abs(self.row0), abs(self.row0 + len(self.starts)))
        return float(max(rows, -self.starts.min(initial=0), self.stops.max(initial=0)) + 1)


def oversampling_for(blur: Blur) -> int:
    """Samples per pixel (a power of two) that hold the response without aliasing."""
    return int(2 ** np.clip(np.ceil(np.log2(max(2.0 * band_of(blur), 2.0))), 1, 7))


def band_of(blur: Blur) -> float:
    """Highest frequency of a response's core [cycles/px]."""
    return float(blur.band_limit(BAND_FLOOR)) + TAPER_BAND


def compact_core(blur: Blur, radius_px: float) -> Core:
    """The response of the light that falls inside `radius_px`, tapered near its edge.

    The taper acts on the image before the pixels collect it, so that pixels without gaps collect
    the same sum at every phase. A blur without wings needs no taper: its radius holds it all.
    """
    os = oversampling_for(blur)
    half = int(np.ceil(radius_px)) + 2
    period = fast_size(2 * half + 8)
    n = period * os
    fy, fx = scipy.fft.fftfreq(n, 1.0 / os)[:, None], scipy.fft.rfftfreq(n, 1.0 / os)[None, :]
    at = scipy.fft.fftfreq(n, 1.0 / n) / os
    inner = TAPER_FROM * radius_px if blur.has_wings else radius_px
    image = scipy.fft.irfft2(blur.image(fy, fx), s=(n, n))
    image *= taper(np.hypot(at[:, None], at[None, :]), inner, radius_px)
    whole = scipy.fft.irfft2(scipy.fft.rfft2(image) * blur.pixel(fy, fx), s=(n, n)) * os**2
    index = np.arange(-half * os, half * os + 1)
    samples = whole[np.ix_(index, index)]
    return Core(os, radius_px, samples, float(image.sum()) * blur.fill_factor)


def taper(r: Array, inner: float, outer: float) -> Array:
    """1 inside `inner`, 0 beyond `outer`, a quintic step with two smooth derivatives between."""
    if outer <= inner:
        return np.where(r <= outer, 1.0, 0.0)
    t = np.clip((outer - r) / (outer - inner), 0.0, 1.0)
    return t**3 * (10.0 + t * (6.0 * t - 15.0))


def core_spectrum(core: Core, period_y: int, period_x: int) -> NDArray[np.complex128]:
    """Real FFT of the core on a period of (period_y, period_x) px."""
    os = core.oversampling
    grid = np.zeros((period_y * os, period_x * os))
    n = core.samples.shape[0]
    rows = (np.arange(n) - n // 2) % grid.shape[0]
    cols = (np.arange(n) - n // 2) % grid.shape[1]
    grid[np.ix_(rows, cols)] = core.samples
    return scipy.fft.rfft2(grid)


def window(core: CoreGrid, reach_y: float, reach_x: float) -> tuple[int, int, int, int]:
    """Half-heights and periods [px] of the window that holds a core swept by +-reach."""
    half_y = int(np.ceil(core.radius_px + reach_y)) + MARGIN_PX
    half_x = int(np.ceil(core.radius_px + reach_x)) + MARGIN_PX
    return half_y, half_x, fast_size(2 * half_y + 4), fast_size(2 * half_x + 4)


def frequencies(core: CoreGrid, period_y: int, period_x: int) -> tuple[Array, Array]:
    """Frequencies [cycles/px] of `core_spectrum`."""
    os = core.oversampling
    fy = scipy.fft.fftfreq(period_y * os, 1.0 / os)
    return fy, scipy.fft.rfftfreq(period_x * os, 1.0 / os)


def phase_table(
    core: CoreGrid,
    spectrum: NDArray[np.complex128],
    half: tuple[int, int],
    period: tuple[int, int],
    phases: int,
) -> PixelResponse:
    """Tabulate a (streaked) core at `phases` sub-pixel phases per axis.

    spectrum : from `core_spectrum` on `period`; half : half-heights of the window [px].
    The values between the samples come from trigonometric interpolation, which is exact for a
    band-limited response (Whittaker-Shannon on a periodic grid). One row of pixels is made at a
    time, so that the fine image is never held whole.
    """
    columns = _fine_rows(spectrum, core.oversampling, max(phases, core.oversampling), half, period)
    peak = float(np.abs(stamp_at(core, spectrum, half, period, 0.0, 0.0)[2]).max())
    rows, lengths, starts, worst = [], [], [], np.zeros(3)
    for r in range(2 * half[0] + 2):
        fine = _fine_columns(columns, r, core.oversampling, phases, half, period)
        first, last = _lit_span(fine, 2 * half[1] + 2, phases, SPAN_FLOOR * peak)
        rows.append(_gather(fine, phases, first, last))
        lengths.append(last - first)
        starts.append(first - half[1])
        worst = np.maximum(worst, _differences(fine))
    counts = np.array([row.shape[2] for row in rows])
    kept = np.flatnonzero(counts)
    span = slice(int(kept[0]), int(kept[-1]) + 1) if kept.size else slice(half[0], half[0])
    counts, first_columns = counts[span], np.array(starts, np.int64)[span]
    last_columns = first_columns + np.array(lengths, np.int64)[span]
    offsets = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    rounding = worst[0] * (2.0**-24 + SPAN_FLOOR)
    return PixelResponse(
        phases,
        span.start - half[0],
        first_columns,
        last_columns,
        offsets,
        np.concatenate(rows[span], axis=2),
        worst[1] / 8.0 + rounding,
        worst[2] * 3.0 / 128.0 + rounding,
        worst[0],
    )


def stamp_at(
    core: CoreGrid,
    spectrum: NDArray[np.complex128],
    half: tuple[int, int],
    period: tuple[int, int],
    y: float,
    x: float,
) -> tuple[int, int, Array]:
    """One stamp at an exact position: (first row, first column, (rows, cols) values).

    The shift theorem moves the core by the sub-pixel part of (y, x); no table, no interpolation.
    """
    os = core.oversampling
    iy, ix = int(np.floor(y)), int(np.floor(x))
    fy, fx = frequencies(core, *period)
    turned = spectrum * np.exp(-2j * np.pi * fx * (x - ix))[None, :]
    rows = _fold(turned * np.exp(-2j * np.pi * fy * (y - iy))[:, None], os)
    return iy - half[0], ix - half[1], stamp_of(rows, half, period, os)


def stamp_of(
    rows: NDArray[np.complex128], half: tuple[int, int], period: tuple[int, int], os: int
) -> Array:
    """The pixels of a window from its spectrum folded along y (`_fold`), which is used up."""
    swept = scipy.fft.ifft(rows, axis=0, overwrite_x=True)
    at_y, at_x = np.arange(-half[0], half[0] + 2), np.arange(-half[1], half[1] + 2)
    # Along x the half spectrum is inverted whole and every `os`-th sample kept: rows are few now.
    fine: Array = scipy.fft.irfft(swept[at_y % period[0]], n=period[1] * os, axis=1)
    return fine[:, (at_x * os) % (period[1] * os)]


def _fold(spectrum: NDArray[np.complex128], os: int) -> NDArray[np.complex128]:
    """Spectrum (rows x os, ...) of the samples at whole pixels: the copies `1 px^-1` apart add up.

    Scaled so that the inverse transform of the folded rows gives the samples themselves.
    """
    rows = spectrum.shape[0] // os
    return spectrum.reshape(os, rows, -1).sum(axis=0) / os


def _fine_rows(
    spectrum: NDArray[np.complex128],
    os: int,
    fine: int,
    half: tuple[int, int],
    period: tuple[int, int],
) -> Array:
    """Rows at `fine` samples a pixel from -half - 2 to half + 2 px; columns still as spectrum."""
    ny, my = period[0] * os, period[0] * fine
    columns = np.zeros((my, spectrum.shape[1]), complex)
    columns[: ny // 2] = spectrum[: ny // 2]
    columns[my - (ny - ny // 2) :] = spectrum[ny // 2 :]
    at = np.arange(-(half[0] + 2) * fine, (half[0] + 2) * fine + 1) % my
    return scipy.fft.ifft(columns, axis=0, overwrite_x=True)[at] * (my / ny)


def _fine_columns(
    columns: Array, row: int, os: int, phases: int, half: tuple[int, int], period: tuple[int, int]
) -> Array:
    """Fine samples (phases + 5, ...) around one row of pixels, `phases` a pixel on both axes.

    Pixel d at phase k stands at d - k / phases. Row j of the block is phase phases + 2 - j of
    pixel row `row - half`; along x, index i stands at i / phases - half - 2.
    """
    fine = max(phases, os)
    step = fine // phases
    first = ((row + 1) * phases - 2) * step
    block = columns[first : first + (phases + 5) * step : step]
    mx = period[1] * fine
    at = np.arange(-(half[1] + 2) * phases, (half[1] + 2) * phases + 1) * step % mx
    return scipy.fft.irfft(block, n=mx, axis=1)[:, at] * (fine / os)


@njit(cache=True, nogil=True)
def _lit_span(fine, cols, phases, floor):
    """First and last-plus-one pixel of a row that is above `floor` at any of its phases."""
    first, last = cols, 0
    for c in range(cols):
        lit = False
        for y in range(1, phases + 4):
            for x in range((c + 1) * phases - 1, (c + 2) * phases + 2):
                if abs(fine[y, x]) > floor:
                    lit = True
                    break
            if lit:
                break
        if lit:
            first, last = min(first, c), c + 1
    return (first, last) if last > first else (0, 0)


@njit(cache=True, nogil=True)
def _gather(fine, phases, first, last):
    """values[ky, kx, :] of one row of pixels: the fine samples at each pixel, phase by phase."""
    n, steps = phases + 3, -(-(last - first) // ROW_STEP)
    out = np.zeros((n, n, steps * ROW_STEP), np.float32)
    for ky in range(n):
        for kx in range(n):
            for c in range(first, last):
                out[ky, kx, c - first] = fine[phases + 3 - ky, (c + 2) * phases - (kx - 1)]
    return out


@njit(cache=True, nogil=True)
def _differences(fine):
    """Largest value, and second and fourth differences summed over the axes: h^n |f^(n)|."""
    ny, nx = fine.shape
    peak, down2, along2, down4, along4 = 0.0, 0.0, 0.0, 0.0, 0.0
    for y in range(2, ny - 2):
        for x in range(2, nx - 2):
            c = fine[y, x]
            peak = max(peak, abs(c))
            up = fine[y - 1, x] + fine[y + 1, x]
            side = fine[y, x - 1] + fine[y, x + 1]
            down2 = max(down2, abs(up - 2.0 * c))
            along2 = max(along2, abs(side - 2.0 * c))
            down4 = max(down4, abs(fine[y - 2, x] - 4.0 * up + 6.0 * c + fine[y + 2, x]))
            along4 = max(along4, abs(fine[y, x - 2] - 4.0 * side + 6.0 * c + fine[y, x + 2]))
    return np.array([peak, down2 + along2, down4 + along4])
