"""What paths lose that bend at the rows of a table of attitudes, between an exposure's nodes."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from pipeline.arrays import Geometry
from pipeline.physics.psf.response import compact_core
from pipeline.plan.pointing.geometry import PATH_TOLERANCE_PX, bend_px
from pipeline.plan.response.responses import point_slope
from pipeline.plan.stars.longest_streaks import longest_px
from pipeline.plan.timing import dwell_plans

if TYPE_CHECKING:
    from pipeline.plan.resolved import ResolvedScene


def kink_warnings(plan: ResolvedScene, g: Geometry) -> list[str]:
    """That paths between nodes pass by the rows of a table, where that shows.

    At a row a path is `bend_px` off at most, in the step between two nodes that holds it: the light
    of one step is displaced by less than that, and so errs by it times the image's slope.
    """
    tables = [p for p in dwell_plans(plan.scene) if p.pointing.mode == "table"]
    if not tables or not plan.responses.classes:
        return []
    off_px, steps = bend_px(plan.scene, g, plan.dut1_s), g.nodes - 1
    if off_px <= PATH_TOLERANCE_PX:
        return []
    r, light_e = plan.responses, plan.facts.brightest_e
    off_e = light_e / steps * off_px * max(point_slope(b) for b in r.blurs)
    peak = max(float(compact_core(b, r.usual_px).samples.max()) for b in r.blurs)
    photons_e = light_e * min(peak, 1.0 / max(longest_px(plan, g), 1.0))
    photons_e *= plan.scene.sensor.photon_noise
    sigma = off_e / math.sqrt(plan.facts.light_floor_e**2 + photons_e)
    if sigma <= plan.scene.accuracy.noise_fraction:
        return []
    return [
        f"pointing.rows: paths bend at rows up to {off_px:.2g} px beside the lines between "
        f"an exposure's {g.nodes} nodes: a pixel of the brightest source is up to {off_e:.2g} e- "
        f"off there, {sigma:.2g} of its noise (asked: "
        f"{plan.scene.accuracy.noise_fraction:g})"
    ]
