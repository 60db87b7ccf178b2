"""Moonlight before it meets air or optics: the Moon's phase law, and its colour."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.physics.constants import ASTRONOMICAL_UNIT_M, DEG_RAD
from pipeline.physics.radiometry import ResponseCurve, photon_integral

Array = NDArray[np.float64]

MEAN_DISTANCE_M = 384_400_000.0
FULL_V_MAG, SUN_V_MAG = -12.73, -26.76
DARKEST_RAD = 150.0 * DEG_RAD  # beyond, the law grows too fast: it is held
# Disc reflectance at 45 degrees of phase over that at 550 nm: Kieffer & Stone 2005, AJ 129, 2887,
# table 4 (terms a0 to a3), joined to neighbouring bands; beyond its ends the last value is held.
COLOUR_NM = (
    352.6,
    410.6,
    441.6,
    470.4,
    486.9,
    549.0,
    665.1,
    698.4,
    745.3,
    769.2,
    873.3,
    936.6,
    1059.5,
)
COLOUR = (0.538, 0.746, 0.782, 0.827, 0.875, 1.0, 1.296, 1.272, 1.345, 1.400, 1.510, 1.481, 1.715)


def irradiance_share(phase_rad: Array, moon_sun_m: Array, moon_observer_m: Array) -> Array:
    """Irradiance (n,) of the Moon in V, over the solar irradiance at 1 au.

    V = -12.73 + 0.026 |a| + 4e-9 a^4, a the phase angle in degrees, at the mean distances (Allen
    1976, as in Krisciunas & Schaefer 1991, PASP 103, 1033, equations 9 and 20), the Sun -26.76;
    both distances by the inverse square. Omitted: the opposition surge (35% at full Moon below 2
    degrees), libration, and the difference of waxing and waning. Against the mean of Kieffer &
    Stone 2005 (AJ 129, 2887) at 550 nm: 4 to 8% brighter from 10 to 90 degrees (tests).

    phase_rad : (n,) Sun - Moon - observer; moon_sun_m, moon_observer_m : (n,) distances
    """
    a = np.minimum(np.abs(np.asarray(phase_rad, float)), DARKEST_RAD) / DEG_RAD
    mag = FULL_V_MAG + 0.026 * a + 4e-9 * a**4
    scale = (MEAN_DISTANCE_M / moon_observer_m) * (ASTRONOMICAL_UNIT_M / moon_sun_m)
    return 10.0 ** (-0.4 * (mag - SUN_V_MAG)) * scale**2


def spectrum(wavelength_m: Array, sun_w_m3: Array) -> Array:
    """Moonlight (n,) where its irradiance in V is that of the Sun: the Sun's, reddened."""
    return sun_w_m3 * np.interp(np.asarray(wavelength_m) * 1e9, COLOUR_NM, COLOUR)


def band_rate(wavelength_m: Array, sun_w_m3: Array, response: ResponseCurve) -> float:
    """Electrons/s/m2 of moonlight whose irradiance in V is that of the Sun at 1 au.

    wavelength_m, sun_w_m3 : (n,) solar spectrum at 1 au, W/m2/m
    """
    grid = np.union1d(wavelength_m, np.array(COLOUR_NM) * 1e-9)
    sun = np.interp(grid, wavelength_m, sun_w_m3, left=0.0, right=0.0)
    return photon_integral(grid, spectrum(grid, sun), response)
