"""Dwells: times of every frame, slews and settling, and what does not fit together."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from catalog_tools.ingest.ingest import ingest
from pipeline.errors import BadInput
from pipeline.physics.colour import ColourFit
from pipeline.physics.vectors import separation
from pipeline.plan.pointing.geometry import (
    aimed,
    camera_of,
    plan_geometry,
    sampled_frames,
    star_paths,
)
from pipeline.plan.stars.brightest import brightest_star_e, brightest_target_e, star_radius_rad
from pipeline.plan.timing import (
    end_s,
    frame_count,
    frame_times,
    integration_range_s,
    integration_s,
    longest_s,
)
from pipeline.route.finish import _empty_noise
from pipeline.route.prepare import prepare
from pipeline.spec.load import InvalidScene
from pipeline.spec.scene import Scene
from tests.plan.test_plan import GAUSS, facts_of
from tests.plans import plan_from

Make = Callable[..., Scene]
ARCSEC = np.pi / 648_000


def held(ra: float, **more: Any) -> dict[str, Any]:
    return {"mode": "sidereal", "boresight_ra_deg": ra, "boresight_dec_deg": 25.0} | more


PLAN: list[dict[str, Any]] = [
    {"frames": 3, "integration_s": [0.5, 2.0]},
    {"pointing": held(41.0), "slew": {"duration_s": 8.0}, "wait_s": 1.5, "frames": 2,
     "integration_s": 1.0, "cadence_s": 4.0},
    {"pointing": held(40.0), "slew": {"duration_s": 5.0, "profile": "bang_bang"},
     "start_s": 60.0, "frames": 4, "integration_s": 2.0, "cadence_s": 2.0,
     "settle": {"amplitude_arcsec": 20.0, "frequency_hz": 1.0, "damping": 0.1}},
]  # fmt: skip


def test_one_dwell_is_what_it_was(scene: Make) -> None:
    s = scene()
    start, time = frame_times(s, np.arange(5))
    assert np.array_equal(start, np.arange(5) * 10.0)
    assert np.array_equal(time, np.full(5, 2.0))
    assert (frame_count(s), end_s(s), integration_range_s(s)) == (5, 42.0, (2.0, 2.0))


def test_times_of_every_frame(scene: Make) -> None:
    s = scene({"dwells": PLAN, "exposure.cadence_s": None})
    start, time = frame_times(s, np.arange(9))
    assert np.allclose(start, [0.0, 0.5, 2.5, 12.5, 16.5, 60.0, 62.0, 64.0, 66.0])
    assert np.allclose(time, [0.5, 2.0, 0.5, 1.0, 1.0, 2.0, 2.0, 2.0, 2.0])
    assert np.array_equal(frame_times(s, np.array([7, 1]))[0], start[[7, 1]])
    assert (frame_count(s), end_s(s), integration_range_s(s)) == (9, 68.0, (0.5, 2.0))
    assert integration_s(s, 1) == 2.0
    assert {0, 2, 3, 4, 5, 8} <= set(sampled_frames(s))
    g = plan_geometry(s, np.arange(9), 0.0)
    assert np.allclose(g.offset_s[:, 0], start)
    assert np.allclose(g.offset_s[:, -1] - g.offset_s[:, 0], time)


def test_a_dwell_waits_without_a_slew(scene: Make) -> None:
    s = scene({"dwells": [{"frames": 2}, {"frames": 1, "wait_s": 7.0}], "exposure.cadence_s": 3.0})
    assert np.array_equal(frame_times(s, np.arange(3))[0], [0.0, 3.0, 12.0])


def test_a_dwell_alone_is_the_scene_without_it(scene: Make) -> None:
    plain = scene()
    same = scene({"dwells": [{}]})
    a, b = (plan_geometry(s, np.arange(5), 0.0) for s in (plain, same))
    assert np.array_equal(a.attitude, b.attitude)


def test_frames_in_a_slew_are_on_the_way(scene: Make) -> None:
    """Minimum jerk over 0.01 degrees: at half the time half the way, at rest at both ends."""
    near = {"pointing": held(40.011), "slew": {"duration_s": 10.0}, "start_s": 2.0, "frames": 6,
            "integration_s": 2.0, "cadence_s": 2.0}  # fmt: skip
    still = {"stars.aberration": False, "stars.deflection": False}
    s = scene({"dwells": [{"frames": 1}, near], "exposure.cadence_s": 2.0} | still)
    g = plan_geometry(s, np.arange(7), 0.0)
    total = separation(g.attitude[0, 0, 2], g.attitude[-1, -1, 2])
    t = np.clip((g.offset_s - 2.0) / 10.0, 0.0, 1.0)
    share = separation(g.attitude[0, 0, 2], g.attitude[:, :, 2]) / total
    assert np.allclose(share, 10 * t**3 - 15 * t**4 + 6 * t**5, atol=1e-7)
    camera = camera_of(s)
    middle = star_paths(camera, g, np.array([383.5]), np.array([255.5]), False)[:, 0]
    lengths = np.hypot(*np.diff(middle, axis=-1)).sum(axis=-1)
    assert np.allclose(lengths.sum(), np.tan(total) / 1e-5, rtol=1e-3)
    assert lengths[3] > 5 * lengths[1] > 0
    assert lengths[6] == pytest.approx(0.0, abs=1e-6)


def test_a_slew_begins_where_the_dwell_before_has_drifted_to(scene: Make) -> None:
    """50 arcsec a second for the two seconds before it."""
    away = {"pointing": held(40.011), "slew": {"duration_s": 10.0}, "start_s": 2.0, "frames": 6,
            "integration_s": 2.0, "cadence_s": 2.0}  # fmt: skip
    drift = {"attitude": {"drift": {"x_arcsec_s": 50.0, "y_arcsec_s": 0.0}}}
    still = {"stars.aberration": False, "stars.deflection": False, "exposure.cadence_s": 2.0}
    axes = []
    for more in (drift, {}):
        s = scene({"dwells": [{"frames": 1}, away], "pointing": held(40.0) | more} | still)
        begin, end = (aimed(s, np.array([2.0]), 0.0, np.array([k]))[1][0] for k in (1, 0))
        np.testing.assert_allclose(begin, end, atol=1e-12)
        axes.append(begin[2])
    assert separation(*axes) == pytest.approx(100.0 * ARCSEC, rel=1e-3)


@pytest.mark.parametrize("direction_deg", [0.0, 30.0, 250.0])
def test_settling_after_a_slew(scene: Make, direction_deg: float) -> None:
    settle = {"amplitude_arcsec": 20.0, "frequency_hz": 1.0, "damping": 0.01,
              "direction_deg": direction_deg}  # fmt: skip
    s = scene({"dwells": [*PLAN[:2], PLAN[2] | {"settle": settle}], "exposure.cadence_s": None})
    rest = [{k: v for k, v in d.items() if k != "settle"} for d in PLAN]
    moved, still = (
        plan_geometry(x, np.arange(5, 9), 0.0)
        for x in (s, scene({"dwells": rest, "exposure.cadence_s": None}))
    )
    t = moved.offset_s - 22.5  # the slew starts at 17.5 and lasts 5 s
    w = 2 * np.pi
    wave = 20.0 * ARCSEC * np.exp(-0.01 * w * t) * np.sin(w * np.sqrt(0.9999) * t)
    assert np.abs(wave).max() > 1.0 * ARCSEC
    stride = (moved.nodes - 1) // (still.nodes - 1)
    angle = np.radians(direction_deg)
    for axis, share in ((0, np.cos(angle)), (1, np.sin(angle))):
        left = np.einsum(
            "fkj,fkj->fk", moved.attitude[:, ::stride, 2], still.attitude[:, :, axis]
        )
        assert np.allclose(left, share * wave[:, ::stride], rtol=0.0, atol=1e-12)


def test_a_dwell_may_start_when_the_one_before_it_ends(scene: Make) -> None:
    """3 x 0.2 s are 0.6 s, though their sum is rounded up; not a millisecond before."""
    times = {"frames": 3, "integration_s": 0.2}
    s = scene({"dwells": [times, times | {"start_s": 0.6}], "exposure.cadence_s": None})
    assert np.allclose(frame_times(s, np.arange(6))[0], 0.2 * np.arange(6))
    early = scene({"dwells": [times, times | {"start_s": 0.599}], "exposure.cadence_s": None})
    with pytest.raises(BadInput, match=r"dwells\.1\.start_s"):
        frame_times(early, np.arange(1))


BAD: dict[str, tuple[list[dict[str, Any]], str, str]] = {
    "overlap": ([{}, {"start_s": 3.0}], "dwells.1.start_s", "when the dwell before it ends"),
    "first slew": ([{"slew": {"duration_s": 1.0}}], "dwells.0.slew", "after another dwell"),
    "cadence": ([{"integration_s": 20.0}], "dwells.0.integration_s", "cadence"),
    "own cadence": ([{"integration_s": [1, 5], "cadence_s": 2}], "dwells.0.cadence_s", "at least"),
    "wait": ([{"start_s": 3, "wait_s": 1}], "dwells.0.wait_s", "allowed: 0"),
    "no time": ([{"integration_s": []}], "dwells.0.integration_s", ""),
    "none": ([], "dwells", "at least 1"),
    "target": ([{"pointing": {"mode": "target", "target": "x"}}], "dwells.0.pointing.target",
               "name of a target"),
    "random": ([{"pointing": held(1.0, attitude={"modes": [
        {"kind": "random_walk", "axis": "x", "arcsec_rts": 1.0}]})}],
        "dwells.0.pointing.attitude", "drift"),
    "too many": ([{"frames": 100_000}, {}], "dwells", "frames in all"),
    "damping": ([{"settle": {"amplitude_arcsec": 1, "frequency_hz": 1, "damping": 1}}],
                "dwells.0.settle.damping", "less than 1"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_dwells_that_do_not_fit(scene: Make, name: str) -> None:
    plans, field, word = BAD[name]
    with pytest.raises((BadInput, InvalidScene)) as caught:
        frame_times(scene({"dwells": plans}), np.arange(1))
    assert caught.value.field == field
    assert word in str(caught.value)


@pytest.mark.parametrize("own", [True, False])
def test_a_pointing_that_does_not_fit_is_named_where_it_stands(scene: Make, own: bool) -> None:
    local = {"mode": "local", "azimuth_deg": 0.0, "elevation_deg": 45.0}
    here = {"observer": {"kind": "fixed", "position_au": [1, 0, 0]}}
    where = {"dwells": [{"frames": 2}, {"pointing": local}]} if own else {"pointing": local}
    s = scene(here | where)
    with pytest.raises(BadInput) as caught:
        plan_geometry(s, sampled_frames(s), 0.0)
    assert caught.value.field == ("dwells.1.pointing.mode" if own else "pointing.mode")


def test_which_exposures_a_plan_is_made_for(scene: Make) -> None:
    """Times that no frame takes and bias frames do not count; bias frames alone are planned for."""
    for times, frames, planned, longest in (
        ([2.0, 3.0, 9.0], 2, (2.0, 3.0), 3.0), ([3.0, 0.0, 2.0], 3, (2.0, 3.0), 3.0),
        ([0.0, 5.0], 2, (5.0, 5.0), 5.0), ([0.0], 2, (1e-6, 1e-6), 0.0),
    ):  # fmt: skip
        dwell = {"integration_s": times, "frames": frames, "cadence_s": 10.0}
        s = scene({"dwells": [dwell, dwell]})
        assert (integration_range_s(s), longest_s(s)) == (planned, longest)


LIT = {
    "sensor.psf": {"kind": "gaussian", "sigma_px": 0.8}, "sensor.dark_e_per_s": 3.0,
    "sensor.gain_e_per_dn": 6.0, "background": {"uniform_e_per_s": 7.0},
}  # fmt: skip


@pytest.mark.parametrize("photons", [True, False])
def test_the_floor_of_each_frame_is_that_of_its_own_exposure(scene: Make, photons: bool) -> None:
    """Sky and dark of its time, where light has noise; the facts' is that of the shortest one."""
    s = scene(LIT | {"dwells": [{"integration_s": [4.0, 2.0, 2.5], "frames": 3}],
                     "exposure.cadence_s": None, "sensor.photon_noise": photons})  # fmt: skip
    facts = replace(facts_of(s), flat=0.8)
    plan = plan_from(s, facts, plan_geometry(s, sampled_frames(s), 0.0))
    fixed = 5.0**2 + 6.0**2 / 12.0
    for frame, time_s in enumerate((4.0, 2.0, 2.5)):
        floor, told = (photons * (sky + 3.0) * time_s + fixed for sky in (7.0, 0.8 * 7.0))
        assert plan.floor_e(frame) == pytest.approx(np.sqrt(floor), rel=1e-12)
        assert plan.snr_floor_e2(frame, *np.zeros((2, 1))) == pytest.approx(told, rel=1e-12)
    assert facts.sigma_floor_e == plan.floor_e(1)
    assert (facts.background_e, facts.dark_e) == (14.0, 6.0)


def test_the_report_has_the_noise_of_every_frame_where_one_differs(scene: Make) -> None:
    """Also where that of others is the floor: it is of the frames in order, or not there."""
    for times in ([4.0, 2.0], [2.0, 2.0]):
        s = scene(LIT | {"dwells": [{"integration_s": times, "frames": 2}],
                         "exposure.cadence_s": None})  # fmt: skip
        plan = plan_from(s, facts_of(s), plan_geometry(s, sampled_frames(s), 0.0))
        noise = [np.sqrt(10.0 * t + 5.0**2 + 6.0**2 / 12.0) for t in times]
        told = {"empty_noise_e": pytest.approx(noise, rel=1e-5)} if times[0] > 2.0 else {}
        assert _empty_noise(plan) == told


def test_the_smear_that_is_told_is_that_of_the_shortest_exposure(scene: Make) -> None:
    """Charge moves for 0.1 s: a twentieth of the 2 s of some frames, though others take 8 s."""
    detector = {"readout": {"kind": "frame_transfer", "transfer_s": 0.1, "towards": "low_rows"}}
    s = scene(LIT | {"dwells": [{"integration_s": [8.0, 2.0], "frames": 2}],
                     "exposure.cadence_s": None, "sensor.detector": detector})  # fmt: skip
    plan = plan_from(s, facts_of(s), plan_geometry(s, sampled_frames(s), 0.0))
    [told] = [d.reason for d in plan.decisions if d.component == "frame_transfer"]
    assert "0.05 of a column's mean light" in told


def test_the_brightest_star_is_looked_for_as_far_around_the_frame_again(scene: Make) -> None:
    """Of a camera at rest: within twice the angle to its corner."""
    s = scene()
    corner_rad = np.arctan(0.5 * np.hypot(512, 768) * 10e-6 / 1.0)
    found = star_radius_rad(s, plan_geometry(s, sampled_frames(s), 0.0))
    assert found == pytest.approx(np.full(found.shape, 2.0 * corner_rad), rel=1e-9)


def test_the_brightest_source_is_that_of_the_longest_exposure(scene: Make) -> None:
    fit = ColourFit("b", np.zeros(1), (0.0, 1.0), 0.0, 0.0, 0.0, 0.5, 0.1, 0.0, 1e10, "made up", 1)
    orbit = {"kind": "orbit", "orbit": {
        "kind": "state", "position_m": [4.2e7, 0, 0], "velocity_m_s": [0, 3070, 0]}}  # fmt: skip
    ball = {"name": "t", "eclipse": False, "orbit": {
        "kind": "state", "position_m": [4.2e7, 3e5, 1e5], "velocity_m_s": [0, 3070, 0]},
        "body": {"kind": "sphere", "diameter_m": 1.0, "albedo": 0.3}}  # fmt: skip
    seen = {"observer": orbit, "targets": [ball], "exposure.cadence_s": None,
            "pointing": {"mode": "target", "target": "t"}}  # fmt: skip
    found = []
    for time_s in ([1.0, 4.0], [4.0], [1.0]):
        s = scene(LIT | seen | {"dwells": [{"integration_s": time_s, "frames": len(time_s)}]})
        g = plan_geometry(s, sampled_frames(s), 0.0)
        found.append((brightest_star_e(s, fit, [7.0, 5.0, 9.0]), brightest_target_e(s, g, 1e20)))
    assert found[0] == pytest.approx(found[1], rel=1e-5)
    assert found[1] == pytest.approx(np.multiply(4.0, found[2]), rel=1e-4)
    area_m2 = np.pi / 4.0 * 0.4**2 * (1.0 - 0.3**2)
    assert found[1][0] == pytest.approx(1e10 * 10.0**-2.0 * area_m2 * 4.0, rel=1e-9)


def test_the_brightest_target_is_looked_for_as_far_as_its_wings_may_be_drawn(scene: Make) -> None:
    """To 4,096 px beside the frame of 768 columns."""
    seen = {"observer": {"kind": "orbit", "orbit": {
        "kind": "state", "position_m": [4.2e7, 0, 0], "velocity_m_s": [0, 3070, 0]}},
        "targets": [{"name": "t", "eclipse": False, "orbit": {
            "kind": "state", "position_m": [4.2e7, 3e5, 1e5], "velocity_m_s": [0, 3070, 0]},
            "body": {"kind": "sphere", "diameter_m": 1.0, "albedo": 0.3}}],
        "pointing": {"mode": "target", "target": "t"}}  # fmt: skip
    s = scene(LIT | seen)
    g = plan_geometry(s, sampled_frames(s), 0.0)
    inside = brightest_target_e(s, g, 1e20)
    assert inside > 0.0
    for off_px, found in ((4000.0, inside), (-4000.0, inside), (5000.0, 0.0), (-5000.0, 0.0)):
        beside = replace(g, target_x_px=g.target_x_px + off_px)
        assert brightest_target_e(s, beside, 1e20) == found


def test_stars_move_as_far_as_in_the_fastest_dwell(scene: Make, tmp_path: Path) -> None:
    """Beside a dwell that stands still as alone."""
    (tmp_path / "stars.csv").write_text("source_id,ra,dec,phot_g_mean_mag\n1,40.0,25.0,12.0\n")
    ingest([tmp_path / "stars.csv"], tmp_path / "sky", form="gaia_dr2", workers=1)
    more = {"stars.catalogue": str(tmp_path / "sky"), "sensor.psf": GAUSS,
            "sensor.shape": [64, 64]}  # fmt: skip
    fast = {"mode": "rate", "boresight_ra_deg": 40.0, "boresight_dec_deg": 25.0,
            "rate_ra_arcsec_s": 0.0, "rate_dec_arcsec_s": 100.0}  # fmt: skip
    dwells = [{"frames": 1}, {"frames": 1, "pointing": fast}]
    alone, both = (prepare(scene({"dwells": some} | more)) for some in (dwells[1:], dwells))
    assert alone.spent.excursion_px > 0.0
    assert both.spent.excursion_px == pytest.approx(alone.spent.excursion_px)
