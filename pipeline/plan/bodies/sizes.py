"""How large bodies are: in metres, and on the focal plane."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def radius_m(body: Any) -> float:
    """Radius of a body about its reference point; 0 of a light curve."""
    return RADIUS_M.get(body.kind, _round_m)(body)


def _round_m(body: Any) -> float:
    """Of a cylinder or a cone: half the diagonal of its length and its wider end."""
    wide = getattr(body, "diameter_m", 0.0) or max(body.base_diameter_m, body.top_diameter_m)
    return 0.5 * math.hypot(wide, body.length_m)


RADIUS_M: dict[str, Callable[[Any], float]] = {
    "mesh": lambda body: 0.0 if body.model is None else float(body.model.radius_m),
    "sphere": lambda body: 0.5 * float(body.diameter_m),
    "plate": lambda body: math.sqrt(0.5 * body.area_m2),  # a square's
    "box": lambda body: 0.5 * math.hypot(*body.size_m),
    "cube": lambda body: 0.5 * math.hypot(*3 * (body.edge_m,)),
    "composite": lambda body: max(map(radius_m, body.parts)),
    "light_curve": lambda _: 0.0,
}


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
