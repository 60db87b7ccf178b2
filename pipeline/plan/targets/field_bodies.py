"""What bodies with a size lose by one mixture of a field of responses for all of them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from pipeline.arrays import Geometry
from pipeline.plan.bodies.sizes import limb_px, radius_m
from pipeline.plan.tiles import distance_px
from pipeline.spec.targets.body import SphereBody
from pipeline.spec.targets.mesh import MeshBody

if TYPE_CHECKING:
    from pipeline.plan.resolved import ResolvedScene


def field_body_warnings(plan: ResolvedScene, g: Geometry) -> list[str]:
    """That discs and pictures are drawn with the responses of their middle, where that shows."""
    field, radius_px = plan.responses.field, _largest_px(plan, g)
    if field is None or not radius_px > 0.0:
        return []
    light_e, asked = plan.facts.brightest_e, plan.scene.accuracy.noise_fraction
    off_e = field.edge_change(radius_px) * light_e
    photons_e = plan.scene.sensor.photon_noise * light_e / max(1.0, math.pi * radius_px**2)
    photons_e /= max(1.0, plan.facts.flat)
    sigma = off_e / math.sqrt(plan.facts.light_floor_e**2 + photons_e)
    if sigma <= asked:
        return []
    return [
        f"sensor.psf: bodies (up to {radius_px:.3g} px in radius) are drawn with the responses of "
        f"their middle: at its edge a pixel of the brightest source is some {off_e:.2g} e- off, "
        f"{sigma:.2g} of its noise (asked: {asked:g})"
    ]


def _largest_px(plan: ResolvedScene, g: Geometry) -> float:
    """Radius [px] of the largest body with a size that comes into the frame."""
    sized = [isinstance(t.body, SphereBody | MeshBody) for t in plan.scene.targets]
    if not any(sized):
        return 0.0
    size_m = np.array([radius_m(t.body) for t in plan.scene.targets])[:, None]
    radius_px = limb_px(size_m, g.target_range_m.min(axis=-1), plan.facts.ifov_rad)
    shape = plan.camera.rows, plan.camera.columns
    off_px = np.nan_to_num(distance_px(g.target_x_px, g.target_y_px, 0, 0, *shape), nan=math.inf)
    near = np.array(sized)[:, None] & (off_px.min(axis=-1) <= radius_px)
    return float(radius_px[near].max(initial=0.0))
