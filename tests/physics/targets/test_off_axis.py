"""Bodies off a camera's axis: against directions that are projected one by one."""

from __future__ import annotations

import math

import numpy as np
import pytest

from pipeline.execute.sources import MIDDLE, place_targets
from pipeline.physics.positions.focal_plane import deproject
from pipeline.physics.targets.disc import Sphere
from pipeline.physics.targets.off_axis import OffAxis, Perspective
from pipeline.physics.vectors import separation
from pipeline.plan.pointing.geometry import plan_geometry
from pipeline.route.prepare import prepare
from pipeline.spec.load import parse_scene

SOME = Perspective(1.08, 0.01, -0.02, 1.05, 2e-3, -1e-3)
BODY = OffAxis(Sphere(20.0, 0.7, 0.4), SOME)
RANGE_M, DIAMETER_M = 2500.0, 100.0


def test_back_undoes_forward_and_stretch_bounds_it() -> None:
    rng = np.random.default_rng(3)
    x, y = rng.uniform(-20.0, 20.0, (2, 200))
    u, v = SOME.forward(x, y)
    np.testing.assert_allclose(SOME.back(u, v), (x, y), atol=1e-12)
    turn = rng.uniform(0.0, 2.0 * np.pi, 200)
    du, dv = SOME.forward(x + 1e-4 * np.cos(turn), y + 1e-4 * np.sin(turn))
    found = np.hypot(du - u, dv - v) / 1e-4
    most = SOME.stretch((-20.0, 20.0, -20.0, 20.0))
    assert found.max() <= most * (1.0 + 1e-6)
    assert found.max() > 0.97 * most
    assert SOME.stretch((-20.0, 20.0, -1000.0, 20.0)) == math.inf  # behind the camera


def test_points_in_boxes_are_those_of_the_whole_once_each() -> None:
    """And they are the sphere's, each moved."""
    y, x, share = BODY.points(2.0)
    assert share.sum() == pytest.approx(1.0, abs=1e-9)
    y0, y1, x0, x1 = BODY.box
    assert y0 <= y.min() < y.max() <= y1
    assert x0 <= x.min() < x.max() <= x1
    inner_y, inner_x, inner = BODY.body.points(2.0 * SOME.stretch(BODY.body.box))
    np.testing.assert_array_equal(np.sort(x), np.sort(SOME.forward(inner_x, inner_y)[0]))
    assert inner.sum() == pytest.approx(share.sum(), rel=1e-12)
    parts = [
        BODY.points(2.0, (low, low + 7.0, left, left + 11.0))
        for low in np.arange(-28.0, 28.0, 7.0) for left in np.arange(-33.0, 33.0, 11.0)
    ]  # fmt: skip
    together = np.concatenate(parts, axis=1)
    order, whole = np.lexsort(together[:2]), np.array([y, x, share])
    np.testing.assert_array_equal(together[:, order], whole[:, np.lexsort(whole[:2])])


def scene_of(shift_deg: float, distortion: bool, diameter_m: float = DIAMETER_M) -> dict:
    """A sphere above the equator, seen from 2.5 km, so far from the middle of the field."""
    sensor = {
        "shape": [512, 512], "pixel_pitch_um": 10.0, "focal_length_m": 0.014, "aperture_m": 0.02,
        "bandpass": {"kind": "box", "short_nm": 500, "long_nm": 600}, "read_noise_e": 10.0,
        "psf": {"kind": "gaussian", "sigma_px": 0.8},
    }  # fmt: skip
    if distortion:
        sensor["distortion"] = {"kind": "radial", "k1": 0.3}
    return {
        "schema": "nightglass/scene/1", "name": "off", "accept": ["moon", "daylight", "sun"],
        "epoch": "2019-07-20T09:00:00Z",
        "observer": {"kind": "orbit", "orbit": {
            "kind": "state", "position_m": [7e6, 0, 0], "velocity_m_s": [0, 7546.0, 0]}},
        "sensor": sensor,
        "pointing": {"mode": "sidereal", "boresight_ra_deg": 270.0 + shift_deg,
                     "boresight_dec_deg": 3.0},
        "exposure": {"integration_s": 1e-4},
        "targets": [{"name": "t", "eclipse": False,
                     "body": {"kind": "sphere", "diameter_m": diameter_m, "albedo": 0.3},
                     "orbit": {"kind": "state", "position_m": [7e6, -RANGE_M, 0],
                               "velocity_m_s": [0, 7546.0, 0]}}],
    }  # fmt: skip


@pytest.mark.parametrize("distortion", [False, True])
@pytest.mark.parametrize("shift_deg", [9.0, -9.0, 4.0])
def test_the_limb_is_as_wide_in_angle_all_around(shift_deg: float, distortion: bool) -> None:
    """asin(r/d) of every place of the limb, through the camera's own inverse, wherever it stands;
    the disc of the middle of the field is off by up to 3% there."""
    plan = prepare(parse_scene(scene_of(shift_deg, distortion))).plan
    g = plan_geometry(plan.scene, np.array([0]), plan.dut1_s)
    (t,) = place_targets(plan, g)
    assert isinstance(t.body, OffAxis)
    turn = np.linspace(0.0, 2.0 * np.pi, 13)
    r = t.body.body.radius_px
    x, y = t.body.perspective.forward(r * np.cos(turn), r * np.sin(turn))

    def angles(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        ends = deproject(plan.camera, g.attitude[0, g.middle], t.x_px + x, t.y_px + y)
        return separation(ends, np.broadcast_to(middle, ends.shape))

    middle = deproject(
        plan.camera, g.attitude[0, g.middle], np.array([t.x_px]), np.array([t.y_px])
    )
    wanted = math.asin(0.5 * DIAMETER_M / RANGE_M)
    off = np.abs(angles(x, y) / wanted - 1.0).max()
    assert off < (5e-3 if distortion else 5e-5)
    plain = np.abs(angles(r * np.cos(turn), r * np.sin(turn)) / wanted - 1.0).max()
    assert plain > 3.0 * off


def test_the_lit_side_is_towards_the_sun() -> None:
    """Of a place on the sphere that the Sun stands over, projected by itself."""
    plan = prepare(parse_scene(scene_of(9.0, False))).plan
    g = plan_geometry(plan.scene, np.array([0]), plan.dut1_s)
    (t,) = place_targets(plan, g)
    y, x, share = t.body.points(0.5)
    seen = np.array([share @ x, share @ y])
    attitude = g.attitude[0, g.middle]
    towards = deproject(plan.camera, attitude, np.array([t.x_px]), np.array([t.y_px]))[0]
    sun = g.sun_m[0, g.middle] - g.observer_m[0, g.middle]
    sun = sun / np.linalg.norm(sun)
    across = sun - (sun @ towards) * towards
    near = towards + 1e-4 * across / np.linalg.norm(across)
    step = np.array([near @ attitude[k] / (near @ attitude[2]) for k in (0, 1)])
    step -= [towards @ attitude[k] / (towards @ attitude[2]) for k in (0, 1)]
    turned = np.arctan2(seen[1], seen[0]) - np.arctan2(step[1], step[0])
    assert abs(np.angle(np.exp(1j * turned))) < 0.01


def test_a_sphere_whose_stretch_does_not_show_is_as_in_the_middle() -> None:
    plan = prepare(parse_scene(scene_of(4.0, False, 0.02))).plan
    g = plan_geometry(plan.scene, np.array([0]), plan.dut1_s)
    (t,) = place_targets(plan, g)
    assert t.body is None
    assert 0.0 < t.radius_px < 0.01
    assert MIDDLE.forward(3.0, 4.0) == (3.0, 4.0)
    assert MIDDLE.stretch((-1.0, 1.0, -1.0, 1.0)) == 1.0
