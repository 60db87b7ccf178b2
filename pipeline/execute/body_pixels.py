"""What pixels hold of a resolved body: its picture spread by the response of a point."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Array
from pipeline.physics.targets.disc import Appearance

MOST_SIDE = 192  # cells across a picture: pixels, or squares of them that count as even
BLOCK, ROW = 64, 1 << 20  # cells on a side of a square; squares of a row, for their numbers
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
    side = max(1, math.ceil(max(y1 - y0, x1 - x0) / MOST_SIDE))
    y, x, share = body.points(FINEST / side)
    at_y, at_x = (np.floor((v + 0.5) / side).astype(np.int64) for v in (y, x))
    picture = _binned(at_y - at_y.min(), at_x - at_x.min(), share)
    row, column = ((v - v.min()) // side for v in (row, column))
    values = _spread(picture, row, column, value)
    return values[values > LEAST * values.max()] / side**2, float(side**2)


def _spread(
    picture: Array, row: NDArray[np.int64], column: NDArray[np.int64], value: Array
) -> Array:
    """Values (m,) of the cells that a picture lights through a response known in some (n,).

    Square by square of the response, as long streaks cross most of a frame and fill little of it.
    """
    down, across = (BLOCK + n - 1 for n in picture.shape)
    spectrum = np.fft.rfft2(picture, (down, across))
    out: dict[tuple[int, int], Array] = {}
    number, block = np.unique(row // BLOCK * ROW + column // BLOCK, return_inverse=True)
    for k, key in enumerate(number.tolist()):
        mine = block == k
        image = np.zeros((down, across))
        np.add.at(image, (row[mine] % BLOCK, column[mine] % BLOCK), value[mine])
        image = np.fft.irfft2(np.fft.rfft2(image) * spectrum, (down, across))
        for y in range(0, down, BLOCK):
            for x in range(0, across, BLOCK):
                part = image[y : y + BLOCK, x : x + BLOCK]
                place = key // ROW + y // BLOCK, key % ROW + x // BLOCK
                held = out.setdefault(place, np.zeros((BLOCK, BLOCK)))
                held[: part.shape[0], : part.shape[1]] += part
    return np.concatenate([image.ravel() for image in out.values()])


def _binned(row: NDArray[np.int64], column: NDArray[np.int64], value: Array) -> Array:
    """An image (rows, columns) of what falls into each cell."""
    shape = int(row.max()) + 1, int(column.max()) + 1
    flat = np.bincount(row * shape[1] + column, weights=value, minlength=math.prod(shape))
    return flat.astype(np.float64).reshape(shape)
