"""Random motion of the pointing: what becomes path, what blur, and its runs frame by frame."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Array
from pipeline.plan.accuracy import part_sigma
from pipeline.plan.timing import end_s, frame_count, frame_times, integration_range_s
from pipeline.spec.pointing.attitude import (
    AttitudeModel,
)
from pipeline.spec.scene import Scene

FEWEST, MOST = 9, 1025  # steps of which the fastest wave that is path has PER_PERIOD, and one more
PER_PERIOD = 8
MOST_NODES = 4097  # of a random path: each of the steps is halved until it is straight
LEFT_PX = 5e-3  # rms that a path, and an exposure's mean, may be off by
GAINED = 0.9  # of the error before, above which more nodes are no gain
ROUGH_SCATTER = math.sqrt(0.8)  # relative rms of the mean square of a Brownian bridge: 1/45 to 1/36
MOST_MOMENTS = 1 << 17  # of a random path at which it is looked how far it goes
SHARPEST_PX = 0.5  # rms of the images for which a wrong variance of blur is bounded


@dataclass(frozen=True)
class MotionPlan:
    """How a scene's random motion is drawn.

    nodes : of its path in each exposure; between them it is straight
    slowest_s : what turns or decays far in this time is blur
    blur_px : rms of each axis drawn as blur; path_px : rms drawn as path
    left_px : rms of an exposure's mean that the blur leaves out, and of what the path is from
    straight; scatter : relative rms change of the blur's variance from exposure to exposure
    uneven_px : rms that x or y has more than the blur, which is round
    roll_px : rms motion in the frame's corners of the roll that is omitted
    """

    nodes: int
    slowest_s: float
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
        """Frequency above which waves are blur."""
        return split_hz(self.slowest_s)


def split_hz(slowest_s: float) -> float:
    """Frequency of waves that have PER_PERIOD such times in a period."""
    return 1.0 / (PER_PERIOD * slowest_s)


def motion_plan(scene: Scene) -> MotionPlan | None:
    """The plan of a scene's random motion; None where the scene has none."""
    model = scene.pointing.attitude
    if model is None or not model.random:
        return None
    s = scene.sensor
    times = (*integration_range_s(scene), end_s(scene))
    return _plan(model, times, s.ifov_rad, 0.5 * math.hypot(*s.shape), part_sigma(scene))


def fast_blur_px(scene: Scene) -> float:
    """Rms per axis [px] of the motion that is drawn as blur; 0 where there is none."""
    plan = motion_plan(scene)
    return 0.0 if plan is None else plan.blur_px


@lru_cache(maxsize=16)
def _plan(
    model: AttitudeModel,
    times_s: tuple[float, float, float],
    ifov_rad: float,
    corner_px: float,
    part: float,
) -> MotionPlan:
    """Fewest steps whose blur leaves out little, halved as long as that makes the path straighter:
    `part` is the error allowed, over the noise."""

    def over(made: MotionPlan) -> float:
        return max(made.left_px / LEFT_PX, made.error_sigma / part)  # of what is allowed

    steps = FEWEST - 1
    while True:
        nodes = steps + 1
        best = _plan_with(model, steps, nodes, times_s, ifov_rad, corner_px)
        while over(best) > 1.0 and nodes < MOST_NODES:
            nodes = 2 * nodes - 1
            finer = _plan_with(model, steps, nodes, times_s, ifov_rad, corner_px)
            if over(finer) > GAINED * over(best):
                break  # it is the blur that is wrong
            best = finer
        if over(best) <= 1.0 or steps >= MOST - 1:
            return best
        steps *= 2


def _plan_with(
    model: AttitudeModel,
    steps: int,
    nodes: int,
    times_s: tuple[float, float, float],
    ifov_rad: float,
    corner_px: float,
) -> MotionPlan:
    """What a number of steps and nodes leads to; times_s : the shortest exposure, the longest, and
    from the epoch to the end of all."""
    from pipeline.physics.motion.jitter import bend_variance, fast_part
    from pipeline.plan.pointing.motion_runs import jitter_bins, mode_of, mode_split

    shortest_s, longest_s, last_s = times_s
    slowest_s, step_s = longest_s / steps, longest_s / (nodes - 1)
    hz = split_hz(slowest_s)
    rough = max(1.0 - (shortest_s / longest_s) ** 3, ROUGH_SCATTER / math.sqrt(nodes - 1))
    blur, left, path = np.zeros(3), np.zeros(3), np.zeros(3)
    scatter, surplus = 0.0, 0.0
    for part in model.jitter:
        bins = jitter_bins(part, hz)
        fast = fast_part(bins, hz, shortest_s)
        blur[:2] += fast.variance
        left[:2] += fast.mean_variance + bend_variance(bins, hz, step_s)
        path[:2] += float(bins.variance.sum()) - fast.variance
        scatter = math.hypot(scatter, fast.scatter * fast.variance)
    for i, mode in enumerate(model.modes):
        one, parts = mode_of(mode, i), mode_split(mode, i, slowest_s, step_s, shortest_s, last_s)
        blur += parts.variance + parts.rough
        left += parts.mean_variance + parts.bend + parts.rough / (2.0 * (nodes - 1))
        path += np.einsum("ij,jk,ik->i", parts.c_slow, one.start, parts.c_slow)
        surplus += rough * float(parts.rough[:2].max())  # in the shortest exposure, if no scatter
    round_ = 0.5 * (blur[0] + blur[1])
    return MotionPlan(
        nodes,
        slowest_s,
        math.sqrt(round_) / ifov_rad,
        math.sqrt(max(path[0], path[1])) / ifov_rad,
        math.sqrt(max(left[0], left[1])) / ifov_rad,
        (scatter + surplus) / round_ if round_ else 0.0,
        math.sqrt(abs(blur[0] - blur[1]) / 2.0) / ifov_rad,
        math.sqrt(blur[2]) * corner_px,
    )


def random_motion_rad(scene: Scene, frames: NDArray[np.int64], nodes: int) -> Array:
    """Displacements (F, nodes, 3) in x, y and roll [rad] of some frames: the slow part.

    A frame's values depend on the scene and the frame alone. Between the nodes of the random path
    they run straight; `nodes` must be at least as many.
    """
    plan, model = motion_plan(scene), scene.pointing.attitude
    if plan is None or model is None:
        return np.zeros((len(frames), nodes, 3))
    from pipeline.plan.pointing.motion_runs import jitter_waves, mode_states, slow_output

    start, time = frame_times(scene, frames)
    at = np.linspace(0.0, 1.0, plan.nodes)
    out = np.zeros((len(frames), plan.nodes, 3))
    t = start[:, None] + at * time[:, None]
    for i, part in enumerate(model.jitter):
        run = jitter_waves(part, i, scene.seed, plan.split_hz)
        out[..., :2] += run.at(t.ravel()).reshape(*t.shape, 2)
    for i, mode in enumerate(model.modes):
        c = slow_output(mode, i, plan.slowest_s)
        if c.any():
            states = mode_states(scene, mode, i, frames, time, plan.nodes)
            for j in range(states.shape[-1]):
                out += states[..., j, None] * c[:, j]
    return _straight_between(out, nodes)


def farthest_rad(scene: Scene) -> float:
    """How far the random path takes the boresight from where it is aimed in any frame [rad].

    Of more frames than are looked at, twice as far as in those, which are spread over all.
    """
    plan, count = motion_plan(scene), frame_count(scene)
    if plan is None:
        return 0.0
    looks = max(2, MOST_MOMENTS // plan.nodes)
    frames = np.unique(np.linspace(0, count - 1, min(count, looks)).round().astype(np.int64))
    moved = random_motion_rad(scene, frames, plan.nodes)  # straight between: it is at a node
    farthest = float(np.hypot(moved[..., 0], moved[..., 1]).max())
    return farthest if len(frames) == count else 2.0 * farthest


def _straight_between(values: Array, nodes: int) -> Array:
    """Values (F, n, 3) at more nodes, on straight lines between them."""
    stride = (nodes - 1) // (values.shape[1] - 1)
    if stride == 1:
        return values
    k, t = np.divmod(np.arange(nodes), stride)
    upper = np.minimum(k + 1, values.shape[1] - 1)
    share = (t / stride)[:, None]
    return (1.0 - share) * values[:, k] + share * values[:, upper]
