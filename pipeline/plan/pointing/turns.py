"""Frames between which the camera and its observer turn by little: no field lies between them."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Array
from pipeline.physics.constants import ARCSEC_RAD, DEG_RAD
from pipeline.physics.vectors import unit
from pipeline.plan.pointing.geometry import aimed
from pipeline.plan.timing import dwell_of, dwell_plans, frame_times
from pipeline.spec.pointing.pointing import RatePointing
from pipeline.spec.scene import Scene

FIELD_RAD, PLACE_RAD = 1.0 * DEG_RAD, 10.0 * DEG_RAD  # turns of the boresight, of the observer
STEP_S = 30.0  # most between two frames that are aimed, of pointings that turn evenly


def turning_frames(scene: Scene, dut1_s: float) -> NDArray[np.int64]:
    """Frames between which nothing turns far: no visit to another field is passed over.

    Wherever the boresight at mid-exposure is FIELD_RAD from where it was in the last frame so
    found, or the observer around the Earth PLACE_RAD, that frame and the one before it.
    """
    frames = _aimed_frames(scene)
    start, time = frame_times(scene, frames)
    at, attitude = aimed(scene, start + 0.5 * time, dut1_s, dwell_of(dwell_plans(scene), frames))
    kept = _kept(attitude[:, 2], FIELD_RAD) | _kept(unit(at.observer_m), PLACE_RAD)
    kept[[0, -1]] = True
    return frames[kept]


def _aimed_frames(scene: Scene) -> NDArray[np.int64]:
    """Every frame of tables; of other dwells their ends, and some at even steps of time."""
    out = []
    for plan in dwell_plans(scene):
        k, step_s = np.arange(plan.frames), STEP_S
        if isinstance(plan.pointing, RatePointing):
            p = plan.pointing
            more = math.hypot(p.acceleration_ra_arcsec_s2, p.acceleration_dec_arcsec_s2)
            rate = math.hypot(p.rate_ra_arcsec_s, p.rate_dec_arcsec_s)
            rate += more * (plan.end_s - plan.start_s)
            step_s = min(STEP_S, FIELD_RAD / (max(rate, 1e-9) * ARCSEC_RAD))
        if plan.pointing.mode != "table":
            steps = np.floor(plan.starts_s(k) / step_s)
            k = k[(np.diff(steps, prepend=-np.inf) > 0.0) | (k == plan.frames - 1)]
        out.append(plan.first + k)
    return np.concatenate(out)


def _kept(u: Array, turn_rad: float) -> NDArray[np.bool_]:
    """Which of some unit vectors (n, 3) differ from the last one kept, with the one before each."""
    kept, least = np.zeros(len(u), bool), math.cos(turn_rad)
    x0, y0, z0 = u[0].tolist()
    for k, (x, y, z) in enumerate(u.tolist()):
        if x * x0 + y * y0 + z * z0 < least:
            kept[k - 1 : k + 1] = True
            x0, y0, z0 = x, y, z
    return kept
