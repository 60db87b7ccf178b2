"""Random numbers keyed by (seed, component, frame, pixel): Philox4x32-10 and what is drawn from it.

Every pixel of every frame owns its stream, so a draw depends on no tile, worker or order, and a
component that is switched on, or a pixel that changes, leaves all other draws as they were.
"""

from __future__ import annotations

import hashlib
import math

import numpy as np
from numba import njit, uint64

GAUSSIAN_ABOVE = 1e8  # Poisson means above it are drawn as a rounded Gaussian (skew 1e-4)
EXACT_BELOW = 10.0  # and those below it by inversion


def stream_key(seed: int, component: str) -> tuple[int, int]:
    """The 64-bit key of a component's stream, as two 32-bit words.

    A hash of the seed and the name (BLAKE2b), so that any two components differ.
    """
    digest = hashlib.blake2b(f"{seed}/{component}".encode(), digest_size=8).digest()
    word = int.from_bytes(digest, "little")
    return word & 0xFFFFFFFF, word >> 32


@njit(cache=True, nogil=True, inline="always")
def philox(c0, c1, c2, c3, k0, k1):
    """Philox4x32-10 (Salmon et al. 2011, SC '11, 16): four words from a counter and a key."""
    c0, c1, c2, c3 = uint64(c0), uint64(c1), uint64(c2), uint64(c3)
    k0, k1 = uint64(k0), uint64(k1)
    low = uint64(0xFFFFFFFF)
    for _ in range(10):
        p0 = uint64(0xD2511F53) * c0
        p1 = uint64(0xCD9E8D57) * c2
        c0 = (p1 >> uint64(32)) ^ c1 ^ k0
        c1 = p1 & low
        c2 = (p0 >> uint64(32)) ^ c3 ^ k1
        c3 = p0 & low
        k0 = (k0 + uint64(0x9E3779B9)) & low
        k1 = (k1 + uint64(0xBB67AE85)) & low
    return c0, c1, c2, c3


@njit(cache=True, nogil=True, inline="always")
def uniform(high, low):
    """A double in (0, 1) from two 32-bit words: 52 bits, centred so that 0 and 1 never occur."""
    bits = (uint64(high) << uint64(20)) | (uint64(low) >> uint64(12))
    return (np.float64(bits) + 0.5) * 2.220446049250313e-16


@njit(cache=True, nogil=True)
def normal_quantile(p):
    """Inverse of the normal distribution function, relative error 1e-16 (Wichura 1988, AS 241)."""
    q = p - 0.5
    if abs(q) <= 0.425:
        r = 0.180625 - q * q
        top = ((((((2509.0809287301226727 * r + 33430.575583588128105) * r
                   + 67265.770927008700853) * r + 45921.953931549871457) * r
                 + 13731.693765509461125) * r + 1971.5909503065514427) * r
               + 133.14166789178437745) * r + 3.387132872796366608  # fmt: skip
        bottom = ((((((5226.495278852545925 * r + 28729.085735721942674) * r
                      + 39307.89580009271061) * r + 21213.794301586595867) * r
                    + 5394.1960214247511077) * r + 687.1870074920579083) * r
                  + 42.313330701600911252) * r + 1.0  # fmt: skip
        return q * top / bottom
    r = math.sqrt(-math.log(p if q < 0.0 else 1.0 - p))
    if r <= 5.0:
        r -= 1.6
        top = ((((((7.7454501427834140764e-4 * r + 0.0227238449892691845833) * r
                   + 0.24178072517745061177) * r + 1.27045825245236838258) * r
                 + 3.64784832476320460504) * r + 5.7694972214606914055) * r
               + 4.6303378461565452959) * r + 1.42343711074968357734  # fmt: skip
        bottom = ((((((1.05075007164441684324e-9 * r + 5.475938084995344946e-4) * r
                      + 0.0151986665636164571966) * r + 0.14810397642748007459) * r
                    + 0.68976733498510000455) * r + 1.6763848301838038494) * r
                  + 2.05319162663775882187) * r + 1.0  # fmt: skip
    else:
        r -= 5.0
        top = ((((((2.01033439929228813265e-7 * r + 2.71155556874348757815e-5) * r
                   + 0.0012426609473880784386) * r + 0.026532189526576123093) * r
                 + 0.29656057182850489123) * r + 1.7848265399172913358) * r
               + 5.4637849111641143699) * r + 6.6579046435011037772  # fmt: skip
        bottom = ((((((2.04426310338993978564e-15 * r + 1.4215117583164458887e-7) * r
                      + 1.8463183175100546818e-5) * r + 7.868691311456132591e-4) * r
                    + 0.0148753612908506148525) * r + 0.13692988092273580531) * r
                  + 0.59983220655588793769) * r + 1.0  # fmt: skip
    return math.copysign(top / bottom, q)


@njit(cache=True, nogil=True)
def _log_factorial_rest(k):
    """log k! - [(k + 1/2) log k - k + log(2 pi)/2], k >= 7 (Stirling's series), error < 1e-12."""
    s = 1.0 / k
    q = s * s
    return s * (1.0 / 12 - q * (1.0 / 360 - q * (1.0 / 1260 - q * (1.0 / 1680 - q / 1188.0))))


@njit(cache=True, nogil=True)
def poisson(mean, x, y, frame, k0, k1):
    """One Poisson draw for a pixel, as a float64 whole number.

    Below 10 by inversion of the distribution; up to 1e8 by the transformed rejection PTRS
    (Hormann 1993, Insurance: Mathematics and Economics 12, 39), its acceptance test written with
    Stirling's series so that it does not cancel; above by a rounded Gaussian, whose distribution
    function differs by less than 7e-6 everywhere (Edgeworth: 0.0665/sqrt(mean)).
    """
    if mean <= 0.0:
        return 0.0
    draw = uint64(0)
    a, b, c, d = philox(x, y, frame, draw, k0, k1)
    u = uniform(a, b)
    if mean < 10.0:
        k, p = 0.0, math.exp(-mean)
        while u > p and k < 200.0:
            u -= p
            k += 1.0
            p *= mean / k
        return k
    root = math.sqrt(mean)
    if mean > 1e8:
        return max(0.0, np.rint(mean + root * normal_quantile(u)))
    bb = 0.931 + 2.53 * root
    aa = -0.059 + 0.02483 * bb
    inverse_alpha = 1.1239 + 1.1328 / (bb - 3.4)
    vr = 0.9277 - 3.6224 / (bb - 2.0)
    while True:
        v = uniform(c, d)
        u -= 0.5
        us = 0.5 - abs(u)
        k = math.floor((2.0 * aa / us + bb) * u + mean + 0.43)
        if us >= 0.07 and v <= vr:
            return k
        if k >= 0.0 and not (us < 0.013 and v > us):
            left = math.log(v * inverse_alpha / (aa / (us * us) + bb))
            if left <= _log_pmf(k, mean):
                return k
        draw += uint64(1)
        a, b, c, d = philox(x, y, frame, draw, k0, k1)
        u = uniform(a, b)


@njit(cache=True, nogil=True)
def _log_pmf(k, mean):
    """log of the Poisson probability of k, without cancellation for large means."""
    if k < 7.0:
        return k * math.log(mean) - mean - math.lgamma(k + 1.0)
    t = (mean - k) / k
    bend = k * (math.log1p(t) - t) if abs(t) > 1e-4 else -k * t * t * (0.5 - t * (1.0 / 3 - t / 4))
    return bend - 0.5 * math.log(2.0 * math.pi * k) - _log_factorial_rest(k)


@njit(cache=True, nogil=True)
def standard_normals(rows, columns, y0, x0, frame, k0, k1):
    """(rows, columns) standard normal draws of the pixels from (y0, x0) on."""
    out = np.empty((rows, columns))
    for r in range(rows):
        for c in range(columns):
            a, b, _, _ = philox(x0 + c, y0 + r, frame, 0, k0, k1)
            out[r, c] = normal_quantile(uniform(a, b))
    return out


@njit(cache=True, nogil=True)
def poisson_image(mean_e, y0, x0, frame, k0, k1):
    """(ny, nx) Poisson draws of an image of means whose first pixel is frame pixel (y0, x0)."""
    out = np.empty_like(mean_e)
    for r in range(mean_e.shape[0]):
        for c in range(mean_e.shape[1]):
            out[r, c] = poisson(mean_e[r, c], x0 + c, y0 + r, frame, k0, k1)
    return out
