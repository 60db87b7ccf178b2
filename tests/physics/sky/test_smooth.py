"""Slow functions over a frame: few calls where a polynomial is proved, all calls else."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.physics.sky.smooth import NODES, smooth


def counted(light):
    calls = []

    def evaluate(x, y):
        calls.append(len(x))
        return light(x, y)

    return evaluate, calls


@pytest.mark.parametrize(
    ("light", "few"),
    [
        (lambda x, y: 5.0 / (1.0 + 1e-3 * x + 2e-3 * y) ** 2, True),
        (lambda x, y: np.exp(-np.abs(x - 40.0) / 10.0), False),
        (lambda x, y: np.where(x > 30.0, x, 0.0), False),
    ],
    ids=["smooth", "kink", "zero"],
)
def test_few_calls_only_where_it_is_exact(light, few):
    evaluate, calls = counted(light)
    y, x = (a.ravel() for a in np.mgrid[-0.5:59.5:61j, -0.5:79.5:81j])
    np.testing.assert_allclose(smooth(evaluate, 60, 80, x, y), light(x, y), rtol=2e-5)
    assert sum(calls) == NODES**2 + 16 + (0 if few else x.size)
    assert smooth(evaluate, 60, 80, x[:9], y[:9]) == pytest.approx(light(x[:9], y[:9]))


@pytest.mark.parametrize("height", [3.0, -0.9])
def test_a_spot_between_the_nodes_is_not_smoothed_away(height):
    """Brighter or darker than its surroundings: found at one of the places that prove."""
    x0, y0 = (half * (1.0 + np.cos(0.3 * np.pi)) - 0.5 for half in (40.0, 30.0))

    def light(x, y):
        return 1.0 + height * np.exp(-((x - x0) ** 2 + (y - y0) ** 2) / 0.3)

    y, x = (a.ravel() for a in np.mgrid[-0.5:59.5:61j, -0.5:79.5:81j])
    np.testing.assert_allclose(smooth(light, 60, 80, x, y), light(x, y), rtol=2e-5)
