"""The plan made: every decision about a resolved scene, in one pass."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from pipeline.arrays import Geometry
from pipeline.plan.accuracy import judge
from pipeline.plan.checks import choose_checks
from pipeline.plan.coverage import FieldCoverage
from pipeline.plan.decision import Decision
from pipeline.plan.decisions import decide
from pipeline.plan.needs import drawing_s
from pipeline.plan.optics.pupil import decide_pupil
from pipeline.plan.plan import Plan
from pipeline.plan.pointing.attitude_motion import decide_motion
from pipeline.plan.pointing.decisions import decide_pointing
from pipeline.plan.pointing.occultation import decide_occultation
from pipeline.plan.resolved import ResolvedScene
from pipeline.plan.sensor.detector import decide_detector
from pipeline.plan.sky.air import decide_air
from pipeline.plan.targets.decisions import decide_targets
from pipeline.plan.targets.umbra import decide_umbra
from pipeline.plan.tiles import plan_tiles

if TYPE_CHECKING:
    from pipeline.plan.stars.engines import StarCounts
    from pipeline.plan.stars.shared_frames import OwnMotion


@dataclass(frozen=True)
class FieldStars:
    """What was found of the stars around the field.

    counts : those that light the fullest of some frames; own_motion : the most that any has
    layers : the decisions about catalogues laid over the main one
    coverage : of the frames by the main catalogue
    """

    counts: StarCounts
    own_motion: OwnMotion
    layers: tuple[Decision, ...] = ()
    coverage: FieldCoverage | None = None


def make_plan(
    resolved: ResolvedScene,
    g: Geometry,
    stars: FieldStars | None = None,
    remarks: tuple[str, ...] = (),
    warnings: tuple[str, ...] = (),
) -> Plan:
    """Decide everything about a scene.

    g : geometry of some of its frames; stars : None without any, or where none were looked at
    Raises BadInput where the bounds sum to more than the scene asks and accepts.
    """
    scene, facts, responses = resolved.scene, resolved.facts, resolved.responses
    sky = resolved.sky
    decisions: tuple[Decision, ...] = (
        *decide(scene, facts, responses),
        *decide_occultation(scene, resolved.camera, responses.reach_px, g),
        *decide_targets(scene, facts, g, responses.blur),
        *decide_umbra(scene, facts, g, resolved.sun_rate_e_s_m2, resolved.dut1_s),
        *decide_pupil(scene, g),
        *decide_air(scene, facts, g, resolved.extinction),
        *(sky.decisions if sky else ()),
        *decide_detector(scene, facts, g, resolved.dut1_s),
        *decide_pointing(scene),
        *decide_motion(scene, facts.sigma_floor_e),
    )
    shared = 1
    if stars is not None:
        from pipeline.plan.stars.engines import choose_engines
        from pipeline.plan.stars.shared_frames import share_frames

        responses, decisions = choose_engines(resolved, g, stars.counts, decisions)
        drawn = replace(resolved, responses=responses)
        seconds = drawing_s(drawn, stars.counts.total)
        shared, more = share_frames(drawn, decisions, g.frame, stars.own_motion, seconds)
        decisions = (*decisions, *more, *stars.layers)
    return Plan(
        **vars(resolved) | {"responses": responses},
        tiles=plan_tiles(scene),
        checks=choose_checks(scene, g),
        decisions=decisions,
        remarks=remarks,
        warnings=(*judge(scene, decisions), *warnings),
        coverage=stars.coverage if stars else None,
        stars_per_frame=stars.counts.total if stars else 0,
        shared_frames=shared,
    )
