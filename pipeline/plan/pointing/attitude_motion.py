"""Random motion of the pointing: what becomes path, what blur, and its runs frame by frame."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from pipeline.arrays import Array
from pipeline.errors import BadInput
from pipeline.physics.constants import ARCSEC_RAD
from pipeline.physics.noise.streams import standard_normals, stream_key
from pipeline.plan.accuracy import part_sigma
from pipeline.plan.decision import Decision
from pipeline.plan.timing import frame_count, frame_times, integration_range_s
from pipeline.spec.pointing.attitude import (
    AttitudeModel,
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

if TYPE_CHECKING:
    from pipeline.physics.motion.flexible import Mode as ModeOf
    from pipeline.physics.motion.flexible import ModeSplit
    from pipeline.physics.motion.jitter import Spectrum, SpectrumBins, Waves

FEWEST, MOST = 9, 1025  # nodes of a random path
PER_PERIOD = 8  # nodes in a period of the fastest wave that is path
LEFT_PX = 5e-3  # rms of an exposure's mean that blur may leave out
SHARPEST_PX = 0.5  # rms of the images for which a wrong variance of blur is bounded
AXES = ("x", "y", "roll")


@dataclass(frozen=True)
class MotionPlan:
    """How a scene's random motion is drawn.

    nodes : of its path in each exposure, of which the longest lasts `longest_s`
    blur_px : rms of each axis drawn as blur; path_px : rms drawn as path
    left_px : rms of an exposure's mean that the blur leaves out; scatter : relative rms change of
    the blur's variance from exposure to exposure
    uneven_px : rms that x or y has more than the blur, which is round
    roll_px : rms motion in the frame's corners of the roll that is left out
    """

    nodes: int
    longest_s: float
    blur_px: float
    path_px: float
    left_px: float
    scatter: float
    uneven_px: float
    roll_px: float

    @property
    def error_sigma(self) -> float:
        """Four times what the blur leaves out, in a pixel whose light equals the noise floor."""
        wrong_px2 = self.uneven_px**2 + self.roll_px**2 + 4.0 * self.scatter * self.blur_px**2
        return 4.0 * self.left_px + wrong_px2 / (2.0 * SHARPEST_PX**2)

    @property
    def split_hz(self) -> float:
        return split_hz(self.nodes, self.longest_s)


def split_hz(nodes: int, longest_s: float) -> float:
    """Frequency above which waves are blur."""
    return (nodes - 1) / (PER_PERIOD * longest_s)


def motion_plan(scene: Scene) -> MotionPlan | None:
    """The plan of a scene's random motion; None where the scene has none."""
    model = scene.pointing.attitude
    if model is None or not model.random:
        return None
    s = scene.sensor
    ifov = s.pixel_pitch_um * 1e-6 / s.focal_length_m
    times = integration_range_s(scene)
    return _plan(model, *times, ifov, 0.5 * math.hypot(*s.shape), part_sigma(scene))


def fast_blur_px(scene: Scene) -> float:
    """Rms per axis [px] of the motion that is drawn as blur; 0 where there is none."""
    plan = motion_plan(scene)
    return 0.0 if plan is None else plan.blur_px


@lru_cache(maxsize=16)
def _plan(
    model: AttitudeModel,
    shortest_s: float,
    longest_s: float,
    ifov_rad: float,
    corner_px: float,
    part: float,
) -> MotionPlan:
    """Fewest nodes whose blur leaves out little: `part` is the error allowed, over the noise."""
    nodes = FEWEST
    while True:
        made = _plan_with(model, nodes, shortest_s, longest_s, ifov_rad, corner_px)
        if (made.left_px <= LEFT_PX and made.error_sigma <= part) or nodes >= MOST:
            return made
        nodes = 2 * nodes - 1


def _plan_with(
    model: AttitudeModel,
    nodes: int,
    shortest_s: float,
    longest_s: float,
    ifov_rad: float,
    corner_px: float,
) -> MotionPlan:
    """What a number of nodes leads to."""
    step = longest_s / (nodes - 1)
    blur, left, path = np.zeros(3), np.zeros(3), np.zeros(3)
    scatter = 0.0
    for part in model.jitter:
        from pipeline.physics.motion.jitter import fast_part, slow_loss

        bins = _bins(part, split_hz(nodes, longest_s))
        fast = fast_part(bins, split_hz(nodes, longest_s), shortest_s)
        blur[:2] += fast.variance + slow_loss(bins, split_hz(nodes, longest_s), step)
        left[:2] += fast.mean_variance
        path[:2] += float(bins.variance.sum()) - fast.variance
        scatter = math.hypot(scatter, fast.scatter * fast.variance)
    for i, mode in enumerate(model.modes):
        one, parts = _mode(mode, i), _split(mode, i, step, shortest_s)
        blur += parts.variance
        left += parts.mean_variance
        path += np.einsum("ij,jk,ik->i", parts.c_slow, one.start, parts.c_slow)
    round_ = 0.5 * (blur[0] + blur[1])
    return MotionPlan(
        nodes,
        longest_s,
        math.sqrt(round_) / ifov_rad,
        math.sqrt(max(path[0], path[1])) / ifov_rad,
        math.sqrt(max(left[0], left[1])) / ifov_rad,
        scatter / round_ if round_ else 0.0,
        math.sqrt(abs(blur[0] - blur[1]) / 2.0) / ifov_rad,
        math.sqrt(blur[2]) * corner_px,
    )


@lru_cache(maxsize=64)
def _bins(part: Jitter, split: float) -> SpectrumBins:
    from pipeline.physics.motion.jitter import bins_of

    return bins_of(_spectrum(part), split)


def _spectrum(part: Jitter) -> Spectrum:
    from pipeline.physics.motion import jitter

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
def _mode(mode: Mode, index: int) -> ModeOf:
    from pipeline.physics.motion import flexible

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


@lru_cache(maxsize=256)
def _split(mode: Mode, index: int, step_s: float, exposure_s: float) -> ModeSplit:
    from pipeline.physics.motion.flexible import split

    return split(_mode(mode, index), step_s, exposure_s)


def random_motion_rad(scene: Scene, frames: NDArray[np.int64], nodes: int) -> Array:
    """Displacements (F, nodes, 3) in x, y and roll [rad] of some frames: the slow part.

    A frame's values depend on the scene and the frame alone. Between the nodes of the random path
    they run straight; `nodes` must be at least as many.
    """
    plan, model = motion_plan(scene), scene.pointing.attitude
    if plan is None or model is None:
        return np.zeros((len(frames), nodes, 3))
    start, time = frame_times(scene, frames)
    at = np.linspace(0.0, 1.0, plan.nodes)
    out = np.zeros((len(frames), plan.nodes, 3))
    t = start[:, None] + at * time[:, None]
    for i, part in enumerate(model.jitter):
        run = _waves(part, i, scene.seed, plan.split_hz)
        out[..., :2] += run.at(t.ravel()).reshape(*t.shape, 2)
    step = plan.longest_s / (plan.nodes - 1)
    shortest = integration_range_s(scene)[0]
    for i, mode in enumerate(model.modes):
        c = _split(mode, i, step, shortest).c_slow
        if c.any():
            states = _mode_run(scene, mode, i, frames, time, plan.nodes)
            for j in range(states.shape[-1]):
                out += states[..., j, None] * c[:, j]
    return _straight_between(out, nodes)


@lru_cache(maxsize=64)
def _waves(part: Jitter, index: int, seed: int, split: float) -> Waves:
    from pipeline.physics.motion.jitter import waves

    bins = _bins(part, split)
    key = stream_key(seed, f"pointing_jitter/{index}")
    draws = standard_normals(len(bins.variance), 5, 0, 0, 0, *key)
    return waves(bins, split, draws[:, :4], ndtr(draws[:, 4]))


def _mode_run(
    scene: Scene, mode: Mode, index: int, frames: NDArray[np.int64], time_s: Array, nodes: int
) -> Array:
    """States (F, nodes, n) of a mode in some frames."""
    from pipeline.physics.motion.flexible import between

    every = np.arange(frame_count(scene), dtype=np.int64)
    starts, times = frame_times(scene, every)
    ends = _ends(mode, index, scene.seed, starts.tobytes(), times.tobytes())[frames]
    key, levels = stream_key(scene.seed, f"pointing_mode/{index}"), int(math.log2(nodes - 1))
    one, n = _mode(mode, index), ends.shape[-1]
    out = np.empty((len(frames), nodes, n))
    for time in np.unique(time_s):
        mine = np.flatnonzero(time_s == time)
        draw = np.stack([standard_normals(nodes - 2, n, 0, 0, int(frames[k]), *key) for k in mine])
        out[mine] = between(one, ends[mine, 0], ends[mine, 1], float(time), levels, draw)
    return out


@lru_cache(maxsize=64)
def _ends(mode: Mode, index: int, seed: int, starts: bytes, times: bytes) -> Array:
    """States (F, 2, n) at the start and end of all frames of a scene, one after the other."""
    from pipeline.physics.motion.flexible import run

    start, time = np.frombuffer(starts), np.frombuffer(times)
    before = np.concatenate([[0.0], start[:-1] + time[:-1]])
    gaps = np.stack([np.maximum(np.round(start - before, 9), 0.0), time], axis=-1).ravel()
    one = _mode(mode, index)
    key = stream_key(seed, f"pointing_mode_frames/{index}")
    draws = standard_normals(len(gaps) + 1, len(one.a), 0, 0, 0, *key)
    return run(one, gaps, draws).reshape(len(start), 2, -1)


def _straight_between(values: Array, nodes: int) -> Array:
    """Values (F, n, 3) at more nodes, on straight lines between them."""
    stride = (nodes - 1) // (values.shape[1] - 1)
    if stride == 1:
        return values
    k, t = np.divmod(np.arange(nodes), stride)
    upper = np.minimum(k + 1, values.shape[1] - 1)
    share = (t / stride)[:, None]
    return (1.0 - share) * values[:, k] + share * values[:, upper]


def decide_motion(scene: Scene, sigma_floor_e: float) -> tuple[Decision, ...]:
    """What the plan says of random motion; nothing for a scene that has none."""
    plan, model = motion_plan(scene), scene.pointing.attitude
    if plan is None or model is None:
        return ()
    parts = f"{len(model.jitter)} spectra, {len(model.modes)} modes"
    more = ""
    if plan.uneven_px > 1e-4:
        more += f"; one axis has {plan.uneven_px:.2g} px rms more than the round blur"
    if plan.roll_px > 1e-4:
        more += f"; fast roll of {plan.roll_px:.2g} px rms in the corners is left out"
    return (
        Decision(
            "pointing_motion",
            True,
            f"{parts}: below {plan.split_hz:.3g} Hz (in the longest exposure) a path of "
            f"{plan.nodes} nodes, {plan.path_px:.3g} px rms; the rest, and what straight lines "
            f"between nodes lose, is a blur of {plan.blur_px:.3g} px rms per axis. Left out: how "
            f"that blur moves an exposure's mean ({plan.left_px:.2g} px rms) and changes its own "
            f"variance from exposure to exposure ({100 * plan.scatter:.2g}% rms){more}. The bound "
            "is four times these, in a pixel whose light equals the noise floor, for images of "
            f"{SHARPEST_PX:g} px rms or more",
            plan.error_sigma * sigma_floor_e,
            plan.error_sigma,
        ),
    )
