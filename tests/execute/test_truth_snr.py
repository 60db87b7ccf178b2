"""Signal-to-noise in the truth: of long streaks, of each frame's own time, of what sets."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.special import erf

from pipeline.execute import truth
from pipeline.execute.light import draw_targets
from pipeline.execute.outlook import target_snr
from pipeline.execute.sources import FrameTarget, place_targets
from pipeline.execute.truth import brightest_pixel_e, matched_snr, star_truth, target_truth
from pipeline.physics.motion.streak import POINT, Path, straight
from pipeline.physics.radiometry import box
from pipeline.physics.targets.disc import Sphere
from pipeline.plan.facts import gather_facts
from pipeline.plan.pointing.geometry import plan_geometry
from pipeline.plan.response.streaks import Streak, exact_path
from pipeline.plan.response.zones import Zone
from pipeline.plan.sky.sky import SkyPlan, facts_with_sky
from pipeline.plan.tiles import Tile
from pipeline.route.prepare import prepare
from pipeline.spec.load import parse_scene
from tests.execute.test_engines import SIDE, field, geometry_of, plan_of
from tests.execute.test_truth_magnitudes import scene
from tests.physics.targets.test_off_axis import scene_of
from tests.plans import plan_from

GAUSSIAN = {"kind": "gaussian", "sigma_px": 1.0}


def test_a_streak_of_many_pieces_has_the_noise_of_all_its_pixels() -> None:
    """Of the same light in each pixel, SNR grows with the root of the length."""
    plan, at = plan_of(GAUSSIAN, 0.0, 0.0), np.array([60.0])
    found = [
        float(matched_snr(plan, straight(px), np.array([20.0 * px]), at, at)[0]) / np.sqrt(px)
        for px in (500.0, 60_000.0)  # 6 pieces, and 625
    ]
    assert found[1] == pytest.approx(found[0], rel=0.01)


def test_a_bent_streak_is_as_long_as_its_bend() -> None:
    """Half a circle of 100 px by a chain of chords, along which light is sent 400 times."""
    turn = np.linspace(0.0, np.pi, 401)
    followed = np.empty((401, 2, 3, 3))
    followed[:, 0], followed[:, 1] = (
        v[:, None, None] for v in (100.0 * np.cos(turn), 100.0 * np.sin(turn))
    )
    streak = Streak(Zone(0.0, 9.0, 0.0, 9.0), POINT, (), followed, 1.0)
    at = np.array([2.0, 5.0])
    found = streak.lengths_px(at, at)
    np.testing.assert_allclose(found, np.pi * 100.0, rtol=2e-3)


def by_hand(light_e: float, length_px: float, noise_e2: float) -> float:
    """SNR of a streak of a Gaussian of 1 px along the rows, by sums over its pixels' light."""
    at, (y, x) = 40.0, np.mgrid[:81, : 81 + int(length_px)]
    edges = np.linspace(-0.5, 0.5, 21)[:, None, None] * length_px
    whole = np.zeros(y.shape)
    for along in 0.5 * (edges[1:] + edges[:-1]) if length_px else np.zeros((1, 1, 1)):
        parts = [
            0.5 * (erf((v + 0.5) / 2**0.5) - erf((v - 0.5) / 2**0.5))
            for v in (y - at, x - at - 0.5 * int(length_px) - along)
        ]
        whole += parts[0] * parts[1]
    signal = light_e * whole / whole.sum()
    return float(np.sqrt(np.sum(signal**2 / (noise_e2 + signal))))


@pytest.mark.parametrize("light_e", [50.0, 3e3, 1e6])
def test_snr_is_that_of_the_sky_behind_the_source_in_its_frame(light_e: float) -> None:
    """Not of the darkest sky of all frames and places, on which the plan of errors rests."""
    plan = plan_of(GAUSSIAN, 0.0, 0.0)
    dark, bright = np.full((2, 2), 10.0), np.array([[100.0, 500.0], [100.0, 500.0]])
    sky = SkyPlan((SIDE, SIDE), np.array([0, 4]), np.stack([dark, bright]), 10.0, 0.0, None, ())
    plan = replace(plan, sky=sky, facts=facts_with_sky(plan.facts, plan.scene, sky))
    x, y = np.array([0.0, (SIDE - 1) / 2, SIDE - 1.0, 300.0]), np.full(4, 60.0)
    fixed = 5.0**2 + plan.scene.sensor.gain_e_per_dn**2 / 12.0
    for frame, at in ((0, [10.0] * 4), (2, [56.0, 155.0, 254.0, 255.0]), (4, None)):
        skies = [101.25, 300.0, 498.75, 498.75] if at is None else at
        found = matched_snr(plan, POINT, np.full(4, light_e), x, y, frame)
        for snr, sky_e in zip(found, skies, strict=True):
            wanted = by_hand(light_e, 0.0, fixed + sky_e)
            assert snr == pytest.approx(wanted, rel=0.02)


def test_snr_is_that_of_each_stars_own_streak() -> None:
    """Of a camera that rolls, whose stars streak the farther the farther out they are."""
    plan = plan_of(GAUSSIAN, 0.0, 0.0, 600, 6.0)
    g, far_px = geometry_of(plan), np.array([0.0, 20.0, 60.0, 140.0, 290.0])
    middle = 299.5
    stars = field(middle + far_px, np.full(5, middle), np.full(5, 2e3))
    found = star_truth(plan, g, stars)["snr"]
    fixed = 5.0**2 + plan.scene.sensor.gain_e_per_dn**2 / 12.0
    for snr, px in zip(found, far_px, strict=True):
        wanted = by_hand(2e3, px * math.radians(6.0), fixed)
        assert snr == pytest.approx(wanted, rel=0.02)


@pytest.mark.parametrize(
    ("x_px", "y_px", "in_view"),
    [(-0.4, 20.0, True), (63.4, 20.0, True), (-0.6, 20.0, False), (63.6, 20.0, False),
     (20.0, -0.4, True), (20.0, 63.4, True), (20.0, -0.6, False), (20.0, 63.6, False)],
)  # fmt: skip
def test_a_target_is_in_view_up_to_the_outer_edges_of_the_pixels(
    monkeypatch: pytest.MonkeyPatch, x_px: float, y_px: float, in_view: bool
) -> None:
    """Of a frame of 64 x 64 px."""
    plan = prepare(scene()).plan
    g = plan_geometry(plan.scene, np.array([0]), plan.dut1_s)
    moved = [replace(t, x_px=x_px, y_px=y_px) for t in place_targets(plan, g)]
    monkeypatch.setattr("pipeline.execute.outlook.place_targets", lambda *_: moved)
    assert (target_snr(plan, g, ("ball",))["ball"] > 0.0) == in_view


DWELLS = [{"integration_s": 1.0}, {"integration_s": 4.0, "start_s": 10.0}]


def test_noise_of_all_frames_at_once_is_that_of_each() -> None:
    """In the middle of frames, the sky linear between two of four, dark and exposures their own."""
    dwells = [{"integration_s": (1.0, 4.0), "frames": 3}, {"integration_s": 9.0, "start_s": 20.0}]
    plan = prepare(scene(dwells=dwells, exposure={"integration_s": 1.0})).plan
    plan = replace(plan, facts=replace(plan.facts, dark_e=7.0, flat=0.9))
    rows, columns = plan.scene.sensor.shape
    grids = np.stack([np.full((2, 2), 10.0), np.array([[100.0, 500.0], [900.0, 700.0]])])
    sky = SkyPlan((rows, columns), np.array([0, 3]), grids, 10.0, 0.0, None, ())
    x, y = np.array(plan.camera.centre_px)[:, None]
    for one in (plan, replace(plan, sky=sky, facts=facts_with_sky(plan.facts, plan.scene, sky))):
        each = [one.snr_floor_e2(k, x, y)[0] for k in range(one.frames)]
        assert one.empty_noise_e() ** 2 == pytest.approx(each, rel=1e-12)
        assert len(np.unique(each)) > 1


def test_each_frame_of_a_target_has_the_noise_of_its_own_time() -> None:
    """Under a bright sky four times the exposure is twice the SNR of a steady light."""
    sky = {"background": {"uniform_e_per_s": 1e9}, "exposure": {"integration_s": 1.0}}
    plan = prepare(scene(dwells=DWELLS, **sky)).plan
    g = plan_geometry(plan.scene, np.arange(2), plan.dut1_s)
    one, four = (target_truth(plan, g.frame_slice(k))["snr"][0] for k in range(2))
    assert four == pytest.approx(2.0 * one, rel=0.01)


def test_each_frame_of_a_star_has_the_noise_of_its_own_time() -> None:
    """Much dark: what sends no more in four times the exposure has half the SNR."""
    dark = parse_scene(plan_of(GAUSSIAN, 0.0, 0.0).scene.as_dict() | {"dwells": DWELLS})
    g = plan_geometry(dark, np.arange(2), 0.0)
    plan = plan_from(dark, gather_facts(dark, box(600e-9, 700e-9), 1e6, 5.0, 1.0), g)
    stars = field(np.array([60.0]), np.array([60.0]), np.array([1e3]))
    one, four = (star_truth(plan, g.frame_slice(k), stars)["snr"][0] for k in range(2))
    assert four == pytest.approx(0.5 * one, rel=0.01)


def test_a_star_that_sets_has_the_noise_of_the_path_that_is_left(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As one that streaks half as far with the same light."""
    at, light = np.array([60.0]), np.array([300.0])
    plan, half = (plan_of(GAUSSIAN, px, 0.0) for px in (40.0, 20.0))
    setting = replace(field(at, at, light), visible_fraction=np.array([0.5]))
    left = FrameTarget(0, 60.0, 60.0, straight(20.0), float(light[0]))
    monkeypatch.setattr(truth, "setting_stars", lambda plan, g, stars: [left])
    snr = star_truth(plan, geometry_of(plan), setting)["snr"][0]
    monkeypatch.undo()
    wanted = star_truth(half, geometry_of(half), field(at, at, light))["snr"][0]
    assert snr == pytest.approx(wanted, rel=0.02)


def test_same_snr_however_many_pixels_are_held_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    plan, at = plan_of(GAUSSIAN, 0.0, 0.0), np.array([60.0, 61.0, 62.0])
    wish = plan, straight(300.0), np.array([1e2, 3e4, 1e6]), at, at
    whole = matched_snr(*wish)
    monkeypatch.setattr(truth, "MOST_VALUES", 5000)  # of some 3000 pixels: one light at a time
    np.testing.assert_array_equal(matched_snr(*wish), whole)


def test_light_is_centred_by_what_each_part_of_a_path_has_of_it() -> None:
    """A quarter in the middle of the first part of a bent path, the rest in that of the second."""
    path = Path(np.array([-3.0, 1.0, 5.0]), np.array([0.0, 2.0, 2.0]), np.array([0.25, 0.75]))
    found = truth._centroid(FrameTarget(0, 60.0, 50.0, path, 9.0))
    assert found == pytest.approx((60.0 - 0.25 + 2.25, 50.0 + 0.25 + 1.5))


@pytest.mark.parametrize(("side", "roll_deg"), [(160, 5.0), (160, 20.0), (300, 5.0)])
def test_snr_in_a_turning_field_is_that_of_each_stars_own_path(side: int, roll_deg: float) -> None:
    """The star in the middle stands still, also where its path is that of the whole zone."""
    plan = plan_of(GAUSSIAN, 0.0, 0.0, roll_deg=roll_deg, side=side)
    g, at = geometry_of(plan), np.array([side / 2 - 0.5, 0.75 * side, side - 5.0])
    told = star_truth(plan, g, field(at, at, np.full(3, 200.0)))["snr"]
    paths = [exact_path(plan.camera, g, v, v, True) for v in at.tolist()]
    own = [
        float(matched_snr(plan, path, *(np.array([v]) for v in (200.0, x, x)))[0])
        for path, x in zip(paths, at.tolist(), strict=True)
    ]
    assert told == pytest.approx(own, rel=0.01)
    assert own[2] < 0.75 * own[0]


@pytest.mark.parametrize(("dx", "dy"), [(700.0, 0.0), (300.0, -500.0), (30.0, 20.0)])
def test_snr_of_a_body_on_a_streak_counts_its_own_width(dx: float, dy: float) -> None:
    """A disc of 6 px that moves across most of a frame: against the sum of its steps, each drawn
    as it stands."""
    plan, light_e = plan_of(GAUSSIAN, 0.0, 0.0, side=900), 3e4
    path = Path(np.array([-0.5, 0.5]) * dx, np.array([-0.5, 0.5]) * dy, np.ones(1))
    body, at = Sphere(6.0, 0.8, 0.3), (np.array([450.0]), np.array([450.0]))
    found = float(matched_snr(plan, path, np.array([light_e]), *at, 0, body)[0])
    y, x, share = body.points(2.0)
    steps = np.linspace(-0.5, 0.5, int(4 * np.hypot(dx, dy)) + 1)
    image = np.zeros((900, 900))
    for step in steps:
        row, column = (np.round(v + 450.0 + step * d).astype(int) for v, d in ((y, dy), (x, dx)))
        np.add.at(image, (row, column), share / len(steps))
    light = light_e * gaussian_filter(image, 1.0)
    floor_e2 = float(plan.snr_floor_e2(0, *at)[0])
    wanted = math.sqrt(float(np.sum(light**2 / (floor_e2 + light))))
    assert found == pytest.approx(wanted, rel=0.02)


@pytest.mark.parametrize(
    ("range_m", "time_s"), [(500.0, 1e-7), (500.0, 1e-5), (2000.0, 1e-5), (30.0, 1e-8)]
)
def test_snr_of_a_body_is_that_of_the_pixels_of_its_picture(range_m: float, time_s: float) -> None:
    """Of a sphere of 1 m, from 5 to 330 px in radius: against the image that is drawn. It was
    that of a point, 5 times too much for faint ones."""
    data = scene_of(0.0, False, 1.0)
    data["sensor"] |= {"focal_length_m": 0.2, "shape": [256, 256]}
    data["pointing"] = {"mode": "target", "target": "t"}
    data["exposure"]["integration_s"] = time_s
    data["targets"][0]["orbit"]["position_m"] = [7e6, -range_m, 0.0]
    plan = prepare(parse_scene(data)).plan
    g = plan_geometry(plan.scene, np.array([0]), plan.dut1_s)
    (t,) = place_targets(plan, g)
    assert t.body is not None
    side = 256 if range_m > 100.0 else 800
    corner = int(0.5 * (256 - side))
    image = draw_targets(plan, g, Tile(0, 0, corner, corner, side, side), [])
    floor_e2 = float(plan.snr_floor_e2(0, np.array([t.x_px]), np.array([t.y_px]))[0])
    light = np.maximum(image, 0.0)
    wanted = math.sqrt(float(np.sum(light**2 / (floor_e2 + light))))
    told = target_truth(plan, g)
    assert told["snr"][0] == pytest.approx(wanted, rel=0.02)
    assert target_snr(plan, g, ("t",))["t"] == told["snr"][0]
    brightest = float(image.max()) + float(plan.empty_e(0.0)[()])
    assert brightest_pixel_e(plan, t, 0) == pytest.approx(brightest, rel=0.1)
