"""Loops over a run of pixels that vectorise: random words, normal quantiles, Poisson draws."""

from __future__ import annotations

import numpy as np
from numba import int64, njit, uint64

from pipeline.physics.noise.pixel_draws import (
    MIDDLE,
    accepted,
    central_quantile,
    inverted_poisson,
    log_factorial_rest,
    normal_quantile,
    rejection_from,
)

RUN_PX = 512
FEW = 12  # so few pixels are not worth a loop of their own
LOW_GUARD = 1e-11  # how near a cumulative probability the approximate inversion may not decide
TEST_GUARD = 1e-7  # and how near equality the approximate acceptance test
_TWO_52_BITS = 0x4330000000000000  # the double 2^52, whose last 52 bits count ones
_INVERSE = 1.0 / np.maximum(np.arange(201.0), 1.0)


@njit(cache=True, nogil=True, inline="always")
def _round(c0, c1, c2, c3, k0, k1):
    """One round of Philox4x32 on words below 2^32."""
    low = uint64(0xFFFFFFFF)
    p0 = uint64(0xD2511F53) * c0
    p1 = uint64(0xCD9E8D57) * c2
    return (p1 >> uint64(32)) ^ c1 ^ k0, p1 & low, (p0 >> uint64(32)) ^ c3 ^ k1, p0 & low


@njit(cache=True, nogil=True, error_model="numpy")
def words(n, x, y, frame, draw, k0, k1, first, second):
    """Philox4x32-10 of the pixels (x[i], y): two uniforms each, as doubles in [2^52, 2^53)."""
    low = uint64(0xFFFFFFFF)
    a, b = uint64(0x9E3779B9), uint64(0xBB67AE85)
    p0, p1 = uint64(k0), uint64(k1)
    q0, q1 = (p0 + a) & low, (p1 + b) & low
    r0, r1 = (q0 + a) & low, (q1 + b) & low
    s0, s1 = (r0 + a) & low, (r1 + b) & low
    t0, t1 = (s0 + a) & low, (s1 + b) & low
    u0, u1 = (t0 + a) & low, (t1 + b) & low
    v0, v1 = (u0 + a) & low, (u1 + b) & low
    w0, w1 = (v0 + a) & low, (v1 + b) & low
    x0, x1 = (w0 + a) & low, (w1 + b) & low
    y0, y1 = (x0 + a) & low, (x1 + b) & low
    row, third, fourth = uint64(y), uint64(frame), uint64(draw)
    exponent = uint64(_TWO_52_BITS)
    for i in range(n):
        c0, c1, c2, c3 = _round(x[i] & low, row, third, fourth, p0, p1)
        c0, c1, c2, c3 = _round(c0, c1, c2, c3, q0, q1)
        c0, c1, c2, c3 = _round(c0, c1, c2, c3, r0, r1)
        c0, c1, c2, c3 = _round(c0, c1, c2, c3, s0, s1)
        c0, c1, c2, c3 = _round(c0, c1, c2, c3, t0, t1)
        c0, c1, c2, c3 = _round(c0, c1, c2, c3, u0, u1)
        c0, c1, c2, c3 = _round(c0, c1, c2, c3, v0, v1)
        c0, c1, c2, c3 = _round(c0, c1, c2, c3, w0, w1)
        c0, c1, c2, c3 = _round(c0, c1, c2, c3, x0, x1)
        c0, c1, c2, c3 = _round(c0, c1, c2, c3, y0, y1)
        first[i] = (c0 << uint64(20)) | (c1 >> uint64(12)) | exponent
        second[i] = (c2 << uint64(20)) | (c3 >> uint64(12)) | exponent


@njit(cache=True, nogil=True, error_model="numpy")
def to_uniforms(n, values):
    """In place: doubles in [2^52, 2^53) to uniforms in (0, 1); every step is exact."""
    for i in range(n):
        values[i] = ((values[i] - 4503599627370496.0) + 0.5) * 2.220446049250313e-16


@njit(cache=True, nogil=True, error_model="numpy")
def count_below(n, values, limit):
    """How many of n values are below a limit."""
    count = 0
    for i in range(n):
        count += 1 if values[i] < limit else 0
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def quantiles(n, p, out):
    """Normal quantiles of n probabilities: the middle's for all, then those beyond it anew."""
    for i in range(n):
        out[i] = central_quantile(p[i] - 0.5)
    for i in range(n):
        if abs(p[i] - 0.5) > MIDDLE:
            out[i] = normal_quantile(p[i])


@njit(cache=True, nogil=True, error_model="numpy")
def _exp_of_minus(n, mean, out):
    """exp(-mean) for means of 0 to 10, relative error 1e-13: Taylor's series of 1/16, squared."""
    for i in range(n):
        t = -0.0625 * mean[i]
        e = 1.0 + t / 13.0
        e = 1.0 + t * (1.0 / 12.0) * e
        e = 1.0 + t * (1.0 / 11.0) * e
        e = 1.0 + t * (1.0 / 10.0) * e
        e = 1.0 + t * (1.0 / 9.0) * e
        e = 1.0 + t * (1.0 / 8.0) * e
        e = 1.0 + t * (1.0 / 7.0) * e
        e = 1.0 + t * (1.0 / 6.0) * e
        e = 1.0 + t * (1.0 / 5.0) * e
        e = 1.0 + t * (1.0 / 4.0) * e
        e = 1.0 + t * (1.0 / 3.0) * e
        e = 1.0 + t * 0.5 * e
        e = 1.0 + t * e
        e = e * e
        e = e * e
        e = e * e
        out[i] = e * e


@njit(cache=True, nogil=True, error_model="numpy")
def _count(n, mean, step, p, rest, k, near):
    """Four steps of the inversion for all; `rest` is negative where the number is reached."""
    a, b, c, d = _INVERSE[step], _INVERSE[step + 1], _INVERSE[step + 2], _INVERSE[step + 3]
    for i in range(n):
        m, p0 = mean[i], p[i]
        p1 = p0 * (m * a)
        p2 = p1 * (m * b)
        p3 = p2 * (m * c)
        p[i] = p3 * (m * d)
        r0 = rest[i] - p0
        r1 = r0 - p1
        r2 = r1 - p2
        r3 = r2 - p3
        rest[i] = r3
        low = (1.0 if r0 > 0.0 else 0.0) + (1.0 if r1 > 0.0 else 0.0)
        k[i] += low + (1.0 if r2 > 0.0 else 0.0) + (1.0 if r3 > 0.0 else 0.0)
        near[i] = min(near[i], abs(r0), abs(r1), abs(r2), abs(r3))


@njit(cache=True, nogil=True, error_model="numpy")
def _any_positive(n, values):
    for i in range(n):  # noqa: SIM110 - numba has no any()
        if values[i] > 0.0:
            return True
    return False


@njit(cache=True, nogil=True, error_model="numpy")
def draw_low(n, mean, u, k, scratch):
    """Poisson draws k of n means below 10, by inversion: k where the sum of probabilities passes u.

    scratch : (3 or more, RUN_PX)
    """
    p, rest, near = scratch[0], scratch[1], scratch[2]
    for i in range(n):
        rest[i], k[i], near[i] = u[i], 0.0, 1.0
    _exp_of_minus(n, mean, p)
    for step in range(1, 200, 4):
        _count(n, mean, step, p, rest, k, near)
        if not _any_positive(n, rest):
            break
    for i in range(n):
        if near[i] < LOW_GUARD:
            k[i] = inverted_poisson(mean[i], u[i])


@njit(cache=True, nogil=True, error_model="numpy")
def draw_low_among(which, mean, u, out, scratch):
    """`draw_low` of the pixels `which` of a run. scratch : (6 or more, RUN_PX)"""
    m, v, k = scratch[3], scratch[4], scratch[5]
    for j in range(which.size):
        m[j], v[j] = mean[which[j]], u[which[j]]
    draw_low(which.size, m, v, k, scratch)
    for j in range(which.size):
        out[which[j]] = k[j]


@njit(cache=True, nogil=True, error_model="numpy")
def _candidates(n, mean, u, v, k, us, settled):
    """PTRS candidates, and 1 where the quick test takes them, else 0."""
    for i in range(n):
        m = mean[i]
        bb = 0.931 + 2.53 * np.sqrt(m)
        aa = -0.059 + 0.02483 * bb
        vr = 0.9277 - 3.6224 / (bb - 2.0)
        t = u[i] - 0.5
        s = 0.5 - abs(t)
        k[i] = np.floor((2.0 * aa / s + bb) * t + m + 0.43)
        us[i] = s
        settled[i] = 1.0 if (s >= 0.07) & (v[i] <= vr) else 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def _arguments(n, k, mean, us, v, w, bend):
    """Of the acceptance test log(w) <= bend in doubt: w, and the bend of log(k) about the mean.

    bend is NaN where its series does not hold (far tails and few electrons).
    """
    for i in range(n):
        bb = 0.931 + 2.53 * np.sqrt(mean[i])
        aa = -0.059 + 0.02483 * bb
        inverse_alpha = 1.1239 + 1.1328 / (bb - 3.4)
        safe = max(k[i], 1.0)
        scale = inverse_alpha * np.sqrt(6.283185307179586 * safe)
        w[i] = v[i] * scale / (aa / (us[i] * us[i]) + bb)
        s = (mean[i] - safe) / (mean[i] + safe)
        q = s * s
        odd = 1 / 3.0 + q * (
            1 / 5.0
            + q
            * (
                1 / 7.0
                + q * (1 / 9.0 + q * (1 / 11.0 + q * (1 / 13.0 + q * (1 / 15.0 + q / 17.0))))
            )
        )
        value = 2.0 * safe * q * (s * odd - 1.0 / (1.0 - s)) - log_factorial_rest(safe)
        bend[i] = value if (q < 0.09) & (k[i] >= 4.0) else np.nan


@njit(cache=True, nogil=True, error_model="numpy")
def _logarithms(n, values, bits, part, part_bits, power, power_bits):
    """In place: logarithms of positive doubles to 1e-9 (`bits` shares the memory of `values`)."""
    exponent, mantissa = uint64(_TWO_52_BITS), uint64(0x000FFFFFFFFFFFFF)
    for i in range(n):
        power_bits[i] = (bits[i] >> uint64(52)) | exponent
        part_bits[i] = (bits[i] & mantissa) | uint64(0x3FF0000000000000)
    for i in range(n):
        s = (part[i] - 1.5) / (part[i] + 1.5)
        q = s * s
        odd = 1.0 + q * (1 / 3.0 + q * (1 / 5.0 + q * (1 / 7.0 + q * (1 / 9.0 + q / 11.0))))
        whole = power[i] - 4503599627371519.0  # 2^52 and the exponent's bias of 1023
        values[i] = 0.6931471805599453 * whole + 0.4054651081081644 + 2.0 * s * odd


@njit(cache=True, nogil=True, error_model="numpy")
def draw_middle(which, mean_e, u_of, v_of, place, out, scratch, ints):
    """Poisson draws of the pixels `which`, of means of 10 to 1e8, by PTRS.

    which : indices of pixels (x_of[i], y); u_of, v_of : uniforms of their first try; place : (x_of,
    y, frame, k0, k1). Those that a try rejects go on to the next one together.
    """
    n, (x_of, y, frame, k0, k1) = which.size, place
    mean, k, us, w, bend = scratch[0], scratch[1], scratch[2], scratch[3], scratch[4]
    part, power, settled = scratch[5], scratch[6], scratch[7]
    u, v = scratch[8], scratch[9]
    first, second, x, at, doubtful = ints[0], ints[1], ints[2], ints[3], ints[4]
    w_bits, part_bits, power_bits = w.view(np.uint64), part.view(np.uint64), power.view(np.uint64)
    for j in range(n):
        i = which[j]
        at[j], mean[j], u[j], v[j] = i, mean_e[i], u_of[i], v_of[i]
    draw = int64(0)  # typed, as all counts are: a literal would compile callees once more
    while n > FEW:
        _candidates(n, mean, u, v, k, us, settled)
        doubts = int64(0)
        for j in range(n):
            out[at[j]] = k[j]
            doubtful[doubts] = j
            doubts += settled[j] == 0.0
        for i in range(doubts):
            j = doubtful[i]
            at[i], mean[i], k[i], us[i], v[i] = at[j], mean[j], k[j], us[j], v[j]
        _arguments(doubts, k, mean, us, v, w, bend)
        _logarithms(doubts, w, w_bits, part, part_bits, power, power_bits)
        n = int64(0)
        for i in range(doubts):
            over = w[i] - bend[i]
            taken = over < 0.0
            if not abs(over) > TEST_GUARD:
                taken = accepted(k[i], mean[i], us[i], v[i])
            taken &= (k[i] >= 0.0) & ((us[i] >= 0.013) | (v[i] <= us[i]))
            at[n], mean[n], x[n] = at[i], mean[i], x_of[at[i]]
            n += not taken
        draw += 1
        words(n, x, y, frame, draw, k0, k1, first, second)
        u, v = first.view(np.float64), second.view(np.float64)
        to_uniforms(n, u)
        to_uniforms(n, v)
    for i in range(n):
        column = int64(x_of[at[i]])
        out[at[i]] = rejection_from(mean[i], u[i], v[i], column, y, frame, draw, k0, k1)
