"""Flexible modes: runs against their covariances, and what blur leaves out against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.physics.motion.flexible import (
    Mode,
    between,
    markov,
    mean_variance,
    oscillator,
    random_walk,
    rate_markov,
    run,
    split,
    system,
)

MODES = {
    "fast": markov(0, 1e-6, 1.0, None),
    "slow": markov(1, 1e4, 1.0, None),
    "swing": oscillator(0, 1.3, 0.02, 1.0, None),
    "stiff": oscillator(2, 4e3, 0.5, 1.0, None),
}


@pytest.mark.parametrize("name", MODES)
def test_runs_have_the_covariance_of_the_process(name: str) -> None:
    """2000 runs of three exposures of 0.4 s with gaps: variances and lagged covariances."""
    mode, count, levels = MODES[name], 2000, 3
    n, rng = len(mode.a), np.random.default_rng(7)
    gaps = np.array([0.1, 0.4, 0.6, 0.4])
    ends = run(mode, gaps, rng.standard_normal((count, 5, n)))
    first, last = ends[:, 2], ends[:, 3]
    inside = between(mode, first, last, 0.4, levels, rng.standard_normal((count, 7, n)))
    x = inside @ mode.c.T
    x = x[..., np.argmax(np.abs(mode.c).sum(axis=1))]
    sizes = (x**2).mean(axis=0)
    assert np.allclose(sizes, 1.0, atol=5 * np.sqrt(2 / count))
    from scipy.linalg import expm

    for lag in (1, 4, 8):
        expected = expm(mode.a * (0.05 * lag))[0, 0] if name != "stiff" else 0.0
        found = (x[:, 0] * x[:, lag]).mean()
        assert found == pytest.approx(expected, abs=5 / np.sqrt(count))
    before = ends[:, 1] @ mode.c.T  # the end of the exposure before, 0.6 s earlier
    before = before[:, np.argmax(np.abs(mode.c).sum(axis=1))]
    expected = expm(mode.a * 0.6)[0, 0] if name != "stiff" else 0.0
    assert (before * x[:, 0]).mean() == pytest.approx(expected, abs=5 / np.sqrt(count))


def test_a_finer_run_passes_through_a_coarser_one() -> None:
    mode, rng = MODES["swing"], np.random.default_rng(1)
    first, last, draw = rng.standard_normal((3, 31, 2))
    coarse = between(mode, first[:2], last[:2], 2.0, 2, draw[None, :3].repeat(2, 0))
    fine = between(mode, first[:2], last[:2], 2.0, 5, draw[None].repeat(2, 0))
    assert np.array_equal(fine[:, ::8], coarse)


def test_against_the_mean_of_a_markov_process() -> None:
    """Var of the mean over T: 2 s^2 tau / T (1 - tau / T (1 - exp(-T / tau)))."""
    for tau, t in ((1e-6, 1.0), (0.3, 1.0), (1e4, 1.0), (10.0, 500.0)):
        mode, r = markov(1, tau, 2.0, None), tau / t
        exact = 4.0 * 2.0 * r * (1.0 + r * np.expm1(-1.0 / r)) if r < 100 else 4.0
        assert mean_variance(mode, mode.c, t)[1] == pytest.approx(exact, rel=1e-4)


def test_strengths_by_noise_density() -> None:
    w, z = 2.0 * np.pi * 3.0, 0.1
    by_noise = oscillator(0, 3.0, z, None, 5.0)
    assert by_noise.start[0, 0] == pytest.approx(25.0 / (4.0 * z * w**3))
    from scipy.linalg import solve_continuous_lyapunov

    a = np.array([[0.0, 1.0], [-(w**2), -2.0 * z * w]])
    b = np.array([[0.0], [5.0]])
    assert by_noise.start[0, 0] == pytest.approx(solve_continuous_lyapunov(a, -b @ b.T)[0, 0])
    assert markov(0, 4.0, None, 3.0).start[0, 0] == pytest.approx(9.0 * 4.0 / 2.0)


def test_a_random_walk_and_an_integrated_rate_grow() -> None:
    rng, gaps = np.random.default_rng(2), np.full(9, 2.0)
    walk = random_walk(0, 3.0)
    x = run(walk, gaps, rng.standard_normal((3000, 10, 1)))[:, -1, 0]
    assert x.std() == pytest.approx(3.0 * np.sqrt(18.0), rel=0.06)
    bias = rate_markov(0, 1e4, 0.5)  # hardly changes in 18 s: angle = rate t
    y = run(bias, gaps, rng.standard_normal((3000, 10, 2)))[:, -1, 0]
    assert y.std() == pytest.approx(0.5 * 18.0, rel=0.06)


def test_split_of_a_system_into_path_and_blur() -> None:
    """A mixed system's fast part becomes blur; path and blur together hold its variance."""
    rng = np.random.default_rng(4)
    v = np.eye(3) + 0.3 * rng.standard_normal((3, 3))
    a = v @ np.diag([-1e6, -1e5, -0.01]) @ np.linalg.inv(v)
    c = rng.standard_normal((3, 3))
    mode = system(a, rng.standard_normal((3, 3)), c)
    parts = split(mode, 1e-2, 1e-2, 1.0)
    slow = np.einsum("ij,jk,ik->i", parts.c_slow, mode.start, parts.c_slow)
    total = np.einsum("ij,jk,ik->i", c, mode.start, c)
    assert np.allclose(slow + parts.variance, total, rtol=2e-2)  # but for their covariance
    assert np.abs(parts.c_slow @ v[:, :2]).max() < 1e-9  # nothing fast is in the path
    assert parts.mean_variance.max() < 1e-3 * parts.variance.max()


@pytest.mark.parametrize(("mode", "fast"), [
    (markov(0, 1e-5, 1.0, None), True), (markov(0, 10.0, 1.0, None), False),
    (oscillator(0, 100.0, 0.01, 1.0, None), True), (oscillator(0, 1.0, 0.01, 1.0, None), False),
])  # fmt: skip
def test_which_modes_are_blur(mode: Mode, fast: bool) -> None:
    parts = split(mode, 0.01, 0.01, 1.0)
    assert parts.c_slow.any() != fast
    assert parts.variance[0] == pytest.approx(1.0 if fast else 0.0, abs=1e-9)


ROUGH = {
    "walk": (random_walk(0, 2.0), 0.5),
    "markov": (markov(1, 1.0, 2.0, None), 0.3),
    "oscillator": (oscillator(1, 1.0, 0.01, 2.0, None), 0.12),
    "noisy": (oscillator(1, 1.0, 0.7, 2.0, None), 0.12),
    "rate": (rate_markov(0, 2.0, 3.0), 0.5),
}


@pytest.mark.parametrize("name", ROUGH)
def test_how_far_modes_are_from_straight_lines(name: str) -> None:
    """Against runs between two nodes: the whole mean square, and what the two states say of it.

    What the parabola of a mean takes for a bend is a little too much: 8 / 15 for 2 / 3.
    """
    mode, step = ROUGH[name]
    parts = split(mode, step, step, 1.0)
    rng, levels, runs = np.random.default_rng(7), 5, 4000
    ends = run(mode, np.array([0.0, step]), rng.standard_normal((runs, 3, len(mode.a))))
    draw = rng.standard_normal((runs, 2**levels - 1, len(mode.a)))
    x = between(mode, ends[:, 0], ends[:, 1], step, levels, draw) @ mode.c.T
    mean = between(mode, ends[:, 0], ends[:, 1], step, levels, 0.0 * draw) @ mode.c.T
    share = np.linspace(0.0, 1.0, 2**levels + 1)[:, None]
    line = x[:, :1] + share * (x[:, -1:] - x[:, :1])
    rough, whole = (np.square(v)[:, :-1].mean(axis=(0, 1)) for v in (x - mean, x - line))
    assert parts.rough == pytest.approx(rough, rel=0.06 if name in ("walk", "markov") else 0.5)
    told = parts.rough + parts.bend
    assert (told >= 0.95 * whole).all()
    assert (told <= 1.3 * whole).all()


def test_what_begins_at_zero_is_as_wide_as_it_becomes() -> None:
    """A slow oscillator, and a fast one, in a system that has an integrator and never settles."""
    for hz in (1.0, 500.0):
        alone = oscillator(0, hz, 0.01, 2.0, None)
        a, b, c = np.zeros((3, 3)), np.zeros((3, 2)), np.zeros((3, 3))
        a[:2, :2], b[:2, :1], c[:, :2] = alone.a, alone.b, alone.c
        b[2, 1] = 1.0
        mixed = system(a, b, c)
        assert not mixed.start.any()
        told, wanted = split(mixed, 0.1, 0.1, 1.0, 1e3), split(alone, 0.1, 0.1, 1.0, 1e3)
        for name in ("variance", "bend", "rough", "mean_variance"):
            found = getattr(told, name)
            assert found == pytest.approx(getattr(wanted, name), rel=1e-6, abs=1e-15), name


@pytest.mark.parametrize("count", [1, 8])
def test_steady_motion_is_straight(count: int) -> None:
    """A rate that hardly changes, and waves much longer than a step, leave nothing to blur."""
    for mode in (rate_markov(1, 1e6, 8.0), oscillator(1, 1e-4, 1e-6, 8.0, None)):
        parts = split(mode, 0.5, 0.5 / count, 4.0)
        assert parts.c_slow.any()
        assert np.sqrt(parts.rough + parts.bend).max() < 1e-3


@pytest.mark.parametrize("mode", [*MODES.values(), rate_markov(1, 2.5, 0.3)])
def test_processes_stay_as_wide_as_they_start(mode: Mode) -> None:
    """A P + P A' + B B' = 0 for states that have settled: not for an angle that grows."""
    rise = mode.a @ mode.start + mode.start @ mode.a.T + mode.b @ mode.b.T
    settled = np.diag(mode.start) > 0
    off = np.abs(rise[np.ix_(settled, settled)]).max()
    assert off < 1e-12 * np.abs(mode.b @ mode.b.T).max()


@pytest.mark.parametrize(("turn", "decay"), [(0.75, 1.9), (0.82, 2.1)])
def test_from_where_on_modes_are_blur(turn: float, decay: float) -> None:
    """An eighth of a turn between nodes, or two time constants."""
    fast = decay > 2.0
    for mode in (oscillator(1, turn / (0.02 * np.pi), 0.01, 1.0, None),
                 markov(2, 0.01 / decay, 1.0, None)):  # fmt: skip
        assert split(mode, 0.01, 0.001, 1.0).c_slow.any() != fast
