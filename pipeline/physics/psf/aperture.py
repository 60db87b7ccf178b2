"""Diffraction by an aperture with vanes and a wavefront: the autocorrelation of its pupil.

The pupil is sampled on a grid with the area of each cell that is open (edges are grey), its
autocorrelation taken by FFT. Only the difference to the plain annulus on the same grid is kept:
the annulus itself is exact (`Airy`), and what sampling does to its edges cancels.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import scipy
from numba import njit
from numpy.typing import NDArray

from pipeline.errors import BadInput
from pipeline.physics.psf.pupil import Airy, Transfer
from pipeline.physics.psf.radial import light_table, mean_over_directions
from pipeline.physics.psf.zernike import wavefront

Array = NDArray[np.float64]
Terms = tuple[tuple[int, float], ...]

CELLS = 512  # across the pupil
STEEPEST = 0.25  # waves per cell: beyond, the sampled wavefront is another one
LEAST_OPEN = 0.05  # of the annulus
FARTHEST_Q = 200.0  # light beyond is counted up to here: the field of the sampled pupil
LIGHT_NODES = 4096


@dataclass(frozen=True)
class SpiderVanes:
    """Straight vanes from the centre to the rim, at equal angles.

    width : over the aperture's diameter; angle_rad : of the first, from +x towards +y
    """

    count: int
    width: float
    angle_rad: float = 0.0


@dataclass(frozen=True)
class ApertureLattice:
    """What vanes and wavefront change in the transfer function of an annulus.

    values : (2 cells + 1, cells + 1) at shifts of whole cells, rows -cells ... cells, columns
        0 ... cells; real where the pattern is point-symmetric
    open_fraction : of the annulus that the vanes leave open
    edge : length of all edges over pi times the open area, in diameters: slope of the transfer
        function at zero, mean over directions
    gradient : steepest wavefront, waves per diameter
    """

    cells: int
    values: Transfer
    open_fraction: float
    edge: float
    gradient: float


@dataclass(frozen=True)
class Pupil:
    """Diffraction by a round aperture with a central obscuration, vanes and a wavefront.

    q_px : lambda F / (D pitch); obscuration : linear
    waves : (Noll index, rms over the unobscured disc [waves]); positive tilt Z2 moves the image
        to +x, Z3 to +y (rays go by + F grad W); pupil axes are those of the image
    """

    q_px: float
    obscuration: float = 0.0
    vanes: SpiderVanes | None = None
    waves: Terms = ()

    @property
    def _shape(self) -> ApertureLattice:
        return lattice(self.obscuration, self.vanes, self.waves)

    @property
    def _traits(self) -> ApertureLattice:
        return _traits(self.obscuration, self.vanes, self.waves)

    @property
    def annulus(self) -> Airy:
        """The same aperture without vanes and wavefront."""
        return Airy(self.q_px, self.obscuration)

    def radial(self, f: Array) -> Array:
        """The part of the transfer function that is exact and round: the annulus's."""
        return self.annulus.radial(f)

    def rest(self, fy: Array, fx: Array) -> Transfer:
        """The other part, from the lattice: cubic between whole cells."""
        fy, fx = np.broadcast_arrays(np.asarray(fy, float), np.asarray(fx, float))
        shape = self._shape
        step = self.q_px * shape.cells
        values = _between(shape.values, (fy * step).ravel(), (fx * step).ravel())
        return values.reshape(fy.shape)

    def transfer(self, fy: Array, fx: Array) -> Transfer:
        """Transfer function at (fy, fx) [cycles/px]; zero beyond the cut-off 1/q_px."""
        return self.annulus.transfer(fy, fx) + self.rest(fy, fx)

    def band_limit(self, floor: float) -> float:
        """The cut-off frequency 1/Q [cycles/px]."""
        return self.annulus.band_limit(floor)

    def light_beyond(self, radius_px: float) -> float:
        """Fraction of the light beyond a radius, from the transfer function; to a few percent.

        Far from the axis light comes from the edges alone: Q (edge length) / (2 pi^2 area r).
        """
        near = _light(self.obscuration, self.vanes, self.waves)
        if radius_px <= FARTHEST_Q * self.q_px:
            return near(radius_px / self.q_px)
        far = self.q_px * self._traits.edge / (2.0 * np.pi * radius_px)
        return min(near(FARTHEST_Q), far)

    @property
    def open_fraction(self) -> float:
        """Share of the annulus that the vanes leave open: times this the light gets through."""
        return self._traits.open_fraction

    @property
    def blur_px(self) -> float:
        """Radius of the image by rays: Q times the steepest wavefront."""
        return self.q_px * self._traits.gradient

    @property
    def scale_px(self) -> float:
        return self.q_px

    @property
    def has_wings(self) -> bool:
        return True

    @property
    def core_px(self) -> float:
        return self.annulus.core_px + 1.2 * self.blur_px

    def wing_fall(self, radius_px: float) -> float:
        """4 for rings; with vanes 1 where a spike is level (r < Q / width) and 2.5 beyond.

        (Measured: 7 to 8, 2.2 to 2.9 and 2.9 to 17; tests look again.)
        """
        if self.vanes is None:
            return 4.0
        return 1.0 if radius_px < self.q_px / self.vanes.width else 2.5


@lru_cache(maxsize=24)  # the wavelengths of a band are at most 20
def lattice(
    obscuration: float, vanes: SpiderVanes | None, waves: Terms, cells: int = CELLS
) -> ApertureLattice:
    """Sample the pupil, correlate it with itself, and subtract the plain annulus."""
    y, x = _places(cells)
    plain, of_plain = _annulus(obscuration, cells)
    field = plain if vanes is None else plain * (1.0 - _blocked(y, x, vanes, cells))
    area = float(field.sum()) / cells**2
    if area < LEAST_OPEN * float(plain.sum()) / cells**2:
        raise BadInput(
            "sensor.psf.vanes",
            f"{vanes.count} of {vanes.width:g} apertures wide" if vanes else "none",
            "vanes that leave 5% of the aperture open",
        )
    w = wavefront(waves, 2.0 * y, 2.0 * x)
    lit = field > 0.0
    steps = [np.abs(np.diff(w, axis=k))[lit.take(range(cells - 1), k)] for k in (0, 1)]
    steepest = float(max(s.max(initial=0.0) for s in steps))
    if steepest > STEEPEST:
        raise BadInput(
            "sensor.psf.aberrations",
            f"a wavefront of {steepest * cells:.0f} waves a diameter",
            f"at most {STEEPEST * cells:.0f}: weaker terms, or a table from a design program",
        )
    values = _correlate(field * np.exp(2j * np.pi * w) if waves else field, area)
    values -= of_plain
    values[cells, 0] = 0.0
    if np.abs(values.imag).max() < 1e-12:
        values = values.real
    values.setflags(write=False)
    edge = _edges(obscuration, vanes) / (np.pi * area)
    open_fraction = area * cells**2 / float(plain.sum())
    return ApertureLattice(cells, values, open_fraction, edge, steepest * cells)


@lru_cache(maxsize=256)
def _traits(obscuration: float, vanes: SpiderVanes | None, waves: Terms) -> ApertureLattice:
    """The lattice without its values, which are 8 MB each."""
    return replace(lattice(obscuration, vanes, waves), values=np.zeros((0, 0)))


def _places(cells: int) -> tuple[Array, Array]:
    """Middles of the cells (rows, 1) and (1, columns), in diameters."""
    at = (np.arange(cells) + 0.5) / cells - 0.5
    return at[:, None], at[None, :]


@lru_cache(maxsize=1)  # all wavelengths have it, and all places of a field
def _annulus(obscuration: float, cells: int) -> tuple[Array, Transfer]:
    """Share of each cell that the plain annulus leaves open, and that correlated with itself."""
    y, x = _places(cells)
    plain = _disc(y, x, 0.5, cells) - _disc(y, x, 0.5 * obscuration, cells)
    values = _correlate(plain, float(plain.sum()) / cells**2)
    for array in (plain, values):
        array.setflags(write=False)
    return plain, values


def _correlate(field: NDArray[np.complex128] | Array, area: float) -> Transfer:
    """Autocorrelation over the area at shifts of whole cells; (2 cells + 1, cells + 1)."""
    cells = field.shape[0]
    n = 2 * cells
    power = np.abs(scipy.fft.fft2(field, s=(n, n), overwrite_x=True)) ** 2
    shifted = scipy.fft.rfft2(power) / (float(n * n) * cells**2 * area)
    rows = np.arange(-cells, cells + 1) % n
    out = shifted[rows]
    out[0] = out[-1] = 0.0
    out[:, -1] = 0.0
    return out


@lru_cache(maxsize=256)
def _light(obscuration: float, vanes: SpiderVanes | None, waves: Terms) -> Callable[[float], float]:
    """Light beyond a radius in units of Q, up to FARTHEST_Q."""
    one = Pupil(1.0, obscuration, vanes, waves)
    f = np.linspace(0.0, 1.0, LIGHT_NODES)
    round_part = mean_over_directions(one.rest)(f)

    def mtf(at: Array) -> Array:
        return one.radial(at) + np.interp(at, f, round_part)

    return light_table(mtf, 1.0, 1.0, FARTHEST_Q)


def _edges(obscuration: float, vanes: SpiderVanes | None) -> float:
    """Length of all edges of the pupil, in diameters."""
    rims = np.pi * (1.0 + obscuration)
    return float(rims if vanes is None else rims + vanes.count * (1.0 - obscuration))


def _disc(y: Array, x: Array, radius: float, cells: int) -> Array:
    """Share of each cell inside a disc: its edge taken as straight within a cell."""
    r = np.hypot(y, x)
    if radius <= 0.0:
        return np.zeros(r.shape)
    return _covered(radius - r, x / r, y / r, cells)


def _blocked(y: Array, x: Array, vanes: SpiderVanes, cells: int) -> Array:
    """Share of each cell behind vanes."""
    clear = np.ones(np.broadcast_shapes(y.shape, x.shape))
    for k in range(vanes.count):
        angle = vanes.angle_rad + 2.0 * np.pi * k / vanes.count
        c, s = np.cos(angle), np.sin(angle)
        along, across = c * x + s * y, c * y - s * x
        strip = _covered(across + 0.5 * vanes.width, -s, c, cells) - _covered(
            across - 0.5 * vanes.width, -s, c, cells
        )
        clear *= 1.0 - strip * _covered(along, c, s, cells)
    return 1.0 - clear


def _covered(depth: Array, nx: Array | float, ny: Array | float, cells: int) -> Array:
    """Share of a square cell inside a half-plane; `depth` is how far its centre lies inside.

    The distances of a cell's points from a line with normal (nx, ny) are the sum of two uniform
    variates, of widths |nx| and |ny|; the share is their distribution function.
    """
    a = np.maximum(np.abs(nx), np.abs(ny))
    b = np.maximum(np.minimum(np.abs(nx), np.abs(ny)), 1e-6)
    t = depth * cells

    def ramp(u: Array) -> Array:
        return np.square(np.maximum(u, 0.0))

    p, m = 0.5 * (a + b), 0.5 * (a - b)
    share = (ramp(t + p) - ramp(t + m) - ramp(t - m) + ramp(t - p)) / (2.0 * a * b)
    return np.clip(share, 0.0, 1.0)


@njit(cache=True, nogil=True)
def _cubic(u):
    a, b, c = u + 1.0, u - 1.0, u - 2.0
    return -u * b * c / 6.0, a * b * c / 2.0, -a * u * c / 2.0, a * u * b / 6.0


@njit(cache=True, nogil=True)
def _between(values, ys, xs):
    """Cubic between lattice points; the other half plane by conjugation, 0 beyond the lattice."""
    cells = values.shape[1] - 1
    out = np.zeros(ys.size, values.dtype)
    for k in range(ys.size):
        y, x = ys[k], xs[k]
        if y * y + x * x >= float(cells * cells):
            continue
        turned = x < 0.0
        if turned:
            y, x = -y, -x
        iy, ix = int(np.floor(y)), int(np.floor(x))
        wy, wx = _cubic(y - iy), _cubic(x - ix)
        total = values[0, 0] * 0.0
        for i in range(4):
            row = iy - 1 + i
            if abs(row) > cells:
                continue
            for j in range(4):
                column = ix - 1 + j
                if column > cells:
                    continue
                if column < 0:
                    total += wy[i] * wx[j] * np.conj(values[cells - row, -column])
                else:
                    total += wy[i] * wx[j] * values[cells + row, column]
        out[k] = np.conj(total) if turned else total
    return out
