"""Frames between which the camera and its observer turn by little: no field lies between them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.physics.constants import DEG_RAD
from pipeline.physics.vectors import separation, unit
from pipeline.plan.pointing.geometry import aimed
from pipeline.plan.timing import dwell_of, dwell_plans, frame_count, frame_times
from pipeline.spec.scene import Scene

STEP_RAD = 10.0 * DEG_RAD


def turning_frames(scene: Scene, dut1_s: float) -> NDArray[np.int64]:
    """As few frames as leave no turn of STEP_RAD between neighbours.

    The boresight at mid-exposure, and the observer around the Earth, turn by less from each to the
    next, or no frame lies between them: no visit is passed over, however short.
    """
    frames = np.arange(frame_count(scene))
    start, time = frame_times(scene, frames)
    at, attitude = aimed(scene, start + 0.5 * time, dut1_s, dwell_of(dwell_plans(scene), frames))
    turn = np.maximum(*(separation(v[:-1], v[1:]) for v in (attitude[:, 2], unit(at.observer_m))))
    jumps = np.flatnonzero(turn > STEP_RAD)
    steps = np.flatnonzero(np.diff(np.floor(np.cumsum(turn) / STEP_RAD), prepend=0.0))
    return np.unique(np.concatenate([frames[[0, -1]], jumps, jumps + 1, steps + 1]))
