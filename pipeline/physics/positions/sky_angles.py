"""Angles on the sky from unit vectors: rate and position angle of a motion, azimuth, elevation."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.physics.vectors import separation, unit

Array = NDArray[np.float64]


def motion(before: Array, after: Array, step_s: float) -> tuple[Array, Array, Array]:
    """Middle direction (..., 3), rate [rad/s] and position angle [rad] (...) of a motion.

    before, after : (..., 3) unit vectors `step_s` apart. The angle runs from north (+z) through
    east, at the middle (Green 1985, Spherical Astronomy, section 1.6).
    """
    middle, way = unit(before + after), after - before
    x, y = middle[..., 0], middle[..., 1]
    east = way[..., 1] * x - way[..., 0] * y  # times the cosine of the declination, as is north
    north = way[..., 2] * (x * x + y * y) - middle[..., 2] * (way[..., 0] * x + way[..., 1] * y)
    angle = np.arctan2(east, north) % (2.0 * np.pi)
    return middle, separation(before, after) / step_s, angle


def horizontal(u: Array, axes: Array) -> tuple[Array, Array]:
    """Azimuth, from north through east in [0, 2 pi), and elevation [rad] (...) of directions.

    u : (..., 3); axes : (..., 3, 3) whose rows are north, east and zenith
    """
    north, east, up = (np.sum(u * axes[..., k, :], axis=-1) for k in range(3))
    return np.arctan2(east, north) % (2.0 * np.pi), np.arctan2(up, np.hypot(north, east))
