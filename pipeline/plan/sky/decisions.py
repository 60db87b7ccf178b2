"""The sky in the plan: what was decided of it when its light was gathered, and by which rules."""

from __future__ import annotations

from collections.abc import Callable
from fnmatch import fnmatchcase

from pipeline.plan.decision import Decision
from pipeline.plan.rule import PlanBasis, Rule


def _of_sky(pattern: str) -> Callable[[PlanBasis], list[Decision]]:
    """Those decisions of the sky whose component is such."""

    def decide(basis: PlanBasis) -> list[Decision]:
        sky = basis.resolved.sky
        return [d for d in sky.decisions if fnmatchcase(d.component, pattern)] if sky else []

    return decide


def _faint_stars(basis: PlanBasis) -> list[Decision]:
    """Stars beyond the limit, and those of layers that another catalogue holds."""
    layers = basis.stars.layers if basis.stars else ()
    return [*_of_sky("stars.faint")(basis), *layers]


RULES = (
    Rule(
        ("stray_light.*",),
        "each body where background.stray_light asks for it",
        "tests/plan/sky/test_stray_light.py::test_sources_are_switched",
        _of_sky("stray_light.*"),
    ),
    Rule(
        ("background.*",),
        "light per solid angle where a pixel looks, through its own solid angle and the pupil's "
        "cosine; on a grid, of one value or refined until its error is within the accuracy",
        "tests/acceptance/test_wide_field.py::test_a_uniform_sky_falls_with_the_cosine",
        _of_sky("background.*"),
    ),
    Rule(
        ("stars.faint", "stars.layer_*"),
        "stars below the limit (given, with starlight: all, or where the sum of all fainter "
        "ones is below a part of the noise) become smooth light; in layers each star is drawn once",
        "tests/plan/sky/test_sky.py",
        _faint_stars,
    ),
)
