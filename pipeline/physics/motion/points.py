"""A path as points: the light that falls along it, as light at the nodes of a quadrature.

A source that moves is the sum of its image at rest over the places that it passes. An image without
frequencies beyond some band is summed, for all that shows, by few places: Gauss-Legendre nodes on
each segment (Abramowitz and Stegun, Handbook of Mathematical Functions, 25.4.29).
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from numpy.typing import NDArray

from pipeline.physics.motion.streak import Path

Array = NDArray[np.float64]

SEEN = 1e-9  # of a source's light at one frequency: what the nodes of a segment may err by
MOST = 48  # nodes of a segment; longer ones are cut
HALVINGS = 30  # of a node's phases, to find how far nodes serve


def points_along(path: Path, band: float) -> tuple[Array, Array, Array]:
    """Places x, y [px] and shares of the light (n,) that stand for a path.

    band : highest frequency of the image at rest [cycles/px]. Up to it, light at the points has the
    transfer function of light along the path, to SEEN.
    """
    x0, y0, dx, dy = path.x_px[:-1], path.y_px[:-1], np.diff(path.x_px), np.diff(path.y_px)
    phase_rad = np.pi * band * np.hypot(dx, dy)  # of a segment's ends against its middle
    cuts = np.maximum(1, np.ceil(phase_rad / _served_rad()[-1])).astype(np.int64)
    count = np.searchsorted(_served_rad(), phase_rad / cuts) + 1
    found = []
    for cut, nodes in np.unique(np.stack([cuts, count]), axis=1).T:
        some = np.flatnonzero((cuts == cut) & (count == nodes))[:, None]
        t, w = _nodes(int(nodes))
        at = ((np.arange(cut)[:, None] + 0.5 * (t + 1.0)) / cut).ravel()
        share = path.weight[some] * np.tile(0.5 * w / cut, cut)
        found.append([x0[some] + at * dx[some], y0[some] + at * dy[some], share])
    x, y, share = (
        np.concatenate([v.ravel() for v in values]) for values in zip(*found, strict=True)
    )
    return x, y, share


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
