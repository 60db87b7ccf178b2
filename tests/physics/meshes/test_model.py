"""Joints: where parts stand, panels that follow the Sun, light curves of bodies that move."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.physics.meshes import brdf
from pipeline.physics.meshes.facets import Facets
from pipeline.physics.meshes.intensity import FacetSurface
from pipeline.physics.meshes.model import (
    Joint,
    MeshModel,
    RigidPart,
    model_light,
    posed,
    tracking_angle,
)
from pipeline.physics.vectors import rotate_about, unit

X, Y, Z = np.eye(3)
WHITE = FacetSurface(partial(brdf.lambert, albedo=1.0))


def plate(side=1.0):
    v = 0.5 * side * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0.0]])
    return Facets(v[[[0, 1, 2], [0, 2, 3]]], np.zeros(2, np.int64), np.zeros(2, bool))


angles = st.floats(-3.0, 3.0)


@given(axis=st.tuples(angles, angles, angles), sun=st.tuples(angles, angles, angles))
def test_tracking_turns_the_face_nearest_to_the_sun(axis, sun):
    if np.hypot.reduce(axis) < 1e-3 or np.hypot.reduce(sun) < 1e-3:
        return
    a, s = unit(np.array(axis)), unit(np.array(sun))
    face = unit(np.cross(a, [0.3, -0.5, 0.8]) + 0.2 * a)
    angle = float(tracking_angle(a, face, s))
    best = rotate_about(a, angle) @ face @ s
    other = [rotate_about(a, angle + d) @ face @ s for d in np.linspace(-3, 3, 61)]
    assert best >= max(other) - 1e-9


def test_limits_the_sun_on_the_axis_turns_nothing():
    assert tracking_angle(Z, X, Z) == 0.0
    assert tracking_angle(Z, Z, X) == 0.0


def test_parts_stand_on_parts():
    quarter = rotate_about(Z, np.pi / 2)
    arm = RigidPart(plate(), None, quarter, np.array([1.0, 0.0, 0.0]))
    hand = RigidPart(plate(), 0, None, np.array([2.0, 0.0, 0.0]), Joint("fixed", X, Y, Z, np.pi))
    mesh = posed(MeshModel((arm, hand), (WHITE,)), Z)
    np.testing.assert_allclose(mesh.corners_m[:2].mean(axis=(0, 1)), [1, 0, 0], atol=1e-12)
    # turned half about x through y = 1: its middle goes to y = 2, normal down; then on the arm
    middle = mesh.corners_m[2:].reshape(-1, 3)
    np.testing.assert_allclose(0.5 * (middle.min(0) + middle.max(0)), [-1, 2, 0], atol=1e-12)
    np.testing.assert_allclose(mesh.normal[2:], [[0, 0, -1]] * 2, atol=1e-12)


def test_a_tracking_panel_on_a_spinning_bus_stays_bright():
    bus = RigidPart(plate(1e-3), None, None, None, Joint("spin", Y, 0 * X, Z, 0.0, 0.1))
    panel = RigidPart(plate(), 0, None, np.array([0.0, 2.0, 0.0]), Joint("sun", Y, 0 * X, Z))
    model = MeshModel((bus, panel), (WHITE,))
    t = np.linspace(0, 60, 13)
    sun = np.tile(unit(np.array([1.0, 0.5, 0.2])), (13, 1))
    light, error = model_light(model, sun, sun, t)
    cosine2 = 1 - sun[0, 1] ** 2
    np.testing.assert_allclose(light, cosine2 / np.pi, rtol=1e-5)
    assert np.all(error <= 1e-3 * light)
    assert model.radius_m >= 2.0


@pytest.mark.parametrize("rate_rad_s", [0.5, -0.5])
def test_a_spinning_plate_flashes_with_its_period(rate_rad_s):
    joint = Joint("spin", X, 0 * X, Z, 0.0, rate_rad_s)
    model = MeshModel((RigidPart(plate(), None, None, None, joint),), (WHITE,))
    t = np.linspace(0, 20, 41)
    z = np.tile(Z, (41, 1))
    true = np.maximum(np.cos(0.5 * t), 0.0) ** 2 / np.pi
    light, _ = model_light(model, z, z, t)
    np.testing.assert_allclose(light, true, atol=1e-12)
    t = np.linspace(0, 20, 2001)
    light, _ = model_light(model, z[:1].repeat(2001, 0), z[:1].repeat(2001, 0), t, step_rad=0.05)
    true = np.maximum(np.cos(0.5 * t), 0.0) ** 2 / np.pi
    np.testing.assert_allclose(light, true, atol=3e-4)


def test_a_dish_shades_the_bus_below_it():
    dish = RigidPart(plate(0.5), None, None, np.array([0.0, 0.0, 1.0]))
    model = MeshModel((RigidPart(plate()), dish), (WHITE,))
    s, o = unit(np.array([[0.2, 0.0, 1.0]])), Z[None]
    light, _ = model_light(model, s, o, np.zeros(1), 1e-6)
    # covered: 0.5 x 0.5 as seen and as shaded, of which 0.3 x 0.5 is both
    true = s[0, 2] * (1.0 - 0.25 - 0.25 + 0.15 + 0.25) / np.pi
    assert light[0] == pytest.approx(true, rel=1e-6)


def test_moments_close_to_each_other_are_interpolated():
    dish = RigidPart(plate(0.5), None, None, np.array([0.0, 0.0, 1.0]))
    model = MeshModel((RigidPart(plate()), dish), (WHITE,))
    angle = np.linspace(0.1, 0.4, 201)
    o = np.stack([np.sin(angle), 0 * angle, np.cos(angle)], axis=-1)
    s = np.tile(unit(np.array([-0.3, 0.2, 1.0])), (201, 1))
    every, _ = model_light(model, s, o, angle, 1e-6)
    some, _ = model_light(model, s, o, angle, 1e-6, step_rad=0.01)
    np.testing.assert_allclose(some, every, rtol=2e-3)
    assert np.median(np.abs(some / every - 1.0)) < 2e-5
    assert not np.array_equal(some, every)


def test_limits_no_moments_and_moments_that_repeat():
    model = MeshModel((RigidPart(plate()),), (WHITE,))
    z = np.tile(Z, (5, 1))
    for step in (0.0, 0.1):
        light, error = model_light(model, z, z, np.arange(5.0), step_rad=step)
        np.testing.assert_allclose(light, 1.0 / np.pi)
        assert not error.any()
        assert model_light(model, z[:0], z[:0], np.zeros(0), step_rad=step)[0].size == 0


@given(seed=st.integers(0, 1000))
def test_no_corner_leaves_the_radius_however_the_joints_turn(seed):
    """Chains of parts on parts with pivots of their own; in some pose most of it is used."""
    rng = np.random.default_rng(seed)
    parts = [
        RigidPart(plate(0.1), k - 1 if k else None, None, rng.normal(size=3),
             Joint("spin", unit(rng.normal(size=3)), rng.normal(size=3), Z, 0.0, 1.0 + 0.7 * k))
        for k in range(3)
    ]  # fmt: skip
    model = MeshModel(tuple(parts), (WHITE,))
    far = [posed(model, Z, t).radius_m for t in np.linspace(0.0, 60.0, 40)]
    assert max(far) <= model.radius_m
    one = Joint("fixed", X, 3.0 * Y, Z, np.pi)
    turned = MeshModel((RigidPart(plate(0.1), None, None, None, one),), (WHITE,))
    assert 5.9 < posed(turned, Z).radius_m <= turned.radius_m < 6.1


def test_joints_turn_on_from_their_first_angle():
    spin = Joint("spin", X, 0 * X, Z, 0.3, 0.5)
    track = Joint("sun", X, 0 * X, Z, 0.4)
    light = []
    for joint in (spin, track):
        model = MeshModel((RigidPart(plate(), None, None, None, joint),), (WHITE,))
        z = np.array([[0.0, -0.6, 0.8] if joint is track else Z])
        light.append(model_light(model, z, z, np.array([1.4]))[0][0] * np.pi)
    assert light == pytest.approx([np.cos(1.0) ** 2, np.cos(0.4) ** 2], rel=1e-12)
