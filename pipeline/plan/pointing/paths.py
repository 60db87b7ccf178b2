"""Paths of stars and targets during exposures: how far they bend between nodes, and absurd ones."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Array, Geometry
from pipeline.errors import BadInput
from pipeline.plan.timing import integration_range_s
from pipeline.spec.scene import Scene

LONGEST_STREAK_PX = 1e5  # a longer one in one exposure is taken for a mistake in the scene
NEAR_PX = 1e4  # of the frame's middle


def bends_px(scene: Scene, g: Geometry, stars: Array) -> Array:
    """How far linear motion between the nodes is from the real one in each frame (F,), at worst.

    stars : (2, n, F, K) paths of some stars. Linear interpolation between nodes twice as far apart
    errs four times as much, so a quarter of what it misses at the nodes between is the error of the
    nodes themselves. Raises BadInput for streaks longer than LONGEST_STREAK_PX.
    """
    return missed_px(scene, g, stars, 2) / 4.0


def missed_px(scene: Scene, g: Geometry, stars: Array, step: int) -> Array:
    """What straight lines between every `step`-th node miss at the nodes between, (F,) at worst.

    stars : (2, n, F, K) paths of some stars. Of paths that leave the camera's view only what is
    near the frame counts. Raises BadInput for streaks longer than LONGEST_STREAK_PX.
    """
    beside = np.where(near_frame(scene, g)[..., None], 0.0, np.nan)  # others do not count
    xs = np.concatenate([g.target_x_px + beside, stars[0]])
    ys = np.concatenate([g.target_y_px + beside, stars[1]])
    if not xs.size:
        return np.zeros(len(g.frame))
    whole = np.isfinite(xs).all(axis=-1)
    near = np.hypot(xs - 0.5 * scene.sensor.shape[1], ys - 0.5 * scene.sensor.shape[0])
    near = whole[..., None] | (near < NEAR_PX + max(scene.sensor.shape))
    with np.errstate(invalid="ignore", over="ignore"):
        length = np.hypot(np.diff(xs, axis=-1), np.diff(ys, axis=-1)).sum(axis=-1)
        longest = np.where(whole, length, 0.0).max()
        bend = np.zeros(len(g.frame))
        for k in range(1, step):
            off = np.hypot(_off(xs, step, k), _off(ys, step, k))
            counts = near[..., k::step] & (near[..., :-step:step] | near[..., step::step])
            off = np.where(counts & np.isfinite(off), off, 0.0)
            bend = np.maximum(bend, off.max(axis=(0, 2)))
    if longest > LONGEST_STREAK_PX:
        raise BadInput(
            "exposure.integration_s",
            integration_range_s(scene)[1],
            f"streaks of at most {LONGEST_STREAK_PX:.0f} px; here {longest:.3g} px in one "
            "exposure (see pointing rates and orbits)",
        )
    return bend


def _off(v: Array, step: int, k: int) -> Array:
    """How far the k-th of `step` nodes is from the line between those before and after it."""
    part = k / step
    line = (1.0 - part) * v[..., :-step:step] + part * v[..., step::step]
    return np.asarray(v[..., k::step] - line)


def near_frame(scene: Scene, g: Geometry, beside_px: float = 0.0) -> NDArray[np.bool_]:
    """Targets and frames (T, F) whose path in the exposure touches the frame or what is beside it.

    Beside it: within the frame's longer side, or `beside_px` if that is more. Others must not slow
    down the rest, nor be smooth. Of one that is behind the camera for a part of the exposure the
    rest is looked at.
    """
    rows, columns = scene.sensor.shape
    side = max(rows, columns, beside_px)
    x, y = g.target_x_px, g.target_y_px
    with np.errstate(invalid="ignore"):
        near = (np.fmax.reduce(x, axis=-1) > -side) & (np.fmin.reduce(x, axis=-1) < columns + side)
        near &= (np.fmax.reduce(y, axis=-1) > -side) & (np.fmin.reduce(y, axis=-1) < rows + side)
    return np.asarray(near)


def check_paths(scene: Scene, g: Geometry, stars: Array) -> None:
    """Refuse absurd streaks over the frame: a bad orbit, a near collision, a wild pointing.

    stars : (2, n, F, K) paths of some stars
    """
    rows, columns = scene.sensor.shape
    with np.errstate(invalid="ignore", over="ignore"):
        x, y = g.target_x_px, g.target_y_px
        length = np.nansum(np.hypot(np.diff(x, axis=-1), np.diff(y, axis=-1)), axis=-1)
        touches = (np.fmax.reduce(x, axis=-1) > 0) & (np.fmin.reduce(x, axis=-1) < columns)
        touches &= (np.fmax.reduce(y, axis=-1) > 0) & (np.fmin.reduce(y, axis=-1) < rows)
    absurd = touches & (length > LONGEST_STREAK_PX)
    if absurd.any():
        target, frame = np.argwhere(absurd)[0]
        raise BadInput(
            f"targets.{target}.orbit",
            f"{length[target, frame]:.3g} px over the frame in exposure {g.frame[frame]}",
            f"streaks of at most {LONGEST_STREAK_PX:.0f} px: a shorter exposure, or another orbit",
        )
    if scene.stars is None:
        return
    length = np.hypot(*np.diff(stars, axis=-1)).sum(axis=-1).max(axis=0)
    absurd = ~(length <= LONGEST_STREAK_PX)
    if absurd.any():
        frame = int(np.argmax(absurd))
        far_px = length[frame]
        far = f"streak {far_px:.3g} px" if far_px < np.inf else "come behind the camera"
        raise BadInput(
            "pointing",
            f"stars that {far} in exposure {g.frame[frame]}",
            f"streaks of at most {LONGEST_STREAK_PX:.0f} px: a shorter exposure, or a slower "
            "pointing",
        )
