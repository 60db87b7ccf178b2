"""Grey Lambertian cylinder, cone and frustum: area functions in closed form, any directions."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

NARROW_RAD = 0.5  # half width of an arc below which it is summed without cancellation
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)


def frustum_area_function(
    sun: ArrayLike,
    observer: ArrayLike,
    base_radius_m: ArrayLike,
    top_radius_m: ArrayLike,
    height_m: ArrayLike,
    base_closed: ArrayLike = True,
    top_closed: ArrayLike = True,
) -> Array:
    """G [m2] = integral of max(0, n.s) max(0, n.o) over a frustum about +z: (...,).

    The side's normal at azimuth p is (nr cos p, nr sin p, nz), so n.d = a + b cos(p - p_d) with
    a = nz d_z and b = nr hypot(d_x, d_y): positive over the whole circle, an arc, or nowhere. The
    two arcs overlap in up to two pieces, and the product has an elementary integral. Its terms
    cancel on short pieces: those are summed by Gauss's rule, exact to rounding there, of the
    factored form b (cos x - cos w) = 2 b sin((w + x)/2) sin((w - x)/2). Relative error below
    1e-13 for every direction, but for the rounding of the directions themselves at grazing light.

    sun, observer : (..., 3) unit vectors in the body's axes
    base_radius_m (at z = 0), top_radius_m (at z = height_m) : equal for a cylinder, one 0 for a
        cone; base_closed, top_closed : a lid reflects like the side; an open end shows nothing
        (no light comes out of the inside).
    """
    s, o = np.asarray(sun, float), np.asarray(observer, float)
    given = (base_radius_m, top_radius_m, height_m, base_closed, top_closed)
    shape = np.broadcast_shapes(s.shape[:-1], o.shape[:-1], *(np.shape(v) for v in given))
    # Copies: writable and contiguous, so that the loop is compiled once.
    lit, seen = (np.array(np.broadcast_to(v, (*shape, 3))).reshape(-1, 3) for v in (s, o))
    r0, r1, height, base, top = (
        np.array(np.broadcast_to(np.asarray(v, float), shape)).ravel() for v in given
    )
    areas = _areas(lit, seen, r0, r1, height, base, top, _NODES, _WEIGHTS)
    return np.asarray(areas).reshape(shape)


def cylinder_area_function(
    sun: ArrayLike,
    observer: ArrayLike,
    radius_m: ArrayLike,
    length_m: ArrayLike,
    closed: ArrayLike = True,
) -> Array:
    """G [m2] of a cylinder about +z; `closed`: with both lids. See `frustum_area_function`."""
    return frustum_area_function(sun, observer, radius_m, radius_m, length_m, closed, closed)


def cone_area_function(
    sun: ArrayLike,
    observer: ArrayLike,
    radius_m: ArrayLike,
    height_m: ArrayLike,
    closed: ArrayLike = True,
) -> Array:
    """G [m2] of a cone, apex towards +z; `closed`: with its base. See `frustum_area_function`."""
    return frustum_area_function(sun, observer, radius_m, 0.0, height_m, closed, False)


@njit(cache=True, nogil=True)
def _areas(sun, observer, base, top, height, base_closed, top_closed, nodes, weights):
    """(n,) area functions of (n, 3) directions and (n,) sizes."""
    out = np.empty(len(base))
    for i in range(len(base)):
        s, o, r0, r1 = sun[i], observer[i], base[i], top[i]
        g = _side(s[0], s[1], s[2], o[0], o[1], o[2], r0, r1, height[i], nodes, weights)
        if s[2] > 0.0 and o[2] > 0.0:
            g += top_closed[i] * math.pi * r1 * r1 * s[2] * o[2]
        elif s[2] < 0.0 and o[2] < 0.0:
            g += base_closed[i] * math.pi * r0 * r0 * s[2] * o[2]
        out[i] = g
    return out


@njit(cache=True, nogil=True)
def _side(sx, sy, sz, ox, oy, oz, r0, r1, height, nodes, weights):
    """The side's area function.

    w: half width of an arc, u = w - pi/2; delta: azimuth of the observer from the Sun's, and
    e = pi - delta, each from atan2, so that no small arc is a difference of large numbers.
    """
    slant = math.hypot(height, r0 - r1)
    nr, nz = height / slant, (r0 - r1) / slant
    a, b = nz * sz, nr * math.hypot(sx, sy)
    c, d = nz * oz, nr * math.hypot(ox, oy)
    if not (a + b > 0.0 and c + d > 0.0):
        return 0.0 * (a + b + c + d)  # 0, or NaN from NaN
    ws, us = _arc(a, b)
    wo, uo = _arc(c, d)
    cross, dot = abs(sx * oy - sy * ox), sx * ox + sy * oy
    delta = math.atan2(cross, dot)
    e = math.atan2(cross, -dot) if cross > 0.0 or dot != 0.0 else math.pi - delta
    left, right = delta + us - uo, delta + uo - us  # the observer's ends beyond the Sun's
    arcs, rule = ((a, b, us), (c, d, uo), ws, delta), (nodes, weights)
    if left < 0.0:  # all the lit arc is seen
        near = _piece(2.0 * ws, (0.0, 0.0, -left, right), arcs, rule)
    elif right < 0.0:  # all the seen arc is lit
        near = _piece(2.0 * wo, (left, -right, 0.0, 0.0), arcs, rule)
    else:
        near = _piece(us + uo + e, (left, 0.0, 0.0, right), arcs, rule)
    turn = 2.0 * math.pi
    far = _piece(us + uo - e, (0.0, turn - right, turn - left, 0.0), arcs, rule)
    return 0.5 * (r0 + r1) * slant * (near + far)


@njit(cache=True, nogil=True)
def _arc(a, b):
    """Half width w of the arc where a + b cos x > 0, and w - pi/2."""
    if b <= a:
        return math.pi, 0.5 * math.pi
    root = math.sqrt((b - a) * (b + a))
    return math.atan2(root, -a), math.atan2(a, root)


@njit(cache=True, nogil=True)
def _piece(length, ends, arcs, rule):
    """Integral over one piece of the overlap.

    ends : how far both ends of the lit and both of the seen arc lie beyond the piece's own; arcs :
    of each a + b cos x as (a, b, u), half the lit one's width, and the angle between their middles.
    """
    sun_left, sun_right, seen_left, seen_right = ends
    (a, b, us), (c, d, uo), ws, delta = arcs
    nodes, weights = rule
    if not length > 0.0:
        return 0.0
    h, start = 0.5 * length, sun_left - ws
    if h > NARROW_RAD:
        m = start + h
        wide = 2.0 * h * (a * c + 0.5 * b * d * math.cos(delta))
        wide += 2.0 * math.sin(h) * (a * d * math.cos(m - delta) + b * c * math.cos(m))
        return wide + 0.5 * b * d * math.sin(2.0 * h) * math.cos(2.0 * m - delta)
    total = 0.0
    for k in range(len(nodes)):
        y = h * (1.0 + nodes[k])
        back = h * (1.0 - nodes[k])
        lit = _height(a, b, us, start + y, sun_left + y, sun_right + back)
        seen = _height(c, d, uo, start + y - delta, seen_left + y, seen_right + back)
        total += weights[k] * lit * seen
    return h * total


@njit(cache=True, nogil=True)
def _height(a, b, u, x, from_left, from_right):
    """a + b cos x, on an arc from the distances to its ends, on a whole circle from x."""
    if u >= 0.5 * math.pi:
        return (a - b) + 2.0 * b * math.cos(0.5 * x) ** 2
    return 2.0 * b * math.sin(0.5 * from_left) * math.sin(0.5 * from_right)
