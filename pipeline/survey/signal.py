"""Signal-to-noise of a sensor over streak length and light: the renderer's own, as a table."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from catalog_tools.engine.code import code_digest
from pipeline.execute.truth import matched_snr
from pipeline.kept import kept
from pipeline.physics.motion.streak import straight
from pipeline.plan.resolved import ResolvedScene

Array = NDArray[np.float64]

LENGTHS, LIGHTS = 96, 160
LEAST_E, MOST_E = 1e-2, 1e10
SLANT_RAD = 0.3927  # 22.5 degrees: streaks along rows and along diagonals err alike
ASIDE_PX, ASIDE_RAD = 5.0, np.pi * np.array([0.0, 0.25, 0.5, 0.75])  # of streaks held against it


@dataclass(frozen=True)
class SignalTable:
    """Logarithm of a frame's matched-filter SNR (LENGTHS, LIGHTS), at even steps of `_of_length`
    and of the logarithm of the light.

    longest_px : of the table, and of a streak in the frame; of a longer one its part in the frame
    counts. direction_spread : largest relative change of a faint, short streak's SNR where it
    lies along rows, columns or a diagonal, of one phase of its pixels
    """

    log_snr: Array
    longest_px: float
    direction_spread: float

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
    """The table of a resolved scene's camera, for its first frame; kept on disk for other studies
    of the same sensor."""
    camera, r = resolved.camera, resolved.responses
    longest = float(min(camera.rows, camera.columns))
    light = np.geomspace(LEAST_E, MOST_E, LIGHTS)
    middle = np.full(LIGHTS, 0.5 * (camera.columns - 1)), np.full(LIGHTS, 0.5 * (camera.rows - 1))

    def make() -> dict[str, Array]:
        lengths = _length_at(np.linspace(0.0, 1.0, LENGTHS) * _of_length(longest))
        paths = [straight(length, SLANT_RAD) for length in lengths]
        snr = [matched_snr(resolved, path, light, *middle) for path in paths]
        short = min(ASIDE_PX, longest)
        faint, *others = (
            matched_snr(resolved, straight(short, angle), light[:1], x, y)
            for angle in (SLANT_RAD, *ASIDE_RAD)
        )
        return {"log_snr": np.log(snr), "spread": np.abs(np.divide(others, faint) - 1.0).max()}

    x, y = (v[:1] for v in middle)
    of_response = tuple((blur, float(share[0])) for blur, _, share in r.parts(x, y, np.ones(1)))
    floor_e2 = float(resolved.snr_floor_e2(0, x, y)[0])
    of_noise = floor_e2, resolved.facts.flat, resolved.scene.sensor.photon_noise
    size = longest, LENGTHS, LIGHTS
    content = "signal", code_digest(), of_response, r.usual_px, of_noise, size
    found = kept(content, make)
    return SignalTable(found["log_snr"], longest, float(found["spread"]))


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
