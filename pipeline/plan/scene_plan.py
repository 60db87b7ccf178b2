"""The plan made: every decision about a resolved scene, in one pass."""

from __future__ import annotations

from dataclasses import replace

from pipeline.arrays import Geometry
from pipeline.plan.accuracy import judge
from pipeline.plan.checks import choose_checks
from pipeline.plan.ledger import LEDGER
from pipeline.plan.needs import drawing_s
from pipeline.plan.plan import Plan
from pipeline.plan.resolved import ResolvedScene
from pipeline.plan.response.sources import (
    KnownSources,
    SourceBounds,
    bounds_of,
    known_of_frames,
)
from pipeline.plan.rule import PlanBasis
from pipeline.plan.stars.engines import choose_engines
from pipeline.plan.stars.field_stars import FieldStars
from pipeline.plan.stars.shared_frames import share_frames
from pipeline.plan.tiles import plan_tiles
from pipeline.spec.scene import Scene


def make_plan(
    resolved: ResolvedScene,
    g: Geometry,
    stars: FieldStars | None = None,
    remarks: tuple[str, ...] = (),
    warnings: tuple[str, ...] = (),
    targets: KnownSources | None = None,
) -> Plan:
    """Decide everything about a scene.

    g : geometry of some of its frames; stars : None without any, or where none were looked at
    targets : those of all frames; None where they are not known
    Raises BadInput where the bounds sum to more than the scene asks and accepts.
    """
    scene, engines, responses = resolved.scene, None, resolved.responses
    if stars is not None:
        engines = choose_engines(resolved, g, stars.counts)
        responses = engines.responses
    known = _all_sources(scene, stars, targets)
    bounds = bounds_of(responses, *known) if known and responses.classes else SourceBounds()
    basis = PlanBasis(resolved, g, stars, engines, bounds.errors_e, bounds.brightest_e)
    decisions = tuple(d for rule in LEDGER for d in rule.decide(basis))
    shared = 1
    if stars is not None:
        drawn = replace(resolved, responses=responses)
        seconds = drawing_s(drawn, stars.counts.total)
        shared, more = share_frames(drawn, decisions, g.frame, stars.own_motion, seconds)
        decisions += more
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
        brightest_e=basis.brightest_e,
    )


def _all_sources(
    scene: Scene, stars: FieldStars | None, targets: KnownSources | None
) -> tuple[KnownSources, KnownSources] | None:
    """All stars and all targets of a scene; None where not all are known."""
    none = known_of_frames(())
    of_stars = none if scene.stars is None else (stars.sources if stars else None)
    of_targets = targets if scene.targets else none
    return (of_stars, of_targets) if of_stars is not None and of_targets is not None else None
