"""Bodies so near that they are not seen from afar, as their light is worked out."""

from __future__ import annotations

import numpy as np

from pipeline.arrays import Geometry
from pipeline.plan.bodies.sizes import radius_m
from pipeline.spec.scene import Scene

OFF = 2.2  # of the light, over radius / distance: a Lambertian sphere, up to a phase of 120 degrees
MOST_NAMED = 5


def near_warnings(scene: Scene, g: Geometry) -> list[str]:
    """Which bodies are so near that their light is off by more than `accuracy.flux_fraction`.

    Sunlight that a body scatters is taken as that which it sends to infinity, over the square of
    its distance. From near by less of it is seen, and the nearest part is brighter: by quadrature
    over a Lambertian sphere of radius R at a distance d the light is 0.6 R / d more at a phase of
    35 degrees, and 2.2 R / d less at 120.
    """
    if not scene.targets:
        return []
    size_m = np.array([radius_m(t.body) for t in scene.targets])
    distance_m = g.target_range_m.min(axis=(1, 2))
    off = OFF * np.divide(size_m, distance_m, where=distance_m > 0.0, out=np.zeros(len(size_m)))
    worst = [i for i in np.argsort(-off, kind="stable") if off[i] > scene.accuracy.flux_fraction]
    told = [
        f"{scene.targets[i].name}: as near as {distance_m[i]:.3g} m, with a radius of "
        f"{size_m[i]:.3g} m: its light is that of a body seen from afar, and up to some "
        f"{100.0 * off[i]:.2g}% off (asked: {100.0 * scene.accuracy.flux_fraction:g}%)"
        for i in worst[:MOST_NAMED]
    ]
    left = len(worst) - len(told)
    return told + ([f"{left} more bodies are near like these, by less"] if left else [])
