"""Regions of the sky, as pure geometry: how far a direction lies outside or inside of one."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import BadInput
from .sphere import Floats, directions, separation_rad

MAX_CORNERS = 1000
COSINE_ROUNDING = 1e-14  # far above that of dot products of unit vectors
Bools = NDArray[np.bool_]
Vector = tuple[float, float, float]


class Region(Protocol):
    """A part of the sky, when it is looked at, and from how far off the barycentre."""

    @property
    def centre(self) -> Vector:
        """Centre of a cap that holds the region: a unit vector, ICRS."""

    @property
    def radius_rad(self) -> float:
        """Radius of that cap."""

    @property
    def inner_radius_rad(self) -> float:
        """Radius of a cap around the same centre that lies within the region; 0 for none."""

    @property
    def epoch_jyear(self) -> float | None:
        """When it is looked at (Julian year); None for the catalogue's own epoch."""

    @property
    def observer_distance_au(self) -> float:
        """The observer's distance from the barycentre, at most."""

    def outside_rad(self, v: Floats) -> Floats:
        """Angles (n,) from unit vectors (n, 3) to the region's border, negative inside it."""

    def holds(self, v: Floats) -> Bools:
        """Which unit vectors (n, 3) lie within: (n,) bool, as `outside_rad(v) <= 0` says."""


@dataclass(frozen=True)
class Cone:
    """All directions within `radius_rad` (0 to pi) of `centre` (unit vector)."""

    centre: Vector
    radius_rad: float
    epoch_jyear: float | None = None
    observer_distance_au: float = 1.1

    @property
    def inner_radius_rad(self) -> float:
        """The cone's own radius."""
        return self.radius_rad

    def outside_rad(self, v: Floats) -> Floats:
        """Angles (n,) from unit vectors (n, 3) to the cone's border, negative inside it."""
        return separation_rad(v, np.array(self.centre)) - self.radius_rad

    def holds(self, v: Floats) -> Bools:
        """Which unit vectors (n, 3) lie within: (n,) bool. Cosines decide where they can."""
        above = v @ np.array(self.centre) - math.cos(self.radius_rad)
        inside: Bools = above > 0.0
        doubtful = np.flatnonzero(np.abs(above) < COSINE_ROUNDING)
        inside[doubtful] = self.outside_rad(v[doubtful]) <= 0.0
        return inside


@dataclass(frozen=True)
class Polygon:
    """A polygon of great-circle arcs: convex or not, in either sense, without crossings.

    corners : unit vectors, 3 to 1000, the last one joined to the first; they must lie within less
    than a hemisphere, and the polygon is the part of the sky within. Raises BadInput otherwise.
    """

    corners: tuple[Vector, ...]
    epoch_jyear: float | None = None
    observer_distance_au: float = 1.1

    def __post_init__(self) -> None:
        corners = np.array(self.corners, float)
        if corners.ndim != 2 or corners.shape[1:] != (3,) or not 3 <= len(corners) <= MAX_CORNERS:
            raise BadInput("polygon", corners.shape, f"3 to {MAX_CORNERS} corners")
        if not np.isfinite(corners).all():
            raise BadInput("polygon", self.corners, "finite corners")
        a, b = self._edges
        if (np.abs(b - a).max(axis=1) < 1e-15).any():
            raise BadInput("polygon", self.corners, "neighbouring corners that differ")
        if np.min(a @ np.array(self.centre)) < 1e-6:
            allowed = "corners within less than a hemisphere (cut a larger polygon into parts)"
            raise BadInput("polygon", self.corners, allowed)
        if _crossing(*self._plane):
            raise BadInput("polygon", self.corners, "edges that don't cross (see their order)")

    @cached_property
    def _edges(self) -> tuple[Floats, Floats]:
        """Where the edges begin and end: (corners, 3) each."""
        corners = np.array(self.corners, float)
        return corners, np.roll(corners, -1, axis=0)

    @cached_property
    def centre(self) -> Vector:
        """The direction whose farthest corner is nearest: centre of the smallest cap around them.

        It points from the origin to the nearest point of the corners' convex hull, which is the
        residual of a non-negative least-squares problem (Lawson & Hanson 1974, section 23.4).
        """
        from scipy.optimize import nnls

        corners = self._edges[0]
        weights, _ = nnls(np.vstack([corners.T, np.ones(len(corners))]), [0.0, 0.0, 0.0, 1.0])
        point = weights @ corners
        length = float(np.sqrt(point @ point))
        x, y, z = (point / length if length > 1e-12 else -corners[0]).tolist()
        return x, y, z

    @cached_property
    def radius_rad(self) -> float:
        """Angle from the centre to the farthest corner: a cap below a hemisphere is convex."""
        return float(separation_rad(self._edges[0], np.array(self.centre)).max()) + 1e-15

    @cached_property
    def inner_radius_rad(self) -> float:
        """Angle from the centre to the nearest edge; 0 where the centre lies outside."""
        return max(0.0, -float(self.outside_rad(np.array([self.centre]))[0]))

    @cached_property
    def _axes(self) -> tuple[Floats, Floats]:
        """Two directions across the centre: the axes of the plane on which edges are straight."""
        centre = np.array(self.centre)
        x = np.cross(np.eye(3)[np.argmin(np.abs(centre))], centre)
        x /= np.sqrt(x @ x)
        return x, np.cross(centre, x)

    @cached_property
    def _plane(self) -> tuple[Floats, Floats]:
        """Gnomonic places (corners,) of the corners."""
        corners, centre = self._edges[0], np.array(self.centre)
        x, y = self._axes
        return corners @ x / (corners @ centre), corners @ y / (corners @ centre)

    def outside_rad(self, v: Floats) -> Floats:
        """Angles (n,) from unit vectors (n, 3) to the polygon's border, negative inside it."""
        inside = self.holds(v)
        nearest = np.full(v.shape[0], np.pi)
        for a, b in zip(*self._edges, strict=True):
            normal = np.cross(a, b - a)  # stays exact for short edges
            normal /= np.sqrt(normal @ normal)
            beside = (v @ np.cross(normal, a) >= 0.0) & (v @ np.cross(b, normal) >= 0.0)
            across = (v - a) @ normal
            along = v - across[:, None] * normal
            to_arc = np.arctan2(np.abs(across), np.sqrt(np.sum(along * along, axis=1)))
            ends = np.minimum(separation_rad(v, a), separation_rad(v, b))
            nearest = np.minimum(nearest, np.where(beside, to_arc, ends))
        return np.where(inside, -nearest, nearest)

    def holds(self, v: Floats) -> Bools:
        """Which unit vectors (n, 3) lie within: (n,) bool, by the even-odd rule.

        On the gnomonic plane of the centre: a ray from each point along the second axis meets the
        edges that span the point's place on the first. The side of an edge is the triple product
        of differences, whose rounding shrinks with the distances.
        """
        centre, (x, _) = np.array(self.centre), self._axes
        depth = v @ centre
        ahead = depth > 0.0
        at = v @ x / np.where(ahead, depth, 1.0)
        corner_at = self._plane[0]
        odd = np.zeros(v.shape[0], bool)
        for i, (a, b) in enumerate(zip(*self._edges, strict=True)):
            from_left = corner_at[i] <= at
            spans = from_left != (corner_at[(i + 1) % corner_at.size] <= at)
            side = np.sum(np.cross(a - v, b - v) * v, axis=1)
            odd ^= spans & ((side > 0.0) == from_left)
        return odd & ahead


def _crossing(x: Floats, y: Floats) -> bool:
    """Whether any two edges of a closed plane polygon (corners (n,)) cross."""
    n = x.size
    x2, y2 = np.roll(x, -1), np.roll(y, -1)

    def side(px: Floats, py: Floats) -> Floats:
        """On which side of edge i (rows) point j (columns) lies: (n, n) of -1, 0, 1."""
        dx, dy = (x2 - x)[:, None], (y2 - y)[:, None]
        return np.sign(dx * (py[None] - y[:, None]) - dy * (px[None] - x[:, None]))

    starts, ends = side(x, y), side(x2, y2)
    apart = starts * ends < 0.0
    crossed = apart & apart.T
    i = np.arange(n)
    for k in (-1, 0, 1):  # neighbours share a corner
        crossed[i, (i + k) % n] = False
    return bool(crossed.any())


def cone_of(ra_deg: float, dec_deg: float, radius_deg: float) -> Cone:
    """A cone by its centre (ICRS) and radius [deg]; raises BadInput naming the field."""
    checks = (
        ("ra_deg", ra_deg, math.isfinite(ra_deg), "a finite angle in degrees"),
        ("dec_deg", dec_deg, -90.0 <= dec_deg <= 90.0, "-90 to 90 degrees"),
        ("radius_deg", radius_deg, 0.0 < radius_deg <= 180.0, "above 0, up to 180 degrees"),
    )
    for field, value, fine, allowed in checks:
        if not fine:
            raise BadInput(field, value, allowed)
    x, y, z = directions(ra_deg, dec_deg).tolist()
    return Cone((x, y, z), math.radians(radius_deg), observer_distance_au=0.0)


def polygon_of(corners_deg: ArrayLike) -> Polygon:
    """A polygon by its corners (n, 2): right ascension and declination [deg], ICRS."""
    corners = np.asarray(corners_deg, float)
    if corners.ndim != 2 or corners.shape[1:] != (2,):
        raise BadInput("polygon", corners_deg, "pairs of right ascension and declination [deg]")
    if not (np.isfinite(corners).all() and (np.abs(corners[:, 1]) <= 90.0).all()):
        raise BadInput("polygon", corners_deg, "finite angles, declinations from -90 to 90 degrees")
    v = directions(corners[:, 0], corners[:, 1])
    return Polygon(tuple(map(tuple, v.tolist())), observer_distance_au=0.0)
