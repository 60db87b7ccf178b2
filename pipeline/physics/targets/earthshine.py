"""Sunlight that the Earth sends up to a target: its lit and visible part as many small lamps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.physics.constants import EARTH_EQUATORIAL_RADIUS_M
from pipeline.physics.vectors import separation, unit

Array = NDArray[np.float64]

NODES = 16  # across and along; error of the total below 5e-4 from 300 km up (tests)


def earth_lamps(
    target_geocentric_m: Array, sun_from_earth_m: Array, albedo: float, nodes: int = NODES
) -> tuple[Array, Array]:
    """Directions (n, k, 3) from a target to parts of the Earth, and their irradiance (n, k).

    Irradiance on a surface that faces the lamp, over the solar irradiance at the Earth:
    (albedo/pi) max(0, n.s) n.u dA/d^2 of a Lambertian sphere. Latitude is counted from the plane
    of Sun, Earth and target, so that limb and terminator bound the longitudes in closed form; then
    Gauss's rule both ways. Omitted: clouds, seas, seasons (the albedo is one number), and a lit
    atmosphere beyond the terminator.

    target_geocentric_m : (n, 3); sun_from_earth_m : (n, 3) or (3,)
    """
    target = np.atleast_2d(np.asarray(target_geocentric_m, float))
    sun = np.broadcast_to(np.asarray(sun_from_earth_m, float), target.shape)
    distance = np.sqrt(np.sum(target * target, -1))
    ratio = np.minimum(EARTH_EQUATORIAL_RADIUS_M / distance, 1.0)[:, None, None]
    up, phase = unit(target), separation(target, sun)[:, None, None]
    east = _across(up, sun)
    north = np.cross(up, east)
    x, w = np.polynomial.legendre.leggauss(nodes)
    limb, near = np.arccos(ratio), np.maximum(1.0 / ratio - 1.0, 1e-9)
    # Latitude and longitude by sinh, crowded below the target as its height asks; the sine takes
    # out the root that the longest longitude seen, cos lat cos lon = R/r, has at the ends.
    turn, most = 0.5 * np.pi * x[None, :, None], np.arcsinh(limb / near)
    latitude = near * np.sinh(most * np.sin(turn))
    height = near * np.cosh(most * np.sin(turn)) * most * 0.5 * np.pi * np.cos(turn) * w[:, None]
    widest = np.arccos(np.minimum(ratio / np.cos(latitude), 1.0))
    low, high = np.maximum(-widest, phase - 0.5 * np.pi), np.minimum(widest, phase + 0.5 * np.pi)
    beside = np.hypot(near, latitude)
    first, last = np.arcsinh(low / beside), np.arcsinh(np.maximum(high, low) / beside)
    place = 0.5 * (last + first) + 0.5 * (last - first) * x
    longitude = beside * np.sinh(place)
    width = 0.5 * (last - first) * beside * np.cosh(place) * w
    area = height * width * np.cos(latitude)
    normal = (
        (np.cos(latitude) * np.cos(longitude))[..., None] * up[:, None, None]
        + (np.cos(latitude) * np.sin(longitude))[..., None] * east[:, None, None]
        + (np.sin(latitude) + 0.0 * longitude)[..., None] * north[:, None, None]
    )
    lit = np.maximum(np.cos(latitude) * np.cos(longitude - phase), 0.0)
    to_earth = normal * ratio[..., None] - up[:, None, None]  # in units of the distance
    squared = np.sum(to_earth * to_earth, -1)
    rise = np.maximum(np.cos(latitude) * np.cos(longitude) - ratio, 0.0) / np.sqrt(squared)
    light = (albedo / np.pi) * lit * rise * area * ratio**2 / squared
    count = len(target)
    return unit(to_earth).reshape(count, -1, 3), light.reshape(count, -1)


def _across(up: Array, sun: Array) -> Array:
    """Unit vectors (n, 3) towards the Sun along the horizon; any where it stands overhead."""
    across = unit(sun) - np.sum(unit(sun) * up, -1, keepdims=True) * up
    lost = np.sum(across * across, -1) < 1e-24
    axis = np.eye(3)[np.argmin(np.abs(up), axis=-1)]
    spare = axis - np.sum(axis * up, -1, keepdims=True) * up
    return unit(np.where(lost[:, None], spare, across))
