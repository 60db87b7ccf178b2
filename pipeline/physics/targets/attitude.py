"""How a body stands in space: pointing, spinning, sun-tracking and tabulated attitudes.

An attitude is a rotation matrix (..., 3, 3) whose columns are the body's x, y and z axes in the
inertial frame (GCRS axes): v_inertial = R v_body. Quaternions are scalar first, (w, x, y, z), body
to inertial. All functions broadcast over leading axes, such as (bodies, times).
"""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from pipeline.errors import BadInput

Array = NDArray[np.float64]

_PARALLEL = 1e-12  # sine of an angle below which two directions do not fix a frame


def in_body_axes(attitude: Array, vectors: Array) -> Array:
    """Vectors (..., 3) of the inertial frame in the body's axes: R^T v."""
    return np.einsum("...ji,...j->...i", attitude, vectors)


def quaternion_matrices(quaternions: ArrayLike) -> Array:
    """Rotation matrices (..., 3, 3) of quaternions (..., 4), scalar first, of any length > 0."""
    q = np.asarray(quaternions, float)
    w, x, y, z = np.moveaxis(q / np.sqrt(np.sum(q * q, -1, keepdims=True)), -1, 0)
    rows = [
        1 - 2 * (y * y + z * z),
        2 * (x * y - w * z),
        2 * (x * z + w * y),
        2 * (x * y + w * z),
        1 - 2 * (x * x + z * z),
        2 * (y * z - w * x),
        2 * (x * z - w * y),
        2 * (y * z + w * x),
        1 - 2 * (x * x + y * y),
    ]
    return np.stack(rows, axis=-1).reshape(*w.shape, 3, 3)


def axes_towards(z_axis: Array, near_y: Array) -> Array:
    """Attitude (..., 3, 3) with z along a direction (..., 3) and y as near as can be to another.

    Where the two are parallel, y is towards the coordinate axis farthest from z: never NaN.
    """
    z, hint = np.broadcast_arrays(_unit(z_axis), _unit(near_y))
    y = hint - _dot(hint, z)[..., None] * z
    lost = _dot(y, y) < _PARALLEL**2
    if np.any(lost):
        farthest = np.eye(3)[np.argmin(np.abs(z[lost]), axis=-1)]
        y[lost] = farthest - _dot(farthest, z[lost])[..., None] * z[lost]
    y = _unit(y)
    return np.stack([_cross(y, z), y, z], axis=-1)


def nadir_attitude(place_m: Array, velocity_m_s: Array) -> Array:
    """z to the Earth's centre, y against the orbit's normal, x forward (the LVLH frame)."""
    return axes_towards(-place_m, -_cross(place_m, velocity_m_s))


def velocity_attitude(place_m: Array, velocity_m_s: Array) -> Array:
    """z along the inertial velocity, y along the orbit's normal r x v, x away from the Earth."""
    return axes_towards(velocity_m_s, _cross(place_m, velocity_m_s))


def sun_attitude(sun: Array, place_m: Array, velocity_m_s: Array) -> Array:
    """z to the Sun (direction (..., 3)), y as near as can be to the orbit's normal."""
    return axes_towards(sun, _cross(place_m, velocity_m_s))


def spin_attitude(start: Array, axis: Array, angle_rad: Array) -> Array:
    """A body turned about an axis fixed in it: start (..., 3, 3), axis (..., 3), angle (...,).

    start @ (I + sin a K + (1 - cos a) K^2), K the cross-product matrix of the axis (Rodrigues).
    Angles are exact to rounding; give them modulo a turn.
    """
    x, y, z = np.moveaxis(_unit(np.asarray(axis, float)), -1, 0)
    zero = np.zeros_like(x)
    k = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).reshape(*x.shape, 3, 3)
    angle = np.asarray(angle_rad, float)[..., None, None]
    once = start @ k
    return start + np.sin(angle) * once + 2.0 * np.sin(0.5 * angle) ** 2 * (once @ k)


def tracking_attitude(bus: Array, axis: Array, sun: Array) -> Array:
    """A panel that turns about one axis of its bus to follow the Sun: y on the axis, z to the Sun.

    bus : (..., 3, 3); axis : (..., 3) in the bus's axes; sun : (..., 3) direction, inertial.
    n = (s - (s.a) a)/|.|; with the Sun on the axis z is any direction across it.
    """
    hinge = np.einsum("...ij,...j->...i", bus, _unit(np.asarray(axis, float)))
    turned = axes_towards(hinge, sun)  # its z on the hinge, its y towards the Sun
    x, y, z = np.moveaxis(turned, -1, 0)
    return np.stack([-x, z, y], axis=-1)


def table_attitude(
    times_s: ArrayLike, quaternions: ArrayLike, at_s: Array, field: str = "attitude"
) -> Array:
    """Attitudes (n, 3, 3) of a table (m,), (m, 4), by the shortest turn at even rate (slerp).

    Slerp of scipy; the sign of a quaternion does not matter. BadInput, naming `field`, where
    the table does not cover the times asked for.
    """
    times, at = np.asarray(times_s, float), np.asarray(at_s, float)
    if at.size and not (times[0] <= at.min() and at.max() <= times[-1]):
        raise BadInput(
            f"{field}.times_s",
            f"{times[0]:g} to {times[-1]:g}",
            f"a table that covers the exposures, {at.min():.6g} to {at.max():.6g} s",
        )
    turn = scipy.spatial.transform
    turns = turn.Rotation.from_quat(np.roll(np.asarray(quaternions, float), -1, axis=-1))
    return np.asarray(turn.Slerp(times, turns)(at.ravel()).as_matrix()).reshape(*at.shape, 3, 3)


def _dot(a: Array, b: Array) -> Array:
    """Scalar product (...,)."""
    return np.asarray(np.einsum("...i,...i->...", a, b))


def _unit(v: Array) -> Array:
    """Vectors of length one (..., 3), zeros of zeros; quicker than `vectors.unit` on many."""
    length = np.sqrt(_dot(v, v))[..., None]
    return np.asarray(v / np.where(length > 0.0, length, 1.0))


def _cross(a: Array, b: Array) -> Array:
    """Cross product (..., 3); several times quicker than numpy's on many short vectors."""
    a, b = np.asarray(a, float), np.asarray(b, float)
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)
