"""Linear stochastic systems dx = A x dt + B dw, discretised exactly for any step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

Array = NDArray[np.float64]

BASE_NORM = 0.25  # of A times the step that the exponential is taken of
SETTLED = 1e-18  # of a transition's size, where the covariance no longer grows
ROUNDINGS = 8.0  # that an eigenvalue may be off by
MULTIPLE = 1e-10  # cosine between an eigenvalue's two vectors, below which it is a multiple one


@dataclass(frozen=True, eq=False)
class LinearStep:
    """x(t + h) = (1 + change) x(t) + noise of the covariance `noise`: (n, n) each.

    The change is kept instead of the transition, so that slow states keep their digits in steps
    that are 1e-10 of their time constants.
    """

    change: Array
    noise: Array

    @property
    def transition(self) -> Array:
        return np.eye(len(self.change)) + self.change

    def doubled(self) -> LinearStep:
        """The step of twice the length."""
        phi = self.transition
        noise = self.noise + phi @ self.noise @ phi.T
        return LinearStep(2.0 * self.change + self.change @ self.change, 0.5 * (noise + noise.T))


def discretise(a: Array, b: Array, step_s: float) -> LinearStep:
    """The exact step of a system over `step_s` >= 0 seconds: a (n, n), b (n, m), unit white noise.

    Van Loan (1978, IEEE Trans. AC-23, 395): the exponential of [[-A, B B^T], [0, A^T]] h holds
    both. Its growing block overflows for stiff systems, so it is taken of h / 2^s, where A h is
    small, and the step is doubled s times: sums of covariances and squares of transitions, which
    stay bounded for every stable system. The states are scaled to one size first (Osborne).
    """
    n = len(a)
    if step_s == 0.0 or n == 0:
        return LinearStep(np.zeros((n, n)), np.zeros((n, n)))
    _, (scale, _) = scipy.linalg.matrix_balance(a, permute=False, separate=True)
    a = a / scale[:, None] * scale
    b = b / scale[:, None]
    size = float(np.abs(a).sum(axis=1).max()) * step_s
    doublings = max(0, int(np.ceil(np.log2(max(size, 1e-300) / BASE_NORM))))
    h = step_s / 2.0**doublings
    block = np.block([[-a, b @ b.T], [np.zeros((n, n)), a.T]]) * h
    whole = scipy.linalg.expm(block)
    phi = whole[n:, n:].T
    noise = phi @ whole[:n, n:]
    step = LinearStep(_exponential_less_one(a * h), 0.5 * (noise + noise.T))
    for _ in range(doublings):
        step = step.doubled()
    return LinearStep(step.change * scale[:, None] / scale, step.noise * np.outer(scale, scale))


def _exponential_less_one(a: Array) -> Array:
    """exp(a) - 1 (n, n) for |a| <= BASE_NORM, by its series: no digit of a small change is lost."""
    out, term = a.copy(), a
    for k in range(2, 20):
        term = term @ a / k
        out = out + term
    return out


def stationary_covariance(a: Array, b: Array) -> Array | None:
    """Covariance (n, n) that a stable system settles to; None where it has none.

    The steps of the fastest state's size are doubled until nothing of the start is left.
    """
    if len(a) and not _settles(a):
        return None
    step = discretise(a, b, 1.0 / max(float(np.abs(a).sum(axis=1).max(initial=0.0)), 1e-300))
    for _ in range(200):
        if np.abs(step.transition).max(initial=0.0) < SETTLED:
            return step.noise
        step = step.doubled()
    return None


def _settles(a: Array) -> bool:
    """Whether all of a system decays, by more than the rounding of its eigenvalues: an integrator
    among mixed states comes out on either side of 0.

    An eigenvalue is off by eps |A| / |y^H x| for its unit vectors from left and right (Golub and
    Van Loan 2013, 7.2.2). Where these are at right angles it is a multiple one, which that does not
    hold for, and its sign alone counts.
    """
    a = scipy.linalg.matrix_balance(a)[0]  # states of one size: no eigenvalue changes
    value, left, right = scipy.linalg.eig(a, left=True, right=True)
    cosine = np.abs(np.sum(left.conj() * right, axis=0))
    rounding = ROUNDINGS * np.finfo(float).eps * np.abs(a).sum(axis=0).max()
    off = np.where(cosine > MULTIPLE, rounding / np.maximum(cosine, MULTIPLE), 0.0)
    return bool((value.real < -off).all())


def factor(covariance: Array) -> Array:
    """Lower triangular L (n, n) with L L^T the covariance; directions without variance get 0."""
    n = len(covariance)
    size = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    safe = np.where(size > 0.0, size, 1.0)
    left = covariance / np.outer(safe, safe)
    out = np.zeros((n, n))
    for k in range(n):
        if left[k, k] > 1e-14 and size[k] > 0.0:
            out[:, k] = np.where(np.arange(n) >= k, left[:, k] / np.sqrt(left[k, k]), 0.0)
            left = left - np.outer(out[:, k], out[:, k])
    return out * size[:, None]


@dataclass(frozen=True, eq=False)
class Bridge:
    """x(t + h) between x(t) and x(t + 2h): `start` x(t) + `stop` x(t + 2h) + `spread` normals."""

    start: Array
    stop: Array
    spread: Array


def bridge(half: LinearStep) -> Bridge:
    """The state in the middle of two steps, given those at its ends: exact for Gaussian systems.

    With Phi and Q of half the way, S = Phi Q Phi^T + Q and G = Q Phi^T S^+: the mean is Phi x0 +
    G (x2 - Phi^2 x0), the covariance (1 - G Phi) Q (1 - G Phi)^T + G Q G^T.
    """
    phi, q = half.transition, half.noise
    whole = phi @ q @ phi.T + q
    size = np.sqrt(np.maximum(np.diag(whole), 0.0))
    safe = np.where(size > 0.0, size, 1.0)
    value, vector = np.linalg.eigh(whole / np.outer(safe, safe))
    inverse = np.where(value > 1e-12, 1.0 / np.maximum(value, 1e-12), 0.0)
    gain = (q @ phi.T / safe) @ (vector * inverse) @ vector.T / safe
    rest = np.eye(len(phi)) - gain @ phi
    return Bridge(rest @ phi, gain, factor(rest @ q @ rest.T + gain @ q @ gain.T))
