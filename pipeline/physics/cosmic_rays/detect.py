"""Finding cosmic rays in a stack of dark frames: what stands out of the stack's median.

The median takes out bias, dark and hot pixels; what stays is a frame's own. An event is a connected
group (8 neighbours) of pixels above a low threshold that holds one above the high threshold.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

Array = NDArray[np.float32]

MAD_TO_SIGMA = 1.4826
CLIP = 4.0
OFTEN = 0.1  # a pixel above the threshold in more than this share of frames (and twice) is bad


def stack_levels(stack: Array) -> tuple[Array, Array]:
    """Median and robust sigma (rows, columns) over the frames of a stack (n, rows, columns).

    The sigma is the rms of what lies within CLIP sigmas by the median of absolute deviations, which
    alone would be as coarse as half a digital number.
    """
    middle = np.median(stack, axis=0)
    away = stack - middle
    rough = MAD_TO_SIGMA * np.median(np.abs(away), axis=0)
    inside = np.abs(away) <= CLIP * np.maximum(rough, np.median(rough))
    return middle, np.sqrt((away**2 * inside).sum(axis=0) / np.maximum(inside.sum(axis=0) - 1, 1))


def steady_sigma(sigma: Array, least: float) -> Array:
    """A pixel's sigma, no less than the whole frame's typical one (few frames give it poorly)."""
    return np.maximum(sigma, max(float(np.median(sigma)), least)).astype(np.float32)


def residual(frame: Array, level: Array) -> Array:
    """A frame without the stack's level and without its own offset from it."""
    rest = frame - level
    return rest - np.float32(np.median(rest))


def bad_pixels(hits: NDArray[np.integer], frames: int) -> NDArray[np.bool_]:
    """Pixels that flicker: above the threshold in too many of the frames; hits (rows, columns)."""
    return hits > max(2.0, OFTEN * frames)


def find_events(
    rest: Array, sigma: Array, bad: NDArray[np.bool_], seed_sigma: float, grow_sigma: float
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Pixels of the events of one frame: event, y, x (m,) each, sorted by event, then place."""
    grown = (rest > grow_sigma * sigma) & ~bad
    labels, count = ndimage.label(grown, structure=np.ones((3, 3)))
    y, x = np.nonzero(labels)
    event = labels[y, x] - 1
    seeded = np.zeros(count, bool)
    seeded[event[rest[y, x] > seed_sigma * sigma[y, x]]] = True
    keep = seeded[event]
    renumbered = np.cumsum(seeded) - 1
    event, y, x = renumbered[event[keep]], y[keep], x[keep]
    order = np.lexsort((x, y, event))
    return event[order], y[order], x[order]
