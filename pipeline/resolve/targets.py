"""The targets of a scene's frames: where they are, and how bright."""

from __future__ import annotations

import numpy as np

from pipeline.arrays import Geometry
from pipeline.plan.resolved import ResolvedScene
from pipeline.plan.response.sources import KnownSources, known_of_frames, targets_known
from pipeline.spec.targets.mesh import MeshBody


def gather_targets(resolved: ResolvedScene, g: Geometry) -> KnownSources | None:
    """The targets that light any frame, placed as the drawing does it; nothing is imported without.

    None where a geometry `g` has not all of the scene's frames, or a mesh's light is dear to find.
    """
    scene = resolved.scene
    if not scene.targets:
        return known_of_frames(())
    if len(g.frame) < resolved.frames:
        return None
    if any(isinstance(t.body, MeshBody) for t in scene.targets):
        return None
    return known_of_frames([_of_frame(resolved, g, k) for k in range(len(g.frame))])


def _of_frame(resolved: ResolvedScene, g: Geometry, k: int) -> KnownSources:
    """The targets of one of a geometry's frames."""
    from pipeline.execute.sources import place_targets

    placed = place_targets(resolved, g.frame_slice(k))
    ends = [(t.x_px + t.path.x_px[i], t.y_px + t.path.y_px[i]) for t in placed for i in (0, -1)]
    return targets_known(
        resolved.responses,
        resolved.scene.sensor.shape,
        np.full(len(placed), k),
        np.array(ends).reshape(-1, 4).T,
        np.array([t.light_e for t in placed]),
        np.array([t.radius_px for t in placed]),
        np.array([t.body is not None for t in placed], bool),
    )
