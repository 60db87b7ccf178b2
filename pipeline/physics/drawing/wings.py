"""Wings engine: the far, smooth light of all sources at once, on a coarse grid.

What the compact cores leave out (response - core) is smooth, so it is convolved on a grid of
`spacing_px` pixels: the sources are spread onto the grid by cubic B-splines, multiplied in
frequency by the wing's transfer function (corrected for both splines), and read back at the
pixels by cubic B-splines. The cost does not depend on the number of sources.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy
from numba import njit
from numpy.typing import NDArray

from pipeline.physics.fast_sizes import fast_size
from pipeline.physics.motion.streak import POINT, Path, transfer
from pipeline.physics.psf.pupil import Blur
from pipeline.physics.psf.response import Core, taper

Array = NDArray[np.float64]

GRID_SAMPLES = 2  # samples a pixel of the core that hold what a grid of 2 px or more can see
TEST_SAMPLES = 8  # and what single pixels can see
TEST_SIDE = 1024  # samples across from which fewer a pixel are taken, and most pixels
LARGEST_SIDE = 4096  # samples across that any test may take
CUT_FROM = 0.9  # of the reach: where the wing's cut-off begins
COLUMNS = 64  # of frequencies that are transformed together
SPLINE_PX = 3  # grid points that the splines need beyond the range they serve


@dataclass(frozen=True)
class WingGrid:
    """Where the coarse grid of one block of the focal plane stands.

    rows, columns : grid points; spacing_px : pixels between them
    y0_px, x0_px : frame position of grid point [0, 0]
    """

    rows: int
    columns: int
    spacing_px: int
    y0_px: float
    x0_px: float


def wing_grid(
    block_shape: tuple[int, int], origin: tuple[int, int], spacing_px: int, reach_px: float
) -> WingGrid:
    """Grid for a block of pixels at `origin` (y, x) and the sources up to `reach_px` off it."""
    pad = int(np.ceil(reach_px / spacing_px)) + SPLINE_PX
    rows, columns = (
        fast_size(int(np.ceil(n / spacing_px)) + 2 * pad + 1, real=True) for n in block_shape
    )
    return WingGrid(
        rows, columns, spacing_px, origin[0] - pad * spacing_px, origin[1] - pad * spacing_px
    )


def wing_kernel(blur: Blur, core: Core, grid: WingGrid, reach_px: float) -> NDArray[np.complex128]:
    """Transfer function of (response - core) on the grid's frequencies, cut off at `reach_px`.

    The cut-off (smooth over the last tenth of the reach) keeps the light of a source from coming
    back in at the far side of the periodic grid. The wing is made on a grid of its own, four
    reaches wide, so that it is the same for every block. Complex (rows, columns // 2 + 1).
    """
    h = grid.spacing_px
    n = fast_size(int(np.ceil(4.0 * reach_px / h)), real=True)
    fy, fx = scipy.fft.fftfreq(n, float(h)), scipy.fft.rfftfreq(n, float(h))
    half = int(np.ceil(reach_px / h))
    at = np.arange(-half, half + 1)
    rows = np.empty((at.size, fx.size), complex)
    for part, columns in _wing_columns(blur, core, fy, fx, GRID_SAMPLES):
        rows[:, part] = scipy.fft.ifft(columns, axis=0, overwrite_x=True)[at]
    wing = scipy.fft.irfft(rows, n)[:, at]
    wing *= taper(np.hypot(at[:, None], at[None, :]) * h, CUT_FROM * reach_px, reach_px)
    placed = np.zeros((grid.rows, grid.columns))
    placed[np.ix_(at, at)] = wing
    fy, fx = grid_frequencies(grid)
    spline = np.sinc(fy * h)[:, None] ** 4 * np.sinc(fx * h)[None, :] ** 4
    return scipy.fft.rfft2(placed) / (spline * spline * h * h)


def grid_frequencies(grid: WingGrid) -> tuple[Array, Array]:
    """Frequencies [cycles/px] of the grid's real FFT."""
    h = float(grid.spacing_px)
    return scipy.fft.fftfreq(grid.rows, h), scipy.fft.rfftfreq(grid.columns, h)


def spread(grid: WingGrid, x_px: Array, y_px: Array, light_e: Array) -> Array:
    """Sources onto the grid: (rows, columns) float64, electrons; those off it are omitted."""
    out = np.zeros((grid.rows, grid.columns))
    _spread(out, grid.y0_px, grid.x0_px, float(grid.spacing_px), x_px, y_px, light_e)
    return out


def convolve(spectrum: NDArray[np.complex128], grid: WingGrid) -> Array:
    """Grid values of a wing field from its spectrum (spline coefficients, electrons per pixel)."""
    return scipy.fft.irfft2(spectrum, s=(grid.rows, grid.columns))


def add_wings(image_e: Array, origin: tuple[int, int], grid: WingGrid, field: Array) -> None:
    """Add a wing field to image pixels (in place); `origin` (y, x) is the image's first pixel."""
    _read(image_e, origin[0] - grid.y0_px, origin[1] - grid.x0_px, float(grid.spacing_px), field)


def wing_error(blur: Blur, core: Core, spacing_px: int, path: Path = POINT) -> float:
    """Largest error of a pixel of the wing, per unit light, measured against the exact response.

    Draws one source (swept along `path`) at three sub-pixel places with the coarse grid, and
    compares with the response sampled directly.
    """
    reach = 6.0 * core.radius_px
    sweep = float(max(np.abs(path.x_px).max(), np.abs(path.y_px).max()))
    size = 2 * int(np.ceil(2.0 * core.radius_px + sweep)) + 1
    grid = wing_grid((size, size), (0, 0), spacing_px, reach)
    kernel = wing_kernel(blur, core, grid, reach) * transfer(
        *grid_frequencies(grid), path.x_px, path.y_px, path.weight
    )
    n = fast_size(2 * size + 2 * int(2.0 * core.radius_px))
    enough = 4 if n * TEST_SAMPLES > TEST_SIDE and blur.band_limit(1e-2) <= 1.0 else TEST_SAMPLES
    enough = min(enough, next((k for k in (TEST_SAMPLES, 4) if n * k <= LARGEST_SIDE), 2))
    os = min(core.oversampling, enough)
    fy, fx = scipy.fft.fftfreq(n * os, 1.0 / os), scipy.fft.rfftfreq(n * os, 1.0 / os)
    shifts = np.arange(3) * os // 3
    index = (np.arange(size) - size // 2) * os - shifts[:, None]
    rows = np.empty((3, size, fx.size), complex)  # all that is looked at, a few columns at a time
    for part, columns in _wing_columns(blur, core, fy, fx, os):
        swept = columns * transfer(fy, fx[part], path.x_px, path.y_px, path.weight)
        rows[:, :, part] = scipy.fft.ifft(swept, axis=0, overwrite_x=True)[index]
    worst = 0.0
    for shift, seen, of_rows in zip(shifts, index, rows, strict=True):
        exact = scipy.fft.irfft(of_rows, n * os)[:, seen] * os**2
        at = np.full(1, size // 2 + shift / os)
        image = np.zeros((size, size))
        light = scipy.fft.rfft2(spread(grid, at, at, np.ones(1)))
        add_wings(image, (0, 0), grid, convolve(light * kernel, grid))
        worst = max(worst, float(np.abs(image - exact).max()))
    return worst


def wing_slope(blur: Blur, core: Core) -> float:
    """Steepest fall of the wing of a source at rest, per px and unit light [1/px]."""
    spectrum, fy, fx, os = _wing_spectrum(blur, core, 6.0 * core.radius_px)
    n = fy.size
    dy, dx = (
        scipy.fft.irfft2(2j * np.pi * f * spectrum, s=(n, n)) for f in (fy[:, None], fx[None, :])
    )
    return float(np.hypot(dy, dx).max() * os**2)


def swept_apart(blur: Blur, core: Core, one: Path, other: Path) -> float | None:
    """Largest difference of a pixel of the wing swept along two paths, per unit light.

    None for paths too long to be compared: TEST_SIDE pixels and more with what is around them.
    """
    ends = [float(np.abs(v).max()) for path in (one, other) for v in (path.x_px, path.y_px)]
    side_px = 2.0 * max(ends) + 6.0 * core.radius_px
    if side_px > TEST_SIDE:
        return None
    spectrum, fy, fx, os = _wing_spectrum(blur, core, side_px)
    a, b = (transfer(fy, fx, p.x_px, p.y_px, p.weight) for p in (one, other))
    n = fy.size
    return float(np.abs(scipy.fft.irfft2(spectrum * (a - b), s=(n, n))).max() * os**2)


def _wing_spectrum(
    blur: Blur, core: Core, side_px: float
) -> tuple[NDArray[np.complex128], Array, Array, int]:
    """Transform of a wing at rest on a square: itself, fy (n,), fx (n // 2 + 1,), samples a px."""
    most = next((os for os in (TEST_SAMPLES, 4) if side_px * os <= TEST_SIDE), 2)
    os = min(core.oversampling, most)
    n = fast_size(int(np.ceil(min(side_px, TEST_SIDE))) + 1) * os
    fy, fx = scipy.fft.fftfreq(n, 1.0 / os), scipy.fft.rfftfreq(n, 1.0 / os)
    return _wing_at(blur, core, fy, fx, os), fy, fx, os


def _wing_at(blur: Blur, core: Core, fy: Array, fx: Array, os: int) -> NDArray[np.complex128]:
    """Transform of a wing at rest at fy (n,), fx (m,) -> (n, m), for `os` samples a pixel."""
    out = np.empty((fy.size, fx.size), complex)
    for part, columns in _wing_columns(blur, core, fy, fx, os):
        out[:, part] = columns
    return out


def _wing_columns(
    blur: Blur, core: Core, fy: Array, fx: Array, os: int
) -> Iterator[tuple[slice, NDArray[np.complex128]]]:
    """The same, a few columns at a time: (which of fx, their part of the transform)."""
    for part, of_core in _core_columns(core, fy, fx, os):
        whole = blur.transfer(fy[:, None], fx[None, part])
        if core.oversampling > os:
            whole = whole * _low_pass(fy, os)[:, None] * _low_pass(fx[part], os)[None, :]
        yield part, np.asarray(whole - of_core)


def _core_columns(
    core: Core, fy: Array, fx: Array, most: int
) -> Iterator[tuple[slice, NDArray[np.complex128]]]:
    """Fourier transform of the core at fy (n,), fx (m,), a few columns at a time as of above.

    fy, fx : those of a real FFT over a whole number of pixels
    A core with more than `most` samples a pixel is first cut smoothly to the frequencies that so
    many hold; the transform is then exact below most / 4 cycles per pixel.
    """
    samples, at, per_px = _smoothed(core, most)
    period = round(1.0 / fx[1]) * per_px
    index = np.rint(at * per_px).astype(np.int64) % period
    rows = np.zeros((len(at), period))
    np.add.at(rows.T, index, samples.T)
    along = np.ascontiguousarray(scipy.fft.rfft(rows, axis=1)[:, : fx.size].T)
    wanted = np.rint(fy * period / per_px).astype(np.int64) % period
    for first in range(0, fx.size, COLUMNS):
        part = slice(first, first + COLUMNS)
        columns = np.zeros((len(along[part]), period), complex)
        np.add.at(columns.T, index, along[part].T)
        yield part, scipy.fft.fft(columns, axis=1, overwrite_x=True)[:, wanted].T / per_px**2


def _low_pass(f: Array, samples: int) -> Array:
    """1 up to samples / 4 cycles per pixel, 0 from samples / 2 on."""
    return taper(np.abs(f), samples / 4, samples / 2)


def _smoothed(core: Core, most: int) -> tuple[Array, Array, int]:
    """Samples of the core with at most `most` per pixel, their places [px], how many a pixel."""
    half, os = core.samples.shape[0] // 2, core.oversampling
    if os <= most:
        return core.samples, np.arange(-half, half + 1) / os, os
    period = fast_size(-(-2 * half // os) + 8)
    fine, n = period * os, period * most
    grid = np.zeros((fine, fine))
    index = np.arange(-half, half + 1) % fine
    grid[np.ix_(index, index)] = core.samples
    keep = np.arange(-(n // 2) + 1, n // 2)
    cut = _low_pass(keep / period, most)
    spectrum = scipy.fft.fft2(grid)[np.ix_(keep % fine, keep % fine)] * cut[:, None] * cut[None, :]
    small = np.zeros((n, n), complex)
    small[np.ix_(keep % n, keep % n)] = spectrum
    samples = scipy.fft.ifft2(small).real * (n / fine) ** 2
    at = np.arange(-(n // 2), n - n // 2)
    return samples[np.ix_(at % n, at % n)], at / most, most


@njit(cache=True, nogil=True)
def _spline(u, w):
    """Cubic B-spline weights of the four grid points around a place at fraction u."""
    v = 1.0 - u
    w[0] = v * v * v / 6.0
    w[1] = 2.0 / 3.0 - u * u * (1.0 + v) / 2.0
    w[2] = 2.0 / 3.0 - v * v * (1.0 + u) / 2.0
    w[3] = u * u * u / 6.0


@njit(cache=True, nogil=True)
def _spread(out, y0, x0, h, xs, ys, light):
    wy, wx = np.empty(4), np.empty(4)
    for s in range(xs.size):
        gy, gx = (ys[s] - y0) / h, (xs[s] - x0) / h
        iy, ix = int(np.floor(gy)), int(np.floor(gx))
        if iy < 1 or ix < 1 or iy + 2 >= out.shape[0] or ix + 2 >= out.shape[1]:
            continue
        _spline(gy - iy, wy)
        _spline(gx - ix, wx)
        for i in range(4):
            for j in range(4):
                out[iy - 1 + i, ix - 1 + j] += light[s] * wy[i] * wx[j]


@njit(cache=True, nogil=True)
def _read(image, oy, ox, h, field):
    ny, nx = image.shape
    wy = np.empty(4)
    wx = np.empty((nx, 4))
    at = np.empty(nx, np.int64)
    for c in range(nx):
        g = (c + ox) / h
        at[c] = int(np.floor(g))
        _spline(g - at[c], wx[c])
    columns = np.empty(field.shape[1])
    for r in range(ny):
        g = (r + oy) / h
        iy = int(np.floor(g))
        _spline(g - iy, wy)
        for j in range(field.shape[1]):
            columns[j] = (
                wy[0] * field[iy - 1, j]
                + wy[1] * field[iy, j]
                + wy[2] * field[iy + 1, j]
                + wy[3] * field[iy + 2, j]
            )
        for c in range(nx):
            j = at[c]
            image[r, c] += (
                wx[c, 0] * columns[j - 1]
                + wx[c, 1] * columns[j]
                + wx[c, 2] * columns[j + 1]
                + wx[c, 3] * columns[j + 2]
            )
