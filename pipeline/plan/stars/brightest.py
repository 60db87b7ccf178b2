"""The brightest source that a scene may hold, as far as it is known before any star is read."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from pipeline.arrays import Array, Geometry
from pipeline.physics.colour import ColourFit, brightest_electrons
from pipeline.physics.positions.focal_plane import corner_radius
from pipeline.physics.radiometry import collecting_area_m2
from pipeline.plan.bodies.sizes import limb_px
from pipeline.plan.pointing.geometry import camera_of
from pipeline.plan.pointing.paths import near_frame
from pipeline.plan.pointing.star_paths import excursions_px
from pipeline.plan.response.responses import FARTHEST_PX, point_curvature
from pipeline.plan.timing import integration_range_s
from pipeline.spec.scene import Scene
from pipeline.spec.targets.body import SphereBody

if TYPE_CHECKING:
    from pipeline.plan.resolved import ResolvedScene

MARGIN = 1.5  # over a target's light in the frames looked at, for those between them


def star_radius_rad(scene: Scene, g: Geometry) -> Array:
    """Radius (F,) around the boresight within which stars light the frame strongly [rad].

    The frame, as much again around it, and the stars' way in an exposure.
    """
    camera = camera_of(scene)
    way = excursions_px(camera, g, scene.star_effects["aberration"]) * scene.sensor.ifov_rad
    return np.minimum(2.0 * corner_radius(camera) + way, np.pi)


def brightest_star_e(scene: Scene, colour: ColourFit, g_mags: Iterable[float]) -> float:
    """Most light that a star of these G magnitudes sends in the longest exposure [e-].

    Of the colour that gives most, through an aperture without vanes; 0 without stars.
    """
    brightest = min(g_mags, default=np.inf)
    zero_e = brightest_electrons(colour, _area_m2(scene), integration_range_s(scene)[1])
    return float(zero_e * 10.0 ** (-0.4 * brightest))


def brightest_target_e(scene: Scene, g: Geometry, sun_rate_e_s_m2: float) -> float:
    """Most light that a target sends in the longest exposure [e-], so near the frame that its
    wings could be drawn onto it.

    Of the frames of a geometry, MARGIN times; 0 without targets.
    """
    seen = near_frame(scene, g, FARTHEST_PX)
    if not seen.any():
        return 0.0
    return float(targets_e(scene, g, sun_rate_e_s_m2)[seen].max())


def targets_e(scene: Scene, g: Geometry, sun_rate_e_s_m2: float) -> Array:
    """Most light (T, F) that each target sends in the longest exposure [e-], MARGIN times."""
    light = np.nan_to_num(np.fmax.reduce(g.target_light, axis=-1))
    area_s = _area_m2(scene) * integration_range_s(scene)[1]
    return np.asarray(MARGIN * light * sun_rate_e_s_m2 * area_s)


def points_beyond(plan: ResolvedScene, g: Geometry) -> bool:
    """Whether a target in or beside the frames of a geometry is brighter than all core classes
    serve though it is drawn as a point: a sphere whose disc shows is not."""
    scene, r = plan.scene, plan.responses
    if not (scene.targets and r.classes):
        return False
    light_e = targets_e(scene, g, plan.sun_rate_e_s_m2)
    size = [
        0.5 * t.body.diameter_m if isinstance(t.body, SphereBody) else 0.0 for t in scene.targets
    ]
    radius = limb_px(np.array(size)[:, None], g.target_range_m[..., g.middle], plan.facts.ifov_rad)
    disc = light_e * point_curvature(r.blur) * np.square(radius) > r.budget_e
    return bool((near_frame(scene, g) & ~disc & (light_e > r.classes[-1].target_e)).any())


def _area_m2(scene: Scene) -> float:
    return collecting_area_m2(scene.sensor.aperture_m, scene.sensor.obscuration)
