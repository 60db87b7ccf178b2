"""Small turns of a camera in its own axes, slews from one attitude to another, and settling."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pipeline.physics.vectors import unit

Array = NDArray[np.float64]


def turned(attitude: Array, x_rad: Array, y_rad: Array, roll_rad: Array) -> Array:
    """Attitudes (n, 3, 3) turned in their own axes by angles (n,) each.

    The boresight moves by an arc of length hypot(x, y) in the direction (x, y) of the camera's
    axes, the others with it on the shortest way; then the camera rolls about it, from +x to +y.
    Exact for any angle: what is in the frame moves by (-x, -y) / ifov for small ones.
    """
    angle = np.hypot(x_rad, y_rad)
    sinc = np.sinc(angle / np.pi)
    half = 0.5 * np.sinc(0.5 * angle / np.pi) ** 2  # (1 - cos) / angle^2
    a, b, zero = x_rad * sinc, y_rad * sinc, np.zeros_like(angle)
    xx, xy, yy = half * x_rad**2, half * x_rad * y_rad, half * y_rad**2
    move = _matrices([[1.0 - xx, -xy, -a], [-xy, 1.0 - yy, -b], [a, b, 1.0 - xx - yy]])
    c, s = np.cos(roll_rad), np.sin(roll_rad)
    roll = _matrices([[c, s, zero], [-s, c, zero], [zero, zero, zero + 1.0]])
    return np.einsum("nij,njk,nkl->nil", roll, move, attitude)


def _matrices(rows: list[list[Array]]) -> Array:
    """(n, 3, 3) from nine arrays (n,)."""
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def slewed(start: Array, stop: Array, share: Array) -> Array:
    """Attitudes (n, 3, 3) on the shortest turn from `start` to `stop`, at shares (n,) of its angle.

    For a turn by exactly 180 degrees, where every axis across is the shortest, one is taken.
    """
    vector = rotation_vector(np.einsum("nji,njk->nik", stop, start))  # takes rows to rows
    return np.einsum("nij,nkj->nik", start, rotation_of(vector * share[:, None]))


def rotation_vector(turn: Array) -> Array:
    """Rotation vectors (n, 3) [rad, up to pi] of rotation matrices (n, 3, 3), by quaternions."""
    q = quaternion_of(turn)
    q = np.where(q[:, 3:] < 0.0, -q, q)
    sine = np.sqrt(np.sum(q[:, :3] ** 2, axis=-1))
    angle = 2.0 * np.arctan2(sine, q[:, 3])
    return q[:, :3] * np.where(sine > 1e-300, angle / np.maximum(sine, 1e-300), 2.0)[:, None]


def rotation_of(vector: Array) -> Array:
    """Rotation matrices (n, 3, 3) of rotation vectors (n, 3) (Rodrigues)."""
    angle = np.sqrt(np.sum(vector**2, axis=-1))
    axis = unit(vector)
    x, y, z = axis[:, 0], axis[:, 1], axis[:, 2]
    zero = np.zeros_like(x)
    k = _matrices([[zero, -z, y], [z, zero, -x], [-y, x, zero]])
    sine, versine = np.sin(angle)[:, None, None], 2.0 * np.sin(0.5 * angle)[:, None, None] ** 2
    return np.eye(3) + sine * k + versine * np.einsum("nij,njk->nik", k, k)


def quaternion_of(turn: Array) -> Array:
    """Unit quaternions (n, 4), scalar last, of rotation matrices (n, 3, 3).

    From the largest of the four components (Shepperd 1978, J. Guidance 1, 223), so that no angle
    loses digits.
    """
    m = turn
    trace = m[:, 0, 0] + m[:, 1, 1] + m[:, 2, 2]
    square = np.stack([m[:, 0, 0], m[:, 1, 1], m[:, 2, 2], trace], axis=-1)
    square = 1.0 + 2.0 * square - trace[:, None]  # 4 q^2
    largest = np.argmax(square, axis=-1)
    xy, xz, yz = (m[:, i, j] + m[:, j, i] for i, j in ((0, 1), (0, 2), (1, 2)))
    wx, wy, wz = (m[:, i, j] - m[:, j, i] for i, j in ((2, 1), (0, 2), (1, 0)))
    rows = np.stack(
        [
            np.stack([square[:, 0], xy, xz, wx], -1),
            np.stack([xy, square[:, 1], yz, wy], -1),
            np.stack([xz, yz, square[:, 2], wz], -1),
            np.stack([wx, wy, wz, square[:, 3]], -1),
        ],
        axis=1,
    )
    return unit(rows[np.arange(len(m)), largest])


def slew_share(
    t_s: Array, duration_s: float, profile: Literal["minimum_jerk", "bang_bang"]
) -> Array:
    """Share (n,) of a slew's angle that is done at times (n,) after its start; 0 before, 1 after.

    minimum_jerk : 10 s^3 - 15 s^4 + 6 s^5 (Flash & Hogan 1985, J. Neurosci. 5, 1688, eq. 2)
    bang_bang : half the time at constant acceleration, half braking
    """
    s = np.clip(t_s / duration_s, 0.0, 1.0)
    if profile == "minimum_jerk":
        return s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    return np.where(s < 0.5, 2.0 * s**2, 1.0 - 2.0 * (1.0 - s) ** 2)


def settling(t_s: Array, amplitude: float, frequency_hz: float, damping: float) -> Array:
    """Oscillation (n,) at times (n,) after the end of a slew; 0 before it, and at its end."""
    w, t = 2.0 * np.pi * frequency_hz, np.maximum(t_s, 0.0)
    return amplitude * np.exp(-damping * w * t) * np.sin(w * np.sqrt(1.0 - damping**2) * t)
