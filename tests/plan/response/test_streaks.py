"""Common streaks: every star is drawn along its own path to what the plan says."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.integrate import simpson

from pipeline.errors import BadInput
from pipeline.physics.drawing.quadrature import draw_quadrature
from pipeline.physics.motion.streak import HALVINGS, POINT, Path, densest_share
from pipeline.physics.psf.pupil import Blur, Gaussian
from pipeline.plan.pointing.geometry import camera_of, plan_geometry, star_paths
from pipeline.plan.response.own_paths import own_paths, star_offsets
from pipeline.plan.response.responses import point_curvature, point_slope
from pipeline.plan.response.streaks import (
    MERGE_TOLERANCE_PX,
    PATH_STEP_PX,
    SHOWN,
    SPREAD_TOLERANCE_PX,
    Streak,
    StreakPlan,
    centroid,
    exact_path,
    light_from,
    merged_px,
    plan_streaks,
    resting,
    zone_streak,
)
from pipeline.spec.scene import USUAL_FRACTION, Scene

Make = Callable[..., Scene]
ROUNDING_PX = 0.75 * PATH_STEP_PX + MERGE_TOLERANCE_PX  # both axes of the grid, and merging


def along(path: Path, share: np.ndarray) -> np.ndarray:
    """Places (2, n) of a path where the given shares of its light have been sent."""
    light = np.concatenate([[0.0], np.cumsum(path.weight)])
    return np.stack([np.interp(share, light, path.x_px), np.interp(share, light, path.y_px)])


def drawn(streak: Streak, x: float, y: float, time: np.ndarray) -> np.ndarray:
    """Places (2, n) of a star at (x, y) as it is drawn, at times 0..1 of the exposure."""
    out = np.empty((2, len(time)))
    count = len(streak.pieces)
    which = np.minimum((time * count).astype(int), count - 1)
    for k, piece in enumerate(streak.pieces):
        mine = which == k
        centre = streak.at(piece.centre, np.array([x]), np.array([y]))
        out[:, mine] = np.array(centre) + along(piece.path, time[mine] * count - k)
    return out


def rate(scene: Make, east: float, north: float, focal_m: float, dec: float = 50.0) -> Scene:
    pointing = {"mode": "rate", "boresight_ra_deg": 1.0, "boresight_dec_deg": dec,
                "rate_ra_arcsec_s": east, "rate_dec_arcsec_s": north}  # fmt: skip
    return scene({"sensor.focal_length_m": focal_m, "pointing": pointing})


@settings(max_examples=12, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    east=st.floats(-60, 60), north=st.floats(-60, 60), focal=st.floats(0.03, 2.0),
    at=st.tuples(st.floats(0, 1), st.floats(0, 1)),
)  # fmt: skip
def test_each_star_keeps_to_its_own_path(
    scene: Make, east: float, north: float, focal: float, at: tuple[float, float]
) -> None:
    s = rate(scene, east, north, focal)
    camera, g = camera_of(s), plan_geometry(s, np.array([0]), 0.0)
    plan = plan_streaks(camera, g, True)
    x, y = at[0] * (camera.columns - 1), at[1] * (camera.rows - 1)
    row, column = int(at[1] * plan.zones * 0.999), int(at[0] * plan.zones * 0.999)
    streak = zone_streak(camera, g, row, column, plan, True)
    time = np.linspace(0.0, 1.0, g.nodes)
    own = star_paths(camera, g, np.array([x]), np.array([y]))[:, 0, 0]
    own -= own[:, [g.middle]]
    off = np.hypot(*(drawn(streak, x, y, time) - own)).max()
    assert plan.spread_px <= SPREAD_TOLERANCE_PX
    assert off <= 1.5 * plan.spread_px + ROUNDING_PX + 2e-3  # 2e-3: bends between the nodes


@pytest.mark.parametrize("roll_deg_s", [0.004, 0.5])
def test_a_frame_that_turns_more_than_the_plan_has_seen_gets_more_pieces(
    scene: Make, roll_deg_s: float
) -> None:
    """Its stars keep to their own paths too, as streaks of one piece do not."""
    seen, turning = rate(scene, 10.0, 0.0, 1.0), scene({"pointing": {
        "mode": "rate", "boresight_ra_deg": 1.0, "boresight_dec_deg": 50.0,
        "rate_ra_arcsec_s": 10.0, "rate_dec_arcsec_s": 0.0, "roll_rate_deg_s": roll_deg_s,
    }})  # fmt: skip
    camera, g = camera_of(seen), plan_geometry(turning, np.array([0]), 0.0)
    plan = plan_streaks(camera, plan_geometry(seen, np.array([0]), 0.0), True)
    assert (plan.zones, plan.pieces) == (1, 1)
    streak, time = zone_streak(camera, g, 0, 0, plan, True), np.linspace(0.0, 1.0, g.nodes)
    for x, y in ((5.0, 5.0), (760.0, 20.0), (30.0, 500.0)):
        own = star_paths(camera, g, np.array([x]), np.array([y]))[:, 0, 0]
        own -= own[:, [g.middle]]
        off_px = np.hypot(*(drawn(streak, x, y, time) - own)).max()
        assert off_px <= 1.5 * SPREAD_TOLERANCE_PX + ROUNDING_PX


@pytest.mark.parametrize("focal_m", [1.0, 0.05])
def test_centroid_and_light_of_the_pieces(scene: Make, focal_m: float) -> None:
    """Of the common shapes: those of a star's own path."""
    s = rate(scene, 30.0 / focal_m, -20.0 / focal_m, focal_m)
    camera, g = camera_of(s), plan_geometry(s, np.array([0]), 0.0)
    plan = plan_streaks(camera, g, True)
    streak = zone_streak(camera, g, 0, 0, plan, True)
    assert sum(p.share for p in streak.pieces) == pytest.approx(1.0, abs=1e-12)
    x, y = np.array([11.0]), np.array([300.0])
    own = centroid(exact_path(camera, g, 11.0, 300.0, True))
    mean = np.zeros(2)
    for piece in streak.pieces:
        place = np.array(streak.at(piece.centre, x, y))[:, 0]
        mean += piece.share * (place + np.array(centroid(piece.path)))
    assert mean == pytest.approx(own, abs=3e-4)


@pytest.mark.parametrize("inside", [True, False])
def test_the_brighter_a_star_the_closer_it_keeps_to_its_path(scene: Make, inside: bool) -> None:
    """Its centroid is that of its motion, to SHOWN of the budget: by Simpson over equal times.

    Of the zone, between whose nodes paths are interpolated, and beside it; between the nodes as far
    as halving their steps leaves it.
    """
    s = rate(scene, 3.0, -2.0, 0.1)
    camera, g = camera_of(s), plan_geometry(s, np.array([0]), 0.0)
    plan = replace(plan_streaks(camera, g, True), floor_e=5.0, budget_e=0.05, photons=False)
    streak = zone_streak(camera, g, 0, 0, plan, True)
    x, y = np.array([11.0 if inside else -900.0]), np.array([200.0])
    offsets = star_offsets(camera, g, x, y, True)[:, 0, 0]
    exact = simpson(offsets, dx=1.0, axis=1) / (offsets.shape[1] - 1)
    left_px = np.hypot(*np.diff(offsets, 2)).max() / 8.0 / 4.0**HALVINGS
    for light_e in (1e4, 1e7, 1e10):
        whole = streak.path
        share = densest_share(whole.x_px, whole.y_px, whole.weight)
        along = share, plan.floor_e, plan.budget_e, plan.photons
        merge_px = merged_px(np.array([light_e]), *along)
        between = streak.zone, streak.followed, plan.own_px
        [own] = own_paths(camera, g, *between, x, y, merge_px, True)
        off_px = math.dist(centroid(own), exact) - left_px
        per_px = light_e / max(1.0, streak.path.length_px)
        assert off_px * per_px <= 2.0 * SHOWN * plan.budget_e


def test_no_stars_have_no_paths_of_their_own(scene: Make) -> None:
    s = rate(scene, 3.0, -2.0, 0.1)
    camera, g = camera_of(s), plan_geometry(s, np.array([0]), 0.0)
    streak = zone_streak(camera, g, 0, 0, plan_streaks(camera, g, True), True)
    none = np.zeros(0)
    assert own_paths(camera, g, streak.zone, streak.followed, 0.0, none, none, none, True) == []


def test_a_star_that_comes_behind_the_camera_has_no_path(scene: Make) -> None:
    """The boresight turns by 180 degrees until mid-exposure."""
    s = rate(scene, 3.0, -2.0, 0.1)
    camera, g = camera_of(s), plan_geometry(s, np.array([0]), 0.0)
    turned = g.attitude.copy()
    turned[:, 0] *= [[1.0], [-1.0], [-1.0]]
    turning = replace(g, attitude=turned)
    x, y = np.array([383.5, 383.5]), np.array([255.5, -900.0])
    with pytest.raises(BadInput, match="a boresight that turns away from its field") as caught:
        star_offsets(camera, turning, x, y, True)
    assert caught.value.field == "exposure.integration_s"
    assert np.isfinite(star_offsets(camera, g, x, y, True)).all()


@pytest.mark.parametrize("finer", [1.0, 0.25, 2.0**-6])
def test_all_tolerances_are_as_fine_as_the_accuracy(scene: Make, finer: float) -> None:
    s = rate(scene, 30.0, -20.0, 1.0)
    camera, g = camera_of(s), plan_geometry(s, np.array([0]), 0.0)
    plan = plan_streaks(camera, g, True, USUAL_FRACTION * finer)
    assert plan.spread_px <= SPREAD_TOLERANCE_PX * finer
    assert plan.step_px == PATH_STEP_PX * finer
    assert plan.merge_px == MERGE_TOLERANCE_PX * finer


def test_light_without_noise_hides_no_error(scene: Make) -> None:
    """A streak's error, off times its light per px, is the budget where own paths begin."""
    s = rate(scene, 30.0, -20.0, 1.0)
    camera, g = camera_of(s), plan_geometry(s, np.array([0]), 0.0)
    noisy, silent = (
        plan_streaks(camera, g, True, 0.05, 5.0, 0.02, photons=photons) for photons in (True, False)
    )
    assert silent.own_from_e_px * silent.off_px == pytest.approx(0.02)
    rises = math.sqrt(1.0 + noisy.own_from_e_px / 25.0)
    assert noisy.own_from_e_px * noisy.off_px == pytest.approx(0.02 * rises)


@pytest.mark.parametrize("focal_m", [0.05, 1.0, 20.0])
def test_places_along_a_path_are_rounded_as_directions_are(scene: Make, focal_m: float) -> None:
    """A star is followed to that from its own direction or that of another eps beside it."""
    s = rate(scene, 30.0 / focal_m, -20.0 / focal_m, focal_m)
    camera, g = camera_of(s), plan_geometry(s, np.array([0]), 0.0)
    rounded_px = plan_streaks(camera, g, True).rounded_px
    assert rounded_px == pytest.approx(1e-12 + np.finfo(float).eps * focal_m / 1e-5, rel=0.02)
    x = np.linspace(0.0, 300.0, 50) + 0.3
    beside = star_offsets(camera, g, x + rounded_px, x, True) - star_offsets(camera, g, x, x, True)
    assert 0.0 < np.abs(beside).mean() < 3.0 * rounded_px


@pytest.mark.parametrize("photons", [True, False])
@pytest.mark.parametrize("light_e", [1.0, 300.0, 1e5, 1e9])
def test_a_star_off_its_path_errs_by_no_more_than_told(light_e: float, photons: bool) -> None:
    """Pixels of a sharp Gaussian, moved by as much as a streak in common is off, over their noise;
    near that for one star as sharp, and no more than the budget however bright it is."""
    floor_e, off_px, sigma_px, asked = 5.0, 1e-4, 0.3, 0.02
    plan = StreakPlan(
        1, 1, off_px, 1.0, 1, 0.0, 0.0,
        floor_e=floor_e, budget_e=asked * floor_e, photons=photons,
    )  # fmt: skip
    plan = replace(plan, own_from_e_px=light_from(off_px, plan))
    told = plan.error_e(light_e)
    assert told <= plan.budget_e
    if light_e >= plan.own_from_e_px:
        assert told == plan.budget_e  # along its own path, off by less
        return

    def pixels(at: float) -> np.ndarray:
        edges = np.arange(-5, 7) - 0.5 - at
        along = np.diff([0.5 * math.erf(e / sigma_px / math.sqrt(2.0)) for e in edges])
        across = math.erf(0.5 / sigma_px / math.sqrt(2.0))
        return light_e * across * along

    worst = 0.0
    for at in np.linspace(0.0, 1.0, 21):
        noise_e = np.sqrt(floor_e**2 + photons * pixels(at))
        worst = max(worst, float((np.abs(pixels(at + off_px) - pixels(at)) / noise_e).max()))
    assert told / 30.0 < worst * floor_e <= 1.4 * told


@pytest.mark.parametrize("share", [(1.0, 0.0, 0.0), (0.5, 1e-9, 0.5)])
def test_a_resting_star_errs_by_no_more_than_told(share: tuple[float, ...]) -> None:
    """Its light evenly along a short path, or half at either end: a point at the centroid instead,
    by quadrature of both, errs by less than is told; the latter by half of it at least."""
    blur, length = Blur(Gaussian(0.5)), 2e-3
    ends = np.cumsum([0.0, *share]) - 0.5 if share[1] == 0.0 else np.array([-0.5, -0.5, 0.5, 0.5])
    x = length * ends[: 2 if share[1] == 0.0 else 4]
    path = Path(x, np.zeros_like(x), np.array(share[: len(x) - 1]))
    plan = StreakPlan(1, 1, 0.0, length, 1, PATH_STEP_PX, MERGE_TOLERANCE_PX, own_px=0.0)
    told = resting(plan, point_curvature(blur), point_slope(blur)).off_px
    worst = 0.0
    for at in np.linspace(0.0, 0.5, 6):
        seen = [draw_quadrature(blur, p, (9, 9), (0, 0), 4.0, 4.0 + at) for p in (path, POINT)]
        worst = max(worst, float(np.abs(seen[0] - seen[1]).max()))
    assert worst <= told
    assert worst >= told * (0.1 if share[1] == 0.0 else 0.3)


def test_a_turning_fields_streaks_are_as_long_as_their_arcs(scene: Make) -> None:
    """A turn of 80 degrees about the frame's middle: longest in the corners, of no length in it."""
    pointing = {"mode": "rate", "boresight_ra_deg": 1.0, "boresight_dec_deg": 50.0,
                "rate_ra_arcsec_s": 0.0, "rate_dec_arcsec_s": 0.0,
                "roll_rate_deg_s": 40.0}  # fmt: skip
    s = scene({"pointing": pointing})
    plan = plan_streaks(camera_of(s), plan_geometry(s, np.array([0]), 0.0), True)
    arc_px = math.radians(80.0) * math.hypot(0.5 * 768, 0.5 * 512)
    assert plan.longest_px == pytest.approx(arc_px, rel=1e-4)
    assert plan.shortest_px == pytest.approx(0.0, abs=1e-6)


def test_still_stars_are_one_point(scene: Make) -> None:
    s = scene()
    camera, g = camera_of(s), plan_geometry(s, np.array([0, 4]), 0.0)
    plan = plan_streaks(camera, g, True)
    assert (plan.zones, plan.pieces, plan.shapes) == (1, 1, 1)
    assert plan.spread_px == pytest.approx(0.0, abs=1e-3)
    assert zone_streak(camera, g.frame_slice(0), 0, 0, plan, True).path.length_px < 0.01


def test_wide_fields_get_more_pieces_or_zones(scene: Make) -> None:
    plans: list[Any] = []
    for focal in (1.0, 0.1, 0.02):
        s = rate(scene, 4.0 / focal, 0.0, focal)  # the same streak in pixels
        plans.append(plan_streaks(camera_of(s), plan_geometry(s, np.array([0]), 0.0), True))
    parts = [p.zones * p.pieces for p in plans]
    assert parts == sorted(parts)
    assert parts[-1] > parts[0]
    assert all(p.spread_px <= SPREAD_TOLERANCE_PX for p in plans)
