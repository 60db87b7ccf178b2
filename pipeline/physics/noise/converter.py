"""The analogue-to-digital converter: bias, rounding, and the ends of its range."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Value = float | Array

_INT64 = np.iinfo(np.int64)
EXACT_BITS = 40  # above, a float64 holds too few binary places beside the whole number


def digitise(
    signal_dn: Array, bias_dn: Value, adc_bits: int, rounding: str = "half_even"
) -> NDArray[np.integer]:
    """Add the bias, round and clip to 0 ... 2^N - 1; the smallest unsigned type that holds it.

    Above 40 bits whole parts are added as integers and fractions apart: a float64 holds too few
    binary places beside such numbers, and 2^63 - 1 would round up to 2^63 and come back negative.
    """
    top = (1 << adc_bits) - 1
    if adc_bits <= EXACT_BITS:
        levels = np.asarray(signal_dn + bias_dn)
        (np.rint if rounding == "half_even" else np.floor)(levels, out=levels)
        np.clip(levels, 0.0, float(top), out=levels)
        return levels.astype(dn_type(adc_bits))
    signal, signal_rest = _whole_and_rest(signal_dn)
    bias, bias_rest = _whole_and_rest(np.broadcast_to(bias_dn, np.shape(signal_dn)))
    total, rest = _saturated_sum(signal, bias), signal_rest + bias_rest
    odd = (total & 1).astype(float)
    more = np.rint(odd + rest) - odd if rounding == "half_even" else np.floor(rest)
    total = np.where(total > _INT64.max - 2, total, total + more.astype(np.int64))
    full = signal_dn + bias_dn >= 2.0**63
    return np.where(full, top, np.clip(total, 0, top)).astype(dn_type(adc_bits))


def dn_type(adc_bits: int) -> np.dtype[np.unsignedinteger]:
    """The smallest unsigned integer type that holds `adc_bits` bits."""
    size = next(s for s in (8, 16, 32, 64) if s >= adc_bits)
    return np.dtype(f"uint{size}")


def _whole_and_rest(value: Array) -> tuple[NDArray[np.int64], Array]:
    """Largest whole number below, saturating at both ends of int64, and what is above it."""
    limit = 2.0**63
    inside = np.clip(np.asarray(value, float), -limit, limit)
    whole = np.floor(inside)
    safe = np.minimum(whole, np.nextafter(limit, 0.0)).astype(np.int64)
    return np.where(whole >= limit, _INT64.max, safe), inside - whole


def _saturated_sum(a: NDArray[np.int64], b: NDArray[np.int64]) -> NDArray[np.int64]:
    """a + b, held at the ends of int64 instead of wrapping."""
    low, high = _INT64.min - np.minimum(b, 0), _INT64.max - np.maximum(b, 0)
    return np.clip(a, low, high) + b
