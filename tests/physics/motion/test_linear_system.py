"""Linear stochastic systems: against stiff solvers, a Lyapunov solver and closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.linalg import solve_continuous_lyapunov

from pipeline.physics.motion.linear_system import (
    bridge,
    discretise,
    factor,
    stationary_covariance,
)

TIMES_S = np.array([1e-6, 1e-3, 1.0, 1e4])  # from microseconds to hours in one system


def mixed(seed: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """A system with these time constants, none of its states belonging to one of them."""
    rng = np.random.default_rng(seed)
    v = np.eye(4) + 0.3 * rng.standard_normal((4, 4))
    return v @ np.diag(-1.0 / TIMES_S) @ np.linalg.inv(v), rng.standard_normal((4, 2))


def oscillator(frequency_hz: float, damping: float) -> tuple[np.ndarray, np.ndarray]:
    w = 2.0 * np.pi * frequency_hz
    return np.array([[0.0, w], [-w, -2.0 * damping * w]]), np.array([[0.0], [1.0]])


def chain(frequency_hz: float = 3.0) -> tuple[np.ndarray, np.ndarray]:
    """Fast wheel noise drives a mode of 3 Hz, which a slow drift is added to."""
    a = np.zeros((4, 4))
    a[0, 0], a[3, 3] = -1e6, -1e-4
    a[1:3, 1:3] = oscillator(frequency_hz, 0.01)[0]
    a[2, 0] = 5.0
    b = np.zeros((4, 2))
    b[0, 0], b[3, 1] = 1e3, 1e-2
    return a, b


@pytest.mark.parametrize(("step_s", "frequency_hz"), [(1e-5, 3.0), (0.1, 3.0), (1e4, 1e-4)])
def test_against_radau(step_s: float, frequency_hz: float) -> None:
    """Mean and covariance of a system from microseconds to hours, by a stiff solver."""
    a, b = chain(frequency_hz)
    step = discretise(a, b, step_s)
    x0, n = np.array([1.0, -2.0, 0.5, 3.0]), 4

    def rate(_: float, y: np.ndarray) -> np.ndarray:
        p = y[n:].reshape(n, n)
        return np.concatenate([a @ y[:n], (a @ p + p @ a.T + b @ b.T).ravel()])

    def slope(_: float, y: np.ndarray) -> np.ndarray:
        eye = np.eye(n)
        out = np.zeros((n + n * n, n + n * n))
        out[:n, :n], out[n:, n:] = a, np.kron(a, eye) + np.kron(eye, a)
        return out

    start = np.concatenate([x0, np.zeros(n * n)])
    solved = solve_ivp(
        rate, (0.0, step_s), start, method="Radau", jac=slope, rtol=1e-9, atol=1e-14
    )
    mean, covariance = solved.y[:n, -1], solved.y[n:, -1].reshape(n, n)
    assert np.allclose(step.transition @ x0, mean, rtol=1e-6, atol=1e-8)
    size = np.sqrt(np.diag(step.noise))
    assert np.all(np.abs(step.noise - covariance) <= 1e-6 * np.outer(size, size) + 1e-13)


@pytest.mark.parametrize("step_s", [1e-7, 1e-3, 1.0, 100.0, 1e4, 1e6])
def test_against_closed_form_of_a_mixed_system(step_s: float) -> None:
    """By its eigenvectors; the rounding of A itself is worth 1e-16 |A| on the slowest rate."""
    a, b = mixed()
    value, v = np.linalg.eig(a)
    inverse = np.linalg.inv(v)
    change = (v * np.expm1(value * step_s)) @ inverse
    pair = value[:, None] + value[None, :]
    noise = v @ ((inverse @ b) @ (inverse @ b).T * np.expm1(pair * step_s) / pair) @ v.T
    step = discretise(a, b, step_s)
    assert np.abs(step.change - change).max() < 1e-6 * np.abs(change).max()
    assert np.abs(step.noise - noise).max() < 1e-6 * np.abs(noise).max()


@pytest.mark.parametrize("system", [mixed(), mixed(5), oscillator(10.0, 1e-3), chain()])
def test_against_lyapunov(system: tuple[np.ndarray, np.ndarray]) -> None:
    a, b = system
    ours, theirs = stationary_covariance(a, b), solve_continuous_lyapunov(a, -b @ b.T)
    assert ours is not None
    size = np.sqrt(np.diag(theirs))
    assert np.all(np.abs(ours - theirs) < 1e-6 * np.outer(size, size))
    long = discretise(a, b, 3e6)
    assert np.allclose(long.noise, ours, rtol=1e-6, atol=1e-12 * np.abs(ours).max())


def test_limits_slow_states_keep_their_digits() -> None:
    """A step of 1e-10 of the slowest time constant beside one of 1e-6 s: no digit is lost."""
    a, b = np.diag(-1.0 / TIMES_S), np.eye(4)
    for step_s in (1e-9, 1e-3, 1e2):
        step = discretise(a, b, step_s)
        exact = np.expm1(-step_s / TIMES_S)
        noise = -0.5 * TIMES_S * np.expm1(-2.0 * step_s / TIMES_S)
        assert np.allclose(np.diag(step.change), exact, rtol=1e-13)
        assert np.allclose(np.diag(step.noise), noise, rtol=1e-13)


def test_limits_no_stationary_state_and_no_step() -> None:
    assert stationary_covariance(np.zeros((1, 1)), np.ones((1, 1))) is None
    walk = discretise(np.zeros((1, 1)), np.array([[2.0]]), 3.0)
    assert walk.noise[0, 0] == pytest.approx(12.0, rel=1e-14)
    assert not discretise(*chain(), 0.0).noise.any()


@pytest.mark.parametrize("seed", range(12))
def test_an_integrator_among_mixed_states_never_settles(seed: int) -> None:
    """Its eigenvalue rounds to either side of 0; a state that decays in its place settles."""
    rng = np.random.default_rng(seed)
    v, b = np.eye(3) + 0.5 * rng.standard_normal((3, 3)), rng.standard_normal((3, 1))
    found = []
    for slowest in (0.0, -1e-9):
        a = v @ np.diag([slowest, -1.0, -3.0]) @ np.linalg.inv(v)
        found.append(stationary_covariance(a, b))
    assert found[0] is None
    strength = np.linalg.solve(v, b)[0, 0]
    slow = np.linalg.solve(v, np.linalg.solve(v, found[1]).T)[0, 0]
    assert slow == pytest.approx(0.5e9 * strength**2, rel=1e-3)


@pytest.mark.parametrize("steps", [2, 4, 8])
def test_a_row_of_equal_delays_settles(steps: int) -> None:
    """Multiple eigenvalues, whose vectors are no basis."""
    a = -3.0 * (np.eye(steps) - np.eye(steps, k=-1))
    b = np.eye(steps, 1)
    found = stationary_covariance(a, b)
    assert found is not None
    assert np.allclose(found, solve_continuous_lyapunov(a, -b @ b.T), rtol=1e-9)


@pytest.mark.parametrize("frequency_hz", [1e-3, 1.0, 1e4])
@pytest.mark.parametrize("damping", [1e-6, 1.0, 1e3])
def test_an_oscillator_settles_in_states_of_any_size(frequency_hz: float, damping: float) -> None:
    """x and x', not x' / w: its variance is noise^2 / (4 z w^3)."""
    w = 2.0 * np.pi * frequency_hz
    a = np.array([[0.0, 1.0], [-w * w, -2.0 * damping * w]])
    found = stationary_covariance(a, np.array([[0.0], [1.0]]))
    assert found is not None
    assert found[0, 0] == pytest.approx(1.0 / (4.0 * damping * w**3), rel=1e-6)


@given(st.floats(1e-6, 1e4), st.floats(0.01, 0.99), st.floats(-3, 3), st.floats(0.001, 3.0))
def test_two_steps_are_one(total_s: float, share: float, decades: float, damping: float) -> None:
    a, b = oscillator(10.0**decades, damping)
    whole = discretise(a, b, total_s)
    first, second = discretise(a, b, share * total_s), discretise(a, b, (1 - share) * total_s)
    phi = second.transition
    turns = 10.0**decades * total_s
    near = 1e-10 * (1.0 + turns)
    assert np.allclose(phi @ first.transition, whole.transition, atol=near)
    joined = phi @ first.noise @ phi.T + second.noise
    assert np.allclose(joined, whole.noise, atol=near * np.abs(whole.noise).max())


@given(st.floats(1e-6, 1e3), st.floats(-2, 2), st.floats(0.001, 3.0))
def test_a_bridge_gives_back_the_two_steps(half_s: float, decades: float, damping: float) -> None:
    """Middle and end drawn end first have the joint covariance of two steps in order."""
    a, b = oscillator(10.0**decades, damping)
    step, whole = discretise(a, b, half_s), discretise(a, b, 2.0 * half_s)
    made = bridge(step)
    end = whole.noise
    middle = made.stop @ end @ made.stop.T + made.spread @ made.spread.T
    assert np.allclose(made.start + made.stop @ whole.transition, step.transition, atol=1e-8)
    size = np.sqrt(np.diag(step.noise)) + 1e-300
    assert np.all(np.abs(middle - step.noise) < 1e-6 * np.outer(size, size))


@given(st.integers(0, 1000))
def test_a_factor_gives_back_its_covariance(seed: int) -> None:
    rng = np.random.default_rng(seed)
    half = rng.standard_normal((4, rng.integers(1, 5))) * 10.0 ** rng.uniform(-6, 6, (4, 1))
    covariance = half @ half.T
    size = np.sqrt(np.diag(covariance))
    made = factor(covariance)
    assert np.all(np.abs(made @ made.T - covariance) <= 1e-6 * np.outer(size, size))
