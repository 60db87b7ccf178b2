"""Bodies so near that they are not seen from afar, as their light is worked out."""

from __future__ import annotations

import numpy as np

from pipeline.arrays import Array, Geometry
from pipeline.plan.bodies.sizes import radius_m
from pipeline.spec.scene import Scene

OFF, OFF_LATE = 2.2, 3.5  # of the light, over radius / distance: see `off_by`
LATE_RAD = 2.0 * np.pi / 3.0
MOST_NAMED = 5


def off_by(near: Array, phase_rad: Array) -> Array:
    """By what part of its light a body is off at most; near : its radius over its distance.

    By quadrature over a Lambertian sphere: 0.6 `near` more at a phase of 35 degrees, 2.2 `near`
    less at 120, and beyond as the crescent narrows up to 3.5 `near` over what is left to pi.
    """
    late = OFF_LATE / np.maximum(np.pi - phase_rad, 1e-9)
    off: Array = np.minimum(np.where(phase_rad <= LATE_RAD, OFF, late) * near, 1.0)
    return off


def near_warnings(scene: Scene, g: Geometry) -> list[str]:
    """Which bodies are so near that their light is off by more than `accuracy.flux_fraction`.

    Sunlight that a body scatters is taken as that which it sends to infinity, over the square of
    its distance. From near by less of it is seen, and the nearest part is brighter (`off_by`).
    """
    if not scene.targets:
        return []
    size_m = np.array([radius_m(t.body) for t in scene.targets])
    distance_m = g.target_range_m.min(axis=(1, 2))
    near = np.divide(size_m, distance_m, where=distance_m > 0.0, out=np.zeros(len(size_m)))
    off = off_by(near, np.nan_to_num(g.target_phase_rad).max(axis=(1, 2)))
    worst = [i for i in np.argsort(-off, kind="stable") if off[i] > scene.accuracy.flux_fraction]
    told = [
        f"{scene.targets[i].name}: as near as {distance_m[i]:.3g} m, with a radius of "
        f"{size_m[i]:.3g} m: its light is that of a body seen from afar, and up to some "
        f"{100.0 * off[i]:.2g}% off (asked: {100.0 * scene.accuracy.flux_fraction:g}%)"
        for i in worst[:MOST_NAMED]
    ]
    left = len(worst) - len(told)
    return told + ([f"{left} more bodies are near like these, by less"] if left else [])
