"""Optical distortion in the plan."""

from __future__ import annotations

from pipeline.physics.positions.focal_plane import stretch
from pipeline.plan.decision import Decision
from pipeline.plan.rule import PlanBasis, Rule

ROUNDING_PX = 1e-8  # of a distorted place, or back from it


def _distortion(basis: PlanBasis) -> list[Decision]:
    """What the optics do to places."""
    distortion, camera = basis.scene.sensor.distortion, basis.resolved.camera
    if distortion is None:
        return []
    return [
        Decision(
            "distortion",
            True,
            f"{distortion.kind} terms, exact to rounding; lengths change by at most "
            f"{100.0 * (stretch(camera) - 1.0):.3g}%",
            bound=ROUNDING_PX,
            unit="px",
        )
    ]


RULES = (
    Rule(
        ("distortion",),
        "where the sensor has one",
        "tests/acceptance/test_distortion.py",
        _distortion,
    ),
)
