"""Columns of numbers to CSV text as the Gaia archive writes it, some million values a second.

Doubles get 16 significant digits, singles 8, trailing zeros dropped, in Java's notation: 0.0,
12.5, 9.1E-4; their size must stay below 9e15. A number is printed as an integer below 2^53 over
a power of ten up to 10^22, so that `as_printed` and every correct parser give the same double
(Clinger 1990, PLDI, "fast path").
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

DOUBLE, SINGLE, WHOLE, TEXT, NAME = range(5)
DOUBLE_TOP, SINGLE_TOP = 9e15, 9e7  # the integers that are printed stay below
NO_WHOLE = np.iinfo(np.int64).min  # an absent integer
FIELD_BYTES = 32
FOURS = np.frombuffer("".join(f"{i:04d}" for i in range(10_000)).encode(), np.uint8)
POWERS = np.array([float(10**i) for i in range(23)])
WHOLE_POWERS = 10 ** np.arange(19)
COMMA, NEWLINE, MINUS, POINT, ZERO, EXPONENT = (ord(c) for c in ",\n-.0E")


@njit(cache=True, nogil=True)
def _decimals(size, top):
    """The most decimals, up to 22, with which size * 10^decimals stays below top; at least 0."""
    decimals = 14 if top > 1e10 else 6
    while decimals > 0 and size * POWERS[decimals] >= top:
        decimals -= 1
    while decimals < 22 and size * POWERS[decimals + 1] < top:
        decimals += 1
    return decimals


@njit(cache=True, nogil=True)
def _as_printed(values, top):
    out = np.empty_like(values)
    for i in range(values.size):
        power = POWERS[_decimals(abs(values[i]), top)]
        out[i] = np.rint(values[i] * power) / power
    return out


def as_printed(values: NDArray[np.float64], kind: int) -> NDArray[np.float64]:
    """What a reader gets for values (n,) printed as DOUBLE or SINGLE; NaN for an empty field."""
    result: NDArray[np.float64] = _as_printed(values, DOUBLE_TOP if kind == DOUBLE else SINGLE_TOP)
    return result


@njit(cache=True, nogil=True)
def _put_digits(out, at, number, digits):
    """Write an integer that has `digits` digits or fewer, with leading zeros."""
    end = at + digits
    while end - at >= 4:
        rest = number // 10_000
        four = 4 * (number - 10_000 * rest)
        end -= 4
        for i in range(4):
            out[end + i] = FOURS[four + i]
        number = rest
    while end > at:
        rest = number // 10
        end -= 1
        out[end] = ZERO + (number - 10 * rest)
        number = rest
    return at + digits


@njit(cache=True, nogil=True)
def _put_whole(out, at, number):
    """Write a non-negative integer; returns where it ends."""
    digits = 1
    while digits < 19 and number >= WHOLE_POWERS[digits]:
        digits += 1
    return _put_digits(out, at, number, digits)


@njit(cache=True, nogil=True)
def _put_real(out, at, value, top):
    """Write a number in Java's notation; nothing for NaN."""
    if np.isnan(value):
        return at
    if value < 0.0:
        out[at] = MINUS
        at += 1
    size = abs(value)
    decimals = _decimals(size, top)
    number = np.rint(size * POWERS[decimals])
    if number == 0.0:
        decimals = 1
    if number == 0.0 or 1e-3 <= size < 1e7:
        whole = np.int64(number / POWERS[decimals])
        rest = np.int64(number) - whole * WHOLE_POWERS[decimals]
        if rest < 0:  # the quotient was rounded up
            whole, rest = whole - 1, rest + WHOLE_POWERS[decimals]
        at = _put_whole(out, at, whole)
        out[at] = POINT
        return _without_zeros(out, _put_digits(out, at + 1, rest, decimals))
    end = _put_whole(out, at + 1, np.int64(number))
    power = end - at - 2 - decimals
    out[at], out[at + 1] = out[at + 1], POINT
    at = _without_zeros(out, end)
    out[at] = EXPONENT
    if power < 0:
        at += 1
        out[at] = MINUS
    return _put_whole(out, at + 1, abs(power))


@njit(cache=True, nogil=True)
def _without_zeros(out, end):
    """The end of a number without its trailing zeros, but for one after the point."""
    while out[end - 1] == ZERO and out[end - 2] != POINT:
        end -= 1
    if out[end - 1] == POINT:
        out[end] = ZERO
        end += 1
    return end


@njit(cache=True, nogil=True)
def _put_text(out, at, texts, number):
    for i in range(texts.shape[1]):
        if texts[number, i] == 0:
            return at + i
        out[at + i] = texts[number, i]
    return at + texts.shape[1]


@njit(cache=True, nogil=True)
def _put_rows(out, kinds, reals, wholes, texts):
    """Write all rows; returns the number of bytes. Text 0 stands before a NAME's number."""
    at = 0
    for row in range(reals.shape[1]):
        real, whole = 0, 0
        for kind in kinds:
            if kind in (DOUBLE, SINGLE):
                top = DOUBLE_TOP if kind == DOUBLE else SINGLE_TOP
                at = _put_real(out, at, reals[real, row], top)
                real += 1
            else:
                number = wholes[whole, row]
                whole += 1
                if kind == TEXT:
                    at = _put_text(out, at, texts, number)
                elif number != NO_WHOLE:
                    if kind == NAME:
                        at = _put_text(out, at, texts, 0)
                    at = _put_whole(out, at, number)
            out[at] = COMMA
            at += 1
        out[at - 1] = NEWLINE
    return at


def rows_of_text(
    kinds: Sequence[int], columns: Sequence[NDArray[np.generic]], texts: Sequence[str]
) -> memoryview:
    """CSV lines of columns (n,) each, without a header.

    kinds : of each column: DOUBLE or SINGLE (floats, NaN for empty), WHOLE (integers from 0,
    NO_WHOLE for empty), TEXT (numbers in `texts`), NAME (text 0, then the integer).
    """
    real = [c for c, kind in zip(columns, kinds, strict=True) if kind in (DOUBLE, SINGLE)]
    whole = [c for c, kind in zip(columns, kinds, strict=True) if kind not in (DOUBLE, SINGLE)]
    letters = np.array([text.encode() for text in texts], dtype=bytes)
    letters = letters.view(np.uint8).reshape(len(texts), -1)
    rows = columns[0].size
    reals = np.array(real, np.float64).reshape(len(real), rows)
    wholes = np.array(whole, np.int64).reshape(len(whole), rows)
    out = np.empty(len(columns) * (FIELD_BYTES + letters.shape[1]) * rows + 1, np.uint8)
    size = _put_rows(out, np.array(kinds, np.uint8), reals, wholes, letters)
    return out[:size].data
