"""Where the camera looks: frames about a boresight, drifting scans, and their proper attitude."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pipeline.physics.vectors import rotate_about, rotate_minimal, unit

Array = NDArray[np.float64]


def east_north(direction: Array) -> tuple[Array, Array]:
    """Unit vectors towards east and north at directions (..., 3).

    At a pole, where both are undefined, those of the meridian of right ascension 0: the limit of
    approaching the pole along it.
    """
    d = np.asarray(direction, float)
    rho = np.hypot(d[..., 0], d[..., 1])
    safe = np.where(rho > 0.0, rho, 1.0)
    cos_ra = np.where(rho > 0.0, d[..., 0] / safe, 1.0)
    sin_ra = np.where(rho > 0.0, d[..., 1] / safe, 0.0)
    east = np.stack([-sin_ra, cos_ra, np.zeros_like(rho)], axis=-1)
    north = np.stack([-d[..., 2] * cos_ra, -d[..., 2] * sin_ra, rho], axis=-1)
    return east, unit(north)


def boresight_frame(direction: Array, roll_rad: ArrayLike = 0.0) -> Array:
    """Attitudes (..., 3, 3) of a camera that looks along directions (..., 3).

    Rows are the camera's +x (columns), +y (rows) and boresight axes. The roll is the position angle
    of +y from north through east; at roll 0, +y is north and +x west (see `focal_plane.Camera`;
    determinant -1). At a pole north is that of the meridian of right ascension 0.
    """
    boresight = unit(np.asarray(direction, float))
    east, north = east_north(boresight)
    c, s = np.cos(np.asarray(roll_rad))[..., None], np.sin(np.asarray(roll_rad))[..., None]
    return np.stack([s * north - c * east, c * north + s * east, boresight], axis=-2)


def drift(
    boresight: Array, rate_east_rad_s: float, rate_north_rad_s: float, offsets_s: ArrayLike
) -> Array:
    """Directions (n, 3) of a boresight that moves along a great circle at constant rate.

    The rates [rad/s on the sky] set the tangent of the circle at offset 0, where the boresight (3,)
    is. A great circle is no parallel of declination: its position angle turns on the way.
    """
    rotations = _drift_rotations(boresight, rate_east_rad_s, rate_north_rad_s, offsets_s)
    return unit(rotations @ unit(np.asarray(boresight, float)))


def attitudes_drift(
    boresight: Array,
    roll_rad: float,
    rate_east_rad_s: float,
    rate_north_rad_s: float,
    offsets_s: ArrayLike,
) -> Array:
    """Attitudes (n, 3, 3) along a `drift`: the frame of offset 0 carried by parallel transport.

    The motion keeps its direction in the camera, so that a scan streaks along one line of pixels.
    """
    rotations = _drift_rotations(boresight, rate_east_rad_s, rate_north_rad_s, offsets_s)
    return boresight_frame(boresight, roll_rad) @ np.swapaxes(rotations, -1, -2)


def attitudes_swept(
    boresight: Array,
    roll_rad: float,
    rate_rad_s: tuple[float, float],
    acceleration_rad_s2: tuple[float, float],
    offsets_s: ArrayLike,
) -> Array:
    """Attitudes (n, 3, 3) of a boresight that is accelerated: rates (east, north) at offset 0.

    The frame of offset 0 is turned on the shortest way to where the arc d = rate t + a t^2 / 2,
    laid from the boresight along its own direction, ends. Without acceleration `attitudes_drift`.
    """
    t = np.atleast_1d(np.asarray(offsets_s, float))
    b = unit(np.asarray(boresight, float))
    east, north = east_north(b)
    e, n = (r * t + 0.5 * a * t**2 for r, a in zip(rate_rad_s, acceleration_rad_s2, strict=True))
    axes = np.cross(b, unit(e[:, None] * east + n[:, None] * north))
    rotations = rotate_about(axes, np.hypot(e, n))
    return boresight_frame(boresight, roll_rad) @ np.swapaxes(rotations, -1, -2)


def attitudes_local(
    axes: Array, azimuth_rad: float, elevation_rad: float, roll_rad: float
) -> Array:
    """Attitudes (n, 3, 3) that hold a direction in local axes (n, 3, 3): forward, right, up.

    Of a site: north, east, zenith. Azimuth from forward to the right, elevation from the plane of
    both; at roll 0, +y points to the zenith's side and +x to the right; the roll turns +y from up
    to the left (as from north through east on the sky).
    """
    forward, right, up = axes[:, 0], axes[:, 1], axes[:, 2]
    ca, sa = np.cos(azimuth_rad), np.sin(azimuth_rad)
    ce, se = np.cos(elevation_rad), np.sin(elevation_rad)
    level = ca * forward + sa * right
    boresight, above = ce * level + se * up, ce * up - se * level
    left = sa * forward - ca * right
    c, s = np.cos(roll_rad), np.sin(roll_rad)
    return np.stack([s * above - c * left, c * above + s * left, boresight], axis=-2)


def proper_attitude(attitude_astrometric: Array, boresight_proper: Array) -> Array:
    """Attitudes (n, 3, 3) turned so that the boresight becomes the proper direction (n, 3).

    The smallest rotation from the astrometric to the proper boresight. So sidereal pointing holds
    the given ICRS place at the frame's centre as a guided telescope does, and target tracking holds
    the target there. Raises ValueError for opposite directions.
    """
    attitude = np.asarray(attitude_astrometric, float)
    turn = rotate_minimal(attitude[..., 2, :], np.asarray(boresight_proper, float))
    return attitude @ np.swapaxes(turn, -1, -2)


def _drift_rotations(
    boresight: Array, rate_east_rad_s: float, rate_north_rad_s: float, offsets_s: ArrayLike
) -> Array:
    """Rotation matrices (n, 3, 3) that carry the boresight at offset 0 to each offset."""
    b = unit(np.asarray(boresight, float))
    east, north = east_north(b)
    axis = unit(np.cross(b, rate_east_rad_s * east + rate_north_rad_s * north))
    rate = float(np.hypot(rate_east_rad_s, rate_north_rad_s))
    return rotate_about(axis, rate * np.atleast_1d(np.asarray(offsets_s, float)))
