"""What bodies with a size lose by one mixture of a field of responses for all of them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pipeline.arrays import Geometry
from pipeline.physics.targets.sphere import sphere_area_function
from pipeline.plan.bodies.sizes import limb_px, radius_m
from pipeline.plan.pointing.paths import near_frame
from pipeline.plan.stars.brightest import targets_e
from pipeline.spec.targets.body import SphereBody
from pipeline.spec.targets.mesh import MeshBody

if TYPE_CHECKING:
    from pipeline.plan.resolved import ResolvedScene


def field_body_warnings(plan: ResolvedScene, g: Geometry) -> list[str]:
    """That discs and pictures are drawn with the responses of their middle, where that shows.

    The limb is taken to be as bright as a Lambert sphere's is where the Sun stands overhead: of all
    its light F / G, with the area function G of so many px.
    """
    scene, field = plan.scene, plan.responses.field
    if field is None:
        return []
    sized = np.array([isinstance(t.body, SphereBody | MeshBody) for t in scene.targets], bool)
    if not sized.any():
        return []
    seen = near_frame(scene, g) & sized[:, None]
    size_m = np.array([radius_m(t.body) for t in scene.targets])[:, None]
    radius_px = limb_px(size_m, g.target_range_m.min(axis=-1), plan.facts.ifov_rad)[seen]
    phase = g.target_phase_rad.max(axis=-1)[seen]
    share_px = 1.0 / np.maximum(1.0, sphere_area_function(phase, 2.0 * radius_px))
    light_e = targets_e(scene, g, plan.sun_rate_e_s_m2)[seen]
    off_e = field.edge_change(radius_px, share_px) * light_e
    photons_e = light_e * share_px / max(1.0, plan.facts.flat)
    sigma = off_e / np.sqrt(plan.facts.light_floor_e**2 + scene.sensor.photon_noise * photons_e)
    asked, worst = scene.accuracy.noise_fraction, int(np.argmax(sigma)) if sigma.size else 0
    if not sigma.size or sigma[worst] <= asked:
        return []
    return [
        f"sensor.psf: bodies are drawn with the responses of their middle: at the edge of one of "
        f"{radius_px[worst]:.3g} px in radius a pixel is up to {off_e[worst]:.2g} e- off, "
        f"{sigma[worst]:.2g} of its noise (asked: {asked:g})"
    ]
