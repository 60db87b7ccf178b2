"""Rows that are exposed later than others: places moved on along their motion."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.physics.motion.rolling import later, row_delay_s


@pytest.mark.parametrize("delay_s", [-0.4, 0.0, 0.7, 12.0])
def test_a_parabola_is_followed_wherever_its_times_begin(delay_s: float) -> None:
    def place(t: np.ndarray) -> np.ndarray:
        return np.stack([2.0 - 1.5 * t + 0.25 * t**2, 7.0 + 3.0 * t - 0.1 * t**2])

    time_s = np.linspace(3.0, 8.0, 9)
    moved = later(place(time_s), time_s[None], delay_s)
    np.testing.assert_allclose(moved, place(time_s + delay_s), rtol=0, atol=1e-12)


def test_delays_of_rows_from_either_side() -> None:
    """A frame of 100 rows, 2 ms a row; the last one first where the time is negative."""
    rows = np.array([0.0, 10.5, 99.0])
    assert row_delay_s(rows, 2e-3, 100) == pytest.approx([0.0, 0.021, 0.198])
    assert row_delay_s(rows, -2e-3, 100) == pytest.approx([0.198, 0.177, 0.0])
