"""Optical distortion: SIP, TPV and radial polynomials between pixels and the tangent plane.

Places here are offsets from the boresight pixel [px]: (u, v) on the detector, (U, V) on the
undistorted plane, in units of the central pixel. A polynomial moves w to M(w) = w + D(w):
SIP and TPV from the detector to the plane, the radial one from the plane to the detector.

Beyond a rectangle that holds the frame and a margin the displacement fades into a constant along
each axis: M(w) = w + D(held(w)), where held is w in the rectangle and h + f tanh((w - h) / f)
beyond its half side h. Where the symmetric part of M's Jacobian is positive definite everywhere, M
is strongly monotone on the whole plane, hence one-to-one (Browder-Minty): nothing far away can be
folded back into the frame. `fitted` checks that and refuses all else.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

from catalog_tools.documents import JsonObject
from pipeline.errors import BadInput

Array = NDArray[np.float64]
Table = tuple[tuple[float, ...], ...]

FIELD = "sensor.distortion"
LEAST_SLOPE = 0.05  # least eigenvalue of the Jacobian's symmetric part
MARGIN = 1.0 / 16.0  # of the frame's sides, on each side; the displacement fades over as much more
LEAST_MARGIN_PX = 4.0
GRID = 97
WIDEST = 8.0  # the rectangle may be that many times the frame and its margin
MOST_STEPS, MOST_HALVINGS = 60, 30


@dataclass(frozen=True)
class Distortion:
    """D(w) = L^-1 P(L (w - origin)) - (the same at w = 0): the boresight's pixel stays.

    a, b : P's two components; [p][q] is the coefficient of s_x^p s_y^q
    a_odd, b_odd : of |s|, |s|^3, |s|^5, |s|^7
    matrix : L, row by row; origin_px : reference place (x, y), an offset from the boresight pixel
    to_pixel : M leads from the plane to the detector, not from the detector to the plane
    half_px : half sides (x, y) of the rectangle beyond which the displacement fades into a
    constant, over about fade_px
    """

    a: Table
    b: Table
    a_odd: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)
    b_odd: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)
    matrix: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 1.0)
    origin_px: tuple[float, float] = (0.0, 0.0)
    to_pixel: bool = False
    half_px: tuple[float, float] = (math.inf, math.inf)
    fade_px: tuple[float, float] = (1.0, 1.0)

    def to_plane(self, u_px: Array, v_px: Array) -> tuple[Array, Array]:
        """Undistorted offsets (U, V) of detector offsets (u, v) of any shape [px]."""
        return _inverse(self, u_px, v_px) if self.to_pixel else _moved(self, u_px, v_px)

    def to_detector(self, u_px: Array, v_px: Array) -> tuple[Array, Array]:
        """Detector offsets (u, v) of undistorted ones (U, V) of any shape [px]; NaN stays NaN."""
        return _moved(self, u_px, v_px) if self.to_pixel else _inverse(self, u_px, v_px)

    def scale_matrices(self, u_px: Array, v_px: Array) -> Array:
        """Jacobians (n, 2, 2) d(U, V)/d(u, v) at detector offsets (n,) [px] in the rectangle."""
        if not self.to_pixel:
            return _slopes(self, u_px, v_px)
        return np.asarray(np.linalg.inv(_slopes(self, *_inverse(self, u_px, v_px))), float)

    def largest_stretch(self) -> float:
        """Most by which a length may grow between detector and plane, either way, anywhere."""
        singular = np.linalg.svd(_jacobians(self)[2], compute_uv=False)
        worst = max(1.0 / singular.min(), singular.max(), 1.0)
        return 1.01 * float(worst)  # the grid may miss the very largest


def distortion_of(request: JsonObject, rows: int, columns: int, ifov_rad: float) -> Distortion:
    """The distortion that a scene's plain data ask for, checked over the frame and a margin.

    request : `kind` (sip, tpv or radial) and its coefficients, as `pipeline.spec.sensor.distortion`
        has them
    Raises BadInput that names `sensor.distortion` where it is not one-to-one.
    """
    origin = (0.0, 0.0)
    if request.get("reference_px") is not None:
        x, y = request["reference_px"]
        origin = (x - (columns - 1) / 2.0, y - (rows - 1) / 2.0)
    if request["kind"] == "sip":
        raw = sip(request["a"], request["b"], origin)
    elif request["kind"] == "tpv":
        step = math.degrees(ifov_rad)
        cd = request.get("cd_deg") or ((-step, 0.0), (0.0, step))
        raw = tpv(request["pv1"], request["pv2"], cd, origin)
    elif request["kind"] == "radial":
        k = (request["k1"], request["k2"], request["k3"])
        raw = radial(k, (request["p1"], request["p2"]), ifov_rad, origin)
    else:
        raise BadInput(f"{FIELD}.kind", request["kind"], "sip, tpv or radial once files are read")
    return fitted(raw, rows, columns)


def sip(
    a: Mapping[str, float], b: Mapping[str, float], origin_px: tuple[float, float] = (0.0, 0.0)
) -> Distortion:
    """Simple Imaging Polynomial (Shupe et al. 2005, ADASS XIV): U = u + sum A_p_q u^p v^q."""
    return Distortion(_table(_powers(a)), _table(_powers(b)), origin_px=origin_px)


def tpv(
    pv1: Mapping[int, float],
    pv2: Mapping[int, float],
    cd_deg: Sequence[Sequence[float]],
    origin_px: tuple[float, float] = (0.0, 0.0),
) -> Distortion:
    """The TPV convention of the FITS registry: xi' = sum PV1_k t_k(xi, eta), in degrees.

    The second axis has xi and eta exchanged. Terms by rising degree d: xi^d, xi^(d-1) eta, ...,
    eta^d, and after the odd degrees r^d; 1 is 1 unless given, all others 0. (xi, eta) is
    `cd_deg` (2, 2) times the pixel offset.
    """
    tables: list[Table] = []
    odd: list[tuple[float, ...]] = []
    for pv, swap in ((pv1, False), (pv2, True)):
        terms, powers = {1: 1.0} | {int(k): v for k, v in pv.items()}, {}
        for k, (p, q) in enumerate(TPV_TERMS):
            if q >= 0:
                powers[(q, p) if swap else (p, q)] = terms.get(k, 0.0)
        own = (0, 1) if swap else (1, 0)
        powers[own] -= 1.0
        tables.append(_table(powers))
        odd.append(tuple(terms.get(k, 0.0) for k in TPV_ODD))
    (c11, c12), (c21, c22) = cd_deg
    if not c11 * c22 - c12 * c21:
        raise BadInput(f"{FIELD}.cd_deg", cd_deg, "a matrix that can be inverted")
    matrix = (float(c11), float(c12), float(c21), float(c22))
    return Distortion(tables[0], tables[1], odd[0], odd[1], matrix, origin_px)


def _tpv_terms() -> tuple[tuple[int, int], ...]:
    """Powers (p, q) of xi and eta of each TPV term; (d, -1) for r^d."""
    out: list[tuple[int, int]] = []
    for degree in range(8):
        out += [(degree - q, q) for q in range(degree + 1)]
        if degree % 2:
            out.append((degree, -1))
    return tuple(out)


TPV_TERMS = _tpv_terms()
TPV_ODD = tuple(k for k, (_, q) in enumerate(TPV_TERMS) if q < 0)


def radial(
    k: tuple[float, float, float],
    p: tuple[float, float],
    ifov_rad: float,
    origin_px: tuple[float, float] = (0.0, 0.0),
) -> Distortion:
    """Brown-Conrady in tangents x, y of the angles from the axis, as camera calibrations give it.

    x' = x (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2)
    y' = y (1 + k1 r^2 + k2 r^4 + k3 r^6) + p1 (r^2 + 2 y^2) + 2 p2 x y
    from the direction (x, y) to the place on the detector (Brown 1966; signs as in OpenCV).
    """
    p1, p2 = p
    a: dict[tuple[int, int], float] = {(1, 1): 2.0 * p1, (2, 0): 3.0 * p2, (0, 2): p2}
    b: dict[tuple[int, int], float] = {(1, 1): 2.0 * p2, (0, 2): 3.0 * p1, (2, 0): p1}
    for n, coefficient in enumerate(k, start=1):
        for j in range(n + 1):
            share = coefficient * math.comb(n, j)
            a[2 * (n - j) + 1, 2 * j] = share
            b[2 * (n - j), 2 * j + 1] = share
    matrix = (ifov_rad, 0.0, 0.0, ifov_rad)
    return Distortion(_table(a), _table(b), (0.0,) * 4, (0.0,) * 4, matrix, origin_px, True)


@lru_cache(maxsize=16)
def fitted(raw: Distortion, rows: int, columns: int) -> Distortion:
    """The distortion with the rectangle for a frame; BadInput where it is not one-to-one there."""
    fade = (max(MARGIN * columns, LEAST_MARGIN_PX), max(MARGIN * rows, LEAST_MARGIN_PX))
    half = (0.5 * columns + fade[0], 0.5 * rows + fade[1])
    scale = 1.0
    while True:
        out = replace(raw, half_px=(scale * half[0], scale * half[1]), fade_px=fade)
        _check(out, rows, columns)
        if not raw.to_pixel or _covers(out, half):
            return out
        scale *= 1.05
        if scale > WIDEST:
            raise BadInput(FIELD, "light that does not reach the frame's edge", _ALLOWED)


_ALLOWED = "a distortion that is one-to-one over the frame and a margin of an eighth of its sides"


def _covers(d: Distortion, half_px: tuple[float, float]) -> bool:
    """Whether the image of the rectangle's edge lies outside of a rectangle about the frame."""
    edge = np.linspace(-1.0, 1.0, GRID)
    one = np.ones(GRID)
    u, v = np.concatenate([one, edge]) * d.half_px[0], np.concatenate([edge, one]) * d.half_px[1]
    for sign in (1.0, -1.0):
        x, y = _moved(d, sign * u, sign * v)
        if (sign * x[:GRID]).min() < half_px[0] or (sign * y[GRID:]).min() < half_px[1]:
            return False
    return True


def _check(d: Distortion, rows: int, columns: int) -> None:
    """Refuse a map whose Jacobian is not safely positive, naming the first worst place."""
    u, v, jacobian = _jacobians(d)
    with np.errstate(all="ignore"):
        least = _least_slope(jacobian)
    worst = int(np.argmin(np.where(np.isfinite(least), least, -np.inf)))
    if least[worst] >= LEAST_SLOPE:
        return
    x, y = u[worst] + (columns - 1) / 2.0, v[worst] + (rows - 1) / 2.0
    where = "towards" if d.to_pixel else "at"
    raise BadInput(
        FIELD,
        f"a slope of {least[worst]:.3g} {where} pixel x = {x:.1f}, y = {y:.1f}",
        f"{_ALLOWED}: a least slope of {LEAST_SLOPE:g}",
    )


def _least_slope(jacobian: Array) -> Array:
    """Least eigenvalue (n,) of the symmetric part of matrices (n, 2, 2)."""
    a, d = jacobian[:, 0, 0], jacobian[:, 1, 1]
    b = 0.5 * (jacobian[:, 0, 1] + jacobian[:, 1, 0])
    return np.asarray(0.5 * (a + d) - np.hypot(0.5 * (a - d), b))


def _jacobians(d: Distortion) -> tuple[Array, Array, Array]:
    """Jacobians (n, 2, 2) of M over the whole plane, with the held places (n,), (n,) they are of.

    Held places fill the rectangle and the fade; at their outer edge they stand for all beyond.
    """
    nodes = np.linspace(-1.0, 1.0, GRID)
    u, v = (
        g.ravel()
        for g in np.meshgrid(*(nodes * (h + f) for h, f in zip(d.half_px, d.fade_px, strict=True)))
    )
    jacobian = _slopes(d, u, v)
    for axis, w in enumerate((u, v)):
        into = np.maximum((np.abs(w) - d.half_px[axis]) / d.fade_px[axis], 0.0)
        follow = 1.0 - np.minimum(into, 1.0) ** 2  # tanh' = 1 - tanh^2
        own = np.eye(2)[axis]
        jacobian[:, :, axis] = own + (jacobian[:, :, axis] - own) * follow[:, None]
    return u, v, jacobian


def _powers(terms: Mapping[str, float]) -> dict[tuple[int, int], float]:
    """Coefficients by powers from keys such as 2_0."""
    return {(int(k.split("_")[0]), int(k.split("_")[1])): v for k, v in terms.items()}


def _table(powers: Mapping[tuple[int, int], float]) -> Table:
    size = 1 + max((p + q for (p, q), v in powers.items() if v), default=0)
    return tuple(tuple(float(powers.get((p, q), 0.0)) for q in range(size)) for p in range(size))


@lru_cache(maxsize=32)
def _arrays(d: Distortion) -> tuple[Array, Array, Array]:
    """What the kernels take: polynomials (2, n, n), odd terms (2, 4), and 16 numbers.

    The numbers are L, its inverse, the origin, the half sides, the fade, and what is taken off.
    """
    size = max(len(d.a), len(d.b))
    table = np.zeros((2, size, size))
    for i, rows in enumerate((d.a, d.b)):
        table[i, : len(rows), : len(rows)] = rows
    matrix = np.array(d.matrix).reshape(2, 2)
    numbers = np.zeros(16)
    numbers[0:4], numbers[4:8] = d.matrix, np.linalg.inv(matrix).ravel()
    numbers[8:10], numbers[10:12], numbers[12:14] = d.origin_px, d.half_px, d.fade_px
    odd = np.array([d.a_odd, d.b_odd], float)
    s, t = (float(c) for c in -(matrix @ d.origin_px))
    polynomial = [np.polynomial.polynomial.polyval2d(s, t, rows) for rows in table]
    radii = np.array([math.hypot(s, t) ** k for k in (1, 3, 5, 7)])
    numbers[14:16] = np.linalg.inv(matrix) @ (np.array(polynomial) + odd @ radii)
    for values in (table, odd, numbers):
        values.flags.writeable = False
    return table, odd, numbers


def _moved(d: Distortion, u: Array, v: Array) -> tuple[Array, Array]:
    flat, shape = _flat(u, v)
    out = np.empty_like(flat)
    _move_all(flat, *_arrays(d), out)
    return out[0].reshape(shape), out[1].reshape(shape)


def _inverse(d: Distortion, u: Array, v: Array) -> tuple[Array, Array]:
    flat, shape = _flat(u, v)
    out = np.empty_like(flat)
    _invert_all(flat, *_arrays(d), out)
    return out[0].reshape(shape), out[1].reshape(shape)


def _slopes(d: Distortion, u: Array, v: Array) -> Array:
    flat, _ = _flat(u, v)
    out = np.empty((flat.shape[1], 2, 2))
    _slope_all(flat, *_arrays(d), out)
    return out


def _flat(u: Array, v: Array) -> tuple[Array, tuple[int, ...]]:
    u, v = np.broadcast_arrays(np.asarray(u, float), np.asarray(v, float))
    return np.stack([u.ravel(), v.ravel()]), u.shape


@njit(cache=True, nogil=True)
def _component(table, odd, s, t):
    """One component of P at (s, t), with its slopes by s and t; table (n, n), odd (4,)."""
    size = table.shape[0]
    value, by_s, by_t = 0.0, 0.0, 0.0
    for p in range(size - 1, -1, -1):
        inner, inner_t = 0.0, 0.0
        for q in range(size - 1 - p, -1, -1):
            inner_t = inner_t * t + inner
            inner = inner * t + table[p, q]
        by_s = by_s * s + value
        value = value * s + inner
        by_t = by_t * s + inner_t
    r = math.hypot(s, t)
    if r > 0.0:
        power = 1.0 / r
        for k in range(4):
            by_r = (2 * k + 1) * odd[k] * power
            value += odd[k] * power * r * r
            by_s += by_r * s
            by_t += by_r * t
            power *= r * r
    return value, by_s, by_t


@njit(cache=True, nogil=True)
def _displacement(u, v, table, odd, numbers, out):
    """D and its slopes at (u, v): out = (D_x, D_y, dD_x/du, dD_x/dv, dD_y/du, dD_y/dv)."""
    l11, l12, l21, l22 = numbers[0], numbers[1], numbers[2], numbers[3]
    a, b, c, d = numbers[4], numbers[5], numbers[6], numbers[7]
    x, y = u - numbers[8], v - numbers[9]
    s, t = l11 * x + l12 * y, l21 * x + l22 * y
    f, f_s, f_t = _component(table[0], odd[0], s, t)
    g, g_s, g_t = _component(table[1], odd[1], s, t)
    out[0] = a * f + b * g - numbers[14]
    out[1] = c * f + d * g - numbers[15]
    f_u, f_v = f_s * l11 + f_t * l21, f_s * l12 + f_t * l22
    g_u, g_v = g_s * l11 + g_t * l21, g_s * l12 + g_t * l22
    out[2], out[3] = a * f_u + b * g_u, a * f_v + b * g_v
    out[4], out[5] = c * f_u + d * g_u, c * f_v + d * g_v


@njit(cache=True, nogil=True)
def _held(u, v, table, odd, numbers, out):
    """The same at held places, with the slopes by the places themselves."""
    into_u = max(abs(u) - numbers[10], 0.0) / numbers[12]
    into_v = max(abs(v) - numbers[11], 0.0) / numbers[13]
    if into_u == 0.0 and into_v == 0.0:
        _displacement(u, v, table, odd, numbers, out)
        return
    far_u, far_v = math.tanh(into_u), math.tanh(into_v)
    hu = u if into_u == 0.0 else math.copysign(numbers[10] + numbers[12] * far_u, u)
    hv = v if into_v == 0.0 else math.copysign(numbers[11] + numbers[13] * far_v, v)
    _displacement(hu, hv, table, odd, numbers, out)
    out[2] *= 1.0 - far_u * far_u
    out[4] *= 1.0 - far_u * far_u
    out[3] *= 1.0 - far_v * far_v
    out[5] *= 1.0 - far_v * far_v


@njit(cache=True, nogil=True)
def _move_all(places, table, odd, numbers, moved):
    out = np.empty(6)
    for i in range(places.shape[1]):
        u, v = places[0, i], places[1, i]
        if not (math.isfinite(u) and math.isfinite(v)):
            moved[0, i], moved[1, i] = u, v
            continue
        _held(u, v, table, odd, numbers, out)
        moved[0, i], moved[1, i] = u + out[0], v + out[1]


@njit(cache=True, nogil=True)
def _slope_all(places, table, odd, numbers, slopes):
    out = np.empty(6)
    for i in range(places.shape[1]):
        _displacement(places[0, i], places[1, i], table, odd, numbers, out)
        slopes[i, 0, 0], slopes[i, 0, 1] = 1.0 + out[2], out[3]
        slopes[i, 1, 0], slopes[i, 1, 1] = out[4], 1.0 + out[5]


@njit(cache=True, nogil=True)
def _invert_all(places, table, odd, numbers, found):
    """Newton's method with halved steps, each place on its own: no place depends on another."""
    out, trial = np.empty(6), np.empty(6)
    for i in range(places.shape[1]):
        goal_u, goal_v = places[0, i], places[1, i]
        if not (math.isfinite(goal_u) and math.isfinite(goal_v)):
            found[0, i], found[1, i] = goal_u, goal_v
            continue
        _held(goal_u, goal_v, table, odd, numbers, out)
        u, v = goal_u - out[0], goal_v - out[1]
        enough = 1e-12 + 4e-16 * (abs(goal_u) + abs(goal_v))
        _held(u, v, table, odd, numbers, out)
        fu, fv = u + out[0] - goal_u, v + out[1] - goal_v
        for _ in range(MOST_STEPS):
            left = math.hypot(fu, fv)
            if left <= enough:
                break
            det = (1.0 + out[2]) * (1.0 + out[5]) - out[3] * out[4]
            du = ((1.0 + out[5]) * fu - out[3] * fv) / det
            dv = ((1.0 + out[2]) * fv - out[4] * fu) / det
            share, better = 1.0, False
            for _ in range(MOST_HALVINGS):
                nu, nv = u - share * du, v - share * dv
                _held(nu, nv, table, odd, numbers, trial)
                gu, gv = nu + trial[0] - goal_u, nv + trial[1] - goal_v
                if math.hypot(gu, gv) < left:
                    better = True
                    break
                share *= 0.5
                if share * math.hypot(du, dv) < enough:
                    break
            if not better:
                break
            u, v, fu, fv = nu, nv, gu, gv
            for k in range(6):
                out[k] = trial[k]
        found[0, i], found[1, i] = u, v
