"""From sunlight on a target to photons at the aperture: phase angle, distances, rates."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pipeline.physics.constants import ASTRONOMICAL_UNIT_M
from pipeline.physics.vectors import separation

Array = NDArray[np.float64]


def phase_angle(target_m: Array, sun_m: Array, observer_m: Array) -> Array:
    """Angle Sun - target - observer [rad] in [0, pi] (n,), exact at both ends (atan2).

    All places (n, 3) or (3,) in one frame and from one origin; the target when the light left it.
    """
    target = np.asarray(target_m, float)
    return separation(np.asarray(sun_m, float) - target, np.asarray(observer_m, float) - target)


def sun_distance(target_m: Array, sun_m: Array) -> Array:
    """Distance from the target to the Sun's centre [m]: (n,)."""
    offset = np.asarray(sun_m, float) - np.asarray(target_m, float)
    return np.sqrt(np.sum(offset * offset, axis=-1))


def solar_distance_factor(sun_distance_m: ArrayLike) -> Array:
    """Irradiance at a distance over that at 1 au: (1 au / d)^2."""
    return np.square(ASTRONOMICAL_UNIT_M / np.asarray(sun_distance_m, float))


def photon_rate_at_aperture(
    irradiance_ph_s_m2_at_1au: ArrayLike,
    sun_distance_m: ArrayLike,
    sunlit_fraction: ArrayLike,
    g_times_albedo_over_pi_m2: ArrayLike,
    range_m: ArrayLike,
) -> Array:
    """In-band photons per second and square metre at the observer: E I/R^2.

    Parameters
    ----------
    irradiance_ph_s_m2_at_1au : in-band solar photon irradiance at 1 au.
    sun_distance_m, sunlit_fraction : (n,) of the target, see `sun_distance` and `eclipse`.
    g_times_albedo_over_pi_m2 : (n,) intensity per irradiance [m2/sr] of the body.
    range_m : (n,) target to observer, from emission to reception.
    """
    factor = solar_distance_factor(sun_distance_m) * np.asarray(sunlit_fraction, float)
    lit = np.asarray(irradiance_ph_s_m2_at_1au, float) * factor
    return lit * np.asarray(g_times_albedo_over_pi_m2, float) / np.square(range_m)
