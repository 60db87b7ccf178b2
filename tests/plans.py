"""Plans of scenes whose facts a test has made itself."""

from __future__ import annotations

from pipeline.arrays import Geometry
from pipeline.plan.facts import Facts
from pipeline.plan.plan import Plan
from pipeline.plan.resolved import resolved_scene
from pipeline.plan.scene_plan import make_plan
from pipeline.spec.scene import Scene


def plan_from(
    scene: Scene,
    facts: Facts,
    g: Geometry,
    sun_rate_e_s_m2: float = 0.0,
    remarks: tuple[str, ...] = (),
) -> Plan:
    """A plan whatever its bounds sum up to."""
    scene = scene.model_copy(update={"accept": (*scene.accept, "error")})
    resolved = resolved_scene(scene, facts, g, sun_rate_e_s_m2=sun_rate_e_s_m2)
    return make_plan(resolved, g, remarks=remarks)
