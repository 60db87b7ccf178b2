"""Camera frames, drifting scans and proper attitudes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.physics.motion.pointing import (
    attitudes_drift,
    boresight_frame,
    drift,
    east_north,
    proper_attitude,
)
from pipeline.physics.vectors import from_angles, separation, to_angles, unit

ARCSEC = np.pi / 648000


def direction(lon: float, lat: float) -> np.ndarray:
    return from_angles(np.array(lon), np.array(lat))


@given(st.floats(0, 6.28), st.floats(-1.5707963, 1.5707963), st.floats(-7, 7))
def test_frames_are_left_handed_and_orthonormal(lon: float, lat: float, roll: float) -> None:
    a = boresight_frame(direction(lon, lat), roll)
    assert np.allclose(a @ a.T, np.eye(3), atol=1e-13)
    assert np.linalg.det(a) == pytest.approx(-1, abs=1e-13)


@given(st.floats(0, 6.28), st.floats(-1.5, 1.5), st.floats(0, 6.28))
def test_against_astropy_position_angle(lon: float, lat: float, roll: float) -> None:
    from astropy.coordinates import position_angle

    a = boresight_frame(direction(lon, lat), roll)
    up = to_angles(a[2] + 1e-4 * a[1])
    angle = position_angle(lon, lat, *up).rad
    assert abs(np.angle(np.exp(1j * (angle - roll)))) < 2e-3 / np.cos(lat)


def test_roll_zero_shows_the_sky_with_east_left() -> None:
    a = boresight_frame(np.array([1.0, 0.0, 0.0]), 0.0)
    assert np.allclose(a, [[0, -1, 0], [0, 0, 1], [1, 0, 0]], atol=1e-16)
    b = boresight_frame(np.array([1.0, 0.0, 0.0]), np.pi / 2)  # +y to the east
    assert np.allclose(b[1], [0, 1, 0], atol=1e-16)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_limits_poles_use_the_meridian_of_zero(sign: float) -> None:
    pole = np.array([0.0, 0.0, sign])
    east, north = east_north(pole)
    assert np.array_equal(east, [0, 1, 0])
    assert np.array_equal(north, [-sign, 0, 0])
    near = boresight_frame(direction(0.0, sign * (np.pi / 2 - 1e-12)), 0.3)
    assert np.allclose(boresight_frame(pole, 0.3), near, atol=1e-11)


def test_same_frames_in_batches() -> None:
    d = unit(np.random.Generator(np.random.SFC64(5)).normal(size=(4, 3)))
    rolls = np.array([0.0, 1.0, 2.0, 3.0])
    many = boresight_frame(d, rolls)
    assert many.shape == (4, 3, 3)
    for i in range(4):
        assert np.array_equal(many[i], boresight_frame(d[i], rolls[i]))


def test_drift_runs_at_the_asked_rate_and_heading() -> None:
    b = direction(1.0, 0.8)
    t = np.array([-3.0, 0.0, 0.01, 5.0, 3600.0])
    rate_e, rate_n = 15 * ARCSEC, -4 * ARCSEC
    path = drift(b, rate_e, rate_n, t)
    assert np.allclose(separation(path, b), np.hypot(rate_e, rate_n) * np.abs(t), atol=1e-14)
    east, north = east_north(b)
    step = path[2] - b
    assert step @ east == pytest.approx(rate_e * 0.01, rel=1e-6)
    assert step @ north == pytest.approx(rate_n * 0.01, rel=1e-6)
    plane = np.cross(path[0], path[3])
    assert np.max(np.abs(path @ unit(plane))) < 1e-13  # one great circle


def test_drift_carries_its_frame_by_parallel_transport() -> None:
    b, t = direction(0.3, -1.2), np.linspace(0, 2000, 9)
    rates = (100 * ARCSEC, 50 * ARCSEC)
    a = attitudes_drift(b, 0.7, *rates, t)
    path = drift(b, *rates, t)
    assert np.allclose(a[:, 2], path, atol=1e-14)
    assert np.allclose(a[0], boresight_frame(b, 0.7), atol=1e-15)
    later = drift(b, *rates, t + 1.0)
    heading = np.einsum("nij,nj->ni", a, unit(later - path))[:, :2]
    assert np.allclose(heading, heading[0], atol=1e-10)


def test_limits_no_drift_and_drift_over_the_pole() -> None:
    b = direction(1.0, 0.5)
    assert np.allclose(drift(b, 0.0, 0.0, [0.0, 1e6]), b, atol=1e-15)
    start = direction(0.0, np.pi / 2 - 1e-3)
    over = drift(start, 0.0, 1e-3, [2.0])[0]
    assert np.allclose(to_angles(over), [np.pi, np.pi / 2 - 1e-3], atol=1e-12)


def test_proper_attitude_moves_the_boresight_and_nothing_more() -> None:
    d = unit(np.random.Generator(np.random.SFC64(6)).normal(size=(5, 3)))
    moved = unit(d + 1e-4 * np.roll(d, 1, axis=1))
    a = boresight_frame(d, 0.4)
    p = proper_attitude(a, moved)
    assert np.allclose(p[:, 2], moved, atol=1e-15)
    assert np.allclose(p @ np.swapaxes(p, 1, 2), np.eye(3), atol=1e-14)
    axis = np.cross(d, moved)
    assert np.allclose(np.einsum("nij,nj->ni", p - a, axis), 0, atol=1e-15)
    assert np.array_equal(proper_attitude(a[0], d[0]), a[0])
