"""Cones of a catalogue's sky that hold every star of a frame."""

from __future__ import annotations

import math

import numpy as np

from pipeline.arrays import Geometry
from pipeline.physics.constants import ARCSEC_RAD, SPEED_OF_LIGHT_M_S
from pipeline.physics.positions.apparent import unaberrated_caps
from pipeline.physics.positions.focal_plane import corner_radius, stretch
from pipeline.plan.pointing.air import above_air
from pipeline.plan.pointing.star_paths import excursions_px
from pipeline.plan.resolved import ResolvedScene
from pipeline.spec.scene import Scene

FIELD_MARGIN_RAD = 30.0 * ARCSEC_RAD  # deflection: 1.75 arcsec at the Sun's limb


def field_cones(resolved: ResolvedScene, g: Geometry) -> tuple[np.ndarray, np.ndarray]:
    """Cones (centres (F, 3), radii (F,) [rad]) that hold every star of each frame.

    The radius holds the focal plane's corners, the halo, the way of the stars during the exposure,
    and what `catalogue_cones` adds.
    """
    # An angle off axis is at most halo radians beyond the corner: the projection only shrinks it.
    camera, scene = resolved.camera, resolved.scene
    way = excursions_px(camera, g, scene.star_effects["aberration"])
    radius = (
        corner_radius(camera) + (resolved.halo_px + way) * stretch(camera) * resolved.facts.ifov_rad
    )
    return catalogue_cones(scene, g, g.attitude[:, g.middle, 2], radius)


def catalogue_cones(
    scene: Scene, g: Geometry, centres: np.ndarray, radius_rad: float | np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Cones of the catalogue's sky for cones seen at mid-exposure: (F, 3) and (F,) [rad].

    Refraction and aberration are taken out, the latter at any speed; the radius is widened by a
    margin for deflection. The stars' own motion and parallax are the caller's.
    """
    beta = g.observer_m_s[:, g.middle] / SPEED_OF_LIGHT_M_S
    if scene.stars is not None and not scene.stars.aberration:
        beta = np.zeros_like(beta)
    seen = np.minimum(radius_rad + FIELD_MARGIN_RAD + np.zeros(len(centres)), math.pi)
    centres, seen = above_air(g, centres, seen)
    return unaberrated_caps(centres, seen, beta)
