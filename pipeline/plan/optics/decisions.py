"""The optics in the plan: distortion, and the projected pupil."""

from __future__ import annotations

import numpy as np

from pipeline.arrays import Geometry
from pipeline.physics.positions.focal_plane import Camera, corner_radius, stretch
from pipeline.plan.decision import Decision
from pipeline.plan.optics.pupil import pupil_along
from pipeline.plan.pointing.star_paths import at_nodes, field_points, star_paths
from pipeline.plan.rule import PlanBasis, Rule
from pipeline.spec.scene import Scene

ROUNDING_PX = 1e-8  # of a distorted place, or back from it
NODES = 5


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


def _pupil(basis: PlanBasis) -> list[Decision]:
    """The projected pupil, its size, and what taking it at mid-exposure errs by, where it is."""
    scene, camera = basis.scene, basis.resolved.camera
    lost = 1.0 - float(np.cos(corner_radius(camera)))
    size = f"a corner of the frame receives {lost:.2g} less than its middle"
    if not scene.sensor.pupil_projection:
        flat = scene.sensor.flat
        why = "flat is an image, which holds it" if isinstance(flat, str) else "switched off"
        reason = f"{why} (sensor.pupil_projection): {size}, by its cosine off axis"
        return [Decision("pupil_projection", False, reason, bound=lost, unit="of the light")]
    along = basis.resolved.responses.streaks.light is not None and not camera.line_s
    reason = (
        f"light is dimmed by the cosine of its angle off axis: {size}; not the stray light, which "
        "reaches the focal plane otherwise. Of a star that streaks, "
        + ("all along its path" if along else "at mid-exposure")
    )
    at_middle = scene.stars is not None and not along
    off = _changes(scene, camera, basis.frames) if at_middle else 0.0
    return [Decision("pupil_projection", True, reason, bound=off, unit="of a source's light")]


def _changes(scene: Scene, camera: Camera, ends: Geometry) -> float:
    """Most by which the pupil's fraction changes along a star's streak from mid-exposure on.

    Of the stars in the middle and the corners, in the frames looked at, at NODES nodes.
    """
    few = at_nodes(ends, np.linspace(0, ends.nodes - 1, NODES).round().astype(np.int64))
    paths = star_paths(camera, few, *field_points(camera), scene.star_effects["aberration"])
    found = pupil_along(scene, camera, few.offset_s, *paths)
    return float(np.nanmax(np.abs(found / found[..., [NODES // 2]] - 1.0)))


RULES = (
    Rule(
        ("distortion",),
        "where the sensor has one",
        "tests/acceptance/test_distortion.py",
        _distortion,
    ),
    Rule(
        ("pupil_projection",),
        "always, but where flat is an image (a measured flat holds it) or the sensor says no",
        "tests/acceptance/test_wide_field.py::test_stars_fall_with_the_cosine",
        _pupil,
    ),
)
