"""Where the planets stand, to two arcminutes, and how bright they can be."""

from __future__ import annotations

import erfa.ufunc as era
import numpy as np
from numpy.typing import NDArray

from pipeline.physics.constants import ASTRONOMICAL_UNIT_M, DEG_RAD

Array = NDArray[np.float64]

# ERFA's number, and V at 1 au from Sun and observer at full phase, Saturn's with its rings as wide
# open as they come (Mallama & Hilton 2018, Astron. Comput. 25, 10;
# doi:10.1016/j.ascom.2018.08.002).
PLANETS = {
    "Mercury": (1, -0.613),
    "Venus": (2, -4.384),
    "Mars": (4, -1.601),
    "Jupiter": (5, -9.395),
    "Saturn": (6, -9.90),
    "Uranus": (7, -7.110),
    "Neptune": (8, -7.00),
}
OFF_RAD = DEG_RAD / 30.0  # plan94 to 0.024 deg, and what a planet moves by while its light comes


def planet_m(name: str, tt1: Array, tt2: Array) -> Array:
    """Heliocentric place (n, 3) [m], mean equator of J2000, of a planet at Julian dates TT.

    Simon et al. 1994 (A&A 282, 663) as ERFA's plan94 has it: to 0.024 degrees from 1800 to 2200,
    aberration and light time, another 0.012, omitted.
    """
    pv = era.plan94(tt1, tt2, PLANETS[name][0])[0]
    return np.asarray(pv["p"]) * ASTRONOMICAL_UNIT_M


def brightest_v_mag(name: str, from_sun_m: Array, away_m: Array) -> Array:
    """V (n,) of a planet seen at full phase; less of it is lit as seen from inside of its orbit."""
    product = from_sun_m * away_m / ASTRONOMICAL_UNIT_M**2
    return np.asarray(PLANETS[name][1] + 5.0 * np.log10(np.maximum(product, 1e-9)))
