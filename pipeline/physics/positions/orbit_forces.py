"""Forces on a satellite: zonal harmonics, drag in a static atmosphere, sunlight, Sun and Moon."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pipeline.physics.constants import (
    ASTRONOMICAL_UNIT_M,
    EARTH_EQUATORIAL_RADIUS_M,
    EARTH_FLATTENING,
    EARTH_GM_M3_S2,
    EARTH_ROTATION_RAD_S,
    SOLAR_CONSTANT_W_M2,
    SPEED_OF_LIGHT_M_S,
    SUN_RADIUS_M,
)

Array = NDArray[np.float64]

SUN_GM_M3_S2 = 1.327_124_400_18e20  # DE405
MOON_GM_M3_S2 = 4.902_800_076e12  # DE421
REENTRY_HEIGHT_M = 100e3
# J2 to J6 of EGM96, -C_n0 sqrt(2n + 1) (Lemoine et al. 1998, NASA/TP-1998-206861)
_J = np.array(
    [0, 0, 1.0826266835e-3, -2.5326564853e-6, -1.6196215914e-6, -2.2729608287e-7, 5.4068123911e-7]
)
# Nominal densities (Vallado 2013, table 8-4: US Standard Atmosphere 1976 and CIRA-72 with an
# exospheric temperature of 1000 K), joined by exponentials; the scale height above is 268 km.
_HEIGHT_KM = np.array([
    100.0, 110.0, 120.0, 130.0, 140.0, 150.0, 180.0, 200.0, 250.0, 300.0,
    350.0, 400.0, 450.0, 500.0, 600.0, 700.0, 800.0, 900.0, 1000.0,
])  # fmt: skip
_LOG_DENSITY = np.log([
    5.297e-7, 9.661e-8, 2.438e-8, 8.484e-9, 3.845e-9, 2.070e-9, 5.464e-10, 2.789e-10, 7.248e-11,
    2.418e-11, 9.518e-12, 3.725e-12, 1.585e-12, 6.967e-13, 1.454e-13, 3.614e-14, 1.170e-14,
    5.245e-15, 3.019e-15,
])  # fmt: skip
_SCALE_ABOVE_KM = 268.0
_SUNLIGHT_N_M2 = SOLAR_CONSTANT_W_M2 / SPEED_OF_LIGHT_M_S


@dataclass(frozen=True)
class Forces:
    """Which forces act beside the Earth's central one.

    zonals : highest zonal harmonic, 0 or 2 to 6
    drag_m2_kg, radiation_m2_kg : C_D A/m and C_R A/m of a sphere; 0 leaves the force out
    conical : umbra and penumbra, else a cylindrical shadow
    sun, moon : their gravity
    """

    zonals: int = 6
    drag_m2_kg: float = 0.0
    radiation_m2_kg: float = 0.0
    conical: bool = True
    sun: bool = False
    moon: bool = False


def zonal_acceleration(position_m: Array, pole: Array, highest: int) -> Array:
    """Central and zonal gravity [m/s2] (3,) at a place (3,); `pole` is the Earth's axis."""
    return _gravity(np.asarray(position_m, float), np.asarray(pole, float), highest)


def density_kg_m3(height_m: float) -> float:
    """Density of the static atmosphere: exponentials through tabled heights from 100 km up.

    The real one breathes with the Sun's activity: by a factor of 2 at 300 km, 10 at 600 km.
    """
    return float(_density(height_m))


def height_m(position_m: Array, pole: Array) -> float:
    """Height above the ellipsoid, along the radius (within 100 m of the geodetic one in orbit)."""
    return float(_height(np.asarray(position_m, float), np.asarray(pole, float)))


def sunlit(position_m: Array, sun_m: Array, conical: bool = True) -> float:
    """Part of the Sun that is seen beside a spherical Earth: conical shadow, or a cylinder."""
    return float(_sunlit(np.asarray(position_m, float), np.asarray(sun_m, float), conical))


def acceleration(
    state: Array, pole: Array, sun_m: Array, moon_m: Array, forces: Forces, lit: float | None = None
) -> Array:
    """All accelerations [m/s2] (3,) of a state (6,) in GCRS; Sun and Moon geocentric (3,).

    lit : the part of the Sun that is seen, where it is known
    """
    return _acceleration(
        state, pole, sun_m, moon_m, forces.zonals, forces.drag_m2_kg, forces.radiation_m2_kg,
        forces.conical, forces.sun, forces.moon, -1.0 if lit is None else lit,
    )  # fmt: skip


@njit(cache=True, nogil=True)
def _acceleration(y, pole, sun, moon, zonals, drag, radiation, conical, by_sun, by_moon, lit):
    r, v = y[:3], y[3:]
    total = _gravity(r, pole, zonals)
    if drag > 0.0:
        wind = v - EARTH_ROTATION_RAD_S * _cross(pole, r)
        speed = np.sqrt(np.sum(wind * wind))
        total -= 0.5 * _density(_height(r, pole)) * drag * speed * wind
    if radiation > 0.0:
        away = r - sun
        distance = np.sqrt(np.sum(away * away))
        pressure = _SUNLIGHT_N_M2 * (ASTRONOMICAL_UNIT_M / distance) ** 2
        if lit < 0.0:
            lit = _sunlit(r, sun, conical)
        total += pressure * radiation * lit / distance * away
    if by_sun:
        total += _third_body(r, sun, SUN_GM_M3_S2)
    if by_moon:
        total += _third_body(r, moon, MOON_GM_M3_S2)
    return total


@njit(cache=True, nogil=True)
def _cross(a, b):
    """Of two vectors (3,); numba takes two seconds to compile numpy's, which knows many shapes."""
    out = np.empty(3)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        out[i] = a[j] * b[k] - a[k] * b[j]
    return out


@njit(cache=True, nogil=True)
def _gravity(r, pole, highest):
    """grad of GM/r [1 - sum J_n (R/r)^n P_n(s)], s the sine of the latitude.

    (n + 1) P_n + s P_n' = P_(n+1)', so the n-th term is
    GM J_n R^n / r^(n+2) [P_(n+1)'(s) r/|r| - P_n'(s) pole].
    """
    length = np.sqrt(np.sum(r * r))
    up = r / length
    s = np.sum(up * pole)
    radial, polar = -1.0, 0.0
    ratio = EARTH_EQUATORIAL_RADIUS_M / length
    power = ratio
    below, here = 1.0, s  # P_0, P_1
    slope_below, slope = 0.0, 1.0
    for n in range(1, highest + 1):
        following = ((2 * n + 1) * s * here - n * below) / (n + 1)
        slope_following = slope_below + (2 * n + 1) * here
        if n > 1:
            power *= ratio
            radial += _J[n] * power * slope_following
            polar -= _J[n] * power * slope
        below, here = here, following
        slope_below, slope = slope, slope_following
    return EARTH_GM_M3_S2 / length**2 * (radial * up + polar * pole)


@njit(cache=True, nogil=True)
def _third_body(r, body, gm):
    path = body - r
    far = np.sum(path * path)
    centre = np.sum(body * body)
    return gm * (path / (far * np.sqrt(far)) - body / (centre * np.sqrt(centre)))


@njit(cache=True, nogil=True)
def _height(r, pole):
    length = np.sqrt(np.sum(r * r))
    s = np.sum(r * pole) / length
    flat = 1.0 - EARTH_FLATTENING
    surface = EARTH_EQUATORIAL_RADIUS_M * flat / np.sqrt(flat * flat * (1.0 - s * s) + s * s)
    return length - surface


@njit(cache=True, nogil=True)
def _density(height):
    km = 1e-3 * height
    if km >= _HEIGHT_KM[-1]:
        return np.exp(_LOG_DENSITY[-1] - (km - _HEIGHT_KM[-1]) / _SCALE_ABOVE_KM)
    i = min(max(np.searchsorted(_HEIGHT_KM, km) - 1, 0), len(_HEIGHT_KM) - 2)
    part = (km - _HEIGHT_KM[i]) / (_HEIGHT_KM[i + 1] - _HEIGHT_KM[i])
    part = max(part, -1.0)  # below 100 km the satellite is refused: no overflow on the way there
    return np.exp(_LOG_DENSITY[i] + part * (_LOG_DENSITY[i + 1] - _LOG_DENSITY[i]))


@njit(cache=True, nogil=True)
def _sunlit(r, sun, conical):
    """Montenbruck & Gill 2000, section 3.4.2: overlap of two discs as the satellite sees them."""
    to_sun = sun - r
    sun_range, length = np.sqrt(np.sum(to_sun * to_sun)), np.sqrt(np.sum(r * r))
    axis = sun / np.sqrt(np.sum(sun * sun))
    along = np.sum(r * axis)
    if not conical:
        off = r - along * axis
        inside = np.sqrt(np.sum(off * off)) < EARTH_EQUATORIAL_RADIUS_M
        return 0.0 if along < 0.0 and inside else 1.0
    a = np.arcsin(min(1.0, SUN_RADIUS_M / sun_range))
    b = np.arcsin(min(1.0, EARTH_EQUATORIAL_RADIUS_M / length))
    c = np.arccos(min(1.0, max(-1.0, -np.sum(r * to_sun) / (length * sun_range))))
    if c >= a + b:
        return 1.0
    if c <= b - a:
        return 0.0
    if c <= a - b:
        return 1.0 - (b / a) ** 2
    x = (c * c + a * a - b * b) / (2.0 * c)
    y = np.sqrt(max(0.0, a * a - x * x))
    cos_a, cos_b = min(1.0, max(-1.0, x / a)), min(1.0, max(-1.0, (c - x) / b))
    area = a * a * np.arccos(cos_a) + b * b * np.arccos(cos_b) - c * y
    return 1.0 - area / (np.pi * a * a)
