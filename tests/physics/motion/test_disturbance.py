"""Turns, slews and tables of attitudes: against scipy's rotations and closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, RotationSpline, Slerp

from pipeline.physics.motion.attitude_table import (
    AttitudeTable,
    attitudes_at,
    conjugate,
    product,
    table_error_rad,
)
from pipeline.physics.motion.disturbance import (
    rotation_of,
    rotation_vector,
    settling,
    slew_share,
    slewed,
    turned,
)
from pipeline.physics.motion.pointing import attitudes_drift, attitudes_swept, boresight_frame
from pipeline.physics.vectors import from_angles

RNG = np.random.default_rng(1)
TURNS = Rotation.random(50, random_state=2)
FRAMES = boresight_frame(
    from_angles(RNG.uniform(0, 6, 50), RNG.uniform(-1.5, 1.5, 50)), RNG.uniform(0, 6, 50)
)
OTHERS = boresight_frame(from_angles(RNG.uniform(0, 6, 50), RNG.uniform(-1.5, 1.5, 50)))


def test_against_scipy_rotation_vectors() -> None:
    assert np.allclose(rotation_vector(TURNS.as_matrix()), TURNS.as_rotvec(), atol=1e-14)
    for size in (0.0, 1e-12, 1e-6, np.pi - 1e-9):
        vector = TURNS.as_rotvec() / np.linalg.norm(TURNS.as_rotvec(), axis=1)[:, None] * size
        assert np.allclose(rotation_of(vector), Rotation.from_rotvec(vector).as_matrix())
        assert np.allclose(rotation_vector(rotation_of(vector)), vector, rtol=1e-6, atol=1e-15)


def test_turns_move_the_boresight_along_the_cameras_axes() -> None:
    x, y, roll = RNG.uniform(-1.0, 1.0, (3, 50))
    made = turned(FRAMES, x, y, roll)
    angle = np.hypot(x, y)
    expected = np.sin(angle) / angle * x, np.sin(angle) / angle * y, np.cos(angle)
    inside = np.einsum("nij,nj->ni", FRAMES, made[:, 2])
    assert np.allclose(inside, np.transpose(expected), atol=1e-14)
    assert np.allclose(np.einsum("nij,nkj->nik", made, made), np.eye(3), atol=1e-14)
    rolled = turned(FRAMES, 0 * x, 0 * y, roll)
    assert np.allclose(rolled[:, 2], FRAMES[:, 2])
    assert np.allclose(np.sum(rolled[:, 0] * FRAMES[:, 1], axis=-1), np.sin(roll))


def test_slews_go_the_shortest_way() -> None:
    whole = np.einsum("nji,njk->nik", OTHERS, FRAMES)
    angle = Rotation.from_matrix(whole).magnitude()
    for share in (0.0, 0.3, 1.0):
        made = slewed(FRAMES, OTHERS, np.full(50, share))
        part = Rotation.from_matrix(np.einsum("nji,njk->nik", made, FRAMES)).magnitude()
        assert np.allclose(part, share * angle, atol=1e-12)


@pytest.mark.parametrize("profile", ["minimum_jerk", "bang_bang"])
def test_slews_start_and_end_at_rest(profile: str) -> None:
    t = np.linspace(-1.0, 11.0, 1201)
    s = slew_share(t, 10.0, profile)  # type: ignore[arg-type]
    assert (s[t <= 0] == 0).all()
    assert np.allclose(s[t >= 10], 1.0)
    rate = np.diff(s) / np.diff(t)
    assert rate.min() >= -1e-12
    assert abs(rate[100]) < 3e-4
    assert np.trapezoid(np.gradient(s, t), t) == pytest.approx(1.0)


def test_settling_starts_at_zero_and_decays() -> None:
    t = np.linspace(-1.0, 5.0, 6001)
    x = settling(t, 2.0, 1.5, 0.1)
    assert (x[t <= 0] == 0).all()
    assert np.abs(x[t > 4]).max() < 2.0 * np.exp(-0.1 * 2 * np.pi * 1.5 * 4)
    a = (np.gradient(np.gradient(x, t), t))[1100:-100]  # x'' + 2 z w x' + w^2 x = 0
    w = 2 * np.pi * 1.5
    left = a + 0.2 * w * np.gradient(x, t)[1100:-100] + w**2 * x[1100:-100]
    assert np.abs(left).max() < 1e-3 * w**2


def test_against_scipy_interpolation() -> None:
    time = np.cumsum(RNG.uniform(0.5, 1.5, 50))
    q = TURNS.as_quat() * RNG.choice([-1.0, 1.0], (50, 1))  # either sign is the same turn
    at = RNG.uniform(time[0], time[-1], 200)
    flip = np.array([-1.0, 1.0, 1.0])[:, None]
    for kind, theirs in (("slerp", Slerp(time, TURNS)), ("spline", RotationSpline(time, TURNS))):
        made = attitudes_at(AttitudeTable(time, q, kind), at)  # type: ignore[arg-type]
        assert np.allclose(np.swapaxes(made * flip, -1, -2), theirs(at).as_matrix(), atol=1e-12)


def test_against_scipy_products() -> None:
    p, q = TURNS[:25], TURNS[25:]
    made = Rotation.from_quat(product(p.as_quat(), q.as_quat()))
    assert np.allclose(made.as_matrix(), (p * q).as_matrix(), atol=1e-14)
    assert np.allclose(Rotation.from_quat(conjugate(p.as_quat())).as_matrix(), p.inv().as_matrix())


@pytest.mark.parametrize("kind", ["slerp", "spline"])
def test_a_tables_error_is_told(kind: str) -> None:
    """A nutation sampled 12 times a turn: the error between rows is the one measured, to half."""

    def turn(t: np.ndarray) -> Rotation:
        wave = 0.01 * np.stack([np.sin(t), np.cos(1.3 * t), 0.5 * np.sin(0.7 * t)], axis=-1)
        return Rotation.from_rotvec(wave) * Rotation.from_rotvec(np.outer(t, [0, 0, 0.02]))

    time = np.arange(0.0, 30.0, 2 * np.pi / 12)
    table = AttitudeTable(time, turn(time).as_quat(), kind)  # type: ignore[arg-type]
    told = table_error_rad(table, (time > 5) & (time < 25))
    at = np.linspace(5.0, 25.0, 1000)
    axes = np.swapaxes(attitudes_at(table, at) * np.array([-1.0, 1.0, 1.0])[:, None], -1, -2)
    real = (Rotation.from_matrix(axes) * turn(at).inv()).magnitude().max()
    assert told is not None
    assert 0.5 * real <= told <= 4.0 * real
    assert real < (2e-3 if kind == "slerp" else 2e-4)


def test_acceleration_along_the_rate_stays_on_its_great_circle() -> None:
    start, t = from_angles(np.array(1.0), np.array(0.6)), np.linspace(0.0, 20.0, 9)
    made = attitudes_swept(start, 0.3, (3e-3, 4e-3), (6e-4, 8e-4), t)
    along = np.arctan2(
        np.linalg.norm(np.cross(made[:, 2], start), axis=1), made[:, 2] @ start
    )
    assert np.allclose(along, 5e-3 * t + 0.5e-3 * t**2)
    curved = attitudes_swept(start, 0.0, (3e-3, 0.0), (0.0, 1e-3), t)
    x, y = curved[:, 2] @ made[0, 0], curved[:, 2] @ made[0, 1]
    assert np.hypot(x[-1], y[-1]) == pytest.approx(np.sin(np.hypot(0.06, 0.2)))


def test_slews_end_where_they_should_about_one_axis() -> None:
    assert np.allclose(slewed(FRAMES, OTHERS, np.ones(50)), OTHERS, atol=1e-12)
    half, rest = slewed(FRAMES, OTHERS, np.full(50, 0.3)), np.full(50, 4.0 / 7.0)
    later = slewed(FRAMES, OTHERS, np.full(50, 0.7))
    assert np.allclose(slewed(half, OTHERS, rest), later, atol=1e-12)
    jerk = slew_share(np.array([2.5, 5.0, 6.0]), 10.0, "minimum_jerk")
    assert jerk == pytest.approx([53 / 512, 0.5, 0.68256])  # 10 s^3 - 15 s^4 + 6 s^5


def test_swept_boresights_lie_along_the_arc_of_rate_and_acceleration() -> None:
    """Exactly b cos d + e sin d, for unequal rates east and north, accelerated both ways."""
    b, t = from_angles(np.array(2.0), np.array(-0.7)), np.array([0.5, 3.0, 9.0])
    east = np.array([-np.sin(2.0), np.cos(2.0), 0.0])
    north = np.cross(b, east)
    e, n = 0.02 * t - 0.5 * 1e-3 * t**2, -0.05 * t + 0.5 * 4e-3 * t**2
    made = attitudes_swept(b, 0.3, (0.02, -0.05), (-1e-3, 4e-3), t)
    d = np.hypot(e, n)[:, None]
    along = (e[:, None] * east + n[:, None] * north) / d
    assert np.allclose(made[:, 2], np.cos(d) * b + np.sin(d) * along, atol=1e-13)
    assert np.allclose(attitudes_swept(b, 0.3, (0.02, -0.05), (0.0, 0.0), t),
                       attitudes_drift(b, 0.3, 0.02, -0.05, t), atol=1e-13)  # fmt: skip
