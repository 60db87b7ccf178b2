"""Sizes of transforms are those that scipy finds."""

from __future__ import annotations

import pytest
import scipy
from hypothesis import given
from hypothesis import strategies as st

from pipeline.physics.fast_sizes import fast_size


@pytest.mark.parametrize("real", [False, True])
def test_every_small_size_against_scipy(real: bool) -> None:
    for least in range(1, 3000):
        assert fast_size(least, real=real) == scipy.fft.next_fast_len(least, real=real)


@given(st.integers(1, 1 << 24), st.booleans())
def test_large_sizes_against_scipy(least: int, real: bool) -> None:
    assert fast_size(least, real=real) == scipy.fft.next_fast_len(least, real=real)
