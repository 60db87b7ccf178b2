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
MANY = 32  # segments from which on points may be fewer
MORE = 2  # nodes that a run which bends gets beyond those of a straight one
ASIDE = 0.25  # of what segments may be off: what points for them may err by
DIRECTIONS = 4  # in which points and segments are compared
HALVINGS = 30  # of a node's phases, to find how far nodes serve


def points_along(path: Path, band: float) -> tuple[Array, Array, Array]:
    """Places x, y [px] and shares of the light (n,) that stand for a path.

    band : highest frequency of the image at rest [cycles/px]. Up to it, light at the points has the
    transfer function of light along the path, to SEEN.
    """
    x, y, share = _on_segments(path.x_px, path.y_px, path.weight, band, _served_rad(), *_rules())
    return x, y, share


@njit(cache=True, nogil=True)
def _on_segments(x, y, weight, band, served_rad, t, w):
    """Points (3, n) on the lit segments, x, y and light: those of fewest cuts first, and of them
    those of fewest nodes."""
    cuts, rank = np.empty(len(weight), np.int64), np.empty(len(weight), np.int64)
    total, used, now = 0, 0, 0
    for k in range(len(weight)):
        phase_rad = math.pi * band * math.hypot(x[k + 1] - x[k], y[k + 1] - y[k])
        cuts[k] = max(1, math.ceil(phase_rad / served_rad[-1]))
        nodes = np.searchsorted(served_rad, phase_rad / cuts[k]) + 1
        rank[k] = cuts[k] * (MOST + 1) + nodes if weight[k] != 0.0 else 0
        total += cuts[k] * nodes if weight[k] != 0.0 else 0
    out = np.empty((3, total))
    while used < total:
        now = _next_above(now, rank)
        n = now % (MOST + 1)
        for k in range(len(weight)):
            if rank[k] == now:
                end = used + cuts[k] * n
                of_segment = x[k : k + 2], y[k : k + 2], weight[k]
                _place_cuts(*of_segment, t[n - 1, :n], w[n - 1, :n], out[:, used:end])
                used = end
    return out


@njit(cache=True, nogil=True)
def _next_above(now, ranks):
    """The least of some numbers that is above one; 0 where there is none."""
    found = 0
    for rank in ranks:
        if rank > now and (found == 0 or rank < found):
            found = rank
    return found


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


def in_fewer_points(path: Path, band: float) -> Path:
    """A path that bends in many short segments as fewer points, each a segment of no length; or
    the path itself, where points are not fewer.

    band : highest frequency of the image at rest [cycles/px]. Up to it, the transfer function
        differs by at most ASIDE of what it would if all light moved by `path.off_px`.

    The nodes of one Gauss-Legendre rule stand on each run of segments, at equal shares of the light
    for equal steps of the rule; runs that it does not serve, looked at in DIRECTIONS at the band
    itself, are halved.
    """
    if path.segments < MANY:
        return path
    off = max(SEEN, ASIDE * 2.0 * np.pi * band * path.off_px)
    x, y, share = _on_runs(path.x_px, path.y_px, path.weight, band, off, _served_rad(), *_rules())
    if not len(x) or 2 * len(x) > path.segments:
        return path
    weight = np.zeros(2 * len(share) - 1)
    weight[::2] = share
    return Path(np.repeat(x, 2), np.repeat(y, 2), weight)


@njit(cache=True, nogil=True)
def _on_runs(x, y, weight, band, off, served_rad, t, w):
    """Points (3, n) on runs of segments, x, y and light; none where a segment asks for too many."""
    count = len(weight)
    light, way = np.zeros(count + 1), np.zeros(count + 1)  # up to each node
    for k in range(count):
        light[k + 1] = light[k] + weight[k]
        way[k + 1] = way[k] + math.hypot(x[k + 1] - x[k], y[k + 1] - y[k])
    out, used = np.empty((3, count + MOST)), 0
    left = [(0, count)]
    while left:
        first, last = left.pop()
        of_run = light[last] - light[first]
        if of_run <= 0.0:
            continue
        n = int(np.searchsorted(served_rad, math.pi * band * (way[last] - way[first]))) + 1
        n += MORE if last - first > 1 else 0
        if n <= MOST and used + n <= count and n <= last - first:
            points = out[:, used : used + n]
            _place_rule(x, y, weight, light, first, last, t[n - 1], w[n - 1], points)
            if _off_run(x, y, weight, first, last, points, band) <= off * of_run:
                used += n
                continue
        if last - first == 1:
            return out[:, :0]
        middle = (first + last) // 2
        left.append((middle, last))
        left.append((first, middle))
    return out[:, :used]


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


@njit(cache=True, nogil=True)
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
def _served_rad() -> Array:
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
            low, high = (p, high) if off <= SEEN else (low, p)
        served.append(low)
    return np.array(served)
