"""What a mesh sends from the Sun to an observer: intensity per irradiance, and its picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from pipeline.errors import BadInput
from pipeline.physics.meshes.bins import binned, plane_axes
from pipeline.physics.meshes.covers import covered, room_for
from pipeline.physics.meshes.facets import Facets
from pipeline.physics.meshes.free_area import free_area, free_spans
from pipeline.physics.vectors import unit

Array = NDArray[np.float64]

GRAZING = 1e-7  # cosine below which a facet counts as edge-on
ROOM = 1e-9  # of the body's radius: heights below it are one plane
ROUNDS = 12  # of refinement
PATIENCE = 10.0  # a facet's first tolerance over its even share of the error asked for
MOST = 0.25  # of the error asked for: what one facet may take of it
LINES = 4  # across a cell of a picture
MOST_CELLS = 4096  # along a side of a picture
AT_ONCE = 2**16  # BRDF values worked out together


class Brdf(Protocol):
    """How a surface reflects: unit vectors (n, 3), (m, 1, 3), (3,) to BRDF values (m, n) [1/sr]."""

    def __call__(self, normal: Array, sun: Array, observer: Array) -> Array: ...


@dataclass(frozen=True)
class FacetSurface:
    """How a kind of facet reflects.

    two_sided : a facet's back reflects like its front; else it is black
    sun_rings : rings of points that stand for the Sun's disc in the BRDF; 0: one point
    """

    brdf: Brdf
    two_sided: bool = False
    sun_rings: int = 0


@dataclass(frozen=True)
class MeshLight:
    """Intensity of a mesh over the irradiance on it.

    intensity_m2_sr : m2/sr; error_m2_sr : bound on what the quadrature of shadows errs
    facet_m2_sr : (F,) each facet's part
    """

    intensity_m2_sr: float
    error_m2_sr: float
    facet_m2_sr: Array


def mesh_intensity(
    facets: Facets,
    surfaces: Sequence[FacetSurface],
    sun: ArrayLike,
    observer: ArrayLike,
    error: float = 1e-3,
    sun_radius_rad: float = 0.0,
) -> MeshLight:
    """I/E [m2/sr] = sum over facets of BRDF (n.s) (area that is lit and seen, seen from afar).

    sun, observer : (3,) unit vectors in the facets' frame; both far away compared with the body
    error : share of the intensity that the areas may err by (a bound, not a spread). Refined until
        met; `error_m2_sr` says what was reached. Bodies without shadows are exact to rounding.
    sun_radius_rad : of the Sun's disc, for surfaces with rings; shadows are those of its centre
    Light that goes from facet to facet is omitted. Facets are flat: a smooth glossy surface needs
    facets that turn by less than its highlight is wide.
    """
    s, o = _directions(sun, observer)
    cross = facets.cross_m2
    normal = unit(cross)
    sign, weight = facet_weights(normal, facets.surface, surfaces, s, o, sun_radius_rad)
    active = np.flatnonzero(weight > 0.0)
    seen = np.abs(cross @ o) * 0.5
    whole = weight * seen
    if facets.convex or active.size == 0:
        whole[facets.closed & (sign < 0.0)] = 0.0  # the inside of a closed shell is not seen
        return MeshLight(float(whole.sum()), 0.0, whole)
    geometry = _geometry(facets, normal, sign, s, plane_axes(o))
    work = room_for(len(facets))
    allowed = min(PATIENCE / active.size, MOST) * error * float(whole.sum())
    todo, parts, off = active, np.zeros(len(facets)), np.zeros(len(facets))
    for _ in range(ROUNDS):
        area, unsure = _areas(geometry, work, todo, allowed / weight[todo], seen[todo])
        parts[todo], off[todo] = weight[todo] * area, weight[todo] * unsure
        total, bound = float(parts.sum()), float(off.sum())
        if bound <= error * total or total == 0.0:
            break
        allowed *= min(0.5, 0.5 * error * total / bound)
        todo = np.flatnonzero(off > allowed)
    return MeshLight(total, bound, parts)


def seen_areas(facets: Facets, observer: ArrayLike, error: float = 1e-3) -> tuple[Array, float]:
    """Areas (F,) [m2] of facets that an observer sees, across the line of sight; error of the sum.

    error : share of the sum of all that it may err by; bodies that hide nothing are exact
    """
    o, _ = _directions(observer, observer)
    cross = facets.cross_m2
    towards = cross @ o
    whole = np.where(facets.closed & (towards < 0.0), 0.0, np.abs(towards) * 0.5)
    normal = unit(cross)
    active = np.flatnonzero((whole > 0.0) & (np.abs(normal @ o) > GRAZING))
    out = np.zeros(len(facets))
    if facets.convex or active.size == 0:
        out[active] = whole[active]
        return out, 0.0
    geometry = _geometry(facets, normal, np.where(towards < 0.0, -1.0, 1.0), o, plane_axes(o))
    allowed = np.full(active.size, error * float(whole.sum()) / active.size)
    out[active], off = _areas(geometry, room_for(len(facets)), active, allowed, whole[active])
    return out, float(off.sum())


def facet_weights(
    normal: Array,
    surface_of: NDArray[np.int64],
    surfaces: Sequence[FacetSurface],
    sun: Array,
    observer: Array,
    sun_radius_rad: float = 0.0,
) -> tuple[Array, Array]:
    """Which side of each facet is looked at (1 or -1), and BRDF (n.s) of it, 0 if dark: (F,).

    normal : (F, 3); surface_of : (F,) places in `surfaces`
    """
    mu_i, mu_o = normal @ sun, normal @ observer
    sign = np.where(mu_i < 0.0, -1.0, 1.0)
    flip = np.array([surface.two_sided for surface in surfaces])[surface_of]
    good = (mu_i * mu_o > 0.0) & (np.minimum(np.abs(mu_i), np.abs(mu_o)) > GRAZING)
    good &= flip | (sign > 0.0)
    weight = np.zeros(len(normal))
    for k, surface in enumerate(surfaces):
        mine = np.flatnonzero(good & (surface_of == k))
        if not mine.size:
            continue
        towards = normal[mine] * sign[mine, None]
        rings = surface.sun_rings if sun_radius_rad > 0.0 else 0
        points = sun_points(sun, sun_radius_rad, rings)[:, None]
        total = np.zeros(len(mine))
        for some in np.array_split(points, -(-len(points) * len(mine) // AT_ONCE)):
            lit = np.maximum(np.sum(towards * some, axis=-1), 0.0)
            total += np.sum(surface.brdf(towards, some, observer) * lit, axis=0)
        weight[mine] = total / len(points)
    return sign, weight


def sun_points(sun: Array, radius_rad: float, rings: int) -> Array:
    """Directions (n, 3) spread evenly over the Sun's disc: 6 k - 3 on the k-th of `rings` rings.

    A disc of even brightness; n = 1, its centre, without rings.
    """
    if rings == 0:
        return np.asarray(sun, float)[None]
    x, y, _ = plane_axes(sun)
    counts = [6 * k - 3 for k in range(1, rings + 1)]
    edges = np.sqrt(np.cumsum([0, *counts]) / sum(counts))
    out = []
    for k, n in enumerate(counts):
        r = radius_rad * np.sqrt(0.5 * (edges[k] ** 2 + edges[k + 1] ** 2))
        angle = 2.0 * np.pi * (np.arange(n) + 0.5 * (k % 2)) / n
        across = np.cos(angle)[:, None] * x + np.sin(angle)[:, None] * y
        out.append(np.cos(r) * sun + np.sin(r) * across)
    return np.concatenate(out)


def mesh_picture(
    facets: Facets,
    light: MeshLight,
    sun: ArrayLike,
    observer: ArrayLike,
    x_axis: ArrayLike,
    y_axis: ArrayLike,
    cell_m: float,
) -> tuple[Array, tuple[float, float]]:
    """A mesh as the observer sees it: light (ny, nx) in cells, and the place of the frame's origin.

    light : of `mesh_intensity` for the same facets and directions; the picture's sum is its
        intensity [m2/sr]
    x_axis, y_axis : (3,) unit vectors of columns and rows, at right angles to the observer's
    Returns the image and (row, column) of the origin, as `physics.targets.disc.picture` takes them.
    BadInput where the cells are too fine: more than 4096 along a side.
    """
    s, o = _directions(sun, observer)
    axes = np.stack([np.asarray(x_axis, float), np.asarray(y_axis, float), o])
    if np.abs(axes @ axes.T - np.eye(3)).max() > 1e-6:
        raise BadInput("x_axis, y_axis", axes[:2].tolist(), "unit vectors across the line of sight")
    active = np.flatnonzero(light.facet_m2_sr > 0.0)
    normal = facets.normal
    sign = np.where(normal @ s < 0.0, -1.0, 1.0)
    geometry = _geometry(facets, normal, sign, s, axes)
    view = geometry[0]
    low, high = view.low[:, :2].min(axis=0), view.high[:, :2].max(axis=0)
    if not (cell_m > 0.0 and np.max(high - low) / cell_m < MOST_CELLS - 2):
        raise BadInput("cell_m", cell_m, f"at most {MOST_CELLS} cells along a side of the body")
    x0, y0 = (float(np.floor(v / cell_m)) * cell_m for v in low)
    nx, ny = (int(np.floor((h - v) / cell_m)) + 1 for h, v in zip(high, (x0, y0), strict=True))
    frame, image = (x0, y0, float(cell_m)), np.zeros((ny, nx))
    _image(geometry, room_for(len(facets)), active, light.facet_m2_sr, frame, image)
    return image, (-y0 / cell_m - 0.5, -x0 / cell_m - 0.5)


def _geometry(
    facets: Facets,
    normal: Array,
    sign: Array,
    sun: Array,
    axes: Array,
) -> tuple[Any, ...]:
    """What the loops over facets need; see `covered`."""
    towards = plane_axes(sun)
    view, light = (
        binned(facets.corners_m, a, ~facets.closed | (normal @ a[2] > 0.0)) for a in (axes, towards)
    )
    return view, light, sign, normal, sun, axes, ROOM * facets.radius_m


def _directions(sun: ArrayLike, observer: ArrayLike) -> tuple[Array, Array]:
    out = []
    for name, value in (("sun", sun), ("observer", observer)):
        v = np.asarray(value, float)
        if v.shape != (3,) or not abs(v @ v - 1.0) < 1e-6:
            raise BadInput(name, str(value), "a unit vector of 3 numbers")
        out.append(v / np.sqrt(v @ v))
    return out[0], out[1]


@njit(cache=True, nogil=True)
def _areas(geometry, work, active, tolerance, whole):
    """Lit and seen areas of facets in the observer's plane, with bounds on their errors [m2]."""
    view, light, sign, normal, sun, axes, room = geometry
    area, error = np.zeros(active.size), np.zeros(active.size)
    work.seen[:] = -1  # an earlier round's looks
    for i in range(active.size):
        found = covered(active[i], view, light, sign, normal, sun, axes, room, work)
        if found == 0:
            area[i] = whole[i]
        elif found > 0:
            area[i], error[i] = free_area(work, found, tolerance[i])
    return area, error


@njit(cache=True, nogil=True)
def _spread(work, near, frame, lines, part, length, image):
    """One facet's light over the cells of its free pieces; returns their length.

    length : their length where it is known; 0: nothing is drawn yet
    """
    x0, y0, side = frame
    first = int((work.low[0] - y0) * lines / side - 0.5)
    last = int((work.high[0] - y0) * lines / side + 1.5)
    total = 0.0
    for m in range(max(first, 0), min(last, image.shape[0] * lines)):
        for k in range(free_spans(work, near, y0 + (m + 0.5) * side / lines)):
            total += work.end[k] - work.begin[k]
            if length > 0.0:
                u, v = (work.begin[k] - x0) / side, (work.end[k] - x0) / side
                for c in range(int(u), min(int(v) + 1, image.shape[1])):
                    share = min(v, c + 1.0) - max(u, float(c))
                    if share > 0.0:
                        image[m // lines, c] += part * share * side / length
    return total


@njit(cache=True, nogil=True)
def _image(geometry, work, active, parts, frame, image):
    """Each facet's light onto the cells that its lit and seen part covers; thin ones whole."""
    view, light, sign, normal, sun, axes, room = geometry
    x0, y0, side = frame
    for f in active:
        found = max(covered(f, view, light, sign, normal, sun, axes, room, work), 0)
        for k in range(found):
            work.near[k] = k + 1
        length = _spread(work, found, frame, LINES, parts[f], 0.0, image)
        if length > 0.0:
            _spread(work, found, frame, LINES, parts[f], length, image)
        else:
            row = int((work.y[0, :3].mean() - y0) / side)
            image[row, int((work.x[0, :3].mean() - x0) / side)] += parts[f]
