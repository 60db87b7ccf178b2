"""What one pixel draws from its own stream: Philox4x32-10, normal quantiles, Poisson numbers."""

from __future__ import annotations

import math

import numpy as np
from numba import njit, uint64

GAUSSIAN_ABOVE = 1e8  # Poisson means above it are drawn as a rounded Gaussian (skew 1e-4)
EXACT_BELOW = 10.0  # and those below it by inversion


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


MIDDLE = 0.425  # how far from the median AS 241 takes the probability for the middle


@njit(cache=True, nogil=True, inline="always")
def central_quantile(q):
    """AS 241's rational function of the middle, |q| <= MIDDLE from the median."""
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


@njit(cache=True, nogil=True)
def normal_quantile(p):
    """Inverse of the normal distribution function, relative error 1e-16 (Wichura 1988, AS 241)."""
    q = p - 0.5
    if abs(q) <= MIDDLE:
        return central_quantile(q)
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


@njit(cache=True, nogil=True, error_model="numpy")
def log_factorial_rest(k):
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
    a, b, c, d = philox(x, y, frame, 0, k0, k1)
    if mean < EXACT_BELOW:
        return inverted_poisson(mean, uniform(a, b))
    if mean > GAUSSIAN_ABOVE:
        return gaussian_poisson(mean, uniform(a, b))
    return rejection_from(mean, uniform(a, b), uniform(c, d), x, y, frame, 0, k0, k1)


@njit(cache=True, nogil=True)
def inverted_poisson(mean, u):
    """Poisson draw of a mean below 10 from one uniform: the distribution function inverted."""
    if mean <= 0.0:
        return 0.0
    k, p = 0.0, math.exp(-mean)
    while u > p and k < 200.0:
        u -= p
        k += 1.0
        p *= mean / k
    return k


@njit(cache=True, nogil=True)
def gaussian_poisson(mean, u):
    """Poisson draw of a mean above 1e8 from one uniform: a rounded Gaussian."""
    return max(0.0, np.rint(mean + math.sqrt(mean) * normal_quantile(u)))


@njit(cache=True, nogil=True)
def rejection_from(mean, u, v, x, y, frame, draw, k0, k1):
    """Poisson draw by PTRS: try `draw` from (u, v), the next ones from the pixel's stream."""
    bb = 0.931 + 2.53 * math.sqrt(mean)
    aa = -0.059 + 0.02483 * bb
    vr = 0.9277 - 3.6224 / (bb - 2.0)
    while True:
        t = u - 0.5
        us = 0.5 - abs(t)
        k = math.floor((2.0 * aa / us + bb) * t + mean + 0.43)
        if (us >= 0.07 and v <= vr) or accepted(k, mean, us, v):
            return k
        draw += 1
        a, b, c, d = philox(x, y, frame, draw, k0, k1)
        u, v = uniform(a, b), uniform(c, d)


@njit(cache=True, nogil=True)
def accepted(k, mean, us, v):
    """Whether PTRS takes a candidate k whose uniforms its quick test did not settle."""
    if k < 0.0 or (us < 0.013 and v > us):
        return False
    bb = 0.931 + 2.53 * math.sqrt(mean)
    aa = -0.059 + 0.02483 * bb
    inverse_alpha = 1.1239 + 1.1328 / (bb - 3.4)
    left = math.log(v * inverse_alpha / (aa / (us * us) + bb))
    return left <= _log_pmf(k, mean)


@njit(cache=True, nogil=True)
def _log_pmf(k, mean):
    """log of the Poisson probability of k, without cancellation for large means."""
    if k < 7.0:
        return k * math.log(mean) - mean - math.lgamma(k + 1.0)
    t = (mean - k) / k
    bend = k * (math.log1p(t) - t) if abs(t) > 1e-4 else -k * t * t * (0.5 - t * (1.0 / 3 - t / 4))
    return bend - 0.5 * math.log(2.0 * math.pi * k) - log_factorial_rest(k)
