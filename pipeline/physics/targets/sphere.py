"""A grey Lambertian sphere: its area function of the phase angle in closed form."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

_PI_LOW = 1.2246467991473532e-16  # pi - float(pi)
# sin e - e cos e = sum over k >= 1 of (-1)^(k+1) 2k e^(2k+1)/(2k+1)!; ratio of successive terms
_RATIOS = tuple(-(k + 1) / k / ((2 * k + 2) * (2 * k + 3)) for k in range(1, 11))


def sphere_area_function(phase_rad: ArrayLike, diameter_m: ArrayLike) -> Array:
    """G [m2] = integral of max(0, n.s) max(0, n.o) over the sphere at a phase angle.

    G = (2/3) r^2 [sin a + (pi - a) cos a] (Lambert 1760; Russell 1916, ApJ 43, 173). With the
    defect e = pi - a the bracket is sin e - e cos e, summed as a power series below e = 1: every
    digit is kept down to the thinnest crescent (relative error below 1e-14, 0 <= a <= pi). Phases
    that rounding has put outside are moved to the ends; NaN stays NaN.
    """
    phase = np.clip(np.asarray(phase_rad, float), 0.0, np.pi)
    r = 0.5 * np.asarray(diameter_m, float)
    e = (np.pi - phase) + _PI_LOW
    small = np.minimum(e, 1.0)
    term = small**3 / 3.0
    series = term
    for ratio in _RATIOS:
        term = term * (ratio * small * small)
        series = series + term
    bracket = np.where(e < 1.0, series, np.sin(e) - e * np.cos(e))
    return (2.0 / 3.0) * r * r * bracket


def sphere_intensity_per_irradiance(
    phase_rad: ArrayLike, diameter_m: ArrayLike, albedo: ArrayLike
) -> Array:
    """Radiant intensity over irradiance [m2/sr]: (albedo/pi) G, albedo the diffuse reflectance."""
    return np.asarray(albedo, float) / np.pi * sphere_area_function(phase_rad, diameter_m)
