"""The projected pupil in the plan: light falls with the cosine of its angle off axis."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Geometry
from pipeline.physics.positions.focal_plane import Camera, corner_radius, off_axis_cosine
from pipeline.plan.decision import Decision
from pipeline.plan.pointing.star_paths import at_nodes, field_points, star_paths
from pipeline.plan.rule import PlanBasis, Rule
from pipeline.spec.scene import Scene

Array = NDArray[np.float64]

NODES = 5


def pupil_fraction(scene: Scene, camera: Camera, x_px: Array, y_px: Array) -> Array:
    """Fraction (...) of their light that the pupil takes in from sources at pixels x, y (...).

    The entrance pupil is a flat disc at right angles to the axis: from off axis its area is seen
    foreshortened by the cosine (the fourth one of cos^4 illumination, beside the three of a
    gnomonic pixel's solid angle; Born & Wolf 1999, section 4.8.3). Vignetting and aberrations of
    the pupil are not in it. Ones where the sensor does not ask for it.
    """
    if not scene.sensor.pupil_projection:
        return np.ones(np.shape(x_px))
    return off_axis_cosine(camera, x_px, y_px)


def pupil_along(scene: Scene, camera: Camera, offset_s: Array, x_px: Array, y_px: Array) -> Array:
    """The same of places x, y (..., K) at the K nodes of exposures at offset_s (K,) or (F, K).

    Under TDI a place moves with the charge: the light falls where the charge stands then.
    """
    middle = offset_s[..., [offset_s.shape[-1] // 2]]
    return pupil_fraction(scene, camera, x_px, y_px + camera.charge_px_s * (offset_s - middle))


def _pupil(basis: PlanBasis) -> list[Decision]:
    """The projected pupil, its size, and what taking it at mid-exposure errs by."""
    scene, camera = basis.scene, basis.resolved.camera
    lost = 1.0 - float(np.cos(corner_radius(camera)))
    size = f"a corner of the frame receives {lost:.2g} less than its middle"
    if not scene.sensor.pupil_projection:
        flat = scene.sensor.flat
        why = "flat is an image, which holds it" if isinstance(flat, str) else "switched off"
        reason = f"{why} (sensor.pupil_projection): {size}, by its cosine off axis"
        return [Decision("pupil_projection", False, reason, bound=lost, unit="of the light")]
    reason = (
        f"light is dimmed by the cosine of its angle off axis: {size}; not the stray light, which "
        "reaches the focal plane otherwise. Of a star that streaks, at mid-exposure"
    )
    off = _changes(scene, camera, basis.frames) if scene.stars is not None else 0.0
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
        ("pupil_projection",),
        "always, but where flat is an image (a measured flat holds it) or the sensor says no",
        "tests/acceptance/test_wide_field.py::test_stars_fall_with_the_cosine",
        _pupil,
    ),
)
