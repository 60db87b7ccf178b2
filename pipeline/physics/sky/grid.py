"""Smooth light on a small grid over the frame, refined until interpolation is good enough."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Evaluate = Callable[[Array, Array], Array]  # x, y (n,) [px] -> light (..., n)

FIRST_INTERVALS, MOST_INTERVALS = 8, 1024
MOST_VALUES = 4_000_000  # of light, in all that a grid is compared with
STALLED = 0.5  # of the error before: smooth light falls to a quarter from grid to grid


@dataclass(frozen=True, eq=False)
class FrameGrid:
    """Light at nodes over a frame; (..., 1, 1) is uniform.

    values : (..., ny, nx) float64; nodes are evenly spaced, the first and last at the outer edges
        of the frame (pixel coordinates -0.5 and n - 0.5)
    error : largest difference from the light itself that was found, half way between nodes
    met : whether that is within what was asked
    """

    rows: int
    columns: int
    values: Array
    error: float
    met: bool


def refine(evaluate: Evaluate, rows: int, columns: int, tolerance: float) -> FrameGrid:
    """The coarsest grid that errs by at most a tolerance: uniform, 1, 2, 4... intervals an axis.

    Each grid is compared with the light at the nodes of the next finer one, where bilinear
    interpolation errs most. Beyond MOST_INTERVALS light that is not smooth is refined no more, and
    none beyond MOST_VALUES. Where half pixels are fewer, nodes there are exact at every pixel.
    """
    intervals = FIRST_INTERVALS
    fine = at_nodes(evaluate, rows, columns, intervals + 1, intervals + 1)
    low, high = fine.min(axis=(-2, -1)), fine.max(axis=(-2, -1))
    error = float(np.max(0.5 * (high - low)))
    if error <= tolerance:
        middle = (0.5 * (low + high))[..., None, None]
        return FrameGrid(rows, columns, middle, error, True)
    for step in (8, 4, 2):
        coarse = fine[..., ::step, ::step]
        error = _error(coarse, fine)
        if error <= tolerance:
            return FrameGrid(rows, columns, coarse.copy(), error, True)
    while True:
        coarse, before, intervals = fine, error, 2 * intervals
        if intervals**2 >= 4 * rows * columns:
            exact = at_nodes(evaluate, rows, columns, 2 * rows + 1, 2 * columns + 1)
            return FrameGrid(rows, columns, exact, 0.0, True)
        fine = at_nodes(evaluate, rows, columns, intervals + 1, intervals + 1)
        error = _error(coarse, fine)
        if error <= tolerance or _finest(intervals, error > STALLED * before, fine.size):
            return FrameGrid(rows, columns, coarse, error, error <= tolerance)


def _finest(intervals: int, stalled: bool, values: int) -> bool:
    """Whether no finer grid is tried."""
    return intervals > MOST_INTERVALS and (stalled or 4 * values > MOST_VALUES)


def tile_light(
    values: Array, shape: tuple[int, int], corner: tuple[int, int], size: tuple[int, int]
) -> Array:
    """Light (rows, columns) of a part of a frame: the same for each pixel whatever the part.

    values : (ny, nx) of a FrameGrid; shape : of the frame; corner : first row and column
    """
    if values.size == 1:
        return np.full(size, values[0, 0])
    i, u = _between(shape[0], values.shape[0], corner[0], size[0])
    j, v = _between(shape[1], values.shape[1], corner[1], size[1])
    rows = values[i] * (1.0 - u)[:, None] + values[i + 1] * u[:, None]
    light: Array = rows[:, j] * (1.0 - v)
    light += rows[:, j + 1] * v
    return light


def light_at(values: Array, shape: tuple[int, int], x_px: Array, y_px: Array) -> Array:
    """Light (n,) at places in a frame, of the nearest place in it beside it; as of `tile_light`."""
    if values.size == 1:
        return np.full(len(x_px), values[0, 0])
    (i, u), (j, v) = (
        _interval(np.clip(at, 0.0, pixels - 1.0), pixels, nodes)
        for at, pixels, nodes in zip((y_px, x_px), shape, values.shape, strict=True)
    )
    low, high = (values[k, j] * (1.0 - v) + values[k, j + 1] * v for k in (i, i + 1))
    return np.asarray(low * (1.0 - u) + high * u)


def _between(pixels: int, nodes: int, start: int, count: int) -> tuple[NDArray[np.intp], Array]:
    """The interval of each pixel centre along an axis, and where in it."""
    return _interval(np.arange(start, start + count, dtype=float), pixels, nodes)


def _interval(at: Array, pixels: int, nodes: int) -> tuple[NDArray[np.intp], Array]:
    """The interval of places (n,) along an axis, and where in it."""
    place = (at + 0.5) * ((nodes - 1) / pixels)
    first = np.minimum(place, nodes - 2).astype(np.intp)
    return first, np.asarray(place - first, float)


def at_nodes(evaluate: Evaluate, rows: int, columns: int, ny: int, nx: int) -> Array:
    """Light (..., ny, nx) at the nodes of a grid; one node stands for the middle between
    the least and the largest of a 9 x 9 grid."""
    if ny == nx == 1:
        fine = at_nodes(evaluate, rows, columns, FIRST_INTERVALS + 1, FIRST_INTERVALS + 1)
        middle: Array = 0.5 * (fine.min(axis=(-2, -1)) + fine.max(axis=(-2, -1)))
        return middle[..., None, None]
    y, x = np.linspace(-0.5, rows - 0.5, ny), np.linspace(-0.5, columns - 0.5, nx)
    xs, ys = np.meshgrid(x, y)
    found = evaluate(xs.ravel(), ys.ravel())
    return found.reshape(*found.shape[:-1], ny, nx)


def _error(coarse: Array, fine: Array) -> float:
    """Largest difference between a grid and one whose nodes hold it, at the latter's nodes."""
    step = (fine.shape[-1] - 1) // (coarse.shape[-1] - 1)
    at = np.arange(fine.shape[-1]) / step
    i = np.minimum(at.astype(int), coarse.shape[-1] - 2)
    u = at - i
    rows = coarse[..., i, :] * (1.0 - u)[:, None] + coarse[..., i + 1, :] * u[:, None]
    return float(np.abs(rows[..., i] * (1.0 - u) + rows[..., i + 1] * u - fine).max())
