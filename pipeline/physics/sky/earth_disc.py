"""Light of the Earth's visible sunlit disc through a point-source transmittance curve.

About each line of sight the disc is cut into rings of one angle, where the curve has one value:
sum = int PST(t) sin t [int radiance dphi] dt. The limb bounds a ring's arc in closed form, the
terminator is found on it, and both integrals go by Gauss's rule between those ends, in variables
that take out the roots there.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pipeline.physics.constants import EARTH_EQUATORIAL_RADIUS_M
from pipeline.physics.sky.pst import Pst
from pipeline.physics.vectors import separation, unit

Array = NDArray[np.float64]

ANGLES, AROUND = 8, 16  # Gauss nodes in each interval of angles, and on each arc
AROUND_A_MAP, INTERVALS_OF_A_MAP = 64, 24  # where the albedo is a map
SCAN = 24  # intervals of an arc in which the terminator is looked for
MARGIN_RAD = 1e-2  # rings this near to the terminator's nearest and farthest points are searched
LEAST_RAD = 1e-6  # a line of sight this near to the limb counts as that far off it


def earth_stray(
    lines_of_sight: Array,
    observer_geocentric_m: Array,
    sun_from_earth_m: Array,
    pst: Pst,
    albedo: Array,
    to_fixed: Array,
) -> Array:
    """PST-weighted irradiance (n,) from the Earth, over the solar irradiance at the Earth.

    A Lambertian sphere of the equatorial radius, lit by a point-like Sun: radiance
    albedo / pi max(0, n.s). Against a brute-force sum over the surface: below 1e-4 with a constant
    albedo, from 300 km to GEO; with a map of cells of 5 degrees 1e-4, 3e-3 where cells of 10
    degrees hold random numbers (tests). Omitted: the Earth's flattening (limb off by up to 21 km),
    air beyond terminator and limb, clouds' own scattering law.

    lines_of_sight : (n, 3) unit vectors that end beside the Earth's disc
    observer_geocentric_m, sun_from_earth_m : (3,), GCRS axes
    albedo : (rows, columns) at the centres of cells of equal steps, south to north from -90 to 90
        degrees and eastward from -180 to 180; (1, 1) is one number. Bilinear between centres.
    to_fixed : (3, 3) from GCRS to Earth-fixed axes (any for one number)
    """
    p = np.atleast_2d(lines_of_sight)
    place = np.asarray(observer_geocentric_m, float) / EARTH_EQUATORIAL_RADIUS_M
    height = float(np.sqrt(place @ place))
    radius = float(np.arcsin(min(1.0 / height, 1.0)))
    from_nadir = separation(p, -place[None])
    low = np.maximum(from_nadir - radius, LEAST_RAD)
    high = np.minimum(from_nadir + radius, np.pi)
    full = np.minimum(np.maximum(2.0 * np.pi - from_nadir - radius, low), high)
    sun = np.asarray(unit(sun_from_earth_m), float)
    own = np.broadcast_to(pst.breaks_rad, (len(p), len(pst.breaks_rad)))
    dusk = _terminator(p, place, sun)
    near_dusk = dusk.min(axis=1) - MARGIN_RAD, dusk.max(axis=1) + MARGIN_RAD
    edges = np.concatenate([own, dusk, full[:, None]], axis=1)
    around = AROUND
    if albedo.size > 1:
        around = AROUND_A_MAP
        even = np.linspace(0.0, 1.0, INTERVALS_OF_A_MAP)
        edges = np.concatenate([edges, low[:, None] + (high - low)[:, None] * even], axis=1)
    angles, weights = _angles(low, high, edges)
    weights = weights * pst.value(angles) * np.sin(angles)
    return _rings(
        p,
        place,
        sun,
        angles,
        weights,
        *near_dusk,
        from_nadir,
        radius,
        np.ascontiguousarray(albedo, float),
        np.asarray(to_fixed, float),
        *np.polynomial.legendre.leggauss(around),
    )


def _terminator(p: Array, place: Array, sun: Array) -> Array:
    """Angles (n, 4) from lines of sight to the visible terminator: its ends, nearest, farthest.

    place : (3,) the observer in Earth radii; where no terminator is seen, zeros.
    """
    beside = place - (place @ sun) * sun
    reach = float(np.sqrt(beside @ beside))
    if reach <= 1.0:
        return np.zeros((len(p), 4))
    first = beside / reach
    second = np.cross(sun, first)
    turn = np.arccos(1.0 / reach) * np.sin(0.5 * np.pi * np.linspace(-1.0, 1.0, 2 * SCAN + 1))
    points = np.cos(turn)[:, None] * first + np.sin(turn)[:, None] * second
    seen = separation(p[:, None], unit(points - place)[None])
    return np.stack([seen[:, 0], seen[:, -1], _lowest(seen), -_lowest(-seen)], axis=1)


def _lowest(values: Array) -> Array:
    """Least (n,) of curves sampled at even steps (n, m), by a parabola through three samples."""
    rows, at = np.arange(len(values)), np.clip(np.argmin(values, 1), 1, values.shape[1] - 2)
    left, middle, right = (values[rows, at + k] for k in (-1, 0, 1))
    bend = left - 2.0 * middle + right
    dip = np.divide((left - right) ** 2, 8.0 * bend, out=np.zeros_like(bend), where=bend > 0.0)
    return np.minimum(middle - dip, values.min(axis=1))


def _angles(low: Array, high: Array, edges: Array) -> tuple[Array, Array]:
    """Angles (n, m) from each line of sight, and the weights of an integral over them.

    low, high : (n,) angles to the limb's nearest and farthest points; edges : (n, k) where what is
    integrated has a root or a kink. Between them, and between doublings of `low`.
    """
    doubled = low[:, None] * 2.0 ** np.arange(0, int(np.ceil(np.log2(np.pi / low.min()))) + 1)
    ends = np.concatenate([doubled, edges, high[:, None]], axis=1)
    ends = np.sort(np.clip(ends, low[:, None], high[:, None]), axis=1)
    ends = ends[:, np.concatenate([[True], (np.diff(ends, axis=1) > 0.0).any(axis=0)])]
    x, w = np.polynomial.legendre.leggauss(ANGLES)
    turn = 0.5 * np.pi * (x + 1.0)
    share, slope = 0.5 * (1.0 - np.cos(turn)), 0.25 * np.pi * np.sin(turn) * w
    step = np.diff(ends, axis=1)[:, :, None]
    angles = ends[:, :-1, None] + step * share
    return angles.reshape(len(low), -1), (step * slope).reshape(len(low), -1)


@njit(cache=True, nogil=True)
def _rings(
    p, o, s, angles, weights, first_dusk, last_dusk, from_nadir, radius, albedo, to_fixed, x, w
):
    """Sum over rings (n, m) of their weight times the radiance over pi around them: (n,)."""
    out = np.zeros(len(p))
    rise = o[0] * o[0] + o[1] * o[1] + o[2] * o[2] - 1.0
    down = -o / np.sqrt(rise + 1.0)
    for i in range(len(p)):
        line = p[i]
        across = down - (down @ line) * line
        size = np.sqrt(across @ across)
        if size < 1e-12:
            axis = np.zeros(3)
            axis[np.argmin(np.abs(line))] = 1.0
            across = axis - (axis @ line) * line
            size = np.sqrt(across @ across)
        e1 = across / size
        e2 = np.array(
            [
                line[1] * e1[2] - line[2] * e1[1],
                line[2] * e1[0] - line[0] * e1[2],
                line[0] * e1[1] - line[1] * e1[0],
            ]
        )
        for j in range(angles.shape[1]):
            if weights[i, j] == 0.0:
                continue
            t = angles[i, j]
            c, b = from_nadir[i], radius
            # half of the arc: 1 - cos w = [cos(t - c) - cos b] / (sin t sin c), as a product
            gap = abs(t - c)
            inner = 2.0 * np.sin(0.5 * (b + gap)) * np.sin(0.5 * (b - gap))
            base = 2.0 * np.sin(t) * np.sin(c)
            square = 1.0 if base <= inner else max(inner / base, 0.0)
            half = 2.0 * np.arcsin(np.sqrt(square))
            scan = SCAN if first_dusk[i] <= t <= last_dusk[i] else 2
            out[i] += weights[i, j] * _arc(
                line * np.cos(t),
                e1 * np.sin(t),
                e2 * np.sin(t),
                half,
                o,
                rise,
                s,
                albedo,
                to_fixed,
                scan,
                x,
                w,
            )
    return out / np.pi


@njit(cache=True, nogil=True)
def _arc(along, e1, e2, half, o, rise, s, albedo, to_fixed, scan, x, w):
    """Integral of albedo max(0, n.s) over the directions at angles -half to half of a ring.

    The angle is half sin(turn): the radiance has a root at the limb.
    """
    total, before = 0.0, -0.5 * np.pi
    last = _lit(before, along, e1, e2, half, o, rise, s)
    start = before
    for k in range(1, scan + 1):
        now = -0.5 * np.pi + np.pi * k / scan
        here = _lit(now, along, e1, e2, half, o, rise, s)
        if (here > 0.0) != (last > 0.0):
            root = _root(before, now, last, here, along, e1, e2, half, o, rise, s)
            if last > 0.0:
                total += _piece(
                    start, root, along, e1, e2, half, o, rise, s, albedo, to_fixed, x, w
                )
            start = root
        before, last = now, here
    if last > 0.0:
        total += _piece(start, before, along, e1, e2, half, o, rise, s, albedo, to_fixed, x, w)
    return total


@njit(cache=True, nogil=True)
def _normal(turn, along, e1, e2, half, o, rise):
    """Point (3,) of the unit sphere that a ring's direction meets first."""
    angle = half * np.sin(turn)
    c, s = np.cos(angle), np.sin(angle)
    u0 = along[0] + c * e1[0] + s * e2[0]
    u1 = along[1] + c * e1[1] + s * e2[1]
    u2 = along[2] + c * e1[2] + s * e2[2]
    ou = o[0] * u0 + o[1] * u1 + o[2] * u2
    way = rise / (-ou + np.sqrt(max(ou * ou - rise, 0.0)))
    return o[0] + way * u0, o[1] + way * u1, o[2] + way * u2


@njit(cache=True, nogil=True)
def _lit(turn, along, e1, e2, half, o, rise, s):
    """n.s there: above 0 where the Sun is up."""
    n0, n1, n2 = _normal(turn, along, e1, e2, half, o, rise)
    return n0 * s[0] + n1 * s[1] + n2 * s[2]


@njit(cache=True, nogil=True)
def _root(a, b, fa, fb, along, e1, e2, half, o, rise, s):
    """Where the terminator crosses a ring between two turns (regula falsi, Illinois)."""
    side = 0
    c = b
    for _ in range(60):
        c = (fa * b - fb * a) / (fa - fb)
        fc = _lit(c, along, e1, e2, half, o, rise, s)
        if abs(fc) < 1e-12 or abs(b - a) < 1e-13:
            break
        if (fc > 0.0) == (fb > 0.0):
            b, fb = c, fc
            if side == -1:
                fa *= 0.5
            side = -1
        else:
            a, fa = c, fc
            if side == 1:
                fb *= 0.5
            side = 1
    return c


@njit(cache=True, nogil=True)
def _piece(a, b, along, e1, e2, half, o, rise, s, albedo, to_fixed, x, w):
    """Integral over a lit piece of an arc, from turn a to turn b."""
    total = 0.0
    for k in range(len(x)):
        turn = 0.5 * (a + b) + 0.5 * (b - a) * x[k]
        n0, n1, n2 = _normal(turn, along, e1, e2, half, o, rise)
        lit = n0 * s[0] + n1 * s[1] + n2 * s[2]
        if albedo.size == 1:
            share = albedo[0, 0]
        else:
            share = _albedo(
                to_fixed[0, 0] * n0 + to_fixed[0, 1] * n1 + to_fixed[0, 2] * n2,
                to_fixed[1, 0] * n0 + to_fixed[1, 1] * n1 + to_fixed[1, 2] * n2,
                to_fixed[2, 0] * n0 + to_fixed[2, 1] * n1 + to_fixed[2, 2] * n2,
                albedo,
            )
        total += w[k] * np.cos(turn) * share * max(lit, 0.0)
    return 0.5 * (b - a) * half * total


@njit(cache=True, nogil=True)
def _albedo(x, y, z, albedo):
    """The map at a place of the unit sphere, Earth-fixed axes; geocentric latitude."""
    rows, columns = albedo.shape
    row = (np.arctan2(z, np.hypot(x, y)) / np.pi + 0.5) * rows - 0.5
    column = (np.arctan2(y, x) / (2.0 * np.pi) + 0.5) * columns - 0.5
    row = min(max(row, 0.0), rows - 1.0)
    i = min(int(row), rows - 2)
    j = int(np.floor(column))
    u, v = row - i, column - j
    left, right = j % columns, (j + 1) % columns
    low = albedo[i, left] * (1.0 - v) + albedo[i, right] * v
    high = albedo[i + 1, left] * (1.0 - v) + albedo[i + 1, right] * v
    return low * (1.0 - u) + high * u
