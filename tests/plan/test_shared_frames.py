"""Frames that share a drawing of their stars: how far those stand beside it, at any phase."""

from __future__ import annotations

import math

import numpy as np

from pipeline.physics.constants import EARTH_GM_M3_S2
from pipeline.physics.radiometry import box
from pipeline.plan.facts import gather_facts
from pipeline.plan.pointing.geometry import plan_geometry, sampled_frames
from pipeline.plan.stars.field_stars import OwnMotion
from pipeline.plan.stars.shared_frames import _moved_px, bound_sigma, share_frames
from pipeline.spec.load import parse_scene
from tests.plans import plan_from

AXIS_M, A_TURN = 7.078e6, 256


def test_frames_that_are_looked_at_are_of_all_phases_of_an_orbit() -> None:
    """Of eight revolutions; frames at even steps are all of one phase, where stars hardly move."""
    period_s = 2.0 * math.pi * math.sqrt(AXIS_M**3 / EARTH_GM_M3_S2)
    off = math.radians(20.0)
    to = np.array([0.0, math.sin(off), math.cos(off)])
    s = parse_scene({
        "schema": "nightglass/scene/1", "name": "x", "epoch": "2019-04-20T03:00:00Z",
        "accept": ["error", "sun", "moon"],
        "observer": {"kind": "orbit", "orbit": {
            "kind": "state", "position_m": [AXIS_M, 0, 0],
            "velocity_m_s": [0, math.sqrt(EARTH_GM_M3_S2 / AXIS_M), 0]}},
        "sensor": {
            "shape": [2048, 2048], "pixel_pitch_um": 10.0, "focal_length_m": 0.5,
            "aperture_m": 0.1, "psf": {"kind": "gaussian", "sigma_px": 0.8}, "read_noise_e": 5.0,
            "bandpass": {"kind": "box", "short_nm": 600, "long_nm": 700}},
        "pointing": {"mode": "sidereal",
                     "boresight_ra_deg": math.degrees(math.atan2(to[1], to[0])),
                     "boresight_dec_deg": math.degrees(math.asin(to[2]))},
        "exposure": {"integration_s": 1.0, "frames": 8 * A_TURN + 1,
                     "cadence_s": period_s / A_TURN},
        "stars": {"catalogue": "none"},
    })  # fmt: skip
    facts = gather_facts(s, box(600e-9, 700e-9), 0.0, 5.0, 1.0, brightest_e=3000.0)
    sampled, own = sampled_frames(s), OwnMotion(0.0, 0.0)
    plan = plan_from(s, facts, plan_geometry(s, sampled, 0.0))
    together, (decision,) = share_frames(plan, (), sampled, own, 1.0)
    assert together > 1
    told = decision.error_bound_sigma
    assert told is not None
    groups = np.arange(0, A_TURN, together)
    found = bound_sigma(plan, _moved_px(plan, groups, own, together))
    assert found <= 1.1 * told
    assert bound_sigma(plan, _moved_px(plan, sampled, own, together)) < 0.5 * found
