"""How the light of stars changes along their streaks, by the air and the pupil that they meet."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from pipeline.arrays import Array, Geometry
from pipeline.physics.positions.focal_plane import Camera, deproject
from pipeline.spec.scene import Scene

if TYPE_CHECKING:
    from pipeline.physics.sky.extinction import BandExtinction

MOST_MOMENTS = 65  # of an exposure at which the air is looked at: a star's height changes smoothly
FEWEST_STEPS, MOST_STEPS = 16, 1024
LEAST = 1e-12  # of what comes from above: stars behind the camera still have an order


@dataclass(frozen=True)
class ChangingLight:
    """What changes the light of stars while they move.

    extinction : by the air, as seen from the ground; pupil : whether their angle off the axis does
    steps : of equal light in an exposure, at least, in `at_equal_light`
    """

    camera: Camera
    extinction: BandExtinction | None = field(compare=False)
    pupil: bool
    steps: int = FEWEST_STEPS

    def along(self, g: Geometry, x_px: Array, y_px: Array) -> Array:
        """Light (n, F, K) at the nodes of `g` of stars that stand at (x, y) at mid-exposure: as a
        fraction of what comes from above the air on the axis. Of those below the horizon as on it:
        what hides them is not in it."""
        out = np.ones((len(x_px), len(g.frame), g.nodes))
        few = np.unique(np.linspace(0, g.nodes - 1, min(g.nodes, MOST_MOMENTS)).astype(np.int64))
        between = np.array([np.interp(np.arange(g.nodes), few, one) for one in np.eye(len(few))])
        for f in range(len(g.frame)):
            u = deproject(self.camera, g.attitude[f, g.middle], x_px, y_px)
            if self.extinction is not None:
                sine = np.maximum(u @ g.air[f, few, :3].T, 0.0)
                out[:, f] *= self.extinction.transmission(sine) @ between
            if self.pupil:
                out[:, f] *= u @ g.attitude[f, :, 2].T
        return np.maximum(out, LEAST)

    def at_equal_light(self, g: Geometry, x_px: Array, y_px: Array, paths: Array) -> Array:
        """Paths (2, n, F, m (K - 1) + 1) at steps of equal light, from (2, n, F, K) at equal times,
        cubic between these: light that lies evenly along them is that of the stars."""
        light, count = self.along(g, x_px, y_px), paths.shape[-1]
        x, y = (np.ascontiguousarray(v).reshape(-1, count) for v in paths)
        each = math.ceil(self.steps / (count - 1))
        out = _at_equal_light(x, y, light.reshape(-1, count), each)
        return out.reshape(*paths.shape[:-1], -1)


def star_light(
    scene: Scene, camera: Camera, extinction: BandExtinction | None = None
) -> ChangingLight | None:
    """What changes the light of a scene's stars along their streaks; None where nothing does."""
    pupil = scene.sensor.pupil_projection
    return ChangingLight(camera, extinction, pupil) if pupil or extinction is not None else None


def steps_for(moved_px: float, tolerance_px: float) -> int:
    """Steps of equal light in an exposure, between which even light is off by no more than a
    tolerance, if so many may be.

    moved_px : how far equal light moves places of equal time, at most. What is left falls as the
    square of the steps, as between points of a parabola.
    """
    return int(np.clip(math.ceil(math.sqrt(moved_px / tolerance_px)), FEWEST_STEPS, MOST_STEPS))


@njit(cache=True, nogil=True)
def _at_equal_light(x, y, light, steps):
    """Places (2, n, steps (K - 1) + 1) of n paths at equal steps of light, linear between nodes."""
    count, nodes = x.shape
    most = steps * (nodes - 1)
    out = np.empty((2, count, most + 1))
    for i in range(count):
        a = light[i]
        whole = a.sum() - 0.5 * (a[0] + a[-1])
        k, before = 0, 0.0
        for j in range(most + 1):
            asked = whole * j / most
            of_step = 0.5 * (a[k] + a[k + 1])
            while k < nodes - 2 and before + of_step < asked:
                before, k = before + of_step, k + 1
                of_step = 0.5 * (a[k] + a[k + 1])
            rest = min(max(asked - before, 0.0), of_step)
            root = math.sqrt(max(a[k] * a[k] + 2.0 * (a[k + 1] - a[k]) * rest, 0.0))
            t = min(2.0 * rest / (a[k] + root), 1.0) if a[k] + root > 0.0 else 0.0
            if j == most:
                k, t = nodes - 2, 1.0
            out[0, i, j], out[1, i, j] = _between(x[i], k, t), _between(y[i], k, t)
    return out


@njit(cache=True, nogil=True)
def _between(v, k, t):
    """The value a part `t` of a step after node k, by the cubic through the four around."""
    if len(v) < 4:
        return v[k] + t * (v[k + 1] - v[k])
    first = min(max(k - 1, 0), len(v) - 4)
    a = k + t - first
    b, c, d = a - 1.0, a - 2.0, a - 3.0
    ends = -b * c * d / 6.0 * v[first] + a * b * c / 6.0 * v[first + 3]
    return ends + 0.5 * a * c * d * v[first + 1] - 0.5 * a * b * d * v[first + 2]
