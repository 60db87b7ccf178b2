"""A rule of the plan: what decides on components, in words and in code, and where it is tested."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from pipeline.plan.decision import Decision

if TYPE_CHECKING:
    from pipeline.arrays import Geometry
    from pipeline.plan.facts import Facts
    from pipeline.plan.resolved import ResolvedScene
    from pipeline.plan.stars.engines import StarEngines
    from pipeline.plan.stars.field_stars import FieldStars
    from pipeline.spec.scene import Scene


@dataclass(frozen=True)
class PlanBasis:
    """What rules decide on.

    frames : geometry of some of the scene's frames
    stars : None without any, or where none were looked at; engines : those chosen for them
    bounds_e : of approximations, by component, where they follow from the light of all sources
        [e-]; sources_e : of the brightest one, 0 where not all are known
    """

    resolved: ResolvedScene
    frames: Geometry
    stars: FieldStars | None = None
    engines: StarEngines | None = None
    bounds_e: Mapping[str, float] = field(default_factory=dict)
    sources_e: float = 0.0

    @property
    def brightest_e(self) -> float:
        """Light of the brightest source, as far as it is known [e-]; 0 where not."""
        return self.sources_e or self.facts.brightest_e

    def within_budget(self, component: str) -> tuple[float, float]:
        """Bound of an approximation [e-, sigma]: for the sources there are, or else its part."""
        budget_e = self.facts.budget_e
        error_e = self.bounds_e.get(component, budget_e)
        if self.scene.sensor.photon_noise:  # of bright sources in a pixel, which raise its noise
            error_e = min(error_e, budget_e)
        return error_e, error_e / self.facts.light_floor_e

    @property
    def scene(self) -> Scene:
        return self.resolved.scene

    @property
    def facts(self) -> Facts:
        return self.resolved.facts


@dataclass(frozen=True)
class Rule:
    """What decides whether components of the plan are kept, and where the bound is measured.

    components : as named in the plan, `*` for any text
    rule : in words
    test : path, or path::function, of the test that fails where the rule or its bound is broken
    decide : the decisions on them for a scene; none where there is nothing to tell
    """

    components: tuple[str, ...]
    rule: str
    test: str
    decide: Callable[[PlanBasis], Iterable[Decision]]
