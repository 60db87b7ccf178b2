"""Zones of the focal plane, and interpolation across them from three by three nodes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from pipeline.arrays import Array
from pipeline.physics.positions.focal_plane import Camera

NODES = np.array([-1.0, 0.0, 1.0])  # of a zone, where paths are followed exactly
CHECKS = np.array([-1.0, -0.5, 0.5, 1.0])  # where the spread is measured


@dataclass(frozen=True)
class Zone:
    """A rectangle of the focal plane [px]; u and v run from -1 to 1 across it."""

    y0: float
    y1: float
    x0: float
    x1: float

    def uv(self, x_px: Array, y_px: Array) -> tuple[Array, Array]:
        """Places in the zone's own units."""
        half_x, half_y = 0.5 * (self.x1 - self.x0), 0.5 * (self.y1 - self.y0)
        return (x_px - self.x0) / half_x - 1.0, (y_px - self.y0) / half_y - 1.0

    def places(self, u: Array, v: Array) -> tuple[Array, Array]:
        """Pixels (x, y) of places in the zone's own units."""
        half_x, half_y = 0.5 * (self.x1 - self.x0), 0.5 * (self.y1 - self.y0)
        return self.x0 + (u + 1.0) * half_x, self.y0 + (v + 1.0) * half_y


def zone_of_frame(camera: Camera, row: int, column: int, zones: int) -> Zone:
    """A zone of the focal plane."""
    y, x = camera.rows / zones, camera.columns / zones
    return Zone(row * y - 0.5, (row + 1) * y - 0.5, column * x - 0.5, (column + 1) * x - 0.5)


@njit(cache=True, nogil=True)
def _weights(t):
    """Lagrange weights of the values at NODES."""
    return 0.5 * t * (t - 1.0), (1.0 - t) * (1.0 + t), 0.5 * t * (t + 1.0)


def lagrange(t: Array) -> Array:
    """(3, n) Lagrange weights of the values at NODES."""
    return np.stack(_weights.py_func(t))


@njit(cache=True, nogil=True)
def biquadratic(table, u, v):
    """Values (n,) of x and y of a (2, 3, 3) table at (u, v), star by star in one order of sums."""
    x, y = np.zeros(u.size), np.zeros(u.size)
    for k in range(u.size):
        along, down = _weights(u[k]), _weights(v[k])
        for j in range(3):
            for i in range(3):
                weight = down[j] * along[i]
                x[k] += weight * table[0, j, i]
                y[k] += weight * table[1, j, i]
    return x, y
