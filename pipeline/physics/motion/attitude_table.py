"""Attitudes between the rows of a table of quaternions: slerp, or a smooth spline."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy
from numpy.typing import NDArray

from pipeline.physics.vectors import unit

Array = NDArray[np.float64]
Interpolation = Literal["slerp", "spline"]
ORDER: dict[str, float] = {"slerp": 4.0, "spline": 16.0}  # rows twice as dense: errors less by it


@dataclass(frozen=True, eq=False)
class AttitudeTable:
    """Rows of a table: times (n,) increasing [s], unit quaternions (n, 4), scalar last.

    A quaternion turns camera axes (x against the columns, y up the rows, z the boresight) into sky
    axes: v_sky = q v_camera q*.
    """

    time_s: Array
    q: Array
    interpolation: Interpolation


def attitudes_at(table: AttitudeTable, at_s: Array) -> Array:
    """Attitudes (n, 3, 3) at times (n,) within the table: rows +x (columns), +y, boresight.

    slerp : constant rate between two rows (Shoemake 1985, SIGGRAPH '85, 245); rates jump at rows
    spline : cubic in rotation vectors, rates and accelerations continuous (scipy RotationSpline)
    """
    q = _slerp(table, at_s) if table.interpolation == "slerp" else _spline(table, at_s)
    axes = np.swapaxes(matrix_of(q), -1, -2)  # rows: the camera's x, y, z in sky axes
    return axes * np.array([-1.0, 1.0, 1.0])[:, None]


def table_error_rad(table: AttitudeTable, wanted: NDArray[np.bool_]) -> float | None:
    """Largest error between rows [rad], from every other row omitted and interpolated.

    wanted : rows (n,) that count; None where there are too few rows to tell. The largest miss over
    what the order of the interpolation gains from rows twice as dense.
    """
    inner = np.arange(len(table.q)) % 2 == 1
    inner[-1] = False
    if not (inner & wanted).any() or (~inner).sum() < (4 if table.interpolation == "spline" else 2):
        return None
    sparse = AttitudeTable(table.time_s[~inner], table.q[~inner], table.interpolation)
    at = table.time_s[inner & wanted]
    guess = _slerp(sparse, at) if table.interpolation == "slerp" else _spline(sparse, at)
    return float(_angle(guess, table.q[inner & wanted]).max()) / ORDER[table.interpolation]


def product(p: Array, q: Array) -> Array:
    """Hamilton products (..., 4) of quaternions, scalar last: first q turns, then p."""
    pv, ps, qv, qs = p[..., :3], p[..., 3:], q[..., :3], q[..., 3:]
    vector = ps * qv + qs * pv + np.cross(pv, qv)
    return np.concatenate([vector, ps * qs - np.sum(pv * qv, axis=-1, keepdims=True)], axis=-1)


def conjugate(q: Array) -> Array:
    """The inverse turns (..., 4) of unit quaternions, scalar last."""
    return q * np.array([-1.0, -1.0, -1.0, 1.0])


def matrix_of(q: Array) -> Array:
    """Rotation matrices (n, 3, 3) of unit quaternions (n, 4), scalar last: v' = M v."""
    x, y, z, w = q.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def _slerp(table: AttitudeTable, at_s: Array) -> Array:
    k = np.clip(np.searchsorted(table.time_s, at_s, side="right") - 1, 0, len(table.q) - 2)
    a, b = table.q[k], table.q[k + 1]
    share = (at_s - table.time_s[k]) / (table.time_s[k + 1] - table.time_s[k])
    b = np.where(np.sum(a * b, axis=-1, keepdims=True) < 0.0, -b, b)
    half = 0.5 * _angle(a, b)  # between the two as points of the sphere of quaternions
    safe = np.maximum(np.sin(half), 1e-300)
    near = half < 1e-8
    left = np.where(near, 1.0 - share, np.sin((1.0 - share) * half) / safe)
    right = np.where(near, share, np.sin(share * half) / safe)
    return unit(left[:, None] * a + right[:, None] * b)


def _spline(table: AttitudeTable, at_s: Array) -> Array:

    turn = scipy.spatial.transform
    spline = turn.RotationSpline(table.time_s, turn.Rotation.from_quat(table.q))
    return np.asarray(spline(at_s).as_quat())


def _angle(p: Array, q: Array) -> Array:
    """Angles (n,) [rad] of the turns between quaternions (n, 4), exact for small ones."""
    far = np.sqrt(np.sum((p - q) ** 2, axis=-1))
    near = np.sqrt(np.sum((p + q) ** 2, axis=-1))
    return 4.0 * np.arcsin(np.minimum(0.5 * np.minimum(far, near), 1.0))
