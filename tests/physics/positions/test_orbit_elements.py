"""Keplerian elements against Kepler's equation in 50 digits, near the parabola and far in time."""

from __future__ import annotations

from typing import Any

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.errors import BadInput
from pipeline.physics.constants import EARTH_GM_M3_S2
from pipeline.physics.positions.orbit_elements import (
    keplerian_states,
    mean_anomaly_rad,
    perigee_radius,
    since_perigee_by_mean_anomaly,
    since_perigee_by_true_anomaly,
)

mp.mp.dps = 50


def exact(q: float, e: float, t: float) -> np.ndarray:
    """Perifocal place from Kepler's, Barker's or the hyperbolic equation, solved by bisection."""
    gm, q_, e_, t_ = (mp.mpf(x) for x in (EARTH_GM_M3_S2, q, e, t))
    if e == 1:
        b = 3 * t_ * mp.sqrt(gm / (2 * q_**3)) / 2
        y = mp.cbrt(b + mp.sqrt(b * b + 1)) if b >= 0 else -mp.cbrt(-b + mp.sqrt(b * b + 1))
        w = y - 1 / y
        return np.array([float(q_ * (1 - w * w)), float(2 * q_ * w), 0.0])
    a = q_ / abs(1 - e_)
    m = t_ * mp.sqrt(gm / a**3)
    if e < 1:
        root = solve(lambda x: x - e_ * mp.sin(x) - m, m - 1, m + 1)
        x, y = a * (mp.cos(root) - e_), a * mp.sqrt((1 - e_) * (1 + e_)) * mp.sin(root)
    else:
        edge = mp.asinh(abs(m) / (e_ - 1)) + mp.cbrt(6 * abs(m)) + 1
        root = solve(lambda x: e_ * mp.sinh(x) - x - m, -edge, edge)
        x, y = a * (e_ - mp.cosh(root)), a * mp.sqrt((e_ - 1) * (e_ + 1)) * mp.sinh(root)
    return np.array([float(x), float(y), 0.0])


def solve(f: Any, low: Any, high: Any) -> Any:
    for _ in range(190):
        middle = (low + high) / 2
        low, high = (middle, high) if f(middle) < 0 else (low, middle)
    return (low + high) / 2


NEAR = [1 - 1e-3, 1 - 1e-7, 1 - 1e-12, 1.0, 1 + 1e-12, 1 + 1e-7, 1 + 1e-3]


@pytest.mark.parametrize("e", [0.0, 0.3, 0.75, *NEAR, 1.5, 20.0])
def test_against_kepler(e: float) -> None:
    """From an hour before the perigee to a year after it."""
    for t in (-3600.0, 10.0, 1e5, 3e7):
        place, speed = keplerian_states(7e6, e, 0.0, 0.0, 0.0, np.array([t]))
        wanted = exact(7e6, e, t)
        turns = t / (2 * np.pi * np.sqrt((7e6 / (1 - e)) ** 3 / EARTH_GM_M3_S2)) if e < 1 else 0
        room = 1e-13 + 4e-15 * abs(turns) / (1 - min(e, 0.9))
        assert np.linalg.norm(place[0] - wanted) < room * np.linalg.norm(wanted) + 1e-7
        energy = 0.5 * np.sum(speed**2) - EARTH_GM_M3_S2 / np.linalg.norm(place)
        assert abs(energy - 0.5 * EARTH_GM_M3_S2 / 7e6 * (e - 1)) < 1e-13 * EARTH_GM_M3_S2 / 7e6 * (
            1 + e
        )


@pytest.mark.parametrize("e", [1 - 1e-12, 1.0, 1 + 1e-12])
@pytest.mark.parametrize("q", [6.7e6, 8.1e6])
def test_nothing_is_lost_near_the_parabola_whatever_the_time(q: float, e: float) -> None:
    for t in (1e9, 1e11, 1e13):
        place, _ = keplerian_states(q, e, 0.0, 0.0, 0.0, np.array([t]))
        wanted = exact(q, e, t)
        assert np.linalg.norm(place[0] - wanted) < 1e-14 * np.linalg.norm(wanted)


@settings(max_examples=200)
@given(
    st.one_of(st.floats(0.0, 0.99), st.sampled_from(NEAR), st.floats(1.01, 8.0)),
    st.floats(-1.0, 1.0),
    st.floats(6.5e6, 1e8),
)
def test_true_anomaly_and_back(e: float, share: float, q: float) -> None:
    widest = np.pi if e < 0.999 else 0.97 * (np.arccos(-1 / e) if e >= 1 else np.pi)
    nu = 0.99 * share * widest
    t = since_perigee_by_true_anomaly(nu, q, e)
    place, _ = keplerian_states(q, e, 0.0, 0.0, 0.0, np.array([t]))
    assert abs(np.arctan2(place[0, 1], place[0, 0]) - nu) < 1e-10
    radius = q * (1 + e) / (1 + e * np.cos(nu))
    assert np.linalg.norm(place[0]) == pytest.approx(radius, rel=1e-9)


def test_angles_turn_the_orbit() -> None:
    """Against three rotations written out: node, inclination, argument of perigee."""
    i, node, w = 0.7, 2.1, -0.4
    flat = keplerian_states(7e6, 0.4, 0.0, 0.0, 0.0, np.array([500.0]))
    c, s = np.cos, np.sin

    def about_z(x: float) -> np.ndarray:
        return np.array([[c(x), -s(x), 0], [s(x), c(x), 0], [0, 0, 1.0]])

    tilt = np.array([[1, 0, 0], [0, c(i), -s(i)], [0, s(i), c(i)]])
    turn = about_z(node) @ tilt @ about_z(w)
    found = keplerian_states(7e6, 0.4, i, node, w, np.array([500.0]))
    for a, b in zip(found, flat, strict=True):
        assert np.allclose(a[0], turn @ b[0], rtol=1e-14, atol=1e-8)


def test_mean_anomaly() -> None:
    a, e = 2.6e7, 0.3
    q = perigee_radius(a, e)
    period = 2 * np.pi * np.sqrt(a**3 / EARTH_GM_M3_S2)
    t = since_perigee_by_mean_anomaly(mean_anomaly_rad(90.0 + 360e3, e), q, e)
    assert t == pytest.approx(0.25 * period, rel=1e-12)
    assert perigee_radius(-3e7, 1.2) == pytest.approx(6e6)


def test_limits_beyond_the_asymptote() -> None:
    for e, nu in ((1.0, np.pi), (2.0, 2.2)):
        with pytest.raises(BadInput, match="true_anomaly_deg"):
            since_perigee_by_true_anomaly(nu, 7e6, e, "targets.0.orbit")
