"""Unit vectors, angles and rotations in forms that stay exact at their hard ends."""

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
    return np.where(lon >= 2 * np.pi, 0.0, lon), np.arctan2(v[..., 2], np.hypot(v[..., 0], v[..., 1]))


def separation(a: Vectors, b: Vectors) -> NDArray[np.float64]:
    """Angle between vectors [rad], exact from 0 to pi: atan2(|a x b|, a.b)."""
    cross = np.cross(a, b)
    return np.arctan2(np.sqrt(np.sum(cross**2, -1)), np.sum(a * b, -1))


def rotate_minimal(a: Vectors, b: Vectors) -> NDArray[np.float64]:
    """Rotation matrix (3, 3) that takes unit vector `a` to unit vector `b` on the shortest way.

    Rodrigues' formula with 1/(1 + a.b); undefined for opposite vectors, which raises ValueError.
    """
    c = float(a @ b)
    if 1.0 + c < 1e-12:
        raise ValueError("no shortest rotation between opposite vectors")
    k = np.cross(a, b)
    skew = np.array([[0.0, -k[2], k[1]], [k[2], 0.0, -k[0]], [-k[1], k[0], 0.0]])
    return np.eye(3) + skew + skew @ skew / (1.0 + c)


def rotate_about(axis: Vectors, angle_rad: float) -> NDArray[np.float64]:
    """Rotation matrix (3, 3) about a unit axis by a right-handed angle [rad] (Rodrigues)."""
    k = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    return np.eye(3) + np.sin(angle_rad) * k + 2.0 * np.sin(angle_rad / 2) ** 2 * (k @ k)
