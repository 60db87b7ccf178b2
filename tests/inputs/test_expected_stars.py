"""The share of a disc that another covers: counted, and at its ends."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.inputs.stars import disc_share


@pytest.mark.parametrize(
    ("apart", "radius", "other"),
    [(0.5, 1.0, 0.8), (0.9, 0.3, 1.0), (1.2, 1.0, 0.4), (0.1, 2.0, 0.5), (0.2, 0.3, 5.0)],
)
def test_shares_are_those_counted(apart: float, radius: float, other: float) -> None:
    rng = np.random.default_rng(4)
    x, y = rng.uniform(-radius, radius, (2, 400_000))
    within = np.hypot(x, y) < radius
    counted = (np.hypot(x[within] - apart, y[within]) < other).mean()
    found = disc_share(np.array([apart]), np.array([radius]), other)[0]
    assert found == pytest.approx(counted, abs=0.005)


@pytest.mark.parametrize("radius", [0.0, 1e-15, 1e-12, 1e-9, 1e-6])
def test_tiny_discs_are_in_or_out(radius: float) -> None:
    """A row group of one star has a cap without size; no share is above 1 or below 0."""
    apart = np.array([0.0, 0.01, 0.02 - 2e-6, 0.02 + 2e-6, 0.5, 2.0])
    found = disc_share(apart, np.full(6, radius), 0.02)
    assert found.tolist() == [1.0, 1.0, 1.0, 0.0, 0.0, 0.0]
    edge = disc_share(np.linspace(0.0199, 0.0201, 1001), np.full(1001, radius), 0.02)
    assert ((edge >= 0.0) & (edge <= 1.0)).all()
