"""A target that stands still among streaked stars: its wings are as good as the plan says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.arrays import FrameStars, concatenate
from pipeline.execute.blocks import render_block
from pipeline.execute.check import reference
from pipeline.execute.light import draw_targets
from pipeline.execute.sources import place_targets
from pipeline.physics.radiometry import box
from pipeline.plan.facts import gather_facts
from pipeline.plan.plan import Plan
from pipeline.plan.pointing.geometry import plan_geometry
from pipeline.plan.response.responses import FAINT_PART
from pipeline.plan.tiles import Tile
from pipeline.spec.load import parse_scene
from tests.plans import plan_from

SIDE = 256
WHOLE = Tile(0, 0, 0, 0, SIDE, SIDE)
PLACE_M, SPEED_M_S = [7131858.8, -812572.7, 0.0], [-117.404, -1030.438, 7379.381]
GEO_M, GEO_M_S = [4407338.1, -41933021.2, 0.0], [3057.8229, 321.3901, 0.0]
NO_STARS = concatenate([], FrameStars)


def tracked(sun_e_s_m2: float) -> Plan:
    """A plan of one frame that follows a satellite, stars streaking by 300 px; nothing is read."""
    scene = parse_scene({
        "schema": "nightglass/scene/1", "name": "tracked", "epoch": "2019-05-12T09:00:00Z",
        "observer": {"kind": "orbit", "orbit": {
            "kind": "state", "position_m": PLACE_M, "velocity_m_s": SPEED_M_S}},
        "sensor": {
            "shape": [SIDE, SIDE], "pixel_pitch_um": 9.0, "focal_length_m": 1.6, "aperture_m": 0.5,
            "psf": {"kind": "airy", "wavelength_nm": 650.0}, "obscuration": 0.3,
            "bandpass": {"kind": "box", "short_nm": 640.0, "long_nm": 660.0}, "read_noise_e": 6.0,
        },
        "pointing": {"mode": "target", "target": "geo"},
        "targets": [{
            "name": "geo", "body": {"kind": "sphere", "diameter_m": 4.0, "albedo": 0.2},
            "orbit": {"kind": "state", "position_m": GEO_M, "velocity_m_s": GEO_M_S},
        }],
        "exposure": {"integration_s": 8.6}, "stars": {"catalogue": "none"},
    })  # fmt: skip
    facts = gather_facts(scene, box(640e-9, 660e-9), 0.0, 6.0, 1.0)
    g = plan_geometry(scene, np.zeros(1, int), 0.0)
    return plan_from(scene, facts, g, sun_e_s_m2)


def errors_e(plan: Plan) -> np.ndarray:
    """How far the target's light is from the reference path, in a window beside it [e-]."""
    g = plan_geometry(plan.scene, np.zeros(1, int), 0.0)
    image = draw_targets(plan, g, WHOLE, [render_block(plan, g, WHOLE, [NO_STARS])])
    out = []
    for row, column in ((120, 120), (120, 138), (146, 128)):
        window = Tile(0, 0, row, column, 16, 16)
        exact, _ = reference(plan, g, window, NO_STARS)
        part = image[row : row + 16, column : column + 16]
        out.append(np.abs(part - exact))
    return np.stack(out)


@pytest.fixture(scope="module")
def plan() -> Plan:
    """The target as bright as stars of the first class may be."""
    first = tracked(1e18)
    (target,) = place_targets(first, plan_geometry(first.scene, np.zeros(1, int), 0.0))
    limit = first.responses.classes[0].brightest_e / FAINT_PART
    return tracked(1e18 * 0.95 * limit / target.light_e)


def test_its_wings_hold_the_bound(plan):
    first = plan.responses.classes[0]
    assert first.target_e < 0.2 * first.brightest_e
    assert first.target_error > 5.0 * first.wing_error
    assert errors_e(plan).max() <= plan.responses.budget_e


def test_by_the_limits_of_streaked_stars_they_would_not(plan):
    stars = tuple(replace(c, target_e=c.brightest_e / FAINT_PART) for c in plan.responses.classes)
    careless = replace(plan, responses=replace(plan.responses, classes=stars))
    assert errors_e(careless).max() > 3.0 * plan.responses.budget_e


def test_the_plan_says_so(plan):
    (said,) = [d for d in plan.decisions if d.component == "wings_on_a_coarse_grid"]
    first = plan.responses.classes[0]
    assert f"{first.brightest_e:.3g} e-" in said.reason
    assert f"{first.target_e:.3g} e-" in said.reason
