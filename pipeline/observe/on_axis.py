"""Light and signal-to-noise of targets as they would be in the middle of the frame."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Array, Geometry
from pipeline.execute.sources import FrameTarget, seen_as
from pipeline.execute.truth import snr_of
from pipeline.physics.motion.streak import Path
from pipeline.physics.vectors import rotate_minimal, unit
from pipeline.plan.resolved import ResolvedScene


def on_axis_light_e(plan: ResolvedScene, g: Geometry, visible: Array) -> Array:
    """Light (F, T) [e-] of targets in the exposures of `g`, seen in the middle of the frame.

    visible : (F, T) fraction of the exposure in which the Earth does not hide them
    """
    light = np.swapaxes(g.target_light, 0, 1)
    mean = 0.5 * (light[..., :-1] + light[..., 1:]).mean(axis=-1) * visible
    if plan.extinction is not None:
        mean = mean * plan.extinction.transmission(g.target_clear[:, :, g.middle].T)
    exposed_s = np.array([plan.integration_s(int(f)) for f in g.frame])
    return mean * (plan.sun_rate_e_s_m2 * plan.facts.area_m2 * exposed_s)[:, None]


def on_axis_streaks_px(
    plan: ResolvedScene, g: Geometry, direction: Array, velocity: Array
) -> Array:
    """Streaks (F, T, 2) [px] of targets past a camera that is turned onto them as it moves.

    The pointing as a whole is turned on the shortest way from its boresight at mid-exposure to the
    target. direction, velocity : (F, T, 3) of targets, and its change [1/s]
    """
    axes, ends = g.attitude[:, g.middle], g.attitude[:, [0, -1], 2]
    boresight = axes[:, None, 2]
    opposite = 1.0 + np.sum(boresight * direction, axis=-1) < 1e-9
    towards = unit(np.where(opposite[..., None], direction + 1e-4 * axes[:, None, 0], direction))
    turn = rotate_minimal(np.broadcast_to(boresight, towards.shape), towards)
    exposed_s = (g.offset_s[:, -1] - g.offset_s[:, 0])[:, None, None]
    own = np.einsum("ftij,fkj,fti->ftk", turn, axes[:, :2], velocity) * exposed_s
    camera = np.einsum("fkj,fj->fk", axes[:, :2], ends[:, 1] - ends[:, 0])
    charge = exposed_s * [0.0, plan.camera.charge_px_s]
    return np.asarray((own - camera[:, None]) / plan.facts.ifov_rad - charge)


def on_axis_snr(
    plan: ResolvedScene, g: Geometry, which: NDArray[np.int64], light_e: Array, streak_px: Array
) -> Array:
    """Signal-to-noise (n,) of targets `which` whose light (n,) is swept along straight streaks
    (n, 2) in the middle of the one frame of `g`."""
    snr, centre_px = np.zeros(len(which)), plan.camera.centre_px
    for k in np.flatnonzero(light_e > 0.0):
        ends = np.multiply.outer(streak_px[k], [-0.5, 0.5])
        path = Path(ends[0], ends[1], np.ones(1))
        target = FrameTarget(int(which[k]), *centre_px, path, float(light_e[k]))
        snr[k] = snr_of(plan, seen_as(plan, g, target), int(g.frame[0]))
    return snr
