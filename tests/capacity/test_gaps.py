"""Gap times against a count by hand, object by object."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.capacity.gaps import gap_times


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 4), st.floats(1.0, 9_999.0)), max_size=40))
def test_against_a_count_by_hand(rows: list[tuple[int, float]]) -> None:
    who, when = np.array([r[0] for r in rows], np.int64), np.array([r[1] for r in rows])
    found = gap_times(who, when, 5, 10_000.0, 500.0)
    for i in range(5):
        times = sorted(t for k, t in rows if k == i)
        gaps = np.diff([0.0, *times, 10_000.0])
        np.testing.assert_allclose(found.median_s[i], np.median(gaps), atol=1e-8)
        np.testing.assert_allclose(found.p95_s[i], np.percentile(gaps, 95), atol=1e-8)
        np.testing.assert_allclose(found.longest_s[i], gaps.max(), atol=1e-8)
        first = times[0] if times else np.nan
        np.testing.assert_allclose(found.first_s[i], first, atol=1e-8)
        wanted = np.diff(times).mean() if len(times) > 1 else np.nan
        np.testing.assert_allclose(found.revisit_s[i], wanted, atol=1e-6)
        clock = np.arange(0.5, 10_000.0)
        ages = clock[:, None] - np.array(times)[None, :]
        held = ((ages >= 0) & (ages < 500.0)).any(axis=1).mean() if times else 0.0
        assert abs(found.custody[i] - held) < 0.001 * (1 + len(times))


def test_a_detection_after_the_end_makes_no_gap_below_zero() -> None:
    found = gap_times(np.array([0, 0]), np.array([500.0, 1012.0]), 1, 1000.0, 100.0)
    np.testing.assert_array_equal(found.all_s, [500.0, 500.0, 0.0])
    np.testing.assert_allclose(found.custody, [0.1])
