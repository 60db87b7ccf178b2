"""Unit vectors, angles and rotations in forms that stay exact at their limiting cases."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Vectors = NDArray[np.float64]


def unit(v: Vectors) -> Vectors:
    """Vectors scaled to length one: (..., 3) -> (..., 3). A zero vector gives NaN-free zeros."""
    length = np.sqrt(np.sum(np.square(v), axis=-1, keepdims=True))
    return np.divide(v, length, out=np.zeros_like(v, dtype=float), where=length > 0)


def from_angles(lon_rad: NDArray[np.float64], lat_rad: NDArray[np.float64]) -> Vectors:
    """Unit vectors of longitude and latitude [rad]: (...,) -> (..., 3)."""
    lon, lat = np.asarray(lon_rad, float), np.asarray(lat_rad, float)
    c = np.cos(lat)
    return np.stack([c * np.cos(lon), c * np.sin(lon), np.broadcast_to(np.sin(lat), c.shape)], -1)


def to_angles(v: Vectors) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Longitude in [0, 2 pi) and latitude [rad] of vectors of any length: (..., 3)."""
    lon = np.arctan2(v[..., 1], v[..., 0]) % (2 * np.pi)
    lat = np.arctan2(v[..., 2], np.hypot(v[..., 0], v[..., 1]))
    return np.where(lon >= 2 * np.pi, 0.0, lon), lat


def separation(a: Vectors, b: Vectors) -> NDArray[np.float64]:
    """Angle between vectors [rad], exact from 0 to pi: atan2(|a x b|, a.b)."""
    cross = np.cross(a, b)
    return np.arctan2(np.sqrt(np.sum(cross**2, -1)), np.sum(a * b, -1))


def rotate_minimal(a: Vectors, b: Vectors) -> NDArray[np.float64]:
    """Rotation matrices (..., 3, 3) that take unit vectors `a` to `b` on the shortest way.

    Rodrigues' formula with 1/(1 + a.b); undefined for opposite vectors, which raises ValueError.
    """
    c = np.asarray(np.sum(a * b, axis=-1))
    if np.any(1.0 + c < 1e-12):
        raise ValueError("no shortest rotation between opposite vectors")
    skew = _skew(np.cross(a, b))
    return np.eye(3) + skew + skew @ skew / (1.0 + c)[..., None, None]


def rotate_about(axis: Vectors, angle_rad: float | NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotation matrices (..., 3, 3) about unit axes by right-handed angles [rad] (Rodrigues)."""
    k = _skew(np.asarray(axis, float))
    angle = np.asarray(angle_rad, float)[..., None, None]
    return np.eye(3) + np.sin(angle) * k + 2.0 * np.sin(angle / 2) ** 2 * (k @ k)


def _skew(v: Vectors) -> NDArray[np.float64]:
    """Matrices (..., 3, 3) of the cross product with vectors (..., 3)."""
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    zero = np.zeros_like(x)
    rows = [zero, -z, y, z, zero, -x, -y, x, zero]
    return np.stack(rows, axis=-1).reshape(*x.shape, 3, 3)


def position_angle(u: Vectors, way: Vectors) -> Vectors:
    """Angle (...) [rad] of motions (..., 3) at directions (..., 3), from north (+z) through east
    (Green 1985, Spherical Astronomy, section 1.6)."""
    x, y = u[..., 0], u[..., 1]
    east = way[..., 1] * x - way[..., 0] * y  # times the cosine of the declination, as is north
    north = way[..., 2] * (x * x + y * y) - u[..., 2] * (way[..., 0] * x + way[..., 1] * y)
    return np.asarray(np.arctan2(east, north) % (2.0 * np.pi))


def horizontal(u: Vectors, axes: Vectors) -> tuple[Vectors, Vectors]:
    """Azimuth, from north through east in [0, 2 pi), and elevation [rad] (...) of directions.

    u : (..., 3); axes : (..., 3, 3) whose rows are north, east and zenith
    """
    north, east, up = (np.sum(u * axes[..., k, :], axis=-1) for k in range(3))
    return np.arctan2(east, north) % (2.0 * np.pi), np.arctan2(up, np.hypot(north, east))


def angular_radius(radius_m: float, vector_m: Vectors) -> Vectors:
    """Angular radius (...,) [rad] of a sphere at vectors (..., 3) [m]; pi/2 from inside it."""
    distance = np.sqrt(np.sum(np.square(vector_m), axis=-1))
    return np.arcsin(np.minimum(radius_m / np.maximum(distance, radius_m), 1.0))
