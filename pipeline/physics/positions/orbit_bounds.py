"""Bounds of orbits from their mean elements alone: how near, how far north, down since when."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pipeline.physics.constants import EARTH_EQUATORIAL_RADIUS_M

if TYPE_CHECKING:
    from sgp4.api import Satrec

Array = NDArray[np.float64]

GM72_KM3_S2, RADIUS72_KM = 398_600.8, 6378.135  # of SGP4 (WGS 72)
_J2_72, _XKE72 = 0.001082616, 60.0 * (GM72_KM3_S2 / RADIUS72_KM**3) ** 0.5
_DEEP_MIN, _SIMPLE_KM = 225.0, 220.0  # period, perigee: longer or lower orbits have C1 alone
DECAYED = 6  # SGP4's code of a satellite that has come down
_PERIODIC_M = (
    60e3  # of the radius: twice J2's short and J3's long terms (40 km at most, low orbits)
)
_LATITUDE_ROOM_RAD = 0.01  # J2's short terms of the inclination, the pole's precession
_SLIGHT = 1.01  # growth of an axis by drag backwards, beyond which an apogee is twice the axis
_GEO_M = 42.2e6  # from which on Sun and Moon turn the orbit much more
_DEEP_REV_DAY = 6.4  # below, Sun and Moon turn the orbit: what its elements bound is little


def semi_major_axis_m(mean_motion_rad_min: Array) -> Array:
    """Semi-major axes (n,) [m] of Kozai mean motions [rad/min] (WGS 72): within 0.1 %."""
    return np.cbrt(GM72_KM3_S2 / (np.asarray(mean_motion_rad_min) / 60.0) ** 2) * 1e3


def radius_bounds_m(
    mean_motion_rad_min: Array,
    eccentricity: Array,
    inclination_rad: Array,
    bstar: Array,
    days: Array,
) -> tuple[Array, Array]:
    """Least and largest geocentric distance (n,) [m] within so many days of the elements' epoch.

    Perigee and apogee of the mean elements, with room for SGP4's periodic terms; its drag lowers
    both after the epoch, and has lowered the apogee from what it was before. Of deep-space orbits,
    whose eccentricity Sun and Moon change (Hujsak 1979, SpaceTrack Report 1), the perigee may be
    the ground and the apogee twice the semi-major axis.
    """
    e = np.asarray(eccentricity, float)
    axis = brouwer_axis(mean_motion_rad_min, e, inclination_rad)
    a = axis * RADIUS72_KM * 1e3
    deep = mean_motion_rad_min * 1440.0 / (2.0 * np.pi) < _DEEP_REV_DAY
    swing = np.where(deep, 0.002 + 0.0005 * np.abs(days), 0.002)  # of the eccentricity
    swing *= np.maximum(1.0, a / _GEO_M) ** 2
    room = _PERIODIC_M + 0.002 * a
    terms = drag_terms(bstar, e, inclination_rad, axis)
    f = shrinking(terms, np.stack([days, -days], axis=1) * 1440.0)
    least, t = np.maximum(f.min(axis=1), 0.0) ** 2, 1440.0 * np.abs(days)
    most = (1.0 + t * (np.abs(terms[0]) + np.abs(terms[2]) * t**2)) ** 2  # what f grows by, alone
    low = a * least * (1.0 - np.minimum(1.0, e + swing)) - room
    slight = 1.0 + np.minimum(1.0, e + swing) + 4.0 * (most - 1.0)  # twice that of one perigee
    high = a * np.where(most < _SLIGHT, slight, 2.0 * most) + room
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


def brouwer_axis(mean_motion_rad_min: Array, eccentricity: Array, inclination_rad: Array) -> Array:
    """Semi-major axes (n,) [Earth radii] of Brouwer's mean motion, for Kozai's that elements give
    (Hoots & Roehrich 1980, section 6)."""
    first = (_XKE72 / np.asarray(mean_motion_rad_min)) ** (2.0 / 3.0)
    flat = (
        0.75 * _J2_72 * (3.0 * np.cos(inclination_rad) ** 2 - 1.0) / (1.0 - eccentricity**2) ** 1.5
    )
    d = flat / first**2
    d = flat / (first * (1.0 - d / 3.0 - d**2 - 134.0 / 81.0 * d**3)) ** 2
    return first * (1.0 + d) ** (2.0 / 3.0)


def drag_terms(bstar: Array, eccentricity: Array, inclination_rad: Array, axis: Array) -> Array:
    """C1, D2, D3, D4 (4, n) [1/min, 1/min^2, ...] of SGP4's drag, for `shrinking`.

    Hoots & Roehrich 1980, SpaceTrack Report 3, section 6; Vallado et al. 2006, AIAA 2006-6753.
    axis : semi-major axes a0 (n,) of Brouwer's mean motion [Earth radii], sgp4's `a`
    """
    perigee_km = (axis * (1.0 - eccentricity) - 1.0) * RADIUS72_KM
    floor_km = np.where(perigee_km < 98.0, 20.0, np.minimum(perigee_km - 78.0, 78.0))
    s = 1.0 + floor_km / RADIUS72_KM
    xi = 1.0 / (axis - s)
    eta = axis * eccentricity * xi
    psi = np.abs(1.0 - eta**2)
    density = ((120.0 - floor_km) / RADIUS72_KM * xi) ** 4 / psi**3.5
    oblate = 0.375 * _J2_72 * xi / psi * (3.0 * np.cos(inclination_rad) ** 2 - 1.0)
    motion = _XKE72 * axis**-1.5
    round_ = axis * (1.0 + 1.5 * eta**2 + eccentricity * eta * (4.0 + eta**2))
    c1 = bstar * density * motion * (round_ + oblate * (8.0 + 3.0 * eta**2 * (8.0 + eta**2)))
    d2 = 4.0 * axis * xi * c1**2
    third = d2 * xi * c1 / 3.0
    d3 = (17.0 * axis + s) * third
    d4 = 0.5 * third * axis * xi * (221.0 * axis + 31.0 * s) * c1
    simple = (perigee_km < _SIMPLE_KM) | (2.0 * np.pi / motion >= _DEEP_MIN)
    return np.stack([c1, *np.where(simple, 0.0, [d2, d3, d4])])


def shrinking(terms: Array, minutes: Array) -> Array:
    """f (n, ...) = 1 - C1 t - D2 t^2 - D3 t^3 - D4 t^4 at minutes t (n, ...) after the elements'
    epochs: SGP4's mean semi-major axis is a0 f^2."""
    c1, d2, d3, d4 = terms.reshape(4, -1, *(1,) * (minutes.ndim - 1))
    return 1.0 - minutes * (c1 + minutes * (d2 + minutes * (d3 + minutes * d4)))


def have_decayed(
    satellites: Sequence[Satrec], minutes: Array, of: NDArray[np.int64] | None = None
) -> NDArray[np.bool_]:
    """Which of the times (n, ...), minutes after the elements' epochs, are after the satellites
    came down; of : (n,) indices of their satellites, by default all n in turn.

    Their mean semi-major axis a0 f^2 has been below the Earth's radius: with f below zero it grows
    again, and SGP4 goes on with an orbit that is none.
    """
    names = ("bstar", "ecco", "inclo", "a")
    columns = np.array([[getattr(one, name) for name in names] for one in satellites])
    columns = columns.reshape(-1, len(names)).T
    with np.errstate(all="ignore"):  # elements that are none: SGP4 itself tells so
        terms, least = drag_terms(*columns), columns[3] ** -0.5
        if of is not None:
            terms, least = terms[:, of], least[of]
        f = shrinking(terms, minutes)
        return f < least.reshape(-1, *(1,) * (f.ndim - 1))
