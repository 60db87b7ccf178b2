"""Paths as points: the light of each has the same transfer function up to a band."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.physics.motion.points import (
    SEEN,
    bend_px,
    points_along,
    points_of_many,
    points_per_px,
)
from pipeline.physics.motion.streak import POINT, Path

NODE = st.floats(-300.0, 300.0)


def transfer_of(path: Path, fx: np.ndarray, fy: np.ndarray) -> np.ndarray:
    """Of light that falls evenly along each segment, in closed form (sinc)."""
    out = np.zeros(len(fx), complex)
    for i, weight in enumerate(path.weight):
        (xa, xb), (ya, yb) = path.x_px[i : i + 2], path.y_px[i : i + 2]
        middle = fx * 0.5 * (xa + xb) + fy * 0.5 * (ya + yb)
        out += weight * np.sinc(fx * (xb - xa) + fy * (yb - ya)) * np.exp(-2j * np.pi * middle)
    return out


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(NODE, NODE), min_size=2, max_size=6), st.floats(0.2, 6.0),
       st.integers(0, 2**31))  # fmt: skip
def test_points_have_the_transfer_function_of_their_path(nodes, band, seed):
    rng = np.random.default_rng(seed)
    weight = rng.uniform(0.1, 1.0, len(nodes) - 1)
    path = Path(*np.array(nodes).T, weight / weight.sum())
    x, y, share = points_along(path, band)
    radius, angle = band * np.sqrt(rng.uniform(0, 1, 50)), rng.uniform(0, 2 * np.pi, 50)
    fx, fy = radius * np.cos(angle), radius * np.sin(angle)
    found = np.exp(-2j * np.pi * (np.outer(fx, x) + np.outer(fy, y))) @ share
    assert np.abs(found - transfer_of(path, fx, fy)).max() <= SEEN + 1e-11
    assert share.sum() == pytest.approx(1.0, abs=1e-12)
    assert (share > 0.0).all()


def test_few_points_serve():
    line = Path(np.array([0.0, 240.0]), np.array([0.0, 320.0]), np.ones(1))
    x, y, share = points_along(line, 1.3)
    assert len(x) == len(y) == len(share) <= 1.1 * 400.0 * points_per_px(1.3)
    assert points_per_px(1.3) < 3.0
    x, y, share = points_along(POINT, 1.3)
    np.testing.assert_array_equal([x, y, share], [[0.0], [0.0], [1.0]])
    dark = Path(np.array([0.0, 3.0, 9.0]), np.zeros(3), np.zeros(2))
    assert all(len(found) == 0 for found in points_along(dark, 1.3))


WAYS = {  # x and y [px] over the exposure, and nodes that they are known at
    "even": (lambda t: 20.0 * t, lambda t: 3.0 * t, 9),
    "faster": (lambda t: 60.0 * t * t, lambda t: 9.0 * t**3, 9),
    "bent": (lambda t: 60.0 * t * t, lambda t: 20.0 * np.sin(3.0 * t), 65),
    "round": (lambda t: 25.0 * np.cos(2.0 * t), lambda t: 25.0 * np.sin(2.0 * t), 17),
    "still": (lambda t: 0.0 * t, lambda t: 0.0 * t, 9),
}


@pytest.mark.parametrize("band", [0.5, 3.0])
def test_points_of_many_sources_follow_each_as_far_as_its_nodes_tell(band):
    """All have the points that the fastest needs; against quadrature of the paths themselves."""
    at, weight = np.polynomial.legendre.leggauss(3000)
    for x, y, count in WAYS.values():
        t = np.linspace(0.0, 1.0, count)
        offsets = np.array([[x(t), 0.1 * x(t)], [y(t), -y(t)]])
        (px, py), share = points_of_many(offsets, band)
        assert share.sum() == pytest.approx(1.0, abs=1e-12)
        fine = 0.5 * (at + 1.0)
        for i, (along_x, along_y) in enumerate([(x(fine), y(fine)), (0.1 * x(fine), -y(fine))]):
            off_px = bend_px(offsets[:, i])
            for angle in np.linspace(0.0, np.pi, 7):
                fx, fy = 0.99 * band * np.cos(angle), 0.99 * band * np.sin(angle)
                found = np.exp(-2j * np.pi * (fx * px[i] + fy * py[i])) @ share
                exact = 0.5 * np.exp(-2j * np.pi * (fx * along_x + fy * along_y)) @ weight
                assert abs(found - exact) <= 2.0 * np.pi * band * off_px + SEEN
