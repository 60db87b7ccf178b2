"""Keplerian elements of any eccentricity: from the perigee on by two-body motion."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pipeline.errors import BadInput
from pipeline.physics.constants import DEG_RAD, EARTH_GM_M3_S2
from pipeline.physics.positions.orbit_two_body import two_body, universal_functions

Array = NDArray[np.float64]


def keplerian_states(
    perigee_radius_m: float,
    eccentricity: float,
    inclination_rad: float,
    raan_rad: float,
    argument_of_perigee_rad: float,
    since_perigee_s: ArrayLike,
) -> tuple[Array, Array]:
    """Positions [m] and velocities [m/s] (n, 3) at times since perigee, in the elements' axes."""
    place, speed, inverse_axis = perigee_state(
        perigee_radius_m, eccentricity, inclination_rad, raan_rad, argument_of_perigee_rad
    )
    return two_body(place, speed, since_perigee_s, inverse_axis_m=inverse_axis)


def perigee_state(
    perigee_radius_m: float,
    eccentricity: float,
    inclination_rad: float,
    raan_rad: float,
    argument_of_perigee_rad: float,
) -> tuple[Array, Array, float]:
    """Place [m], velocity [m/s] (3,) at perigee and 1/a [1/m], as `two_body` takes them.

    The state at perigee is exact for every eccentricity, and 1/a = (1 - e)/q is handed on as it
    is, so that nothing is lost near the parabola, whatever the time.
    """
    speed = math.sqrt(EARTH_GM_M3_S2 * (1.0 + eccentricity) / perigee_radius_m)
    to_perigee, ahead = _perifocal(inclination_rad, raan_rad, argument_of_perigee_rad)
    inverse_axis = (1.0 - eccentricity) / perigee_radius_m
    return perigee_radius_m * to_perigee, speed * ahead, inverse_axis


def perigee_radius(semi_major_axis_m: float, eccentricity: float) -> float:
    """q = a (1 - e): both factors are negative for a hyperbola."""
    return semi_major_axis_m * (1.0 - eccentricity)


def since_perigee_by_mean_anomaly(
    mean_anomaly_rad: float, perigee_radius_m: float, eccentricity: float
) -> float:
    """Seconds since perigee, M sqrt(|a|^3 / GM); the ellipse and the hyperbola have one."""
    axis = perigee_radius_m / abs(1.0 - eccentricity)
    return mean_anomaly_rad * math.sqrt(axis / EARTH_GM_M3_S2) * axis


def since_perigee_by_true_anomaly(
    true_anomaly_rad: float, perigee_radius_m: float, eccentricity: float, field: str = "orbit"
) -> float:
    """Seconds since perigee at a true anomaly, in closed form for every eccentricity.

    With q = GM = 1 and alpha = 1 - e: U1(s/2)/U0(s/2) = tan(nu/2)/sqrt(1 + e), t = U1(s) + U3(s)
    (Battin 1999, section 4.5). Raises BadInput beyond the asymptotes of a hyperbola and opposite to
    the perigee of a parabola.
    """
    nu = math.remainder(true_anomaly_rad, 2.0 * math.pi)
    if eccentricity >= 1.0 and not 1.0 + eccentricity * math.cos(nu) > 1e-12:
        edge = math.degrees(math.acos(-1.0 / eccentricity))
        raise BadInput(
            f"{field}.true_anomaly_deg", math.degrees(nu), f"between -{edge:.6f} and {edge:.6f}"
        )
    alpha = 1.0 - eccentricity
    tangent = math.tan(0.5 * nu) / math.sqrt(1.0 + eccentricity)
    x = alpha * tangent * tangent
    if abs(x) < 1e-2:  # atan(sqrt x)/sqrt x = sum (-x)^k / (2k + 1)
        s = 2.0 * tangent * sum((-x) ** k / (2 * k + 1) for k in range(9))
    elif alpha > 0.0:
        s = 2.0 * math.atan(math.sqrt(alpha) * tangent) / math.sqrt(alpha)
    else:
        s = 2.0 * math.atanh(math.sqrt(-alpha) * tangent) / math.sqrt(-alpha)
    _, u1, _, u3 = universal_functions(np.array([s]), alpha)
    return float(u1[0] + u3[0]) * math.sqrt(perigee_radius_m / EARTH_GM_M3_S2) * perigee_radius_m


def mean_anomaly_rad(degrees: float, eccentricity: float) -> float:
    """Mean anomaly [rad], of an ellipse reduced to half a turn either way."""
    return (math.remainder(degrees, 360.0) if eccentricity < 1.0 else degrees) * DEG_RAD


def _perifocal(i: float, node: float, w: float) -> tuple[Array, Array]:
    """Unit vectors to the perigee and along the motion there."""
    ci, si, cn, sn, cw, sw = (f(x) for x in (i, node, w) for f in (math.cos, math.sin))
    return (
        np.array([cn * cw - sn * sw * ci, sn * cw + cn * sw * ci, sw * si]),
        np.array([-cn * sw - sn * cw * ci, -sn * sw + cn * cw * ci, cw * si]),
    )
