"""Two-body motion of any eccentricity by a universal variable."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pipeline.physics.constants import EARTH_GM_M3_S2

Array = NDArray[np.float64]

GROWTH = 1.5  # of what the root is looked for within, from step to step
_EDGES = np.cumprod([1e-3, *64 * [GROWTH]])  # the steps


def two_body(
    position_m: Array,
    velocity_m_s: Array,
    dt_s: ArrayLike,
    gm_m3_s2: float = EARTH_GM_M3_S2,
    inverse_axis_m: ArrayLike | None = None,
) -> tuple[Array, Array]:
    """Two-body motion from one state (3,), (3,) by times dt (n,): positions, velocities (n, 3).

    Of many states (m, 3), (m, 3) by times (m, n) at once: (m, n, 3). Universal variable and
    Stumpff functions (Battin 1999, section 4.5; Goodyear 1965): one form for ellipse, parabola and
    hyperbola. Kepler's equation rises monotonically in the variable (its slope is the radius), so
    Newton's method inside a bracket cannot fail. Ellipses are reduced by whole periods first.
    Perturbations are omitted. `inverse_axis_m`, 1/a [1/m] (or (m,), NaN where not known), may be
    given where it is known better than speed and radius tell it: near the parabola. The result of a
    time does not depend on the others.
    """
    r0, v0 = np.asarray(position_m, float), np.asarray(velocity_m_s, float)
    length = np.sqrt(_dot(r0, r0))
    second = np.sqrt(length**3 / gm_m3_s2)
    # lengths in |r0|, times in sqrt(|r0|^3/GM): GM = |r0| = 1
    r0, v0 = r0 / length[..., None], v0 * (second / length)[..., None]
    time = np.atleast_1d(np.asarray(dt_s, float)) / second[..., None]
    radial = np.broadcast_to(_dot(r0, v0)[..., None], time.shape)
    alpha = 2.0 - _dot(v0, v0)  # 1/a
    if inverse_axis_m is not None:
        known = np.asarray(inverse_axis_m, float) * length
        alpha = np.where(np.isnan(known), alpha, known)
    alpha = np.broadcast_to(alpha[..., None], time.shape)
    with np.errstate(divide="ignore", over="ignore"):
        period = 2.0 * np.pi / np.maximum(alpha, 0.0) ** 1.5
    turns = np.isfinite(period)
    period = np.where(turns, period, 1.0)
    time = np.where(turns, time - period * np.round(time / period), time)
    s = _universal_anomaly(time, radial, alpha)
    u0, u1, u2, _ = universal_functions(s, alpha)
    radius = u0 + radial * u1 + u2
    f, g = 1.0 - u2, u1 + radial * u2  # g = t - u3, in the form without a difference
    f_dot, g_dot = -u1 / radius, 1.0 - u2 / radius
    r0, v0 = r0[..., None, :], v0[..., None, :]
    position = f[..., None] * r0 + g[..., None] * v0
    velocity = f_dot[..., None] * r0 + g_dot[..., None] * v0
    scale = length[..., None, None]
    return position * scale, velocity * (scale / second[..., None, None])


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(np.einsum("...i,...i->...", a, b))


def _universal_anomaly(time: Array, radial: Array, alpha: Array) -> Array:
    """Root s of U1 + radial U2 + U3 = time (units GM = |r0| = 1), by bracketed Newton: (...)."""
    edge = _outer_edge(time, radial, alpha)
    low, high = np.where(time < 0, -edge, 0.0), np.where(time < 0, 0.0, edge)
    s = np.clip(time, low, high)
    found = np.zeros(s.shape, bool)
    for _ in range(200):
        u0, u1, u2, u3 = universal_functions(s, alpha)
        excess = u1 + radial * u2 + u3 - time
        low, high = np.where(excess < 0, s, low), np.where(excess > 0, s, high)
        slope = np.maximum(u0 + radial * u1 + u2, 1e-300)
        newton = s - excess / slope
        inside = (newton > low) & (newton < high)
        following = np.where(excess == 0, s, np.where(inside, newton, 0.5 * (low + high)))
        following = np.where(found, s, following)
        found |= np.abs(following - s) <= 4e-16 * np.abs(following)
        s = following
        if found.all():
            break
    return s


def _outer_edge(time: Array, radial: Array, alpha: Array) -> Array:
    """|s| on the far side of the root for every time (...), by growth; one turn at the most.

    The time is the integral of the radius over s, so the root is not before |time| / apoapsis:
    the growth begins a step or two before that.
    """
    parameter = np.maximum(2.0 - alpha - radial**2, 0.0)
    eccentricity = np.sqrt(np.maximum(1.0 - alpha * parameter, 0.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        turn = 2.0 * np.pi / np.sqrt(np.maximum(alpha, 0.0))
        surely = np.abs(time) * alpha / (1.0 + eccentricity)
    begins = np.searchsorted(_EDGES, np.where(surely > 0.0, surely / GROWTH, 0.0)) - 1
    edge = np.minimum(_EDGES[np.maximum(begins, 0)], turn)
    sign = np.where(time < 0, -1.0, 1.0)
    for _ in range(1000):
        _, u1, u2, u3 = universal_functions(sign * edge, alpha)
        short = (np.abs(u1 + radial * u2 + u3) <= np.abs(time)) & (edge < turn)
        if not np.any(short):
            break
        edge = np.where(short, np.minimum(GROWTH * edge, turn), edge)
    return edge


def universal_functions(s: Array, alpha: ArrayLike) -> tuple[Array, Array, Array, Array]:
    """Battin's U0 to U3 of s for reciprocal semi-major axes alpha (one, or as s): each (...).

    U_k = s^k c_k(alpha s^2). Trigonometric or hyperbolic in half arguments away from zero, power
    series within |alpha s^2| < 1, so that no digits are lost near the parabola.
    """
    psi = np.asarray(alpha, float) * s * s
    root = np.sqrt(np.abs(psi))
    c2, c3 = np.empty_like(s), np.empty_like(s)
    near = np.abs(psi) < 1.0
    c2[near], c3[near] = _series(psi[near], 2), _series(psi[near], 3)
    bound, free = ~near & (psi > 0), ~near & (psi < 0)
    x = root[bound]
    c2[bound], c3[bound] = 2.0 * np.sin(x / 2) ** 2 / x**2, (x - np.sin(x)) / x**3
    x = root[free]
    c2[free], c3[free] = 2.0 * np.sinh(x / 2) ** 2 / x**2, (np.sinh(x) - x) / x**3
    return 1.0 - psi * c2, s * (1.0 - psi * c3), s * s * c2, s * s * s * c3


def _series(psi: Array, k: int) -> Array:
    """Stumpff's c_k(psi) = sum (-psi)^j / (k + 2j)! for |psi| < 1."""
    term = np.full_like(psi, 0.5 if k == 2 else 1.0 / 6.0)
    total = term.copy()
    for j in range(1, 10):
        term = term * (-psi) / ((k + 2 * j - 1) * (k + 2 * j))
        total += term
    return total
