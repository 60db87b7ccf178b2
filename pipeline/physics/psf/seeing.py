"""Seeing: Moffat and Kolmogorov profiles, alone or after diffraction by the aperture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from pipeline.physics.psf.pupil import Airy
from pipeline.physics.psf.radial import Radial, intensity, look_up, radial_table

Array = NDArray[np.float64]

# (24 Gamma(6/5) / 5)^(5/6) = 3.44: half of the 6.88 of Fried 1966, JOSA 56, 1372.
KOLMOGOROV_EXPONENT = 3.441938591146906
KOLMOGOROV_FWHM = 0.97586343  # of the profile, over lambda / r0 (0.976 as published)


@dataclass(frozen=True)
class Moffat(Radial):
    """Moffat 1969 (A&A 3, 455): light per area ~ (1 + (r / alpha)^2)^-beta, beta > 1."""

    fwhm_px: float
    beta: float

    @property
    def alpha_px(self) -> float:
        return self.fwhm_px / (2.0 * float(np.sqrt(2.0 ** (1.0 / self.beta) - 1.0)))

    def radial(self, f: Array) -> Array:
        """2 (x/2)^(beta-1) K_(beta-1)(x) / Gamma(beta-1), x = 2 pi f alpha; 1 for x -> 0.

        (Hankel transform 6.565.4 of Gradshteyn and Ryzhik.) Falls as exp(-x).
        """
        order = self.beta - 1.0
        x = 2.0 * np.pi * self.alpha_px * np.asarray(f, float)
        with np.errstate(divide="ignore", invalid="ignore"):
            log = np.log(2.0) + order * np.log(0.5 * x) + np.log(scipy.special.kve(order, x)) - x
            value = np.exp(log - scipy.special.gammaln(order))
        return np.where(np.isfinite(value), np.minimum(value, 1.0), 1.0)

    def intensity(self, r_px: Array) -> Array:
        """Light per px^2 at a radius, per unit light."""
        a2 = self.alpha_px**2
        return (self.beta - 1.0) / (np.pi * a2) * (1.0 + np.square(r_px) / a2) ** -self.beta

    def light_beyond(self, radius_px: float) -> float:
        """(1 + (r / alpha)^2)^(1 - beta): exact."""
        return float((1.0 + (radius_px / self.alpha_px) ** 2) ** (1.0 - self.beta))

    @property
    def scale_px(self) -> float:
        return self.fwhm_px


@dataclass(frozen=True)
class Kolmogorov(Radial):
    """Long exposure through Kolmogorov turbulence: exp(-3.44 (lambda f / r0)^(5/3)).

    lambda_over_r0_px : wavelength over Fried's parameter, as an angle in pixels
    telescope : diffraction of the aperture, multiplied in (Fried 1966); None for the air alone
    """

    lambda_over_r0_px: float
    telescope: Airy | None = None

    def air(self, f: Array) -> Array:
        """The transfer function of the air alone."""
        return np.exp(-KOLMOGOROV_EXPONENT * (self.lambda_over_r0_px * f) ** (5.0 / 3.0))

    def radial(self, f: Array) -> Array:
        f = np.asarray(f, float)
        return self.air(f) if self.telescope is None else self.air(f) * self.telescope.radial(f)

    def intensity(self, r_px: Array) -> Array:
        """Light per px^2 at a radius, per unit light, by quadrature."""
        top, values = radial_table(self)
        return intensity(lambda f: look_up(f, top, values), top, r_px)

    @property
    def fwhm_px(self) -> float:
        """Full width at half maximum of the air alone: 0.976 lambda / r0."""
        return KOLMOGOROV_FWHM * self.lambda_over_r0_px

    @property
    def scale_px(self) -> float:
        return self.fwhm_px if self.telescope is None else max(self.fwhm_px, self.telescope.q_px)

    @property
    def core_px(self) -> float:
        """That of the seeing, or of the diffraction rings where these are what is sharp."""
        own = 4.0 * max(self.fwhm_px, 1.5)
        return own if self.telescope is None else max(own, self.telescope.core_px)


def r0_m(fwhm_rad: float, wavelength_m: float) -> float:
    """Fried's parameter of a seeing (FWHM of the long exposure) at a wavelength."""
    return KOLMOGOROV_FWHM * wavelength_m / fwhm_rad


def r0_at(r0_reference_m: float, reference_m: float, wavelength_m: float) -> float:
    """Fried's parameter at another wavelength: it grows with lambda^(6/5)."""
    return r0_reference_m * (wavelength_m / reference_m) ** 1.2
