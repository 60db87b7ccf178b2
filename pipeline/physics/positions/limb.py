"""What the Earth hides: how clear of its ellipsoid lines of sight pass, and when in an exposure."""

from __future__ import annotations

import erfa.ufunc as era
import numpy as np
from numpy.typing import NDArray

from pipeline.physics.constants import EARTH_EQUATORIAL_RADIUS_M, EARTH_FLATTENING
from pipeline.physics.positions.times import instants
from pipeline.physics.vectors import angular_radius, separation, unit

Array = NDArray[np.float64]

FINER = 16  # steps between two nodes in which a limb's crossing is looked for


def pole_at(utc: tuple[float, float]) -> Array:
    """Unit vector (3,) to the Earth's pole, GCRS axes, at a two-part UTC date: the celestial
    intermediate pole of IAU 2006/2000A (ERFA xys06a).

    It moves by 20 arcsec a year: taken once for a scene, the limb is off by under 3 m a year.
    """
    at = instants(utc, [0.0])
    x, y, _ = era.xys06a(at.tt1[0], at.tt2[0])
    return np.array([float(x), float(y), float(np.sqrt(1.0 - x * x - y * y))])


def height_of_line_m(
    observer_m: Array, direction: Array, pole: Array, range_m: Array | float = np.inf
) -> Array:
    """Least height [m] of lines of sight above the WGS 84 ellipsoid; negative where they cross it.

    The axis along the pole is stretched by 1 / (1 - f), which makes the ellipsoid a sphere and
    leaves lines straight: a line crosses the one where it crosses the other, so that the sign is
    exact. The height is that above the sphere, up to 1.0034 times the real one. It is
    continuous: a target nearer than the limb has that of itself or of the observer.

    Parameters
    ----------
    observer_m : (..., 3) geocentric, GCRS axes, as the other vectors
    direction : (..., 3) geometric unit vectors (in the Earth's frame, without aberration)
    range_m : (...,) distance of what is looked at; infinite for stars

    Returns (...,).
    """
    place, way = _stretched(observer_m, pole), _stretched(direction, pole)
    length = np.sqrt(np.sum(way * way, axis=-1))
    way = way / length[..., None]
    along = np.clip(-np.sum(place * way, axis=-1), 0.0, length * range_m)
    nearest = place + along[..., None] * way
    return np.sqrt(np.sum(nearest * nearest, axis=-1)) - EARTH_EQUATORIAL_RADIUS_M


def _stretched(vector: Array, pole: Array) -> Array:
    """Vectors (..., 3) where the WGS 84 ellipsoid is a sphere of the equator's radius."""
    more = 1.0 / (1.0 - EARTH_FLATTENING) - 1.0
    return vector + more * np.sum(vector * pole, -1, keepdims=True) * pole


def limb_angle(observer_m: Array, direction: Array, pole: Array) -> Array:
    """Angle [rad] (...,) between directions and the limb of the WGS 84 ellipsoid; negative inside.

    It is that of `height_of_line_m`'s space: its sign is exact, its size to 0.4 %. From below the
    ellipsoid a disc of half the sky. Vectors as there.
    """
    place = _stretched(observer_m, pole)
    disc = angular_radius(EARTH_EQUATORIAL_RADIUS_M, place)
    return np.asarray(separation(-place, _stretched(direction, pole)) - disc)


def upright(place_m: Array) -> Array:
    """Normals (..., 3) of the ellipsoid at geocentric places near its surface, of any length.

    The pole is that of the axes of the places: from 2000 to 2100 it moves by 0.6 degrees, which
    turns a normal by 14 arcsec at most.
    """
    return place_m * [1.0, 1.0, (1.0 - EARTH_FLATTENING) ** -2]


def zenith_of(observer_m: Array, pole: Array, latitude_rad: float) -> Array:
    """Normals (..., 3) of the ellipsoid at a site of known latitude, from its places (..., 3).

    Polar motion (0.5 arcsec) is omitted from the latitude. At a pole it is the axis.
    """
    across = observer_m - np.sum(observer_m * pole, -1, keepdims=True) * pole
    return np.cos(latitude_rad) * unit(across) + np.sin(latitude_rad) * pole


def finer(clear: Array) -> Array:
    """Values (..., M) at FINER steps between K nodes at equal steps (..., K): cubics through four.

    The polynomial through the two nodes before and after, at the ends through the four last ones.
    """
    nodes = clear.shape[-1]
    count = min(4, nodes)
    at = np.arange(FINER * (nodes - 1) + 1) / FINER
    first = np.clip(at.astype(np.int64) - 1, 0, nodes - count)
    s, out = at - first, np.zeros((*clear.shape[:-1], len(at)))
    for j in range(count):
        weight = np.ones(len(at))
        for k in range(count):
            weight *= (s - k) / (j - k) if k != j else 1.0
        out += weight * clear[..., first + j]
    return out


def visible_fraction(clear: Array) -> Array:
    """Fraction (...,) of an exposure in which values (..., M) at equal steps are not negative.

    Straight between the steps: off by at most one step for a source that only grazes the limb.
    """
    return np.mean(_part_above(clear[..., :-1], clear[..., 1:]), axis=-1)


def _part_above(before: Array, after: Array) -> Array:
    """Part (...,) of steps in which a straight line between two values is not negative."""
    high, low = np.maximum(before, after), np.minimum(before, after)
    part = np.divide(high, high - low, out=np.ones_like(high), where=high > low)
    return np.where(low >= 0.0, 1.0, np.where(high < 0.0, 0.0, part))


def crossings(clear: Array) -> Array:
    """Moments (c,), in steps from the first, at which values (M,) change their sign."""
    seen = clear >= 0.0
    k = np.flatnonzero(seen[1:] != seen[:-1])
    return k + clear[k] / (clear[k] - clear[k + 1])
