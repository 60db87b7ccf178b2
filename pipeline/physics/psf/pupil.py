"""Transfer functions of the optics, the jitter and the pixel, as functions of frequency."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]


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

    @property
    def scale_px(self) -> float:
        return self.sigma_px


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

        From the slope of the transfer function at zero frequency (PHYSICS section e).
        """
        return 2.0 * self.q_px / (np.pi**2 * radius_px * (1.0 - self.obscuration))

    @property
    def scale_px(self) -> float:
        return self.q_px


Optics = Gaussian | Airy


@dataclass(frozen=True)
class Blur:
    """Everything that shapes a star before sampling: optics, jitter, charge diffusion, pixel.

    fill_factor : fraction of the pixel's area that collects light (a centred square); the light
    that falls beside it is lost, so the transfer function is `fill_factor` at zero frequency.
    """

    optics: Optics
    jitter_px: float = 0.0
    diffusion_px: float = 0.0
    fill_factor: float = 1.0

    def image(self, fy: Array, fx: Array) -> Array:
        """The light that falls on the focal plane: optics x jitter x diffusion, 1 at f = 0."""
        spread = float(np.hypot(self.jitter_px, self.diffusion_px))
        out = self.optics.transfer(fy, fx)
        return out if spread == 0 else out * Gaussian(spread).transfer(fy, fx)

    def pixel(self, fy: Array, fx: Array) -> Array:
        """The collecting square of a pixel: fill x sinc x sinc (PHYSICS section e)."""
        side = np.sqrt(self.fill_factor)
        return self.fill_factor * np.sinc(side * fy) * np.sinc(side * fx)

    def transfer(self, fy: Array, fx: Array) -> Array:
        """The whole response: image x pixel, at (fy, fx) [cycles/px]."""
        return self.image(fy, fx) * self.pixel(fy, fx)

    def band_limit(self, floor: float) -> float:
        """Frequency [cycles/px] beyond which the whole response is below `floor`."""
        spread = float(np.hypot(self.jitter_px, self.diffusion_px))
        own = self.optics.band_limit(floor)
        return own if spread == 0 else min(own, Gaussian(spread).band_limit(floor))

    def light_beyond(self, radius_px: float) -> float:
        """Fraction of the light that falls farther than `radius_px` (the pixel's own size apart).

        Gaussians add in quadrature; beside diffraction wings, whose slope a blur leaves alone, the
        blur's own tail is added, and `radius_px` must be large against the optics' scale.
        """
        spread = float(np.hypot(self.jitter_px, self.diffusion_px))
        if spread == 0:
            return min(1.0, self.optics.light_beyond(radius_px))
        if isinstance(self.optics, Gaussian):
            return Gaussian(float(np.hypot(self.optics.sigma_px, spread))).light_beyond(radius_px)
        tail = Gaussian(spread).light_beyond(radius_px)
        return min(1.0, self.optics.light_beyond(radius_px) + tail)

    @property
    def has_wings(self) -> bool:
        """True where the light falls off as a power of the radius, so that no stamp holds it."""
        return isinstance(self.optics, Airy)


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
