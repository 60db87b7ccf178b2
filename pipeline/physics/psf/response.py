"""Pixel responses: the compact core of a star's light, tabulated at sub-pixel phases.

A star's light is split once, smoothly: `core = response x taper`, `wing = response - core`. The
core is zero beyond a radius and is drawn as stamps; the wing is smooth and is drawn on a coarse
grid (physics/drawing/wings.py). Their sum is the whole response, so that no light is lost or
counted twice whatever the radius is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.fft
from numba import njit
from numpy.typing import NDArray

from pipeline.physics.psf.pupil import Blur

Array = NDArray[np.float64]

BAND_FLOOR = 1e-9
SPAN_FLOOR = 1e-8  # of the peak: pixels below it in every phase are left out of a stamp
MARGIN_PX = 3
TAPER_BAND = 0.3  # cycles/px that the taper adds to the band of the response
TAPER_FROM = 0.7  # of the radius: where the taper begins; the best of 0.5 to 0.85 as measured


@dataclass(frozen=True)
class Core:
    """The compact part of a response on a fine grid.

    samples : (n, n) light that a pixel collects whose centre is there, per unit light of the
        source; spacing 1/`oversampling` px, centred at [n // 2, n // 2], zero beyond radius_px
    light : fraction of the source's light in the core
    """

    samples: Array
    oversampling: int
    radius_px: float
    light: float


@dataclass(frozen=True)
class PixelResponse:
    """Stamps at phases k / `phases` of a pixel, k = -1 ... phases + 1, on both axes.

    row0 : first stamp row relative to the source's reference pixel floor(y)
    starts, stops : (rows,) first and last-plus-one column relative to floor(x)
    offsets : (rows + 1,) where each row begins in the last axis of `values`
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
    def reach_px(self) -> float:
        """Largest distance on either axis from floor(position) to a pixel of the stamp."""
        rows = max(abs(self.row0), abs(self.row0 + len(self.starts)))
        return float(max(rows, -self.starts.min(initial=0), self.stops.max(initial=0)) + 1)


def oversampling_for(blur: Blur) -> int:
    """Samples per pixel (a power of two) that hold the response without aliasing."""
    needed = 2.0 * (blur.band_limit(BAND_FLOOR) + TAPER_BAND)
    return int(2 ** np.clip(np.ceil(np.log2(max(needed, 2.0))), 1, 7))


def compact_core(blur: Blur, radius_px: float) -> Core:
    """The response of the light that falls inside `radius_px`, tapered near its edge.

    The taper acts on the image before the pixels collect it, so that pixels without gaps collect
    the same sum at every phase. A blur without wings needs no taper: its radius holds it all.
    """
    os = oversampling_for(blur)
    half = int(np.ceil(radius_px)) + 2
    period = scipy.fft.next_fast_len(2 * half + 8)
    n = period * os
    fy, fx = scipy.fft.fftfreq(n, 1.0 / os)[:, None], scipy.fft.rfftfreq(n, 1.0 / os)[None, :]
    at = scipy.fft.fftfreq(n, 1.0 / n) / os
    inner = TAPER_FROM * radius_px if blur.has_wings else radius_px
    image = scipy.fft.irfft2(blur.image(fy, fx), s=(n, n))
    image *= taper(np.hypot(at[:, None], at[None, :]), inner, radius_px)
    whole = scipy.fft.irfft2(scipy.fft.rfft2(image) * blur.pixel(fy, fx), s=(n, n)) * os**2
    index = np.arange(-half * os, half * os + 1)
    samples = whole[np.ix_(index, index)]
    return Core(samples, os, radius_px, float(image.sum()) * blur.fill_factor)


def taper(r: Array, inner: float, outer: float) -> Array:
    """1 inside `inner`, 0 beyond `outer`, a quintic step with two smooth derivatives between."""
    if outer <= inner:
        return np.where(r <= outer, 1.0, 0.0)
    t = np.clip((outer - r) / (outer - inner), 0.0, 1.0)
    return t**3 * (10.0 + t * (6.0 * t - 15.0))


def core_spectrum(core: Core, streak: Array | None, period_y: int, period_x: int) -> Array:
    """Real FFT of the core on a period of (period_y, period_x) px, times a streak's transfer."""
    os = core.oversampling
    grid = np.zeros((period_y * os, period_x * os))
    n = core.samples.shape[0]
    rows = (np.arange(n) - n // 2) % grid.shape[0]
    cols = (np.arange(n) - n // 2) % grid.shape[1]
    grid[np.ix_(rows, cols)] = core.samples
    spectrum = scipy.fft.rfft2(grid)
    return spectrum if streak is None else spectrum * streak


def window(core: Core, reach_y: float, reach_x: float) -> tuple[int, int, int, int]:
    """Half-heights and periods [px] of the window that holds a core swept by +-reach."""
    half_y = int(np.ceil(core.radius_px + reach_y)) + MARGIN_PX
    half_x = int(np.ceil(core.radius_px + reach_x)) + MARGIN_PX
    fast = scipy.fft.next_fast_len
    return half_y, half_x, fast(2 * half_y + 4), fast(2 * half_x + 4)


def frequencies(core: Core, period_y: int, period_x: int) -> tuple[Array, Array]:
    """Frequencies [cycles/px] of `core_spectrum`."""
    os = core.oversampling
    fy = scipy.fft.fftfreq(period_y * os, 1.0 / os)
    return fy, scipy.fft.rfftfreq(period_x * os, 1.0 / os)


def phase_table(
    core: Core, spectrum: Array, half: tuple[int, int], period: tuple[int, int], phases: int
) -> PixelResponse:
    """Tabulate a (streaked) core at `phases` sub-pixel phases per axis.

    spectrum : from `core_spectrum` on `period`; half : half-heights of the window [px].
    The values between the samples come from trigonometric interpolation, which is exact for a
    band-limited response (Whittaker-Shannon on a periodic grid).
    """
    fine_per_px = max(phases, core.oversampling)
    fine = _interpolate(
        spectrum, core.oversampling, fine_per_px, half, period, fine_per_px // phases + 1
    )
    step = fine_per_px // phases
    fine = fine[::step, ::step]  # index k holds position k / phases - half - 2
    starts, stops = _spans(fine, half, phases)
    kept = np.flatnonzero(stops > starts)
    rows = slice(int(kept[0]), int(kept[-1]) + 1) if kept.size else slice(half[0], half[0])
    starts, stops = starts[rows], np.maximum(stops[rows], starts[rows])
    offsets = np.concatenate([[0], np.cumsum(stops - starts)]).astype(np.int64)
    values = _gather(fine, phases, rows.start, starts + half[1], stops - starts, offsets)
    second, fourth = _differences(fine)
    linear, cubic = second / 8.0, fourth * 3.0 / 128.0
    peak = float(np.abs(fine).max())
    row0 = rows.start - half[0]
    rounding = peak * 2.0**-24
    return PixelResponse(
        phases, row0, starts, stops, offsets, values, linear + rounding, cubic + rounding, peak
    )


def stamp_at(
    core: Core, spectrum: Array, half: tuple[int, int], period: tuple[int, int], y: float, x: float
) -> tuple[int, int, Array]:
    """One stamp at an exact position: (first row, first column, (rows, cols) values).

    The shift theorem moves the core by the sub-pixel part of (y, x); no table, no interpolation.
    """
    os = core.oversampling
    iy, ix = int(np.floor(y)), int(np.floor(x))
    fy, fx = frequencies(core, *period)
    turned = spectrum * np.exp(-2j * np.pi * fx * (x - ix))[None, :]
    rows = _fold(turned * np.exp(-2j * np.pi * fy * (y - iy))[:, None], os)
    swept = scipy.fft.ifft(rows, axis=0)
    at_y, at_x = np.arange(-half[0], half[0] + 2), np.arange(-half[1], half[1] + 2)
    # Along x the half spectrum is inverted whole and every `os`-th sample kept: rows are few now.
    fine = scipy.fft.irfft(swept[at_y % period[0]], n=period[1] * os, axis=1)
    return iy - half[0], ix - half[1], fine[:, (at_x * os) % (period[1] * os)]


def _fold(spectrum: Array, os: int) -> Array:
    """Spectrum (rows x os, ...) of the samples at whole pixels: the copies `1 px^-1` apart add up.

    Scaled so that the inverse transform of the folded rows gives the samples themselves.
    """
    rows = spectrum.shape[0] // os
    return spectrum.reshape(os, rows, -1).sum(axis=0) / os


def _interpolate(
    spectrum: Array, os: int, fine: int, half: tuple[int, int], period: tuple[int, int], more: int
) -> NDArray[np.float32]:
    """`fine` samples a pixel from -half - 2 px to half + 1 px and `more` samples, on both axes."""
    ny, my, mx = period[0] * os, period[0] * fine, period[1] * fine
    columns = np.zeros((my, spectrum.shape[1]), complex)
    columns[: ny // 2] = spectrum[: ny // 2]
    columns[my - (ny - ny // 2) :] = spectrum[ny // 2 :]
    rows_at = np.arange(-(half[0] + 2) * fine, (half[0] + 1) * fine + more) % my
    columns = scipy.fft.ifft(columns, axis=0, overwrite_x=True)[rows_at]
    cols_at = np.arange(-(half[1] + 2) * fine, (half[1] + 1) * fine + more) % mx
    scale = (my / ny) * (mx / (period[1] * os))
    out = np.empty((rows_at.size, cols_at.size), np.float32)
    for start in range(0, rows_at.size, 256):
        part = scipy.fft.irfft(columns[start : start + 256], n=mx, axis=1)
        out[start : start + 256] = part[:, cols_at] * scale
    return out


def _spans(
    fine: NDArray[np.float32], half: tuple[int, int], phases: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First and last-plus-one column of each stamp row that any phase reaches."""
    floor = SPAN_FLOOR * float(np.abs(fine).max())
    lit = _lit_pixels(fine, 2 * half[0] + 2, 2 * half[1] + 2, phases, floor)
    some, cols = lit.any(axis=1), lit.shape[1]
    first, last = lit.argmax(axis=1), cols - lit[:, ::-1].argmax(axis=1)
    return (
        np.where(some, first, half[1]).astype(np.int64) - half[1],
        np.where(some, last, half[1]).astype(np.int64) - half[1],
    )


@njit(cache=True, nogil=True)
def _lit_pixels(fine, rows, cols, phases, floor):  # type: ignore[no-untyped-def]
    """(rows, cols) whether a pixel is above `floor` at any phase from -1 to phases + 1.

    Pixel d at phase k stands at d - k / phases: fine index (d + half + 2) * phases - k.
    """
    out = np.zeros((rows, cols), np.bool_)
    for r in range(rows):
        for y in range((r + 1) * phases - 1, (r + 2) * phases + 2):
            for c in range(cols):
                if not out[r, c]:
                    for x in range((c + 1) * phases - 1, (c + 2) * phases + 2):
                        if abs(fine[y, x]) > floor:
                            out[r, c] = True
                            break
    return out


@njit(cache=True, nogil=True)
def _gather(fine, phases, row_first, starts, counts, offsets):  # type: ignore[no-untyped-def]
    """values[ky, kx, :] = the fine samples at each kept pixel, phase by phase."""
    n = phases + 3
    out = np.empty((n, n, offsets[-1]), np.float32)
    for ky in range(n):
        for kx in range(n):
            for r in range(counts.size):
                fy = (row_first + r + 2) * phases - (ky - 1)
                for c in range(counts[r]):
                    fx = (starts[r] + c + 2) * phases - (kx - 1)
                    out[ky, kx, offsets[r] + c] = fine[fy, fx]
    return out


@njit(cache=True, nogil=True)
def _differences(fine):  # type: ignore[no-untyped-def]
    """Largest second and fourth differences, each summed over the axes: h^n |f^(n)|."""
    ny, nx = fine.shape
    second, fourth = np.zeros(2), np.zeros(2)
    for y in range(2, ny - 2):
        for x in range(2, nx - 2):
            c = 2.0 * fine[y, x]
            down = abs(fine[y - 1, x] - c + fine[y + 1, x])
            along = abs(fine[y, x - 1] - c + fine[y, x + 1])
            second[0], second[1] = max(second[0], down), max(second[1], along)
            near = 4.0 * (np.float64(fine[y - 1, x]) + fine[y + 1, x])
            down = abs(fine[y - 2, x] - near + 3.0 * c + fine[y + 2, x])
            near = 4.0 * (np.float64(fine[y, x - 1]) + fine[y, x + 1])
            along = abs(fine[y, x - 2] - near + 3.0 * c + fine[y, x + 2])
            fourth[0], fourth[1] = max(fourth[0], down), max(fourth[1], along)
    return second.sum(), fourth.sum()
