"""Facets of a mesh as plain arrays: corners, normals, areas; turned, moved and put together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pipeline.physics.vectors import unit

Array = NDArray[np.float64]

MOST_TESTED = 20_000


@dataclass(frozen=True, eq=False)
class Facets:
    """Triangles in one frame.

    corners_m : (F, 3, 3) corner by corner, counterclockwise seen from outside
    surface : (F,) number of the facet's surface, its place in the body's list of surfaces
    closed : (F,) True for facets of shells without holes or edges that turn around: there those
        whose backs are looked at hide nothing that others do not
    convex : True where no facet can shade or hide another one
    """

    corners_m: Array
    surface: NDArray[np.int64]
    closed: NDArray[np.bool_]
    convex: bool = False

    def __len__(self) -> int:
        return len(self.corners_m)

    @property
    def cross_m2(self) -> Array:
        """Twice the area along the outward normal (F, 3)."""
        a, b, c = (self.corners_m[:, k].T for k in range(3))
        u, v = b - a, c - a
        across = (u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0])
        return np.stack(across, axis=-1)

    @property
    def area_m2(self) -> Array:
        """Areas (F,)."""
        return 0.5 * np.asarray(np.sqrt(np.sum(np.square(self.cross_m2), -1)))

    @property
    def normal(self) -> Array:
        """Outward unit normals (F, 3); zeros for a facet without area."""
        return unit(self.cross_m2)

    @property
    def radius_m(self) -> float:
        """Radius about the origin of a sphere that holds all corners."""
        return float(np.sqrt(np.sum(np.square(self.corners_m), -1)).max(initial=0.0))

    def moved(self, rotation: ArrayLike, place_m: ArrayLike = (0.0, 0.0, 0.0)) -> Facets:
        """The same facets after x -> R x + place; rotation (3, 3), place (3,)."""
        turned = self.corners_m @ np.asarray(rotation, float).T + np.asarray(place_m, float)
        return Facets(turned, self.surface, self.closed, self.convex)


def together(parts: Sequence[Facets]) -> Facets:
    """Facets of several parts in one frame; convex only where one part is all there is."""
    if len(parts) == 1:
        return parts[0]
    return Facets(
        np.concatenate([p.corners_m for p in parts]),
        np.concatenate([p.surface for p in parts]),
        np.concatenate([p.closed for p in parts]),
    )


def is_convex(corners_m: Array, slack: float = 3e-7) -> bool:
    """True where all corners lie behind every facet's plane, to `slack` of the size (files round).

    Then no facet can shade or hide another. Each facet is tested against each corner, the first
    failure ends it; bodies of more than MOST_TESTED facets count as not convex.
    """
    count = len(corners_m)
    if count > MOST_TESTED:
        return False
    facets = Facets(corners_m, np.zeros(count, np.int64), np.ones(count, bool))
    points = np.unique(corners_m.reshape(-1, 3), axis=0)
    room = slack * facets.radius_m
    normal = facets.normal
    for first in range(0, len(normal), 256):
        some = normal[first : first + 256]
        level = np.sum(some * corners_m[first : first + 256, 0], axis=-1)
        if np.any(some @ points.T > level[:, None] + room):
            return False
    return True
