"""Sizes whose Fourier transforms are quick: whole numbers without large prime factors.

As `scipy.fft.next_fast_len` gives them, whose import takes longer than most scenes' planning.
"""

from __future__ import annotations

from functools import cache


@cache
def fast_size(least: int, *, real: bool = False) -> int:
    """The smallest number from `least` on with no prime factor above 11, or 5 for real data."""
    size = max(1, least)
    while not _smooth(size, 5 if real else 11):
        size += 1
    return size


def _smooth(number: int, largest: int) -> bool:
    for prime in (2, 3, 5, 7, 11):
        while prime <= largest and number % prime == 0:
            number //= prime
    return number == 1
