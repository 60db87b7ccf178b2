"""A target that is behind the camera for a part of an exposure is drawn for the rest of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.execute.outlook import target_snr
from pipeline.execute.sources import place_targets, reaching
from pipeline.execute.truth import target_truth
from pipeline.plan.pointing.geometry import plan_geometry
from pipeline.route.prepare import prepare
from pipeline.spec.load import parse_scene

SCENE = {
    "schema": "nightglass/scene/1",
    "name": "behind",
    "accept": ["moon", "daylight"],
    "epoch": "2019-07-20T09:00:00Z",
    "observer": {"kind": "fixed", "position_au": [1, 0, 0]},
    "sensor": {
        "shape": [256, 256], "pixel_pitch_um": 9.0, "focal_length_m": 0.5, "aperture_m": 0.1,
        "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
        "psf": {"kind": "gaussian", "sigma_px": 1.0},
    },
    "pointing": {"mode": "target", "target": "t"},
    "exposure": {"integration_s": 1.0},
    "targets": [{
        "name": "t", "body": {"kind": "sphere", "diameter_m": 1.0, "albedo": 0.5},
        "orbit": {"kind": "state", "position_m": [4.2e7, 0, 0], "velocity_m_s": [0, 3070, 0]},
    }],
}  # fmt: skip


@pytest.mark.parametrize(("behind", "share"), [
    ([], 1.0), ([0], 7 / 8), ([0, 1, 2, 3, 4], 3 / 8), ([3, 4, 5], 4 / 8), ([1, 3, 5, 7], 0.0),
])  # fmt: skip
def test_light_is_that_of_the_steps_in_view(behind: list[int], share: float) -> None:
    plan = prepare(parse_scene(SCENE)).plan
    g = plan_geometry(plan.scene, np.array([0]), 0.0)
    whole = place_targets(plan, g)[0]
    assert g.nodes == 9
    g.target_x_px[0, 0] = 127.5 + 2.0 * np.arange(9)
    g.target_x_px[0, 0, behind], g.target_y_px[0, 0, behind] = np.nan, np.nan
    made = place_targets(plan, g)[0]
    assert made.light_e == pytest.approx(share * whole.light_e, rel=1e-3, abs=1e-9)
    assert np.isfinite(made.path.x_px).all()
    middle = 0.5 * (made.path.x_px[1:] + made.path.x_px[:-1]) + made.x_px
    if share:
        lit = [k for k in range(8) if k not in behind and k + 1 not in behind]
        expected = np.mean([127.5 + 2.0 * k + 1.0 for k in lit])
        assert made.path.weight @ middle == pytest.approx(expected, abs=1e-3)
    assert made.path.segments <= 1 + 2 * len(behind)  # straight runs are merged
    truth = target_truth(plan, g)
    assert truth["electrons"][0] == pytest.approx(made.light_e)
    assert np.isnan(truth["x_px"][0]) == (4 in behind)


def test_what_is_hidden_between_two_moments_alone_is_cut() -> None:
    """Behind the limb for 0.8 of the 8 steps, while it is seen at every moment worked out."""
    plan = prepare(parse_scene(SCENE)).plan
    g = plan_geometry(plan.scene, np.array([0]), 0.0)
    whole = place_targets(plan, g)[0]
    g.target_clear[0, 0] = (np.arange(9) - 3.5) ** 2 - 0.4**2
    assert g.target_clear.min() > 0.0
    assert place_targets(plan, g)[0].light_e == pytest.approx(0.9 * whole.light_e, rel=0.01)


def test_one_that_is_behind_all_the_time_is_not_drawn() -> None:
    plan = prepare(parse_scene(SCENE)).plan
    g = plan_geometry(plan.scene, np.array([0]), 0.0)
    g.target_x_px[:], g.target_y_px[:] = np.nan, np.nan
    assert place_targets(plan, g) == []
    assert place_targets(plan, g, everywhere=True) == []


def test_truth_tells_of_the_middle_of_the_exposure() -> None:
    """Phase, range, sunlit fraction of a minute's exposure: those of an instant in its middle."""
    tle = {
        "kind": "tle",
        "line1": "1 28238U 04011A   19100.50000000  .00000000  00000-0  00000+0 0  9994",
        "line2": "2 28238   0.0200  80.0000 0003000 100.0000 200.0000  1.00270000 54325",
    }
    site = {"kind": "ground", "latitude_deg": 20.0, "longitude_deg": 0.0}
    found = []
    for epoch, seconds in (("09:00:00", 60.0), ("09:00:29.999", 0.002)):
        data = SCENE | {
            "epoch": f"2019-04-10T{epoch}Z", "exposure": {"integration_s": seconds},
            "observer": site, "targets": [SCENE["targets"][0] | {"orbit": tle}],
        }  # fmt: skip
        plan = prepare(parse_scene(data)).plan
        found.append(target_truth(plan, plan_geometry(plan.scene, np.array([0]), 0.0)))
    long, short = found
    for name, room in (("phase_deg", 1e-5), ("range_m", 1e-2), ("apparent_ra_deg", 1e-6)):
        assert long[name][0] == pytest.approx(short[name][0], abs=room), name
    assert long["sunlit_fraction"][0] == short["sunlit_fraction"][0]


@pytest.mark.parametrize("side", ["left", "right", "low", "high"])
def test_targets_reach_an_oblong_frame_from_every_side(side: str) -> None:
    """As far off as anything may be drawn around them, and not farther; SNR only of those in it."""
    sensor = SCENE["sensor"] | {"shape": [100, 300]}
    plan = prepare(parse_scene(SCENE | {"sensor": sensor})).plan
    g = plan_geometry(plan.scene, np.zeros(1, int), 0.0)
    margin = plan.halo_px + plan.responses.reach_core_px
    axis, edge, sign = {"left": ("x", 0.0, -1.0), "right": ("x", 300.0, 1.0),
                        "low": ("y", 0.0, -1.0), "high": ("y", 100.0, 1.0)}[side]  # fmt: skip

    def moved(off_px: float):
        place = {"x": 150.0, "y": 50.0} | {axis: edge + sign * off_px}
        shape = g.target_x_px.shape
        return replace(g, **{f"target_{a}_px": np.full(shape, v) for a, v in place.items()})

    assert reaching(plan, moved(margin - 0.5)) == [0]
    assert reaching(plan, moved(margin + 0.5)) == []
    for off_px, seen in ((-1.0, True), (0.6, False)):
        assert (target_snr(plan, moved(off_px), ("t",))["t"] > 0.0) == seen
        assert target_truth(plan, moved(off_px))["in_frame"].tolist() == [seen]
