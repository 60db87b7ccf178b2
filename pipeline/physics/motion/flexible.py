"""Flexible modes of a body: linear systems, their exact runs, and what an exposure sees of them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pipeline.physics.motion.linear_system import (
    LinearStep,
    bridge,
    discretise,
    factor,
    stationary_covariance,
)

Array = NDArray[np.float64]

FAST_TURN_RAD = np.pi / 4  # of an oscillation between two nodes, from which it is blur
FAST_STEP = 2.0  # time constants between two nodes, from which a process is blur
SETTLED = 1e-9  # of a covariance, up to which it is rounding that changes it
CLEAN = 1e8  # condition of the eigenvectors up to which a system is split into slow and fast


@dataclass(frozen=True, eq=False)
class Mode:
    """dx = a x dt + b dw; c x moves (x, y, roll) [rad].

    a (n, n), b (n, m), c (3, n); start (n, n) : covariance at the epoch, the stationary one, or
    zero for states that have none
    """

    a: Array
    b: Array
    c: Array
    start: Array


def oscillator(
    axis: int, frequency_hz: float, damping: float, rms_rad: float | None, noise: float | None
) -> Mode:
    """x'' + 2 z w x' + w^2 x = noise: states x and x' / w, so that both have one size.

    noise : two-sided density of the acceleration [rad / s^2 / sqrt(Hz)]; the variance of x is
    noise^2 / (4 z w^3).
    """
    w = 2.0 * np.pi * frequency_hz
    if rms_rad is None:
        assert noise is not None
        rms_rad = noise / np.sqrt(4.0 * damping * w**3)
    a = np.array([[0.0, w], [-w, -2.0 * damping * w]])
    b = np.array([[0.0], [rms_rad * np.sqrt(4.0 * damping * w)]])
    return Mode(a, b, _output(axis, 2), rms_rad**2 * np.eye(2))


def markov(axis: int, time_constant_s: float, rms_rad: float | None, noise: float | None) -> Mode:
    """x' = -x / tau + noise; the variance is noise^2 tau / 2 (noise two-sided, rad/s/sqrt(Hz))."""
    if rms_rad is None:
        assert noise is not None
        rms_rad = noise * np.sqrt(0.5 * time_constant_s)
    b = rms_rad * np.sqrt(2.0 / time_constant_s)
    return Mode(
        np.array([[-1.0 / time_constant_s]]),
        np.array([[b]]),
        _output(axis, 1),
        np.array([[rms_rad**2]]),
    )


def random_walk(axis: int, rad_rts: float) -> Mode:
    """x' = noise, from zero at the epoch."""
    return Mode(np.zeros((1, 1)), np.array([[rad_rts]]), _output(axis, 1), np.zeros((1, 1)))


def rate_markov(axis: int, time_constant_s: float, rms_rad_s: float) -> Mode:
    """x' = r, r' = -r / tau + noise: states x and r tau; x starts at zero."""
    tau = time_constant_s
    size = rms_rad_s * tau
    a = np.array([[0.0, 1.0 / tau], [0.0, -1.0 / tau]])
    b = np.array([[0.0], [size * np.sqrt(2.0 / tau)]])
    return Mode(a, b, _output(axis, 2), np.diag([0.0, size**2]))


def system(a: Array, b: Array, c_rad: Array) -> Mode:
    """Any system; it starts in its stationary state, or at zero where it has none."""
    settled = stationary_covariance(a, b)
    return Mode(a, b, c_rad, np.zeros_like(a) if settled is None else settled)


def _output(axis: int, states: int) -> Array:
    c = np.zeros((3, states))
    c[axis, 0] = 1.0
    return c


@dataclass(frozen=True, eq=False)
class ModeSplit:
    """What of a mode becomes path, and what blur, between nodes `step_s` apart.

    c_slow : (3, n) output that is followed from node to node; variance : (3,) of the rest, blur;
    mean_variance : (3,) of the rest's mean over an exposure, which blur leaves out
    rough : (3,) of the slow part about what its states at two nodes say of those between, blur as
    well; bend : (3,) mean square of how far that is from a straight line
    """

    c_slow: Array
    variance: Array
    mean_variance: Array
    rough: Array
    bend: Array


def slow_output(mode: Mode, slowest_s: float) -> Array:
    """The output (3, n) of a mode's slow part, told by its eigenvalues.

    One is fast if it turns by more than FAST_TURN_RAD in `slowest_s`, or decays by more than
    FAST_STEP time constants.
    """
    value, vector = np.linalg.eig(mode.a)
    turns, decays = np.abs(value) * slowest_s > FAST_TURN_RAD, -value.real * slowest_s > FAST_STEP
    fast = np.where(value.imag != 0.0, turns, decays)
    if fast.all():
        return np.zeros_like(mode.c)
    if not fast.any() or np.linalg.cond(vector) > CLEAN:
        return mode.c
    keep = np.where(fast, 0.0, 1.0)
    return np.real((mode.c @ vector) * keep @ np.linalg.inv(vector))


def split(
    mode: Mode, slowest_s: float, step_s: float, exposure_s: float, span_s: float = 0.0
) -> ModeSplit:
    """Slow and fast part (`slow_output`) of a mode, between nodes `step_s` apart.

    Means over a step are two thirds of what is in its middle, as of a parabola. span_s : after the
    epoch, when states that begin at zero are as wide as they come to be
    """
    mode = _grown(mode, span_s)
    c_slow = slow_output(mode, slowest_s)
    c_fast = mode.c - c_slow
    variance = np.einsum("ij,jk,ik->i", c_fast, mode.start, c_fast)
    mean = mean_variance(mode, c_fast, exposure_s) if c_fast.any() else np.zeros(3)
    half = discretise(mode.a, mode.b, 0.5 * step_s)
    rough = (2.0 / 3.0) * np.square(c_slow @ bridge(half).spread).sum(axis=1)
    off = (2.0 / 3.0) * _off_the_line(half, mode.start, c_slow)
    return ModeSplit(c_slow, variance, mean, rough, np.maximum(off - rough, 0.0))


def _grown(mode: Mode, span_s: float) -> Mode:
    """A mode as wide as it is after a time; itself where it has settled."""
    step = discretise(mode.a, mode.b, span_s)
    spread = step.transition @ mode.start @ step.transition.T + step.noise
    size = np.sqrt(np.diag(spread))
    moved = np.abs(spread - mode.start) > SETTLED * np.outer(size, size)
    return replace(mode, start=spread) if moved.any() else mode


def _off_the_line(half: LinearStep, start: Array, c: Array) -> Array:
    """Variance (3,) of c x in the middle of two steps about the mean of both ends.

    With Phi = 1 + D of half the way that is -D^2 / 2 of the state at the start, (1 - D) / 2 of the
    first half's noise, and -1/2 of the second's.
    """
    bent, first = 0.5 * half.change @ half.change, 0.5 * (np.eye(len(start)) - half.change)
    whole = bent @ start @ bent.T + first @ half.noise @ first.T + 0.25 * half.noise
    return np.einsum("ij,jk,ik->i", c, whole, c)


def mean_variance(mode: Mode, c: Array, exposure_s: float) -> Array:
    """Variance (3,) of the mean of c x over an exposure: the integral as three states more."""
    n = len(mode.a)
    a = np.zeros((n + 3, n + 3))
    a[:n, :n], a[n:, :n] = mode.a, c / exposure_s
    b = np.vstack([mode.b, np.zeros((3, mode.b.shape[1]))])
    start = np.zeros((n + 3, n + 3))
    start[:n, :n] = mode.start
    step = discretise(a, b, exposure_s)
    phi = step.transition
    return np.maximum(np.diag(phi @ start @ phi.T + step.noise)[n:], 0.0)


def run(mode: Mode, gaps_s: Array, normals: Array) -> Array:
    """States (..., n, states) at n moments, the first `gaps_s[0]` after the epoch, then gap by gap.

    normals : (..., n + 1, states) standard normal draws, the first for the state at the epoch
    """
    x = normals[..., 0, :] @ factor(mode.start).T
    out = np.empty((*x.shape[:-1], len(gaps_s), x.shape[-1]))
    steps: dict[float, tuple[Array, Array]] = {}
    for k, gap in enumerate(gaps_s):
        if gap > 0.0:
            if gap not in steps:
                step = discretise(mode.a, mode.b, float(gap))
                steps[gap] = step.change, factor(step.noise)
            change, spread = steps[gap]
            x = x + x @ change.T + normals[..., k + 1, :] @ spread.T
        out[..., k, :] = x
    return out


def between(
    mode: Mode, first: Array, last: Array, span_s: float, levels: int, draw: Array
) -> Array:
    """States (F, 2^levels + 1, n) at equal steps between known ones (F, n) at both ends.

    Halved again and again: a finer run passes through the states of a coarser one.
    draw : (F, 2^levels - 1, n) standard normals, level by level
    """
    frames, states = first.shape
    out = np.empty((frames, 2**levels + 1, states))
    out[:, 0], out[:, -1] = first, last
    used, stride = 0, 2**levels
    for _ in range(levels):
        made = bridge(_half(mode, span_s, stride, levels))
        left, right = out[:, :-1:stride], out[:, stride::stride]
        normals = draw[:, used : used + left.shape[1]]
        middle = _times(left, made.start) + _times(right, made.stop) + _times(normals, made.spread)
        out[:, stride // 2 :: stride] = middle
        used, stride = used + left.shape[1], stride // 2
    return out


def _half(mode: Mode, span_s: float, stride: int, levels: int) -> LinearStep:
    return discretise(mode.a, mode.b, 0.5 * span_s * stride / 2**levels)


def _times(x: Array, matrix: Array) -> Array:
    """Products (F, m, n) of a matrix with states, in one order of sums for any number of them."""
    out = np.zeros_like(x)
    for j in range(x.shape[-1]):
        out += x[..., j, None] * matrix[:, j]
    return out
