"""A rule of the plan: what decides on components, in words and in code, and where it is tested."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
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
    """

    resolved: ResolvedScene
    frames: Geometry
    stars: FieldStars | None = None
    engines: StarEngines | None = None

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
