"""A path as points: the light that falls along it, as light at the nodes of a quadrature.

A source that moves is the sum of its image at rest over the places that it passes. An image without
frequencies beyond some band is summed, for all that shows, by few places: Gauss-Legendre nodes on
each segment (Abramowitz and Stegun, Handbook of Mathematical Functions, 25.4.29).
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pipeline.physics.motion.streak import Path, sinc_of

Array = NDArray[np.float64]

SEEN = 1e-9  # of a source's light at one frequency: what the nodes of a segment may err by
MOST = 48  # nodes of a segment; longer ones are cut
MORE = 2  # nodes that a run which bends gets beyond those of a straight one
ASIDE = 0.25  # of what segments may be off: what points for them may err by
DIRECTIONS = 4  # in which points and segments are compared
HALVINGS = 30  # of a node's phases, to find how far nodes serve


def points_along(path: Path, band: float, seen: float = SEEN) -> tuple[Array, Array, Array]:
    """Places x, y [px] and shares of the light (n,) that stand for a path.

    band : highest frequency of the image at rest [cycles/px]. Up to it, light at the points has the
        transfer function of light along the path, to `seen`; where the path itself stands for
        another within `path.off_px`, to ASIDE of what it would differ by if all light moved so far.

    The nodes of one Gauss-Legendre rule stand on each run of segments, at equal shares of the light
    for equal steps of the rule; runs that it does not serve, looked at in DIRECTIONS at the band
    itself, are halved, and long segments cut.
    """
    off = ASIDE * 2.0 * np.pi * band * path.off_px
    nodes = path.x_px, path.y_px, path.weight
    x, y, share = _on_runs(*nodes, band, off, _served_rad(seen), *_rules())
    return x, y, share


def in_fewer_points(path: Path, band: float) -> Path:
    """A path that bends in many short segments as the fewer points of `points_along`, each a
    segment of no length; or the path itself, where points are not fewer."""
    if 2.0 * points_per_px(band) * path.length_px > path.segments:
        return path
    x, y, share = points_along(path, band)
    if not len(x) or 2 * len(x) > path.segments:
        return path
    weight = np.zeros(2 * len(share) - 1)
    weight[::2] = share
    return Path(np.repeat(x, 2), np.repeat(y, 2), weight)


def points_of_many(offsets: Array, band: float) -> tuple[Array, Array]:
    """Places (2, n, P) along the paths of sources that shine evenly, and their shares (P,).

    offsets : (2, n, K) places at equal times [px], between which paths are cubic (`bend_px`)
    band : as of `points_along`, for the fastest of them
    """
    steps = offsets.shape[2] - 1
    fastest = float(np.hypot(*np.diff(offsets, axis=2)).max(initial=0.0)) * steps
    line = Path(np.array([0.0, max(fastest, 1e-9)]), np.zeros(2), np.ones(1))
    way, _, share = points_along(line, band)
    at = way / line.x_px[1] * steps
    first = np.clip(np.floor(at).astype(np.int64) - 1, 0, steps - 3)
    return _cubic(offsets, first, at - first), share


def bend_px(offsets: Array) -> float:
    """How far paths (..., K) through places at equal times may be from the cubic between them: by
    1/24 of their fourth differences, where all four nodes are on one side."""
    fourth = np.diff(offsets, 4, axis=-1)  # of x and of y
    return math.sqrt(2.0) * float(np.abs(fourth).max(initial=0.0)) / 24.0


@njit(cache=True, nogil=True)
def _cubic(offsets, first, t):
    """Values (2, n, P) of paths t steps after their nodes `first` (P,), by the cubic through four
    nodes from there."""
    count = offsets.shape[1]
    out, w = np.empty((2, count, len(t))), np.empty((4, len(t)))
    for p in range(len(t)):
        a, b, c, d = t[p], t[p] - 1.0, t[p] - 2.0, t[p] - 3.0
        w[0, p], w[1, p] = -b * c * d / 6.0, 0.5 * a * c * d
        w[2, p], w[3, p] = -0.5 * a * b * d, a * b * c / 6.0
    for axis in range(2):
        for i in range(count):
            path, to = offsets[axis, i], out[axis, i]
            for p in range(len(t)):
                k = first[p]
                to[p] = w[0, p] * path[k] + w[1, p] * path[k + 1]
                to[p] += w[2, p] * path[k + 2] + w[3, p] * path[k + 3]
    return out


@njit(cache=True, nogil=True)
def _on_runs(x, y, weight, band, off, served_rad, t, w):
    """Points (3, n) on runs of lit segments, x, y and light, in the order of the path."""
    count = len(weight)
    light, way, most = np.zeros(count + 1), np.zeros(count + 1), np.zeros(count + 1, np.int64)
    for k in range(count):  # up to each node; most : points of its segments, each by itself
        light[k + 1] = light[k] + weight[k]
        way[k + 1] = way[k] + math.hypot(x[k + 1] - x[k], y[k + 1] - y[k])
        cuts, n = _rule_of(band, way[k + 1] - way[k], served_rad)
        most[k + 1] = most[k] + (cuts * n if weight[k] != 0.0 else 0)
    out, used = np.empty((3, most[count])), 0
    left = [(0, count)]
    while left:
        first, last = left.pop()
        of_run, own = light[last] - light[first], most[last] - most[first]
        if own == 0:
            continue
        cuts, n = _rule_of(band, way[last] - way[first], served_rad)
        if last - first == 1:
            points = out[:, used : used + own]
            _place_cuts(x[first:], y[first:], weight[first], t[n - 1, :n], w[n - 1, :n], points)
            used += own
            continue
        n += MORE
        if cuts == 1 and n <= min(own - 1, MOST) and off > 0.0:
            points = out[:, used : used + n]
            _place_rule(x, y, weight, light, first, last, t[n - 1], w[n - 1], points)
            if _off_run(x, y, weight, first, last, points, band) <= off * of_run:
                used += n
                continue
        middle = (first + last) // 2
        left.append((middle, last))
        left.append((first, middle))
    return out[:, :used]


@njit(cache=True, nogil=True)
def _rule_of(band, length_px, served_rad):
    """Into how many cuts a way is cut, and how many nodes serve each."""
    phase_rad = math.pi * band * length_px
    cuts = max(1, math.ceil(phase_rad / served_rad[-1]))
    return cuts, int(np.searchsorted(served_rad, phase_rad / cuts)) + 1


@njit(cache=True, nogil=True)
def _place_cuts(x, y, light, t, w, out):
    """Points (3, cuts times n) at the places t (n,) of a rule in each cut of a segment."""
    n, cut = len(t), out.shape[1] // len(t)
    for c in range(cut):
        for i in range(n):
            at, of = (c + 0.5 * (t[i] + 1.0)) / cut, c * n + i
            out[0, of] = x[0] + at * (x[1] - x[0])
            out[1, of] = y[0] + at * (y[1] - y[0])
            out[2, of] = light * (0.5 * w[i] / cut)


@njit(cache=True, nogil=True)
def _place_rule(x, y, weight, light, first, last, t, w, out):
    """Points (3, n) at the places t of a rule in the light of some segments, with its weights w."""
    k, of_run = first, light[last] - light[first]
    for i in range(out.shape[1]):
        to = light[first] + 0.5 * (1.0 + t[i]) * of_run
        while k < last - 1 and light[k + 1] < to:
            k += 1
        part = (to - light[k]) / weight[k] if weight[k] > 0.0 else 0.5
        out[0, i] = x[k] + part * (x[k + 1] - x[k])
        out[1, i] = y[k] + part * (y[k + 1] - y[k])
        out[2, i] = 0.5 * w[i] * of_run


@njit(cache=True, nogil=True, error_model="numpy")
def _off_run(x, y, weight, first, last, points, band):
    """Largest difference of the transfer functions of segments and of points for them, at the band
    in DIRECTIONS."""
    worst = 0.0
    for d in range(DIRECTIONS):
        angle = math.pi * d / DIRECTIONS
        fx, fy = 2.0 * math.pi * band * math.cos(angle), 2.0 * math.pi * band * math.sin(angle)
        off = 0.0j
        for i in range(points.shape[1]):
            phase = fx * (points[0, i] - x[first]) + fy * (points[1, i] - y[first])
            off += points[2, i] * complex(math.cos(phase), math.sin(phase))
        for k in range(first, last):
            begin = fx * (x[k] - x[first]) + fy * (y[k] - y[first])
            half = 0.5 * (fx * (x[k + 1] - x[k]) + fy * (y[k + 1] - y[k]))
            seen = weight[k] * sinc_of(half, math.sin(half))
            off -= seen * complex(math.cos(begin + half), math.sin(begin + half))
        worst = max(worst, abs(off))
    return worst


@cache
def _rules() -> tuple[Array, Array]:
    """Places and weights (MOST, MOST) of the rules of 1, 2, ... nodes, filled up with zeros."""
    t, w = np.zeros((2, MOST, MOST))
    for n in range(1, MOST + 1):
        t[n - 1, :n], w[n - 1, :n] = _nodes(n)
    return t, w


def points_per_px(band: float) -> float:
    """How many points a px of a long segment gets."""
    return MOST * np.pi * band / float(_served_rad()[-1])


@cache
def _nodes(count: int) -> tuple[Array, Array]:
    """Places in [-1, 1] and weights of Gauss-Legendre quadrature."""
    return np.polynomial.legendre.leggauss(count)


@cache
def _served_rad(seen: float = SEEN) -> Array:
    """(MOST,) up to which phase of a segment's ends 1, 2, ... nodes serve.

    Light spread evenly from -p to p has the transfer function sin(p) / p, nodes t of weights w the
    sum of w cos(p t) / 2. Their difference rises with p up to 1.5 a node.
    """
    served = []
    for n in range(1, MOST + 1):
        (t, w), low, high = _nodes(n), 0.0, 1.5 * n
        for _ in range(HALVINGS):
            p = 0.5 * (low + high)
            off = abs(0.5 * float(np.cos(p * t) @ w) - math.sin(p) / p)
            low, high = (p, high) if off <= seen else (low, p)
        served.append(low)
    return np.array(served)
