"""Numbers of a detector on which a plan rests: its noise, and how far back its lag reaches."""

from __future__ import annotations

import math

from pipeline.arrays import SensorMaps
from pipeline.physics.noise.transfer import lag_frames
from pipeline.plan.accuracy import SMALL, part_sigma
from pipeline.spec.scene import Scene


def typical_read_noise_e(scene: Scene, maps: SensorMaps) -> float:
    """Noise of reading a pixel, with that of its row and its column [e-]."""
    read = maps.typical("read_noise_e")
    d = scene.sensor.detector
    return read if d is None else math.hypot(read, d.row_noise_e, d.column_noise_e)


def lag_depth(scene: Scene, sigma_e: float) -> int:
    """How many frames before leave charge in a frame that is worth drawing."""
    d = scene.sensor.detector
    if d is None or d.lag is None:
        return 0
    full_well_e = float(scene.sensor.full_well_e or 0.0)
    return lag_frames(d.lag.fraction, full_well_e, SMALL * part_sigma(scene) * sigma_e)
