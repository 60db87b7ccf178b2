"""Vectors and rotations at their limiting cases."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from pipeline.physics.vectors import (
    from_angles,
    rotate_about,
    rotate_minimal,
    separation,
    to_angles,
    unit,
)

directions = (
    arrays(np.float64, 3, elements=st.floats(-1, 1, allow_subnormal=False))
    .filter(lambda v: np.linalg.norm(v) > 1e-3)
    .map(unit)
)


@given(st.floats(0, 6.283), st.floats(-1.5707, 1.5707))
def test_same_angles_there_and_back(lon: float, lat: float) -> None:
    back = to_angles(from_angles(np.array(lon), np.array(lat)))
    assert np.allclose(back, (lon, lat), atol=1e-12)


def test_limits_longitude_stays_below_a_turn() -> None:
    lon, lat = to_angles(np.array([[1.0, -1e-300, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -2.0]]))
    assert np.all((lon >= 0) & (lon < 2 * np.pi))
    assert lat[2] == -np.pi / 2


def test_limits_separation_keeps_small_and_opposite_angles() -> None:
    a = np.array([1.0, 0.0, 0.0])
    for angle in (1e-15, 1e-9, 1.0, np.pi - 1e-9):
        b = np.array([np.cos(angle), np.sin(angle), 0.0])
        assert separation(a, b) == pytest.approx(angle, rel=1e-6 if angle > 3 else 1e-14, abs=0)


def test_limits_unit_of_zero_is_zero() -> None:
    assert np.all(unit(np.zeros((2, 3))) == 0)


@given(directions, directions)
def test_rotate_minimal_is_a_rotation_that_arrives(a: np.ndarray, b: np.ndarray) -> None:
    if a @ b < -0.999:
        return
    m = rotate_minimal(a, b)
    assert np.allclose(m @ a, b, atol=1e-12)
    assert np.allclose(m @ m.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(m) == pytest.approx(1, abs=1e-12)
    assert np.allclose(m @ np.cross(a, b), np.cross(a, b), atol=1e-12)  # the shortest way


def test_limits_rotate_minimal_refuses_opposites() -> None:
    x = np.array([1.0, 0, 0])
    with pytest.raises(ValueError, match="opposite"):
        rotate_minimal(x, -x)
    assert np.array_equal(rotate_minimal(x, x), np.eye(3))


def test_same_rotations_in_batches_and_one_by_one() -> None:
    rng = np.random.Generator(np.random.SFC64(1))
    a, b = unit(rng.normal(size=(2, 5, 3)))
    angles = rng.uniform(-4, 4, 5)
    many, about = rotate_minimal(a, b), rotate_about(a, angles)
    for i in range(5):
        assert np.array_equal(many[i], rotate_minimal(a[i], b[i]))
        assert np.array_equal(about[i], rotate_about(a[i], float(angles[i])))


def test_against_scipy_rotations() -> None:
    from scipy.spatial.transform import Rotation

    axis = unit(np.array([1.0, -2.0, 0.5]))
    for angle in (1e-12, 0.3, 3.0, -5.0):
        expected = Rotation.from_rotvec(axis * angle).as_matrix()
        assert np.allclose(rotate_about(axis, angle), expected, atol=1e-15)
