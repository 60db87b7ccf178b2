"""Attitude laws against scipy's rotations and their own definitions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from pipeline.errors import BadInput
from pipeline.physics.targets.attitude import (
    axes_towards,
    in_body_axes,
    nadir_attitude,
    quaternion_matrices,
    spin_attitude,
    sun_attitude,
    table_attitude,
    tracking_attitude,
    velocity_attitude,
)
from pipeline.physics.vectors import unit

SEEDS = st.integers(0, 2**32 - 1)


def vectors(seed: int, *shape: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(*shape, 3))


def check_rotations(r: np.ndarray) -> None:
    np.testing.assert_allclose(np.swapaxes(r, -1, -2) @ r, np.broadcast_to(np.eye(3), r.shape),
                               atol=1e-13)  # fmt: skip
    np.testing.assert_allclose(np.linalg.det(r), 1.0, atol=1e-13)


@settings(max_examples=30, deadline=None)
@given(SEEDS)
def test_against_scipy(seed) -> None:
    rng = np.random.default_rng(seed)
    q = rng.normal(size=(200, 4)) * rng.uniform(1e-3, 1e3, (200, 1))
    ours = quaternion_matrices(q)
    np.testing.assert_allclose(ours, Rotation.from_quat(np.roll(q, -1, 1)).as_matrix(), atol=1e-15)
    axis, angle = vectors(seed, 200), rng.uniform(-10, 10, 200)
    turn = Rotation.from_rotvec(unit(axis) * angle[:, None]).as_matrix()
    np.testing.assert_allclose(spin_attitude(ours, axis, angle), ours @ turn, atol=3e-15)
    times = np.cumsum(rng.uniform(0.1, 3, 200))
    at = rng.uniform(times[0], times[-1], 500)
    slerp = Slerp(times, Rotation.from_quat(np.roll(q, -1, 1)))
    signs = rng.choice([-1.0, 1.0], (200, 1))
    np.testing.assert_allclose(table_attitude(times, q * signs, at), slerp(at).as_matrix(),
                               atol=1e-12)  # fmt: skip
    v = vectors(seed, 200)
    np.testing.assert_allclose(in_body_axes(ours, np.einsum("nij,nj->ni", ours, v)), v, atol=1e-13)


@settings(max_examples=30, deadline=None)
@given(SEEDS)
def test_same_definitions_of_the_pointing_laws(seed) -> None:
    place, speed, sun = (unit(vectors(seed + k, 50, 4)) for k in range(3))
    normal = unit(np.cross(place, speed))
    nadir = nadir_attitude(7e6 * place, 7e3 * speed)
    np.testing.assert_allclose(nadir[..., 2], -place, atol=1e-14)
    np.testing.assert_allclose(nadir[..., 1], -normal, atol=1e-12)
    assert np.all(np.sum(nadir[..., 0] * speed, -1) > 0)
    ram = velocity_attitude(7e6 * place, 7e3 * speed)
    np.testing.assert_allclose(ram[..., 2], speed, atol=1e-14)
    np.testing.assert_allclose(ram[..., 1], normal, atol=1e-12)
    to_sun = sun_attitude(sun, place, speed)
    np.testing.assert_allclose(to_sun[..., 2], sun, atol=1e-14)
    axis = vectors(seed + 5, 50, 1)
    panel = tracking_attitude(nadir, axis, sun)
    hinge = np.einsum("...ij,...j->...i", nadir, unit(axis))
    np.testing.assert_allclose(panel[..., 1], hinge, atol=1e-14)
    best = np.sqrt(1 - np.sum(sun * hinge, -1) ** 2)  # no angle of the hinge gets more light
    np.testing.assert_allclose(np.sum(panel[..., 2] * sun, -1), best, atol=1e-12)
    for attitude in (nadir, ram, to_sun, panel):
        check_rotations(attitude)


def test_limits_parallel_directions_give_some_frame() -> None:
    z = np.array([[0.0, 0, 1], [1, 0, 0], [0, -1, 0], [0.6, 0.8, 0]])
    for hint in (z, -z, 0 * z, z + 1e-14):
        frame = axes_towards(z, hint)
        check_rotations(frame)
        np.testing.assert_allclose(frame[..., 2], z, atol=1e-15)
    panel = tracking_attitude(np.eye(3), np.array([0.0, 1, 0]), np.array([0.0, 1, 0]))
    check_rotations(panel)
    check_rotations(nadir_attitude(z * 7e6, z * 1e3))  # straight up


def test_table_must_cover_the_times() -> None:
    with pytest.raises(BadInput, match=r"t\.times_s: '0 to 1' .* covers"):
        table_attitude([0, 1], [[1, 0, 0, 0], [0, 1, 0, 0]], np.array([0.5, 1.5]), "t")


@pytest.mark.parametrize("off", [1e-3, 1e-7, 1e-10])
def test_a_hint_fixes_y_however_near_it_is_to_z(off: float) -> None:
    """To what rounding leaves of it."""
    found = axes_towards(np.array([0.0, 0.0, 2.0]), np.array([3.0 * off, 4.0 * off, 1.0]))
    np.testing.assert_allclose(found[:, 1], [0.6, 0.8, 0.0], atol=1e-5)
