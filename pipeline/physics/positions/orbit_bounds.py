"""Bounds of orbits from their mean elements alone: how near they come, how far north they go."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.physics.constants import EARTH_EQUATORIAL_RADIUS_M

Array = NDArray[np.float64]

GM72_KM3_S2, RADIUS72_KM = 398_600.8, 6378.135  # of SGP4 (WGS 72)
_PERIODIC_M = (
    60e3  # of the radius: twice J2's short and J3's long terms (40 km at most, low orbits)
)
_DRAG_SHARE_DAY = 0.004  # of a semi-major axis lost a day; more has decayed within days
_LATITUDE_ROOM_RAD = 0.01  # J2's short terms of the inclination, the pole's precession
_DEEP_REV_DAY = 6.4  # below, Sun and Moon turn the orbit: what its elements bound is little


def semi_major_axis_m(mean_motion_rad_min: Array) -> Array:
    """Semi-major axes (n,) [m] of Kozai mean motions [rad/min] (WGS 72): within 0.1 %."""
    return np.cbrt(GM72_KM3_S2 / (np.asarray(mean_motion_rad_min) / 60.0) ** 2) * 1e3


def radius_bounds_m(
    mean_motion_rad_min: Array, eccentricity: Array, days: Array
) -> tuple[Array, Array]:
    """Least and largest geocentric distance (n,) [m] within so many days of the elements' epoch.

    Perigee and apogee of the mean elements, with room for SGP4's periodic terms and drag (which
    only lowers both); of deep-space orbits, whose eccentricity Sun and Moon change (Hujsak 1979,
    SpaceTrack Report 1), the perigee may be the ground and the apogee twice the semi-major axis.
    """
    a, e = semi_major_axis_m(mean_motion_rad_min), np.asarray(eccentricity, float)
    deep = mean_motion_rad_min * 1440.0 / (2.0 * np.pi) < _DEEP_REV_DAY
    swing = np.where(deep, 0.002 + 0.0005 * np.abs(days), 0.002)  # of the eccentricity
    room = _PERIODIC_M + 0.002 * a
    low = a * (1.0 - np.minimum(1.0, e + swing)) - room
    low = low - np.where(deep, 0.0, _DRAG_SHARE_DAY * np.abs(days) * a)
    high = a * (1.0 + np.minimum(1.0, e + swing)) + room
    return np.maximum(low, EARTH_EQUATORIAL_RADIUS_M - 30e3), high


def latitude_bound_rad(inclination_rad: Array, mean_motion_rad_min: Array, days: Array) -> Array:
    """Largest geocentric latitude (n,) [rad] within so many days of the elements' epoch."""
    deep = mean_motion_rad_min * 1440.0 / (2.0 * np.pi) < _DEEP_REV_DAY
    reach = np.minimum(inclination_rad, np.pi - inclination_rad) + _LATITUDE_ROOM_RAD
    return np.minimum(reach + np.where(deep, 1e-4 * np.abs(days), 0.0), 0.5 * np.pi)


def never_rises(
    latitude_rad: float, height_m: float, lowest_rad: float, largest_m: Array, latitude: Array
) -> NDArray[np.bool_]:
    """Which orbits (n,) a site never has above an elevation, whatever the time.

    latitude_rad, height_m : of the site, geodetic; lowest_rad : elevation, without refraction
    largest_m, latitude : (n,) from `radius_bounds_m`, `latitude_bound_rad`

    At distance r from the Earth's centre an object above the elevation h is within
    acos((R/r) cos h) - h of the site (Vallado 2013, section 11.2), R the least radius that the
    ellipsoid has; 0.2 degrees are added for vertical against radius.
    """
    radius = EARTH_EQUATORIAL_RADIUS_M - 21_500.0 + min(height_m, 0.0)
    low = lowest_rad - 0.0035
    ratio = np.minimum(1.0, radius * np.cos(low) / np.maximum(largest_m, radius))
    cap = np.arccos(ratio) - low + 0.0035
    return abs(latitude_rad) > latitude + cap


def least_range_m(observer_low_m: float, observer_high_m: float, low_m: Array, high_m: Array):
    """Least distance (n,) [m] between an observer and objects, each within a shell about the
    Earth's centre: 0 where the shells meet."""
    return np.maximum(0.0, np.maximum(low_m - observer_high_m, observer_low_m - high_m))
