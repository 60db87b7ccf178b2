"""What pixels hold of a resolved body: its picture spread by the response of a point."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Array
from pipeline.physics.targets.disc import Appearance

MOST_SIDE = 192  # cells across the picture: pixels, or squares of them that count as even
FINEST = 2.0  # waves a cell that its points are true to
LEAST = 1e-7  # of the brightest: cells that hold less are dark


def body_pixels(
    body: Appearance, row: NDArray[np.int64], column: NDArray[np.int64], value: Array
) -> tuple[Array, float]:
    """Values (m,) of the pixels that a body lights, and how often each of them occurs.

    row, column, value : (n,) of the pixels of a point's response; the body's reference point is
        there in the middle of pixel 0, 0
    """
    y0, y1, x0, x1 = body.box
    row, column = row - row.min(), column - column.min()
    wide = int(max(row.max(), column.max())) + 1 + max(y1 - y0, x1 - x0)
    side = max(1, math.ceil(wide / MOST_SIDE))
    y, x, share = body.points(FINEST / side)
    at_y, at_x = (np.floor((v + 0.5) / side).astype(np.int64) for v in (y, x))
    own = _binned(at_y, at_x, share)
    response = _binned(row // side, column // side, value)
    shape = [a + b - 1 for a, b in zip(own.shape, response.shape, strict=True)]
    both = np.fft.rfft2(own, shape) * np.fft.rfft2(response, shape)
    cells = np.fft.irfft2(both, shape)
    return cells[cells > LEAST * cells.max()] / side**2, float(side**2)


def _binned(row: NDArray[np.int64], column: NDArray[np.int64], value: Array) -> Array:
    """An image of what falls into each cell, from the first row and column that hold any."""
    row, column = row - row.min(), column - column.min()
    shape = int(row.max()) + 1, int(column.max()) + 1
    flat = np.bincount(row * shape[1] + column, weights=value, minlength=math.prod(shape))
    return flat.astype(np.float64).reshape(shape)
