"""Flat grey Lambertian shapes, one- and two-sided plates and boxes: area functions, closed form."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def plate_area_function(
    sun: ArrayLike, observer: ArrayLike, area_m2: ArrayLike, two_sided: ArrayLike = False
) -> Array:
    """G [m2] = A max(0, n.s) max(0, n.o) of a plate whose front looks along +z: (...,).

    sun, observer : (..., 3) unit vectors from the plate, in its own axes
    two_sided : the back (-z) reflects like the front; else it is black. With Sun and observer on
        opposite sides G is 0 in both cases.
    """
    s, o = np.asarray(sun, float)[..., 2], np.asarray(observer, float)[..., 2]
    both = s * o
    seen = (both > 0.0) & ((s > 0.0) | np.asarray(two_sided, bool))
    return np.where(seen, both, 0.0) * np.asarray(area_m2, float)


def box_area_function(sun: ArrayLike, observer: ArrayLike, size_m: ArrayLike) -> Array:
    """G [m2] of a closed box with edges (x, y, z) along its axes: six one-sided faces, (...,).

    sun, observer : (..., 3) unit vectors in the box's axes; size_m : (..., 3)
    Of two opposite faces at most one is lit and seen: where s_i o_i > 0.
    """
    size = np.asarray(size_m, float)
    both = np.asarray(sun, float) * np.asarray(observer, float)
    faces = np.roll(size, -1, axis=-1) * np.roll(size, -2, axis=-1)
    return np.sum(np.maximum(both, 0.0) * faces, axis=-1)
