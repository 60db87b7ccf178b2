"""Jitter and modes of a pointing as the physics takes them, and their runs frame by frame."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
import scipy
from numpy.typing import NDArray

from pipeline.arrays import Array
from pipeline.errors import BadInput
from pipeline.physics.constants import ARCSEC_RAD
from pipeline.physics.motion import flexible, jitter
from pipeline.physics.motion.jitter import Spectrum, SpectrumBins, Waves
from pipeline.physics.noise.streams import standard_normals, stream_key
from pipeline.plan.timing import frame_count, frame_times
from pipeline.spec.pointing.attitude import (
    Jitter,
    MarkovMode,
    Mode,
    OscillatorMode,
    PowerLawJitter,
    RandomWalkMode,
    RateMarkovMode,
    ResonanceJitter,
    SystemMode,
    WhiteJitter,
)
from pipeline.spec.scene import Scene

AXES = ("x", "y", "roll")


@lru_cache(maxsize=64)
def jitter_bins(part: Jitter, split_hz: float) -> SpectrumBins:
    """A spectrum in bins that end at the frequency above which waves are blur."""
    return jitter.bins_of(_spectrum(part), split_hz)


def _spectrum(part: Jitter) -> Spectrum:
    if isinstance(part, WhiteJitter):
        return jitter.white(part.rms_arcsec * ARCSEC_RAD, part.low_hz, part.high_hz)
    if isinstance(part, PowerLawJitter):
        rms = part.rms_arcsec * ARCSEC_RAD
        return jitter.power_law(rms, part.exponent, part.low_hz, part.high_hz)
    if isinstance(part, ResonanceJitter):
        return jitter.resonance(part.rms_arcsec * ARCSEC_RAD, part.frequency_hz, part.damping)
    if part.frequency_hz is None or part.arcsec2_per_hz is None:
        raise BadInput("pointing.attitude.jitter", part.path, "a spectrum that was read")
    return jitter.table(np.array(part.frequency_hz), np.array(part.arcsec2_per_hz) * ARCSEC_RAD**2)


@lru_cache(maxsize=64)
def mode_of(mode: Mode, index: int) -> flexible.Mode:
    """A mode in rad and s. BadInput where it grows."""

    def rad(value: float | None) -> float | None:
        return None if value is None else value * ARCSEC_RAD

    if isinstance(mode, SystemMode):
        a, b, c = (np.array(m, float) for m in (mode.a, mode.b, mode.c))
        growing = float(np.linalg.eigvals(a).real.max())
        if growing > 1e-9 * max(1e-30, float(np.abs(a).max())):
            raise BadInput(
                f"pointing.attitude.modes.{index}.a",
                f"a mode that grows by {growing:.3g} per s",
                "eigenvalues without positive real part",
            )
        return flexible.system(a, b, c * ARCSEC_RAD)
    axis = AXES.index(mode.axis)
    if isinstance(mode, OscillatorMode):
        strength = rad(mode.rms_arcsec), rad(mode.noise_arcsec_s2_rthz)
        return flexible.oscillator(axis, mode.frequency_hz, mode.damping, *strength)
    if isinstance(mode, MarkovMode):
        strength = rad(mode.rms_arcsec), rad(mode.noise_arcsec_s_rthz)
        return flexible.markov(axis, mode.time_constant_s, *strength)
    if isinstance(mode, RandomWalkMode):
        return flexible.random_walk(axis, mode.arcsec_rts * ARCSEC_RAD)
    assert isinstance(mode, RateMarkovMode)
    return flexible.rate_markov(axis, mode.time_constant_s, mode.rms_arcsec_s * ARCSEC_RAD)


@lru_cache(maxsize=64)
def slow_output(mode: Mode, index: int, slowest_s: float) -> Array:
    """The output (3, n) of what of a mode is path."""
    return flexible.slow_output(mode_of(mode, index), slowest_s)


@lru_cache(maxsize=256)
def mode_split(
    mode: Mode, index: int, slowest_s: float, step_s: float, exposure_s: float, span_s: float
) -> flexible.ModeSplit:
    """What of a mode is path, and what blur."""
    return flexible.split(mode_of(mode, index), slowest_s, step_s, exposure_s, span_s)


@lru_cache(maxsize=64)
def jitter_waves(part: Jitter, index: int, seed: int, split_hz: float) -> Waves:
    """The waves of a spectrum's slow part in one run, drawn from the scene's seed."""
    bins = jitter_bins(part, split_hz)
    key = stream_key(seed, f"pointing_jitter/{index}")
    draws = standard_normals(len(bins.variance), 5, 0, 0, 0, *key)
    return jitter.waves(bins, split_hz, draws[:, :4], scipy.special.ndtr(draws[:, 4]))


def mode_states(
    scene: Scene, mode: Mode, index: int, frames: NDArray[np.int64], time_s: Array, nodes: int
) -> Array:
    """States (F, nodes, n) of a mode in some frames."""
    every = np.arange(frame_count(scene), dtype=np.int64)
    starts, times = frame_times(scene, every)
    ends = _ends(mode, index, scene.seed, starts.tobytes(), times.tobytes())[frames]
    key, levels = stream_key(scene.seed, f"pointing_mode/{index}"), int(math.log2(nodes - 1))
    one, n = mode_of(mode, index), ends.shape[-1]
    out = np.empty((len(frames), nodes, n))
    for time in np.unique(time_s):
        mine = np.flatnonzero(time_s == time)
        draw = np.stack([standard_normals(nodes - 2, n, 0, 0, int(frames[k]), *key) for k in mine])
        out[mine] = flexible.between(one, ends[mine, 0], ends[mine, 1], float(time), levels, draw)
    return out


@lru_cache(maxsize=64)
def _ends(mode: Mode, index: int, seed: int, starts: bytes, times: bytes) -> Array:
    """States (F, 2, n) at the start and end of all frames of a scene, one after the other."""
    start, time = np.frombuffer(starts), np.frombuffer(times)
    before = np.concatenate([[0.0], start[:-1] + time[:-1]])
    gaps = np.stack([np.maximum(np.round(start - before, 9), 0.0), time], axis=-1).ravel()
    one = mode_of(mode, index)
    key = stream_key(seed, f"pointing_mode_frames/{index}")
    draws = standard_normals(len(gaps) + 1, len(one.a), 0, 0, 0, *key)
    return flexible.run(one, gaps, draws).reshape(len(start), 2, -1)
