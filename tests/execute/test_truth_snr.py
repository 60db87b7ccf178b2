"""Signal-to-noise in the truth: of long streaks, of each frame's own time, of what sets."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.execute import truth
from pipeline.execute.sources import FrameTarget
from pipeline.execute.truth import matched_snr, star_truth, target_truth
from pipeline.physics.motion.streak import Path
from pipeline.physics.radiometry import box
from pipeline.plan.facts import gather_facts
from pipeline.plan.pointing.geometry import plan_geometry
from pipeline.route.prepare import prepare
from pipeline.spec.load import parse_scene
from tests.execute.test_engines import field, geometry_of, plan_of
from tests.execute.test_truth_magnitudes import scene
from tests.plans import plan_from

GAUSSIAN = {"kind": "gaussian", "sigma_px": 1.0}


def straight(length_px: float) -> Path:
    ends = 0.5 * length_px * np.array([-1.0, 1.0])
    return Path(ends, 0.0 * ends, np.ones(1))


def test_a_streak_of_many_pieces_has_the_noise_of_all_its_pixels() -> None:
    """Of the same light in each pixel, SNR grows with the root of the length."""
    plan, at = plan_of(GAUSSIAN, 0.0, 0.0), np.array([60.0])
    found = [
        float(matched_snr(plan, straight(px), np.array([20.0 * px]), at, at)[0]) / np.sqrt(px)
        for px in (500.0, 60_000.0)  # 6 pieces, and 625
    ]
    assert found[1] == pytest.approx(found[0], rel=0.01)


DWELLS = [{"integration_s": 1.0}, {"integration_s": 4.0, "start_s": 10.0}]


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
