"""Signal-to-noise of a sensor over streak length and light: the renderer's own, as a table."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.execute.truth import matched_snr
from pipeline.physics.motion.streak import straight
from pipeline.plan.resolved import ResolvedScene

Array = NDArray[np.float64]

LENGTHS, LIGHTS = 96, 160
LEAST_E, MOST_E = 1e-2, 1e10
SLANT_RAD = 0.3927  # 22.5 degrees: streaks along rows and along diagonals err alike


@dataclass(frozen=True)
class SignalTable:
    """Logarithm of a frame's matched-filter SNR (LENGTHS, LIGHTS), at even steps of `_of_length`
    and of the logarithm of the light.

    longest_px : of the table, and of a streak in the frame; of a longer one its part in the frame
    counts.
    """

    log_snr: Array
    longest_px: float

    def snr(self, light_e: Array, length_px: Array) -> Array:
        """SNR (n,) of light (n,) [e-] spread over streaks (n,) [px]; linear between the table's
        places: within 1 % of `matched_snr` (tests). Fainter than the table it goes as the light."""
        light = np.clip(light_e, LEAST_E, MOST_E)
        fainter = np.minimum(1.0, np.maximum(light_e, 0.0) / LEAST_E)
        inside = np.minimum(1.0, self.longest_px / np.maximum(length_px, 1e-9))
        x = _of_length(np.minimum(length_px, self.longest_px)) / _of_length(self.longest_px)
        y = np.log(light * inside / LEAST_E) / np.log(MOST_E / LEAST_E)
        i, u = _place(x, LENGTHS)
        j, v = _place(y, LIGHTS)
        t = self.log_snr
        low = (1.0 - v) * t[i, j] + v * t[i, j + 1]
        high = (1.0 - v) * t[i + 1, j] + v * t[i + 1, j + 1]
        return np.asarray(fainter * np.exp((1.0 - u) * low + u * high))


def signal_table(resolved: ResolvedScene) -> SignalTable:
    """The table of a resolved scene's camera, for its first frame."""
    camera = resolved.camera
    longest = float(min(camera.rows, camera.columns))
    light = np.geomspace(LEAST_E, MOST_E, LIGHTS)
    middle = np.full(LIGHTS, 0.5 * (camera.columns - 1)), np.full(LIGHTS, 0.5 * (camera.rows - 1))
    shares = np.linspace(0.0, 1.0, LENGTHS)
    lengths = _length_at(shares * _of_length(longest))
    rows = [
        matched_snr(resolved, straight(length, SLANT_RAD), light, *middle) for length in lengths
    ]
    return SignalTable(np.log(np.array(rows)), longest)


def _of_length(length_px: Array | float) -> Array:
    """A scale of lengths, even near 0 and logarithmic beyond a pixel."""
    return np.arcsinh(np.asarray(length_px, float))


def _length_at(value: Array) -> Array:
    return np.sinh(value)


def _place(share: Array, count: int) -> tuple[NDArray[np.int64], Array]:
    """Index of the table's place below, and the share of the step beyond it."""
    at = np.clip(share, 0.0, 1.0) * (count - 1)
    index = np.minimum(at.astype(np.int64), count - 2)
    return index, at - index
