"""Time-delay integration in the plan: what rows that are exposed in part leave out."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from pipeline.arrays import Geometry
from pipeline.physics.psf.response import compact_core
from pipeline.plan.response.responses import point_slope
from pipeline.plan.stars.longest_streaks import longest_px
from pipeline.spec.sensor.detector import TimeDelay

if TYPE_CHECKING:
    from pipeline.plan.resolved import ResolvedScene


def edge_warnings(plan: ResolvedScene, g: Geometry) -> list[str]:
    """That streaks in rows exposed in part are drawn along all of their way, where that shows.

    Of a streak of L px a share s is exposed, at its end, and drawn over its whole length: an error
    of s (1 - s) L / 2 times the image's slope where it is short, of all the light in a pixel where
    it is long; g : some of the frames.
    """
    scene, r = plan.scene, plan.responses
    readout = None if scene.sensor.detector is None else scene.sensor.detector.readout
    if not (isinstance(readout, TimeDelay) and readout.edges == "partial" and r.classes):
        return []
    length_px = longest_px(plan, g)
    slope = max(point_slope(b) for b in r.blurs)
    peak = max(float(compact_core(b, r.usual_px).samples.max()) for b in r.blurs)
    peak = min(peak, 1.0 / max(length_px, 1.0))
    off_e = plan.facts.brightest_e * min(slope * length_px / 8.0, peak)
    seen_e = 0.5 * scene.sensor.photon_noise * plan.facts.brightest_e * peak
    noise_e = math.sqrt(plan.facts.light_floor_e**2 + seen_e)
    if off_e <= scene.accuracy.noise_fraction * noise_e:
        return []
    return [
        "sensor.detector.readout.edges: in rows that are exposed in part streaks hold their share "
        f"of light all along: of up to {length_px:.2g} px, which makes a pixel of the brightest "
        f"source err by up to {off_e:.2g} e-, {off_e / noise_e:.2g} of its noise (asked: "
        f"{scene.accuracy.noise_fraction:g})"
    ]
