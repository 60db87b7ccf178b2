"""Grids over a frame: as coarse as the tolerance allows, the same whatever the tiles."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.physics.sky.grid import MOST_INTERVALS, at_nodes, refine, tile_light


def curved(a, b, c, d):
    def light(x, y):
        return 50.0 + a * x + b * y + c * x * x + d * x * y + 3.0 * np.sin(x / 40.0) * c

    return light


COEFFICIENT = st.floats(-0.02, 0.02)


@settings(max_examples=60)
@given(COEFFICIENT, COEFFICIENT, COEFFICIENT, COEFFICIENT, st.floats(0.1, 5.0))
def test_error_in_every_pixel_is_what_it_says(a, b, c, d, tolerance):
    light = curved(a, b, c, d)
    rows, columns = 61, 90
    grid = refine(light, rows, columns, tolerance)
    y, x = np.mgrid[:rows, :columns].astype(float)
    got = tile_light(grid.values, (rows, columns), (0, 0), (rows, columns))
    off = np.abs(got - light(x, y)).max()
    assert off <= 1.1 * grid.error + 1e-9
    assert grid.met == (grid.error <= tolerance)


def test_uniform_where_the_tolerance_allows():
    grid = refine(lambda x, y: 10.0 + 0.001 * x, 100, 100, 0.051)
    assert grid.values.shape == (1, 1)
    assert grid.values[0, 0] == pytest.approx(10.0495)
    assert refine(lambda x, y: 10.0 + 0.001 * x, 100, 100, 0.049).values.shape == (2, 2)


def test_several_frames_share_the_finest_grid_needed():
    def light(x, y):
        return np.stack([np.full_like(x, 3.0), 3.0 + np.sin(x / 9.0)])

    grid = refine(light, 64, 64, 0.01)
    assert grid.values.shape[0] == 2
    assert grid.values.shape[1] == grid.values.shape[2] > 5


def test_limits_a_jump_ends_at_the_finest_and_says_so():
    grid = refine(lambda x, y: np.where(x > 31.7, 1.0, 0.0), 1100, 1100, 1e-3)
    assert not grid.met
    assert grid.error > 1e-3
    assert grid.values.shape[-1] == MOST_INTERVALS + 1


def test_a_small_frame_has_each_pixel_by_itself_where_light_is_not_smooth():
    """Nodes at all half pixels: exact, and fewer than the finest grid has."""
    rows, columns = 70, 41
    grid = refine(lambda x, y: np.where(x > 20.2, 1.0, y), rows, columns, 1e-9)
    assert grid.met
    assert grid.values.shape == (2 * rows + 1, 2 * columns + 1)
    y, x = np.mgrid[:rows, :columns].astype(float)
    got = tile_light(grid.values, (rows, columns), (0, 0), (rows, columns))
    np.testing.assert_allclose(got, np.where(x > 20.2, 1.0, y), atol=1e-12)


@settings(max_examples=25)
@given(st.integers(1, 9), st.integers(1, 9), st.integers(5, 40))
def test_same_bits_in_any_tile(ny, nx, size):
    rows, columns = 83, 67
    values = np.random.default_rng(1).random((ny, nx)) if ny * nx > 1 else np.ones((1, 1))
    if min(ny, nx) == 1:
        values = np.ones((1, 1)) * 0.3
    whole = tile_light(values, (rows, columns), (0, 0), (rows, columns))
    for y in range(0, rows, size):
        for x in range(0, columns, size):
            part = (min(size, rows - y), min(size, columns - x))
            got = tile_light(values, (rows, columns), (y, x), part)
            np.testing.assert_array_equal(got, whole[y : y + part[0], x : x + part[1]])


def test_one_node_stands_for_the_same_value_in_every_frame():
    """Frames between knots get what those get: half way between least and largest."""

    def light(x, y):
        return np.stack([10.0 + 0.001 * x, 20.0 - 0.001 * y])

    even = refine(light, 100, 80, 0.06).values
    assert even.shape == (2, 1, 1)
    np.testing.assert_allclose(even.ravel(), [10.0395, 19.9505], rtol=1e-12)
    np.testing.assert_array_equal(at_nodes(light, 100, 80, 1, 1), even)
