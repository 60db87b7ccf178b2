"""Angles on the sky from unit vectors: position angle of a motion, azimuth and elevation."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def position_angle(u: Array, way: Array) -> Array:
    """Angle (...) [rad] of motions (..., 3) at directions (..., 3), from north (+z) through east
    (Green 1985, Spherical Astronomy, section 1.6)."""
    x, y = u[..., 0], u[..., 1]
    east = way[..., 1] * x - way[..., 0] * y  # times the cosine of the declination, as is north
    north = way[..., 2] * (x * x + y * y) - u[..., 2] * (way[..., 0] * x + way[..., 1] * y)
    return np.asarray(np.arctan2(east, north) % (2.0 * np.pi))


def horizontal(u: Array, axes: Array) -> tuple[Array, Array]:
    """Azimuth, from north through east in [0, 2 pi), and elevation [rad] (...) of directions.

    u : (..., 3); axes : (..., 3, 3) whose rows are north, east and zenith
    """
    north, east, up = (np.sum(u * axes[..., k, :], axis=-1) for k in range(3))
    return np.arctan2(east, north) % (2.0 * np.pi), np.arctan2(up, np.hypot(north, east))
