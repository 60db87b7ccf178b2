"""Point-spread functions given as an image: their transfer function at any frequency.

The image is taken as samples of light that has no detail finer than they can hold, so that what
lies between them follows (Whittaker and Shannon). The Fourier transform of the samples is read at
any frequency from a fast transform twice as fine, through a kernel whose own transform is divided
out first: a non-uniform FFT (Barnett et al. 2019, SIAM J. Sci. Comput. 41, C479), error 1e-13.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy
from numba import njit
from numpy.typing import NDArray

from pipeline.errors import BadInput
from pipeline.physics.fast_sizes import fast_size
from pipeline.physics.psf.pupil import Transfer

Array = NDArray[np.float64]

WIDTH = 14  # of the reading kernel, in points of the fine transform
SHAPE = 2.3 * WIDTH
FINER = 2  # times as fine as the samples need
LEFT_OUT = 1e-13  # of the light: what a pixel may lose by cutting the band
MOST_LEFT_OUT = 1e-5  # and where the band is wider than FINE_BAND
FINE_BAND = 3.6  # cycles/px: eight samples a pixel hold it
BETWEEN = 2.0  # times what is found on the samples is the most between them
READ_ERROR = 1e-13  # of a pixel, of the light, by reading the fine transform
LARGEST_SIDE = 2048
WHOLE_STAMP_PX = 48.0  # tables that reach farther have wings
FIELD = "sensor.psf"


@dataclass(frozen=True, eq=False)
class Sampled:
    """A table of light, ready for use; equal to one of the same content. Made by `sampled`.

    samples : (ny, nx) light, sum 1, read-only; spacing_px : pixels between samples
    centre : (row, column) in samples where the source stands
    light : share of the source's light that falls within the table; the rest is lost
    """

    samples: Array
    spacing_px: float
    centre: tuple[float, float]
    light: float
    digest: str

    def __hash__(self) -> int:
        return hash(self.digest)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Sampled) and self.digest == other.digest

    def transfer(self, fy: Array, fx: Array) -> Transfer:
        """Fourier transform of the light at (fy, fx) [cycles/px]; zero beyond its band."""
        fy, fx = np.broadcast_arrays(np.asarray(fy, float), np.asarray(fx, float))
        band, lattice = self.band, _spectrum(self)
        h = self.spacing_px
        step = np.array(lattice.period) * h
        shift = (np.array(self.centre) - [n // 2 for n in self.samples.shape]) * h
        limits = (band.limit, 0.5 / h)
        out = _read(lattice.values, lattice.row0, step, shift, limits, fy.ravel(), fx.ravel())
        return out.reshape(fy.shape)

    @property
    def band(self) -> SampledBand:
        """Where the table's detail ends, and what cutting there costs."""
        return _band(self)

    def band_limit(self, floor: float) -> float:
        """Frequency [cycles/px] beyond which no direction has more than `floor`."""
        band = self.band
        above = np.flatnonzero(band.largest > floor)
        if above.size == 0:
            return band.step
        return float(min(band.limit, band.step * (above[-1] + 1)))

    def light_beyond(self, radius_px: float) -> float:
        """Fraction of the table's light farther than `radius_px` from the source's place."""
        radii, beyond = _rings(self)
        return float(beyond[np.searchsorted(radii, radius_px, side="right")])

    @property
    def reach_px(self) -> float:
        """Distance of the farthest sample that holds light."""
        return float(_rings(self)[0][-1])

    @property
    def scale_px(self) -> float:
        """Radius that holds half of the light."""
        radii, beyond = _rings(self)
        return max(float(radii[np.argmax(beyond[1:] <= 0.5)]), self.spacing_px)

    @property
    def has_wings(self) -> bool:
        return self.reach_px > WHOLE_STAMP_PX

    @property
    def core_px(self) -> float:
        """Radius that holds 99% of the light, and twelve pixels at least."""
        radii, beyond = _rings(self)
        return max(12.0, 1.2 * float(radii[np.argmax(beyond[1:] <= 0.01)]))

    def wing_fall(self, radius_px: float) -> float:  # noqa: ARG002 - nothing is known of it
        """1: a table's far light need not fall at all."""
        return 1.0


@dataclass(frozen=True)
class SampledBand:
    """The band of a table.

    limit : frequency beyond which it is taken as empty [cycles/px]
    left_out : largest change of a pixel by that, over the source's light, as measured;
        left_out_bare : of light that no pixel has collected yet, per px^2
    nyquist : largest value at the highest frequencies that the samples hold: near 0 for a table
        that is fine enough
    largest, step : largest value in rings of width `step` beyond each frequency
    """

    limit: float
    left_out: float
    left_out_bare: float
    nyquist: float
    largest: Array
    step: float


@dataclass(frozen=True)
class SampleLattice:
    """A fine transform of the samples about sample (ny // 2, nx // 2), for reading in between.

    values : rows from row0 along fy, columns from -WIDTH along fx
    period : points of the whole transform along y and x
    """

    values: NDArray[np.complex128]
    row0: int
    period: tuple[int, int]


def sampled(
    samples: Array, spacing_px: float, centre: tuple[float, float] | str, light: float = 1.0
) -> Sampled:
    """A point-spread function from an image of it.

    samples : (ny, nx) light per area in any unit, >= 0; spacing_px : pixels between samples
    centre : (row, column) of the source, or `middle` (between the two middle samples of an even
        side), `sample` (n // 2, as FFTs put it), `peak`, or `centroid`
    light : share of the light that the table holds

    BadInput where the table holds NaN, negative values or nothing, or is too large.
    """
    table = np.array(samples, float)
    if table.ndim != 2 or min(table.shape) < 3 or max(table.shape) > LARGEST_SIDE:
        allowed = f"a table of 3 to {LARGEST_SIDE} rows and columns"
        raise BadInput(FIELD, f"a table of shape {table.shape}", allowed)
    if not np.isfinite(table).all():
        bad = int(table.size - np.isfinite(table).sum())
        raise BadInput(FIELD, f"a table with {bad} NaN or infinite samples", "finite samples")
    if table.min() < 0.0:
        bad = int((table < 0.0).sum())
        what = f"a table with {bad} negative samples, down to {table.min():.3g}"
        raise BadInput(FIELD, what, "light is never negative: take the background off, set to 0")
    total = float(table.sum())
    if not total > 0.0 or not np.isfinite(total):
        raise BadInput(FIELD, "a table of zeros", "a table with light in it")
    table /= total
    table.setflags(write=False)
    place = find_centre(table, centre) if isinstance(centre, str) else centre
    content = hashlib.sha256(table.tobytes())
    content.update(repr((table.shape, float(spacing_px), place, float(light))).encode())
    return Sampled(table, float(spacing_px), place, float(light), content.hexdigest())


def find_centre(table: Array, name: str) -> tuple[float, float]:
    """(row, column) of the source in a table by one of the rules of `sampled`."""
    ny, nx = table.shape
    if name == "middle":
        return 0.5 * (ny - 1), 0.5 * (nx - 1)
    if name == "sample":
        return float(ny // 2), float(nx // 2)
    if name == "peak":
        row, column = np.unravel_index(int(np.argmax(table)), table.shape)
        return float(row), float(column)
    if name == "centroid":
        rows, columns = table.sum(axis=1), table.sum(axis=0)
        total = float(rows.sum()) or 1.0
        row, column = np.sum(rows * np.arange(ny)), np.sum(columns * np.arange(nx))
        return float(row) / total, float(column) / total
    raise BadInput(f"{FIELD}.centre", name, "middle, sample, peak or centroid")


@lru_cache(maxsize=8)
def _rings(table: Sampled) -> tuple[Array, Array]:
    """Radii (n,) of the samples that hold light, and light beyond (n + 1,), 1 first, 0 last."""
    ny, nx = table.samples.shape
    y, x = np.arange(ny) - table.centre[0], np.arange(nx) - table.centre[1]
    r = np.hypot(y[:, None], x[None, :]).ravel() * table.spacing_px
    lit = table.samples.ravel() > 0.0
    r, value = r[lit], table.samples.ravel()[lit]
    order = np.argsort(r, kind="stable")
    beyond = np.concatenate([[0.0], np.cumsum(value[order][::-1])])[::-1]
    return r[order], beyond


@lru_cache(maxsize=8)
def _band(table: Sampled) -> SampledBand:
    """The smallest band beyond which no more than LEFT_OUT is lost, from a plain transform.

    Where that is finer than FINE_BAND more is lost, up to MOST_LEFT_OUT: sources of which it would
    show are the plan's matter.
    """
    ny, nx = (fast_size(2 * n, real=True) for n in table.samples.shape)
    spectrum = scipy.fft.rfft2(table.samples, s=(ny, nx))
    size = np.abs(spectrum)
    h = table.spacing_px
    fy, fx = scipy.fft.fftfreq(ny, h), scipy.fft.rfftfreq(nx, h)
    cell = 1.0 / (ny * nx * h * h)
    weight = np.where((fx > 0.0) & (fx < 0.5 / h), 2.0, 1.0) * cell
    # The pixel's own fall, without its zeros: rings may stand just on them.
    down, along = (1.0 / np.maximum(1.0, np.pi * np.abs(a)) for a in (fy, fx))
    pixel = down[:, None] * along[None, :]
    f = np.hypot(fy[:, None], fx[None, :])
    step = 1.0 / (max(ny, nx) * h)
    ring = np.minimum((f / step).astype(np.int64), int(0.5 * np.sqrt(2.0) / h / step)).ravel()
    lost = np.bincount(ring, weights=(size * pixel * weight[None, :]).ravel())
    lost = np.append(np.cumsum(lost[::-1])[::-1], 0.0)
    largest = np.zeros(lost.size - 1)
    np.maximum.at(largest, ring, size.ravel())
    largest = np.maximum.accumulate(largest[::-1])[::-1]
    fine = int(FINE_BAND / step)
    cut = int(np.argmax(lost <= LEFT_OUT))
    if cut > fine:
        cut = min(cut, max(fine, int(np.argmax(lost <= MOST_LEFT_OUT))))
    last = np.maximum(np.abs(fy)[:, None], fx[None, :]) > 0.45 / h
    nyquist = float(size[last].max())
    limit = min(max(cut, 1) * step, np.sqrt(0.5) / h)
    rest = np.where(f >= limit, spectrum, 0.0)
    square = np.sinc(fy)[:, None] * np.sinc(fx)[None, :]
    left, bare = (
        BETWEEN * float(np.abs(scipy.fft.irfft2(part, s=(ny, nx))).max()) / h**2
        for part in (rest * square, rest)
    )
    return SampledBand(limit, left, bare, nyquist, largest * table.light, step)


@lru_cache(maxsize=4)
def _spectrum(table: Sampled) -> SampleLattice:
    """Transform of the samples over the kernel's own transform, cropped to the band."""
    ny, nx = table.samples.shape
    period = tuple(fast_size(max(FINER * n, 4 * WIDTH), real=True) for n in (ny, nx))
    half_y = int(np.ceil(table.band.limit * period[0] * table.spacing_px)) + WIDTH
    half_x = int(np.ceil(table.band.limit * period[1] * table.spacing_px)) + WIDTH
    half_y, half_x = min(half_y, period[0] // 2 + WIDTH), min(half_x, period[1] // 2 + WIDTH)
    weighted = (
        table.samples
        * table.light
        / np.outer(
            _kernel_transform(np.arange(ny) - ny // 2, period[0]),
            _kernel_transform(np.arange(nx) - nx // 2, period[1]),
        )
    )
    grid = np.zeros(period)
    rows, columns = (np.arange(ny) - ny // 2) % period[0], (np.arange(nx) - nx // 2) % period[1]
    grid[np.ix_(rows, columns)] = weighted
    spectrum = scipy.fft.rfft2(grid)
    ky, kx = np.arange(-half_y, half_y + 1), np.arange(-WIDTH, half_x + 1)
    # Columns left of zero and right of the middle are conjugates of others, their rows turned.
    turned = (kx < 0) | (kx > period[1] // 2)
    column = np.where(turned, -kx, kx) % period[1]
    values = spectrum[np.ix_(ky % period[0], np.where(turned, 0, column))]
    values[:, turned] = np.conj(spectrum[np.ix_(-ky % period[0], column[turned])])
    return SampleLattice(values, -half_y, (period[0], period[1]))


def _kernel_transform(k: NDArray[np.int64], period: int) -> Array:
    """Transform of the reading kernel at sample k of a period, by Gauss-Legendre quadrature."""
    x, w = np.polynomial.legendre.leggauss(40)
    z = 0.5 * WIDTH * x
    kernel = np.exp(SHAPE * (np.sqrt(1.0 - x**2) - 1.0))
    turn = np.cos(2.0 * np.pi * np.outer(k / period, z))
    return 0.5 * WIDTH * (turn * (w * kernel)).sum(axis=1)


@njit(cache=True, nogil=True)
def _weights(z, out):
    """First point of the kernel around z, and its weights in `out`."""
    first = int(np.ceil(z - 0.5 * WIDTH))
    for i in range(WIDTH):
        x = (first + i - z) * 2.0 / WIDTH
        root = 1.0 - x * x
        out[i] = np.exp(SHAPE * (np.sqrt(root) - 1.0)) if root > 0.0 else 0.0
    return first


@njit(cache=True, nogil=True)
def _read(values, row0, step, shift, limits, fys, fxs):
    """Transform at each frequency, turned so that the source stands at 0."""
    limit, nyquist = limits
    out = np.zeros(fys.size, np.complex128)
    wy, wx = np.empty(WIDTH), np.empty(WIDTH)
    for k in range(fys.size):
        fy, fx = fys[k], fxs[k]
        if fy * fy + fx * fx >= limit * limit or max(abs(fy), abs(fx)) > nyquist:
            continue
        turned = fx < 0.0
        if turned:
            fy, fx = -fy, -fx
        iy = _weights(fy * step[0], wy) - row0
        ix = _weights(fx * step[1], wx) + WIDTH
        total = 0.0j
        for i in range(WIDTH):
            row = 0.0j
            for j in range(WIDTH):
                row += wx[j] * values[iy + i, ix + j]
            total += wy[i] * row
        turn = 2.0 * np.pi * (fy * shift[0] + fx * shift[1])
        total *= complex(np.cos(turn), np.sin(turn))
        out[k] = np.conj(total) if turned else total
    return out
