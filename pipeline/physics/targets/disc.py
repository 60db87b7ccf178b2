"""Resolved bodies as points of light: a Lambertian sphere by quadrature, any body by a picture.

A body is drawn from points that stand for it up to a given fineness: the Fourier transform of the
points is that of the body up to so many cycles per pixel. All places are in pixels relative to the
body's reference point (y along rows, x along columns), all light in shares of the body's total.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from pipeline.errors import BadInput
from pipeline.physics.targets.sphere import sphere_area_function

Array = NDArray[np.float64]
Points = tuple[Array, Array, Array]  # y_px, x_px, share
Box = tuple[float, float, float, float]  # y0, y1, x0, x1 [px]: y0 <= y < y1, x0 <= x < x1

EVERYWHERE: Box = (-np.inf, np.inf, -np.inf, np.inf)
SPHERE_VARIANCE = 0.2  # of a sphere's light across the Sun's direction, over its radius squared
PANEL_TURNS = 6.5  # turns of the finest wave along a panel: its quadrature then errs below 1e-9
_PI_LOW = 1.2246467991473532e-16  # pi - float(pi)
_NODES, _WEIGHTS = (0.5 * a for a in np.polynomial.legendre.leggauss(24))
_NODES = _NODES + 0.5
FIELD = "targets.appearance"


class Appearance(Protocol):
    """What every resolved body answers. Hashable by content: it is a key of caches."""

    @property
    def box(self) -> Box:
        """A rectangle that holds all the light."""
        ...

    def points(self, finest_per_px: float, box: Box = EVERYWHERE) -> Points:
        """Points in a box, true to the body up to `finest_per_px` cycles per pixel.

        A point's place and share do not depend on the box, so that boxes side by side hold each
        point once.
        """
        ...


@dataclass(frozen=True)
class Sphere:
    """A grey Lambertian sphere seen from afar (its angular radius small against one radian).

    radius_px : angular radius; phase_rad : angle Sun-body-observer, 0 (full) to pi (new)
    sun_angle_rad : direction of the Sun on the focal plane, from +x towards +y
    The reference point is the centre. The shares sum to 1 at every phase, pi included, where the
    image is the limit of the crescent; the light itself is that of `sphere_area_function`.
    """

    radius_px: float
    phase_rad: float = 0.0
    sun_angle_rad: float = 0.0

    def __post_init__(self) -> None:
        if not (np.isfinite(self.radius_px) and self.radius_px > 0.0):
            raise BadInput(f"{FIELD}.radius_px", self.radius_px, "a finite radius > 0")
        if not 0.0 <= self.phase_rad <= np.pi:
            raise BadInput(f"{FIELD}.phase_rad", self.phase_rad, "0 to pi")
        if not np.isfinite(self.sun_angle_rad):
            raise BadInput(f"{FIELD}.sun_angle_rad", self.sun_angle_rad, "a finite angle")

    @property
    def box(self) -> Box:
        return (-self.radius_px, self.radius_px, -self.radius_px, self.radius_px)

    def points(self, finest_per_px: float, box: Box = EVERYWHERE) -> Points:
        """Gauss nodes on the lit and visible part of the surface.

        With latitude b from the plane of Sun and observer and longitude t from the limb, the light
        is sin t sin(e - t) cos^3 b dt db, 0 <= t <= e = pi - phase (mu0 mu dA; Lambert 1760): no
        edge, no cancellation, however thin the crescent.
        """
        e = (np.pi - self.phase_rad) + _PI_LOW
        total = float(sphere_area_function(self.phase_rad, 2.0))
        c, s = np.cos(self.sun_angle_rad), np.sin(self.sun_angle_rad)
        r, edges = (
            float(self.radius_px),
            (float(box[0]), float(box[1]), float(box[2]), float(box[3])),
        )
        panels = _panels(self, float(finest_per_px), edges)
        return _nodes(panels, e, total, r, c, s, _NODES, _WEIGHTS, edges)


def _panels(sphere: Sphere, finest_per_px: float, box: Box) -> Array:
    """Panels that may reach into a box: (n, 4) of first longitude over e, step, latitude, step."""
    r, e = sphere.radius_px, (np.pi - sphere.phase_rad) + _PI_LOW
    arc = min(PANEL_TURNS / finest_per_px / r, 0.5 * np.pi)
    count = int(np.ceil(np.pi / arc))
    step = np.pi / count
    u0, u1, v0, v1 = _turned(sphere, box)
    low, high = np.arcsin(np.clip([v0, v1], -1.0, 1.0)) + 0.5 * np.pi
    row = np.arange(int(max(low / step - 1, 0)), int(min(high / step + 2, count)))
    first = step * row - 0.5 * np.pi
    ends = np.clip(np.cos([first, first + step]), 0.0, None)
    least, most = ends.min(axis=0), np.where(first * (first + step) < 0.0, 1.0, ends.max(axis=0))
    counts = np.ceil(np.maximum(e * most / arc, 1.0)).astype(np.int64)
    # cos t lies between u0 and u1 over some cos b of the row, with a little room for rounding.
    room = 1e-300
    top = np.clip(u1 / np.maximum(least if u1 >= 0.0 else most, room), -1.0, 1.0)
    bottom = np.clip(u0 / np.maximum(most if u0 >= 0.0 else least, room), -1.0, 1.0)
    begin = np.clip(np.arccos(top) / e * counts - 1.0, 0, counts).astype(np.int64)
    stop = np.clip(np.arccos(bottom) / e * counts + 2.0, begin, counts).astype(np.int64)
    many = stop - begin
    place = np.arange(many.sum()) + np.repeat(begin - (np.cumsum(many) - many), many)
    wide, latitude = np.repeat(1.0 / counts, many), np.repeat(first, many)
    return np.stack([place * wide, wide, latitude, np.full(latitude.size, step)], axis=1)


def _turned(sphere: Sphere, box: Box) -> tuple[float, float, float, float]:
    """Bounds of a box towards the Sun and across it, over the radius."""
    r = sphere.radius_px
    y, x = (np.clip(np.array(box)[k], -r, r) / r for k in ([0, 0, 1, 1], [2, 3, 2, 3]))
    c, s = np.cos(sphere.sun_angle_rad), np.sin(sphere.sun_angle_rad)
    u, v = x * c + y * s, y * c - x * s
    return float(u.min()), float(u.max()), float(v.min()), float(v.max())


@njit(cache=True, nogil=True)
def _nodes(panels, e, total, r, c, s, nodes, weights, box):
    """Points of panels that lie in a box."""
    n = nodes.size
    most, count = panels.shape[0] * n * n, 0
    ys, xs, shares = np.empty(most), np.empty(most), np.empty(most)
    along, lit = np.empty(n), np.empty(n)
    for k in range(panels.shape[0]):
        s0, ds, b0, db = panels[k]
        for i in range(n):
            t = s0 + ds * nodes[i]
            along[i] = np.cos(e * t)
            lit[i] = np.sin(e * t) * np.sin(e * (1.0 - t)) * weights[i] * ds * e / total
        for j in range(n):
            b = b0 + db * nodes[j]
            near, v = np.cos(b), r * np.sin(b)
            high = weights[j] * db * near * near * near
            for i in range(n):
                u = r * near * along[i]
                y, x = u * s + v * c, u * c - v * s
                if box[0] <= y < box[1] and box[2] <= x < box[3]:
                    ys[count], xs[count], shares[count] = y, x, high * lit[i]
                    count += 1
    return ys[:count].copy(), xs[:count].copy(), shares[:count].copy()


def photocentre_offset(radius_px: ArrayLike, phase_rad: ArrayLike) -> Array:
    """Distance [px] of a Lambertian sphere's photocentre from its centre, towards the Sun.

    (3 pi / 16) r sin a (1 + cos a) / [sin a + (pi - a) cos a] (Lindegren 1977, IAU Coll. 48, 387):
    0 at full, 9 pi / 32 of the radius for the thinnest crescent.
    """
    phase = np.clip(np.asarray(phase_rad, float), 0.0, np.pi)
    bracket = 1.5 * sphere_area_function(phase, 2.0)
    moment = 2.0 * np.sin(phase) * np.square(np.cos(0.5 * phase))
    return np.asarray(radius_px, float) * (3.0 * np.pi / 16.0) * moment / bracket


@dataclass(frozen=True, eq=False)
class Picture:
    """A body given as an image, even light within each cell; equal to one of the same content.

    shares : (ny, nx) share of the light in each square cell, sum 1, read-only
    side_px : side of a cell; centre : (row, column) of the reference point, cell middles at whole
        numbers. Made by `picture`.
    """

    shares: Array
    side_px: float
    centre: tuple[float, float]
    digest: str

    def __hash__(self) -> int:
        return hash(self.digest)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Picture) and self.digest == other.digest

    @property
    def box(self) -> Box:
        rows, columns = (np.flatnonzero(self.shares.any(axis=k)) for k in (1, 0))
        y0, y1 = (rows[0] - 0.5 - self.centre[0]), (rows[-1] + 0.5 - self.centre[0])
        x0, x1 = (columns[0] - 0.5 - self.centre[1]), (columns[-1] + 0.5 - self.centre[1])
        h = self.side_px
        return (float(y0 * h), float(y1 * h), float(x0 * h), float(x1 * h))

    def points(self, finest_per_px: float, box: Box = EVERYWHERE) -> Points:
        """Gauss nodes in each cell, enough for an even cell at the finest wave."""
        h, (cy, cx) = self.side_px, self.centre
        n = 4 + int(np.ceil(np.pi * finest_per_px * h))
        nodes, weights = np.polynomial.legendre.leggauss(n)
        top, bottom = _cells(box[0], box[1], h, cy, self.shares.shape[0])
        left, right = _cells(box[2], box[3], h, cx, self.shares.shape[1])
        rows, columns = np.nonzero(self.shares[top:bottom, left:right])
        rows, columns = rows + top, columns + left
        y = ((rows[:, None] - cy) + 0.5 * nodes) * h
        x = ((columns[:, None] - cx) + 0.5 * nodes) * h
        light = self.shares[rows, columns][:, None, None] * 0.25 * np.outer(weights, weights)
        ys, xs = (a.ravel() for a in np.broadcast_arrays(y[:, :, None], x[:, None, :]))
        inside = (ys >= box[0]) & (ys < box[1]) & (xs >= box[2]) & (xs < box[3])
        return ys[inside], xs[inside], light.ravel()[inside]


def _cells(low: float, high: float, side_px: float, centre: float, count: int) -> tuple[int, int]:
    """First and last-plus-one cell that an interval of places touches."""
    first = np.clip(np.floor(low / side_px + centre), 0, count)
    return int(first), int(np.clip(np.ceil(high / side_px + centre) + 1, first, count))


def picture(light: ArrayLike, side_px: float, centre: tuple[float, float] | None = None) -> Picture:
    """A body from an image of it: light (ny, nx) in any unit, >= 0, cells of `side_px` pixels.

    centre : (row, column) of the reference point, the middle of the image when omitted.
    BadInput where the image holds NaN, negative values or nothing, or its cells have no size.
    """
    table = np.array(light, float)
    if table.ndim != 2:
        raise BadInput(FIELD, f"an image of shape {table.shape}", "rows and columns")
    total = float(table.sum())
    if not (np.isfinite(total) and total > 0.0 and table.min() >= 0.0):
        raise BadInput(FIELD, "an image that is empty, negative or not finite", "light >= 0")
    if not (np.isfinite(side_px) and side_px > 0.0):
        raise BadInput(f"{FIELD}.side_px", side_px, "a finite size > 0")
    table /= total
    table.setflags(write=False)
    middle = (0.5 * (table.shape[0] - 1), 0.5 * (table.shape[1] - 1))
    place = middle if centre is None else (float(centre[0]), float(centre[1]))
    content = hashlib.sha256(table.tobytes())
    content.update(repr((table.shape, float(side_px), place)).encode())
    return Picture(table, float(side_px), place, content.hexdigest())
