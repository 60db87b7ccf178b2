"""How large bodies are: in metres, and on the focal plane."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pipeline.spec.body import CompositeBody
from pipeline.spec.mesh import MeshBody

Array = NDArray[np.float64]


def radius_m(body: Any) -> float:
    """Radius of a body about its reference point; 0 of a light curve."""
    if isinstance(body, MeshBody):
        return 0.0 if body.model is None else float(body.model.radius_m)
    if isinstance(body, CompositeBody):
        return max(radius_m(part) for part in body.parts)
    if body.kind == "sphere":
        return 0.5 * float(body.diameter_m)
    if body.kind == "plate":
        return math.sqrt(0.5 * body.area_m2)  # a square's
    if body.kind in ("box", "cube"):
        sides = body.size_m if body.kind == "box" else 3 * (body.edge_m,)
        return 0.5 * math.hypot(*sides)
    if body.kind == "light_curve":
        return 0.0
    wide = getattr(body, "diameter_m", 0.0) or max(body.base_diameter_m, body.top_diameter_m)
    return 0.5 * math.hypot(wide, body.length_m)


def limb_px(radius_m: ArrayLike, range_m: ArrayLike, ifov_rad: float) -> Array:
    """Radius of a sphere's limb in the middle of the focal plane [px].

    Its angle is asin(r/d), as the line of sight touches the sphere, and the camera is gnomonic: the
    tangent of that, r / sqrt(d^2 - r^2). Infinite from inside.
    """
    r, d = np.asarray(radius_m, float), np.asarray(range_m, float)
    leg = np.sqrt(np.maximum((d - r) * (d + r), 0.0))
    inside = np.where(r > 0.0, np.inf, 0.0)
    size = np.divide(r, np.where(leg > 0.0, leg, 1.0) * ifov_rad)
    return np.asarray(np.where(leg > 0.0, size, inside))
