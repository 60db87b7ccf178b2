"""Meshes in a frame: where the centre of their light is, and their picture where a point errs."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from pipeline.physics.constants import SUN_RADIUS_RAD
from pipeline.physics.drawing.pictures import cell_error
from pipeline.physics.meshes.facets import Facets
from pipeline.physics.meshes.intensity import (
    MeshLight,
    facet_weights,
    mesh_intensity,
    mesh_picture,
)
from pipeline.physics.meshes.model import MeshModel, posed
from pipeline.physics.psf.pupil import Blur
from pipeline.physics.targets.disc import Picture, picture
from pipeline.physics.vectors import unit
from pipeline.spec.targets.mesh import MeshBody

Array = NDArray[np.float64]

FIRST_CELLS, MOST_CELLS = 16, 512  # across a body's radius and diameter
SIDE_PX = 0.25  # of the largest cells
WHOLE = 1.0 - 1e-9  # of a facet's light: below it the facet is partly hidden or shaded


@dataclass(frozen=True)
class Pose:
    """A mesh as it stands at mid-exposure; equal to one of the same content.

    directions : (4, 3) as in `Geometry.target_pose`, as bytes; time_s of the body
    """

    digest: str
    directions: bytes
    time_s: float
    error: float
    model: MeshModel = field(compare=False)

    @property
    def axes(self) -> Array:
        """Directions (4, 3) of Sun, observer, +x and +y in the body's axes."""
        return unit(np.frombuffer(self.directions).reshape(4, 3))


@dataclass(frozen=True)
class Spread:
    """How a mesh's light is spread across the line of sight, metres from the body's origin.

    x_m, y_m : the centre of the light; off_m : how far it may be from there; variance_m2 : a bound
    on that along any line
    """

    x_m: float
    y_m: float
    off_m: float
    variance_m2: float


@lru_cache(maxsize=16)
def _seen(pose: Pose) -> tuple[Facets, MeshLight]:
    sun, observer = pose.axes[:2]
    facets = posed(pose.model, sun, pose.time_s)
    surfaces = pose.model.surfaces
    return facets, mesh_intensity(facets, surfaces, sun, observer, pose.error, SUN_RADIUS_RAD)


@lru_cache(maxsize=256)
def spread_of(pose: Pose) -> Spread:
    """Centre and spread of a mesh's light; of a facet that is partly dark it may be anywhere."""
    facets, light = _seen(pose)
    share = light.facet_m2_sr
    total = float(share.sum())
    if total <= 0.0:
        return Spread(0.0, 0.0, 0.0, 0.0)
    sun, observer, *across = pose.axes
    corners = facets.corners_m @ np.stack(across).T
    middle = corners.mean(axis=1)
    centre = share @ middle / total
    _, weight = facet_weights(
        facets.normal, facets.surface, pose.model.surfaces, sun, observer, SUN_RADIUS_RAD
    )
    whole = weight * np.abs(facets.cross_m2 @ observer) * 0.5
    size = np.sqrt(np.sum(np.square(corners - middle[:, None]), -1)).max(axis=1)
    off = float(share @ np.where(share < WHOLE * whole, size, 0.0)) / total
    far = np.sum(np.square(corners - centre), -1).max(axis=1)
    return Spread(float(centre[0]), float(centre[1]), off, float(share @ far) / total)


@lru_cache(maxsize=16)
def picture_of(pose: Pose, px_per_m: float, blur: Blur, error: float) -> Picture:
    """A mesh's picture, in cells so fine that a pixel errs by at most `error` per unit light.

    Cells are halved until that is met or MOST_CELLS lie across the body.
    """
    facets, light = _seen(pose)
    sun, observer, x, y = pose.axes
    radius_px = facets.radius_m * px_per_m
    side_px = min(SIDE_PX, radius_px / FIRST_CELLS)
    side_px = max(side_px, 2.0 * radius_px / MOST_CELLS)
    while True:
        image, centre = mesh_picture(facets, light, sun, observer, x, y, side_px / px_per_m)
        made = picture(image, side_px, centre)
        if 4.0 * radius_px / side_px > MOST_CELLS or cell_error(blur, made) <= error:
            return made
        side_px *= 0.5


def pose_of(body: MeshBody, directions: Array, time_s: float) -> Pose:
    """The pose of a mesh body that has been read."""
    model: MeshModel = body.model
    assert body.error is not None
    packed = np.ascontiguousarray(directions, dtype=np.float64).tobytes()
    return Pose(model.digest, packed, float(time_s), body.error, model)
