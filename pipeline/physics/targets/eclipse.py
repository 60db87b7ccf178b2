"""How much of the Sun a target sees past the Earth: umbra, penumbra and annular shadow."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.physics.constants import EARTH_EQUATORIAL_RADIUS_M, SUN_RADIUS_M
from pipeline.physics.vectors import angular_radius, separation

Array = NDArray[np.float64]


def sunlit_fraction(
    target_geocentric_m: Array,
    sun_from_earth_m: Array,
    earth_radius_m: float = EARTH_EQUATORIAL_RADIUS_M,
) -> Array:
    """Fraction (n,) of the solar disc's light that reaches a target, in [0, 1].

    Overlap of two discs as seen from the target (Montenbruck & Gill 2000, section 3.4.2), with the
    Earth's limb drawn in the tangent plane at its nearest point (radius tan b, not b), which takes
    the error against caps on the sphere from 1.5e-4 to below 1e-6 (3e-6 where the eclipse is
    annular). Written in the depth of overlap, so that first contact and total eclipse come without
    a difference of large numbers. A uniform solar disc and a spherical Earth without
    atmosphere: give a larger `earth_radius_m` for refracting air (often 50 to 90 km).

    Parameters
    ----------
    target_geocentric_m : (n, 3) target when the light left it.
    sun_from_earth_m : (n, 3) or (3,) the Sun; its apparent place (`apparent_sun_m`), because the
        shadow is swept back by the Earth's motion (4 km at GEO).
    """
    target = np.asarray(target_geocentric_m, float)
    to_sun = np.asarray(sun_from_earth_m, float) - target
    a = angular_radius(SUN_RADIUS_M, to_sun)
    b = angular_radius(earth_radius_m, target)
    # overlap along the line of centres
    depth = np.maximum(a + b - separation(to_sun, -target), 0.0)
    # the limb's circle in the plane: same depth, curvature that of the circle on the sphere
    b = np.tan(np.minimum(b, 0.5 * np.pi - 1e-9))
    depth = np.minimum(depth, 2.0 * np.minimum(a, b))  # total, or annular
    between = a + b - depth
    safe = np.where(between > 0.0, between, 1.0)  # equal discs, centred: total
    sagitta_a = np.where(between > 0.0, depth * (2.0 * b - depth) / (2.0 * safe), 2.0 * a)
    sagitta_b = np.where(between > 0.0, depth * (2.0 * a - depth) / (2.0 * safe), 0.0)
    covered = _segment(a, sagitta_a) + _segment(b, sagitta_b)
    lit = np.clip(1.0 - covered / (np.pi * a * a), 0.0, 1.0)
    return np.where(depth >= 2.0 * a, 0.0, lit)  # total: no rounding crumbs


def _segment(radius: Array, sagitta: Array) -> Array:
    """Area of the part of a disc cut off at a height `sagitta` (0 to 2 radius) inside its rim.

    r^2 (x - sin x)/2 with x the central angle; the difference by series below x = 0.5.
    """
    x = 4.0 * np.arcsin(np.sqrt(np.clip(sagitta / (2.0 * radius), 0.0, 1.0)))
    y = np.minimum(x, 0.5) ** 2
    series = np.minimum(x, 0.5) * y / 6.0
    series = series * (1.0 - y / 20.0 * (1.0 - y / 42.0 * (1.0 - y / 72.0 * (1.0 - y / 110.0))))
    return 0.5 * radius * radius * np.where(x < 0.5, series, x - np.sin(x))
