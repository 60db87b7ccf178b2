"""Shells of a mesh: which facets hang together, which shells are closed, which inside out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

Array = NDArray[np.float64]


def closed_shells(faces: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Which shell each facet belongs to (F,), and whether each shell (S,) is closed.

    faces : (F, 3) corner numbers, corners in one place sharing a number. A shell is what hangs
    together by corners; it is closed where each edge is run through once in either direction.
    """
    count = int(faces.max(initial=-1)) + 1
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    links = coo_matrix((np.ones(start.size, bool), (start, end)), shape=(count, count))
    shells, of_corner = connected_components(links, directed=False)
    of_facet = of_corner[faces[:, 0]].astype(np.int64)
    forward, backward = start * count + end, end * count + start
    order = np.sort(forward)
    at = np.searchsorted(order, forward)
    twice = (at + 1 < order.size) & (order[np.minimum(at + 1, order.size - 1)] == forward)
    there = np.searchsorted(order, backward)
    met = order[np.minimum(there, order.size - 1)] == backward
    bad = np.bincount(np.repeat(of_facet, 3), weights=twice | ~met, minlength=shells)
    return of_facet, bad == 0


def shell_volumes(corners_m: Array, shell: NDArray[np.int64], shells: int) -> Array:
    """Volumes (S,) [m3] within shells, by the divergence theorem: negative if turned inside out."""
    a, b, c = np.moveaxis(corners_m - corners_m.mean(axis=(0, 1)), 1, 0)
    six = np.sum(a * np.cross(b, c), axis=-1)
    return np.asarray(np.bincount(shell, weights=six / 6.0, minlength=shells), float)
