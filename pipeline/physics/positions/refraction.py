"""Refraction by the air above a site: true directions to observed ones, and back."""

from __future__ import annotations

import erfa.ufunc as era
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LOWEST_SINE = 0.05  # of the elevation; below it the law goes on as it is there (ERFA's limit)
_ROUNDS = 60


def refraction_terms(
    pressure_hpa: float, temperature_c: float, humidity: float, wavelength_m: float
) -> tuple[float, float]:
    """A and B [rad] of dz = A tan z + B tan^3 z, z the observed zenith distance (ERFA refco).

    Against ray tracing, for any weather: 0.06 arcsec at worst down to 15 degrees of elevation;
    0.6 arcsec at 10 degrees; below that it is only indicative (ERFA's own notes).
    """
    a, b = era.refco(pressure_hpa, temperature_c, humidity, wavelength_m * 1e6)
    return float(a), float(b)


def standard_air(height_m: float) -> tuple[float, float]:
    """Pressure [hPa] and temperature [C] of the standard atmosphere up to 11 km (ISO 2533:1975).

    Above, the pressure falls with the scale height of 6.34 km of its isothermal layer.
    """
    low = min(height_m, 11_000.0)
    kelvin = 288.15 - 6.5e-3 * low
    pressure = 1013.25 * (kelvin / 288.15) ** 5.25588
    if height_m > low:
        pressure *= float(np.exp((low - height_m) / 6341.6))
    return pressure, kelvin - 273.15


def refract(u: Array, air: Array | None) -> Array:
    """Observed directions (..., 3) of true ones (..., 3), the latter with aberration.

    The bending of ERFA atioq, dz = A tan z + B tan^3 z with one Newton step from the true zenith
    distance, as an exact turn.

    air : (..., 5) unit vector towards the zenith, A, B [rad]; None where nothing bends
    """
    if air is None:
        return u
    zenith, sine, level = _split(u, air)
    bend, r = _bend(sine, level, air)
    over = np.divide(np.sin(bend), r, out=np.zeros_like(r), where=r > 0.0)
    scale = np.cos(bend) - sine * over
    lifted = sine * np.cos(bend) + level * np.sin(bend)
    return (u - sine[..., None] * zenith) * scale[..., None] + lifted[..., None] * zenith


def unrefract(u: Array, air: Array | None) -> Array:
    """True directions (..., 3) of observed ones: the inverse of `refract`, to rounding."""
    if air is None:
        return u
    zenith, sine, level = _split(u, air)
    bend = np.zeros_like(sine)
    for _ in range(_ROUNDS):
        before = bend
        s = sine * np.cos(bend) - level * np.sin(bend)
        r = level * np.cos(bend) + sine * np.sin(bend)
        bend, _ = _bend(s, r, air)
        if np.all(np.abs(bend - before) <= 1e-17):
            break
    over = np.divide(np.sin(bend), level, out=np.zeros_like(level), where=level > 0.0)
    scale = np.cos(bend) + sine * over
    low = sine * np.cos(bend) - level * np.sin(bend)
    return (u - sine[..., None] * zenith) * scale[..., None] + low[..., None] * zenith


def squeeze(lowest_sine: Array, air: Array) -> Array:
    """Upper bound (...) of true over observed distances between directions above an elevation."""
    sine = np.maximum(lowest_sine, LOWEST_SINE)
    return 1.0 + 1.05 * np.abs(air[..., 3]) / sine**2


def _split(u: Array, air: Array) -> tuple[Array, Array, Array]:
    """Zenith, sine of the elevation, its cosine."""
    zenith = air[..., :3]
    sine = u[..., 0] * zenith[..., 0] + u[..., 1] * zenith[..., 1] + u[..., 2] * zenith[..., 2]
    across = u - sine[..., None] * zenith
    level = np.sqrt(across[..., 0] ** 2 + across[..., 1] ** 2 + across[..., 2] ** 2)
    return zenith, sine, level


def _bend(sine: Array, level: Array, air: Array) -> tuple[Array, Array]:
    """The angle by which a true direction is lifted, and the cosine of its elevation."""
    z = np.maximum(sine, LOWEST_SINE)
    tangent = level / z
    cubic = air[..., 4] * tangent**2
    return (air[..., 3] + cubic) * tangent / (1.0 + (air[..., 3] + 3.0 * cubic) / z**2), level
