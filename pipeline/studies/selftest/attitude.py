"""Limiting cases of attitude: time constants from a microsecond to hours in one stiff system."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

from pipeline.physics.motion.linear_system import discretise, stationary_covariance
from pipeline.studies.selftest.case import CaseResult, case
from pipeline.studies.worst import worst_of

Array = np.ndarray

CONSTANTS_S = (1e-6, 1e-3, 1.0, 100.0, 1e4)
HOURS_S = 3 * 3600.0


def _cascade() -> tuple[Array, Array]:
    """Lags in a row, the slowest first, each driven by the one before and by noise of its own."""
    slow = np.array(CONSTANTS_S[::-1])
    a = np.diag(-1.0 / slow) + np.diag(1.0 / slow[1:], -1)
    return a, np.diag(1.0 / slow)


@case(
    "attitude/stiff",
    "lags of 1e-6 to 1e4 s in a row, in steps of 1e-7 s to three hours",
    "a stiff solver (Radau, scipy)",
    1e-8,
)
def stiff(_: Path) -> CaseResult:
    a, b = _cascade()
    start = np.array([1.0, -2.0, 3.0, -4.0, 5.0])
    times = np.array([1e-7, 1e-5, 1e-2, 10.0, 1000.0, HOURS_S])
    right = solve_ivp(
        lambda _t, x: a @ x, (0.0, HOURS_S), start, "Radau", times, jac=a, rtol=1e-10, atol=1e-12
    ).y.T
    ours = np.stack([start + discretise(a, b, t).change @ start for t in times])
    error = float(np.abs(ours - right).max())
    many, step = start.copy(), discretise(a, b, 0.5).change
    for _k in range(int(HOURS_S / 0.5)):
        many = many + step @ many
    error = worst_of(error, np.abs(many - right[-1]).max())
    return CaseResult(f"{right[-1, -1]:.9f} after 3 h", f"{many[-1]:.9f} in 21,600 steps", error)


def _exact_covariance(a: Array, b: Array) -> Array:
    """P of A P + P A' + B B' = 0 in whole fractions: no rounding at any stiffness."""
    n = len(a)
    left, noise = ([[Fraction(float(v)) for v in row] for row in matrix] for matrix in (a, b))
    pairs = [(i, j) for i in range(n) for j in range(i + 1)]
    place = {pair: k for k, pair in enumerate(pairs)}
    rows = []
    for i, j in pairs:
        row = [Fraction(0)] * (len(pairs) + 1)
        for k in range(n):
            row[place[max(k, j), min(k, j)]] += left[i][k]
            row[place[max(i, k), min(i, k)]] += left[j][k]
            row[-1] -= noise[i][k] * noise[j][k]
        rows.append(row)
    solved = _eliminated(rows)
    out = np.zeros((n, n))
    for (i, j), value in zip(pairs, solved, strict=True):
        out[i, j] = out[j, i] = float(value)
    return out


def _eliminated(rows: list[list[Fraction]]) -> list[Fraction]:
    """Solution of linear equations (n rows of n + 1), by elimination."""
    n = len(rows)
    for k in range(n):
        pivot = next(i for i in range(k, n) if rows[i][k])
        rows[k], rows[pivot] = rows[pivot], rows[k]
        rows[k] = [v / rows[k][k] for v in rows[k]]
        for i in range(n):
            if i != k and rows[i][k]:
                rows[i] = [x - rows[i][k] * y for x, y in zip(rows[i], rows[k], strict=True)]
    return [row[-1] for row in rows]


@case(
    "attitude/stiff-noise",
    "the covariance that those lags settle to under noise",
    "Lyapunov's equation solved in whole fractions",
    1e-8,
)
def stiff_noise(_: Path) -> CaseResult:
    a, b = _cascade()
    right = _exact_covariance(a, b)
    size = np.sqrt(np.diag(right))
    ours = stationary_covariance(a, b)
    assert ours is not None
    error = float(np.abs((ours - right) / np.outer(size, size)).max())
    found = np.sqrt(np.diag(ours))
    known, told = (f"rms {rms[0]:.6g} to {rms[-1]:.6g}" for rms in (size, found))
    return CaseResult(known, told, error)
