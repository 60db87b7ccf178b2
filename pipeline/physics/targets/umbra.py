"""Sunlight that the Earth's air sends into its shadow: an upper bound, by how far it bends."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.physics.constants import ARCSEC_RAD, EARTH_EQUATORIAL_RADIUS_M, SUN_RADIUS_M
from pipeline.physics.vectors import angular_radius, separation

Array = NDArray[np.float64]

DEEPEST_RAD = 70.0 * 60.0 * ARCSEC_RAD  # twice the refraction at the horizon, 35 arcmin
SCALE_M = 8_000.0  # in which bending falls by e: the density of the air
SCATTERED = 1e-4  # of sunlight: 10 magnitudes


def umbra_fraction(target_geocentric_m: Array, sun_from_earth_m: Array) -> Array:
    """Most of full sunlight (n,) that reaches a target in the umbra; 0 beside it.

    Two parts. Refraction: a line that grazes the ground is bent by DEEPEST_RAD, one h above by
    exp(-h / SCALE_M) of it. Bending keeps surface brightness, so that the light is the solid angle
    of the Sun's image at the limb over the Sun's own. From a target at a distance D of its limb an
    image that is bent by w is thinner than the Sun by 1 + w D / SCALE_M, and longer by sin b /
    sin c (b, c: limb and Sun from the Earth's middle); w is that of the Sun's edge nearest to the
    limb, and none is seen where it is deeper than DEEPEST_RAD. No extinction is taken off, which
    dims it by 1 to 5 magnitudes more (Rayleigh's alone by 7 at the ground at 550 nm), nor clouds.
    Scattering: the eclipsed Moon is 10 to 14 magnitudes fainter than the full one (Danjon 1921;
    Keen 1983, Science 222, 1011), so that SCATTERED is added everywhere.

    target_geocentric_m : (n, 3) when the light left it; sun_from_earth_m : as in `eclipse`
    """
    target = np.asarray(target_geocentric_m, float)
    to_sun = np.asarray(sun_from_earth_m, float) - target
    r = np.sqrt(np.sum(target * target, axis=-1))
    a, b = angular_radius(SUN_RADIUS_M, to_sun), angular_radius(EARTH_EQUATORIAL_RADIUS_M, target)
    c = separation(to_sun, -target)
    bend = np.maximum(b - c - a, 0.0)
    leg = np.sqrt(np.maximum(r * r - EARTH_EQUATORIAL_RADIUS_M**2, 0.0))
    longer = np.sin(b) / np.maximum(np.sin(c), 0.25 * a)
    refracted = np.minimum(longer / (1.0 + bend * leg / SCALE_M), 1.0)
    total = np.minimum(np.where(bend <= DEEPEST_RAD, refracted, 0.0) + SCATTERED, 1.0)
    return np.where(c <= b - a, total, 0.0)
