"""Which of very many satellites may stand above an elevation, step by step: none is missed."""

from __future__ import annotations

import numpy as np
from numba import njit

from pipeline.physics.constants import EARTH_EQUATORIAL_RADIUS_M

PULL_M_S2 = 20.0  # no satellite and observer above the ground accelerate more against each other
ROOM_M = 100.0  # light time, a leap second, rounding
_UMBRA_SLOPE = 0.00475  # by which the umbra narrows, at least (Sun and Earth at their nearest)
_UMBRA_RADIUS_M = EARTH_EQUATORIAL_RADIUS_M - 40_000.0  # of an oblate Earth, with room


@njit(cache=True, nogil=True, error_model="numpy")
def may_be_seen(place, speed, observer, motion, up, lowest, turn, works, sun, half_s, lit):
    """Whether satellites may stand above an elevation, within `half_s` of each of n moments.

    place, speed : (m, n, 3) of satellites [m], [m/s]; observer, motion, up : (n, 3) of the
    observer and its vertical; lowest : (n,) least elevation [rad]; turn : (n,) rate [rad/s] of
    the vertical; works : (n,) whether anything is looked at; sun : (n, 3) unit vectors;
    lit : leave out what is deep in the umbra (of each moment itself: with half_s = 0). Any axes
    that do not turn. Returns (m, n) bool.

    In half an interval h a satellite moves against the observer by at most h |v - v_o| + a h^2/2,
    and so is seen to rise by at most the arcsine of that over its distance.
    """
    m, n = place.shape[0], place.shape[1]
    out = np.zeros((m, n), np.bool_)
    least_sine = np.sin(np.maximum(lowest - 1e-9, -0.5 * np.pi))
    fall = 0.5 * half_s * half_s * PULL_M_S2 + ROOM_M
    for k in range(n):
        if not works[k]:
            continue
        for i in range(m):
            x = place[i, k, 0] - observer[k, 0]
            y = place[i, k, 1] - observer[k, 1]
            z = place[i, k, 2] - observer[k, 2]
            distance = np.sqrt(x * x + y * y + z * z)
            sine = (x * up[k, 0] + y * up[k, 1] + z * up[k, 2]) / distance
            if sine < least_sine[k]:
                u = speed[i, k, 0] - motion[k, 0]
                v = speed[i, k, 1] - motion[k, 1]
                w = speed[i, k, 2] - motion[k, 2]
                moved = half_s * np.sqrt(u * u + v * v + w * w) + fall
                if moved < distance:
                    rise = np.arcsin(moved / distance) + half_s * turn[k]
                    if np.arcsin(max(-1.0, min(1.0, sine))) + rise < lowest[k]:
                        continue
            if lit and _deep_in_umbra(place[i, k], sun[k]):
                continue
            out[i, k] = True
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _deep_in_umbra(place, sun):
    """Whether a place is inside the umbra of a round Earth, with room to its edge."""
    along = place[0] * sun[0] + place[1] * sun[1] + place[2] * sun[2]
    if along >= 0.0:
        return False
    x, y, z = place[0] - along * sun[0], place[1] - along * sun[1], place[2] - along * sun[2]
    radius = _UMBRA_RADIUS_M + along * _UMBRA_SLOPE
    return radius > 0.0 and x * x + y * y + z * z < radius * radius
