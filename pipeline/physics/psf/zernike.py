"""Zernike polynomials in Noll's order and normalisation: the wavefront over a round pupil."""

from __future__ import annotations

from math import factorial

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def noll_orders(j: int) -> tuple[int, int]:
    """Radial order n and azimuthal order m of Noll's index j >= 1 (Noll 1976, JOSA 66, 207).

    m > 0 stands for cos(m theta), m < 0 for sin(|m| theta); even j are cosines.
    """
    n = 0
    while (n + 1) * (n + 2) // 2 < j:
        n += 1
    k = j - n * (n + 1) // 2 - 1
    m = 2 * ((k + 1) // 2) if n % 2 == 0 else 2 * (k // 2) + 1
    return n, m if j % 2 == 0 else -m


def zernike(j: int, rho: Array, theta: Array) -> Array:
    """Zernike polynomial j at (rho, theta), rms 1 over the unit disc (the whole, unobscured one).

    Z4 = sqrt(3) (2 rho^2 - 1) is defocus, Z11 = sqrt(5) (6 rho^4 - 6 rho^2 + 1) spherical.
    """
    n, m = noll_orders(j)
    a = abs(m)
    radial = np.zeros_like(rho)
    for k in range((n - a) // 2 + 1):
        c = factorial(n - k) // (
            factorial(k) * factorial((n + a) // 2 - k) * factorial((n - a) // 2 - k)
        )
        radial += (-1) ** k * c * rho ** (n - 2 * k)
    if m == 0:
        return np.sqrt(n + 1.0) * radial
    turn = np.cos(a * theta) if m > 0 else np.sin(a * theta)
    return np.sqrt(2.0 * (n + 1.0)) * radial * turn


def wavefront(terms: tuple[tuple[int, float], ...], y: Array, x: Array) -> Array:
    """Sum of terms (Noll index, rms) at pupil coordinates in units of its radius; unit of rms."""
    rho, theta = np.hypot(x, y), np.arctan2(y, x)
    out = np.zeros(np.broadcast_shapes(np.shape(y), np.shape(x)))
    for j, rms in terms:
        out += rms * zernike(j, rho, theta)
    return out


def defocus_rms(shift_m: float, focal_ratio: float) -> float:
    """Z4 [m rms over the full disc] of a detector that stands `shift_m` from focus.

    The path difference at the pupil's edge is shift / (8 N^2) and W20 rho^2 is, but for a
    constant, W20 / (2 sqrt 3) of Z4.
    """
    return shift_m / (8.0 * focal_ratio**2) / (2.0 * float(np.sqrt(3.0)))
