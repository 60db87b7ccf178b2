"""Light of a wide lamp on a mesh: all of its parts without shadows, less what shadows take."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pipeline.physics.meshes.facets import Facets
from pipeline.physics.meshes.intensity import (
    FacetSurface,
    facet_weights,
    mesh_intensity,
    seen_areas,
)

Array = NDArray[np.float64]
Lamps = tuple[Array, Array]

PLAIN = (8, 16, 32)  # parts across the lamp, for its light without shadows
SHADED = (2, 3, 4, 6, 8, 12, 16, 24, 32)  # and for what shadows take of it
COARSEST = 0.02  # of one part's light: what its shadows may err by at most


def wide_lamp_intensity(
    facets: Facets,
    surfaces: Sequence[FacetSurface],
    lamp: Callable[[int], Lamps],
    observer: ArrayLike,
    error: float = 1e-3,
    besides_m2_sr: float = 0.0,
) -> tuple[float, float]:
    """Intensity of a mesh [m2/sr] in the light of a wide lamp, and how far it may be off.

    lamp : from n to about n x n parts of it: directions (k, 3) in the facets' frame, and what each
        sheds (k,) on a surface that faces it, over the irradiance that the intensity is told for
    observer : (3,) unit vector
    error : share of this light and `besides_m2_sr` (what else the body sends) that it may err by.
        Parts are made smaller until the light changes by less than half of that (at most 32 across
        for the light and for its shadows): the second number returned is the last changes' sum,
        with the bounds on the areas.
    Shadows are those of `mesh_intensity`, traced for each part; none on convex bodies.
    """
    o = np.asarray(observer, float)
    seen, off_m2 = seen_areas(facets, o, 0.1 * error)
    some = np.flatnonzero(seen > 0.0)
    if not some.size:
        return 0.0, 0.0
    normal, surface_of = facets.normal[some], facets.surface[some]

    def plain(direction: Array) -> float:
        weight = facet_weights(normal, surface_of, surfaces, direction, o)[1]
        return float(weight @ seen[some])

    def light(n: int) -> float:
        return sum(e * plain(d) for d, e in zip(*lamp(n), strict=True) if e > 0.0)

    whole, off = _settled(light, PLAIN, 0.25 * error, 0.0, besides_m2_sr)
    off += whole * off_m2 / float(seen.sum())
    if facets.convex or whole <= 0.0:
        return whole, off
    share = min(max(0.25 * error * (whole + besides_m2_sr) / whole, error), COARSEST)

    def lost(n: int) -> float:
        total = 0.0
        for d, e in zip(*lamp(n), strict=True):
            bare = plain(d) if e > 0.0 else 0.0
            if bare > 0.0:
                shaded = mesh_intensity(facets, surfaces, d, o, share).intensity_m2_sr
                total += e * max(bare - shaded, 0.0)
        return total

    shadow, more = _settled(lost, SHADED, 0.5 * error, whole, besides_m2_sr)
    return max(whole - shadow, 0.0), off + more + share * whole


def _settled(
    value: Callable[[int], float], steps: Sequence[int], share: float, of: float, besides: float
) -> tuple[float, float]:
    """A value at growing fineness until it changes little, and its last change.

    Little: a share of the value (or of `of`) and of what is besides.
    """
    now = value(steps[0])
    for n in steps[1:]:
        last, now = now, value(n)
        change = abs(now - last)
        if change <= share * (max(now, of) + besides):
            break
    return now, change
