"""Transfer functions of the optics, the jitter and the pixel, as functions of frequency."""

from __future__ import annotations

from dataclasses import Field, dataclass
from typing import ClassVar, Protocol

import numpy as np
import scipy
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Transfer = NDArray[np.float64] | NDArray[np.complex128]

SPLITS = np.linspace(0.04, 0.96, 24)  # how a radius may be shared between two blurs
FAR_SIGMA = 7.0  # a Gaussian holds all but 2e-11 of its light within it


class Optics(Protocol):
    """What every point-spread function answers. Frozen and hashable: it is a key of caches.

    Frequencies in cycles per pixel, lengths in pixels, y along rows and x along columns.
    """

    __dataclass_fields__: ClassVar[dict[str, Field[object]]]

    def transfer(self, fy: Array, fx: Array) -> Transfer:
        """Fourier transform of the light, 1 at zero; real where the light is point-symmetric."""
        ...

    def band_limit(self, floor: float) -> float:
        """Frequency [cycles/px] beyond which the transfer function is below `floor`."""
        ...

    def light_beyond(self, radius_px: float) -> float:
        """Fraction of all light (to infinity) that falls farther than `radius_px`."""
        ...

    @property
    def scale_px(self) -> float:
        """Its size: sigma of a Gaussian, Q of a diffraction pattern, the FWHM of seeing."""
        ...

    @property
    def has_wings(self) -> bool:
        """True where no stamp of reasonable size holds all but 1e-8 of the light."""
        ...

    @property
    def core_px(self) -> float:
        """Radius from which on the rest of the light is smooth enough for a coarse grid."""
        ...

    def wing_fall(self, radius_px: float) -> float:
        """Least factor by which the coarse grid's error falls when a core's radius doubles."""
        ...


@dataclass(frozen=True)
class Gaussian:
    """A Gaussian blur of `sigma_px` pixels on each axis."""

    sigma_px: float

    def transfer(self, fy: Array, fx: Array) -> Array:
        """exp(-2 pi^2 sigma^2 f^2); fy, fx in cycles per pixel, any shapes that broadcast."""
        return np.exp(-2.0 * (np.pi * self.sigma_px) ** 2 * (fy**2 + fx**2))

    def band_limit(self, floor: float) -> float:
        """Frequency [cycles/px] beyond which the transfer function is below `floor`."""
        return float(np.sqrt(-np.log(floor) / 2.0) / (np.pi * self.sigma_px))

    def light_beyond(self, radius_px: float) -> float:
        """Fraction of the light farther than `radius_px` from the centre."""
        return float(np.exp(-0.5 * (radius_px / self.sigma_px) ** 2))

    def intensity(self, r_px: Array) -> Array:
        """Light per px^2 at a radius, per unit light."""
        s2 = self.sigma_px**2
        return np.exp(-0.5 * np.square(r_px) / s2) / (2.0 * np.pi * s2)

    @property
    def scale_px(self) -> float:
        return self.sigma_px

    @property
    def has_wings(self) -> bool:
        return False

    @property
    def core_px(self) -> float:
        return 6.1 * self.sigma_px

    def wing_fall(self, radius_px: float) -> float:  # noqa: ARG002 - it has no wings
        return 4.0


@dataclass(frozen=True)
class EllipticalGaussian:
    """A Gaussian blur with standard deviations [px] along two axes.

    angle_rad : of the major axis, from +x (columns) towards +y (rows)
    """

    sigma_major_px: float
    sigma_minor_px: float
    angle_rad: float = 0.0

    def transfer(self, fy: Array, fx: Array) -> Array:
        """exp(-2 pi^2 (a^2 u^2 + b^2 v^2)), u and v the frequencies along the two axes."""
        c, s = np.cos(self.angle_rad), np.sin(self.angle_rad)
        u, v = self.sigma_major_px * (c * fx + s * fy), self.sigma_minor_px * (c * fy - s * fx)
        return np.exp(-2.0 * np.pi**2 * (u**2 + v**2))

    def band_limit(self, floor: float) -> float:
        """That of the narrower axis."""
        return Gaussian(self.sigma_minor_px).band_limit(floor)

    def light_beyond(self, radius_px: float) -> float:
        """Upper bound: that of a round Gaussian as wide as the major axis."""
        return Gaussian(self.sigma_major_px).light_beyond(radius_px)

    @property
    def scale_px(self) -> float:
        return self.sigma_major_px

    @property
    def has_wings(self) -> bool:
        return False

    @property
    def core_px(self) -> float:
        return 6.1 * self.sigma_major_px

    def wing_fall(self, radius_px: float) -> float:  # noqa: ARG002 - it has no wings
        return 4.0


@dataclass(frozen=True)
class Airy:
    """Diffraction by a circular aperture with a central obscuration, one wavelength.

    q_px : lambda F / pitch, the diffraction scale in pixels; obscuration : linear, 0 to < 1.
    """

    q_px: float
    obscuration: float = 0.0

    def transfer(self, fy: Array, fx: Array) -> Array:
        """Autocorrelation of the annular pupil (O'Neill 1956, JOSA 46, 285), by circle overlaps.

        fy, fx in cycles per pixel; zero beyond the cut-off 1/q_px.
        """
        fy, fx = np.broadcast_arrays(np.asarray(fy, float), np.asarray(fx, float))
        distance = 2.0 * self.q_px * np.hypot(fy, fx)
        return _annulus_overlap(distance.ravel(), self.obscuration).reshape(distance.shape)

    def band_limit(self, floor: float) -> float:  # noqa: ARG002 - the cut-off is sharp
        """The cut-off frequency 1/Q [cycles/px]."""
        return 1.0 / self.q_px

    def light_beyond(self, radius_px: float) -> float:
        """Fraction of the light farther than `radius_px`: 2Q / (pi^2 r (1 - e)), for r >> Q.

        From the slope of the transfer function at zero frequency.
        """
        return 2.0 * self.q_px / (np.pi**2 * radius_px * (1.0 - self.obscuration))

    def radial(self, f: Array) -> Array:
        """The transfer function along a radius; f (n,) cycles per pixel."""
        return _annulus_overlap(2.0 * self.q_px * np.asarray(f, float), self.obscuration)

    def intensity(self, r_px: Array) -> Array:
        """Light per px^2 at a radius, per unit light: that of an annulus."""
        e = self.obscuration
        x = np.pi * np.maximum(r_px, 1e-9 * self.q_px) / self.q_px
        inner = e * scipy.special.j1(e * x) if e > 0.0 else 0.0
        amplitude = 2.0 * (scipy.special.j1(x) - inner) / x
        return np.pi / (4.0 * self.q_px**2 * (1.0 - e * e)) * amplitude**2

    @property
    def scale_px(self) -> float:
        return self.q_px

    @property
    def has_wings(self) -> bool:
        return True

    @property
    def core_px(self) -> float:
        """Where the wings of different optics are alike against their peak (measured)."""
        return 12.0 * max(self.q_px, min(1.0, self.q_px) ** (1.0 / 3.0), 0.5)

    def wing_fall(self, radius_px: float) -> float:  # noqa: ARG002 - the same at all radii
        """4: measured 5 to 8 (tests/physics/drawing), as the pattern falls with r^-3."""
        return 4.0


RANGE_TERMS, RANGE_FLOOR = 8, 1e-9  # of the sum over whole frequencies; its last terms


@dataclass(frozen=True)
class Blur:
    """Everything that shapes a star before sampling: optics, jitter, charge diffusion, pixel.

    fill_factor : fraction of the pixel's area that collects light (a centred square); the light
    that falls beside it is lost, so the transfer function is `fill_factor` at zero frequency.
    pixel_in_optics : the optics (a measured table) hold the pixel's collecting square already
    clock_px : length along y of the steps in which charge follows a moving image (TDI)
    """

    optics: Optics
    jitter_px: float = 0.0
    diffusion_px: float = 0.0
    fill_factor: float = 1.0
    pixel_in_optics: bool = False
    clock_px: float = 0.0

    def image(self, fy: Array, fx: Array) -> Transfer:
        """The light that falls on the focal plane: optics x jitter x diffusion, 1 at f = 0."""
        spread = float(np.hypot(self.jitter_px, self.diffusion_px))
        out = self.optics.transfer(fy, fx)
        return out if spread == 0 else out * Gaussian(spread).transfer(fy, fx)

    def pixel(self, fy: Array, fx: Array) -> Array:
        """The collecting square of a pixel: fill x sinc x sinc."""
        if self.pixel_in_optics:
            out = np.full(np.broadcast_shapes(np.shape(fy), np.shape(fx)), self.fill_factor)
        else:
            side = np.sqrt(self.fill_factor)
            out = self.fill_factor * np.sinc(side * fy) * np.sinc(side * fx)
        return out * np.sinc(self.clock_px * fy) if self.clock_px else out

    def transfer(self, fy: Array, fx: Array) -> Transfer:
        """The whole response: image x pixel, at (fy, fx) [cycles/px]."""
        return self.image(fy, fx) * self.pixel(fy, fx)

    def collected_range(self) -> tuple[float, float]:
        """Least and most of a source's light that all pixels collect, wherever it stands in one.

        The sum over pixels of a response T at a place p is sum_k T(k) exp(2 pi i k p) over whole
        frequencies k (Poisson's sum), so it is within sum_{k != 0} |T(k)| of the fill factor T(0).
        Of pixels without gaps T(k) is 0. (0, 1) where the sum does not end within RANGE_TERMS.
        """
        fill = self.fill_factor
        if fill == 1.0:
            return 1.0, 1.0
        k = np.arange(-RANGE_TERMS, RANGE_TERMS + 1, dtype=np.float64)
        terms = np.abs(self.transfer(k[:, None], k[None, :]))
        edge = np.concatenate([terms[0], terms[-1], terms[:, 0], terms[:, -1]])
        if edge.max() > RANGE_FLOOR:
            return 0.0, 1.0
        spread = float(terms.sum()) - float(terms[RANGE_TERMS, RANGE_TERMS])
        return max(0.0, fill - spread), min(1.0, fill + spread)

    def band_limit(self, floor: float) -> float:
        """Frequency [cycles/px] beyond which the whole response is below `floor`."""
        spread = float(np.hypot(self.jitter_px, self.diffusion_px))
        own = self.optics.band_limit(floor)
        return own if spread == 0 else min(own, Gaussian(spread).band_limit(floor))

    def light_beyond(self, radius_px: float) -> float:
        """Fraction of the light that falls farther than `radius_px` (the pixel's own size apart).

        Gaussians add in quadrature; beside diffraction wings, whose slope a blur leaves alone, the
        blur's own tail is added, and `radius_px` must be large against the optics' scale. Of other
        optics it is the upper bound `beyond_sum`.
        """
        spread = float(np.hypot(self.jitter_px, self.diffusion_px))
        if spread == 0:
            return min(1.0, self.optics.light_beyond(radius_px))
        if isinstance(self.optics, Gaussian):
            return Gaussian(float(np.hypot(self.optics.sigma_px, spread))).light_beyond(radius_px)
        if isinstance(self.optics, Airy):
            tail = Gaussian(spread).light_beyond(radius_px)
            return min(1.0, self.optics.light_beyond(radius_px) + tail)
        return beyond_sum(self.optics, Gaussian(spread), radius_px)

    @property
    def has_wings(self) -> bool:
        """True where the light falls off as a power of the radius, so that no stamp holds it."""
        return self.optics.has_wings

    @property
    def core_px(self) -> float:
        """Radius of the smallest core worth drawing: the optics' own, widened by the blur."""
        return self.optics.core_px + 4.0 * float(np.hypot(self.jitter_px, self.diffusion_px))


def beyond_sum(one: Optics, other: Gaussian, radius_px: float) -> float:
    """Upper bound of the light beyond a radius after two blurs in turn.

    A photon lands beyond r only if the first threw it beyond r - d or the second beyond d; the
    best d of some is taken. At large radii it is the first one's own light beyond r - 7 sigma.
    """
    shares = radius_px * SPLITS
    near = FAR_SIGMA * other.sigma_px
    if near < radius_px:
        shares = np.append(shares, near)
    sums = [one.light_beyond(radius_px - d) + other.light_beyond(d) for d in shares]
    return float(min(1.0, *sums))


@njit(cache=True, nogil=True)
def _annulus_overlap(distance, e):
    """Common area of two annuli (radii e and 1) whose centres are `distance` apart, over theirs."""
    out = np.empty(distance.size)
    for i in range(distance.size):
        d = distance[i]
        if d >= 2.0:
            out[i] = 0.0
            continue
        overlap = _lens(d, 1.0, 1.0)
        if e > 0.0:
            overlap += _lens(d, e, e) - 2.0 * _lens(d, 1.0, e)
        out[i] = overlap / (np.pi * (1.0 - e * e))
    return out


@njit(cache=True, nogil=True)
def _lens(d, r1, r2):
    """Area common to two circles of radii r1 >= r2 whose centres are `d` apart."""
    if d >= r1 + r2:
        return 0.0
    if d <= r1 - r2:
        return np.pi * r2 * r2
    a1 = min(1.0, max(-1.0, (d * d + r1 * r1 - r2 * r2) / (2.0 * d * r1)))
    a2 = min(1.0, max(-1.0, (d * d + r2 * r2 - r1 * r1) / (2.0 * d * r2)))
    kite = max(0.0, (r1 + r2 - d) * (d + r1 - r2) * (d - r1 + r2) * (d + r1 + r2))
    return r1 * r1 * np.arccos(a1) + r2 * r2 * np.arccos(a2) - 0.5 * np.sqrt(kite)
