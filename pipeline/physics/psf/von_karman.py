"""Seeing with a finite outer scale of turbulence: von Karman's spectrum."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import scipy
from numpy.typing import NDArray

from pipeline.physics.psf.seeing import KOLMOGOROV_FWHM, Kolmogorov

Array = NDArray[np.float64]

ORDER = 5.0 / 6.0
# Half of the structure function is SATURATES (L0 / r0)^(5/3) far beyond the outer scale:
# Gamma(11/6) Gamma(5/6) / (2 pi^(8/3)) times KOLMOGOROV_EXPONENT.
SATURATES = 0.08631432991183462
SERIES_UP_TO, TERMS = 1.0, 9  # of the argument: the terms left out are below 1e-15 there
LARGEST = 700.0  # argument beyond which K is 0 in double precision
LEAST_OUTER_R0 = 20.0  # outer scale over Fried's parameter: Tokovinin's width holds from there on
LEAST_ALONE_R0 = 35.0  # and without diffraction: 1e-14 of the light would not be spread at all


@dataclass(frozen=True)
class VonKarman(Kolmogorov):
    """Long exposure through turbulence that is no larger than an outer scale.

    The structure function of the phase at a distance rho on the pupil (Tokovinin 2002, PASP 114,
    1156), x = 2 pi rho / L0, K the modified Bessel function of order 5/6::

        D = 0.1717 (L0 / r0)^(5/3) (2^(-1/6) Gamma(5/6) - x^(5/6) K(x))

    It goes over into Kolmogorov's 6.88 (rho / r0)^(5/3) for rho << L0, slowly: it is less than
    that by 1.5 (rho / L0)^(1/3) of itself. Beyond L0 it levels out. Exact to rounding.

    outer_scale_r0 : outer scale L0 over Fried's parameter r0 at this wavelength, dimensionless;
        from LEAST_OUTER_R0 on, or LEAST_ALONE_R0 without a telescope
    """

    outer_scale_r0: float = field(kw_only=True)

    def air(self, f: Array) -> Array:
        """exp(-D / 2), the transfer function of the air alone, at f >= 0 [cycles/px]."""
        x = 2.0 * np.pi * self.lambda_over_r0_px * np.asarray(f, float) / self.outer_scale_r0
        return np.exp(-SATURATES * self.outer_scale_r0 ** (5.0 / 3.0) * levelled(x))

    @property
    def fwhm_px(self) -> float:
        """Full width at half maximum of the air alone (Tokovinin 2002, eq. 19), within 1.2%."""
        narrower = np.sqrt(1.0 - 2.183 * self.outer_scale_r0**-0.356)
        return float(KOLMOGOROV_FWHM * self.lambda_over_r0_px * narrower)


def levelled(x: Array) -> Array:
    """1 - 2^(1/6) x^(5/6) K(x) / Gamma(5/6) at x (n,) >= 0: from 0 to 1, K of order 5/6.

    Up to x = 1 by the series of K (DLMF 10.27.4 and 10.25.2) without its first term, which is the
    1 that it would be taken from: the relative error stays below 1e-13.
    """
    x = np.asarray(x, float)
    q = np.square(np.minimum(x, SERIES_UP_TO)) / 4.0
    falling, rising = np.zeros_like(q), np.ones_like(q)
    a = b = np.ones_like(q)
    for k in range(1, TERMS):
        a, b = a * q / (k * (k - ORDER)), b * q / (k * (k + ORDER))
        falling, rising = falling + a, rising + b
    gamma = scipy.special.gamma
    near = gamma(1.0 - ORDER) / gamma(1.0 + ORDER) * q**ORDER * rising - falling
    big = np.clip(x, SERIES_UP_TO, LARGEST)
    bessel = scipy.special.kv(ORDER, big)
    far = 1.0 - 2.0 ** (1.0 - ORDER) / gamma(ORDER) * big**ORDER * bessel
    return np.where(x < SERIES_UP_TO, near, far)
