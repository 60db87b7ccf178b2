"""Rolling shutters: rows exposed one after the other see moving sources at other times."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

TURNS = 16  # of the search for the moment at which a source's own row is exposed


def row_delay_s(y_px: Array, line_s: float, rows: int) -> Array:
    """How much later than the first row the one at y [px] starts; even beyond a frame's side.

    line_s : from one row to the next, towards higher rows; negative: the last row is the first
    """
    y = np.clip(y_px, -float(rows), 2.0 * rows)
    return np.asarray(line_s * y if line_s >= 0.0 else -line_s * (rows - 1.0 - y))


def later(places: Array, time_s: Array, delay_s: Array | float) -> Array:
    """Places (..., K) at K even times, so much later: along the parabola through the first, middle
    and last of them, on top of what each differs from that; of a bias frame, which took no time, as
    they are."""
    middle = places.shape[-1] // 2
    took = _took(time_s)
    since = time_s - time_s[..., middle : middle + 1]
    first, mid, last = (places[..., k : k + 1] for k in (0, middle, places.shape[-1] - 1))
    speed = (last - first) / took
    bend = 4.0 * (last - 2.0 * mid + first) / np.square(took)
    return np.asarray(places + (speed + bend * (since + 0.5 * delay_s)) * delay_s)


def _took(time_s: Array) -> Array:
    """Time (..., 1) from the first node to the last; infinite, so that rates are 0, where none."""
    took = time_s[..., -1:] - time_s[..., :1]
    return np.where(took > 0.0, took, np.inf)


def rolled(
    x_px: Array, y_px: Array, time_s: Array, line_s: float, rows: int
) -> tuple[Array, Array, Array]:
    """Paths as rows that start one after the other see them, and the delay at each node.

    x_px, y_px : (..., K) places at K even nodes of the first row's exposure, K odd
    time_s : (..., K) since its start
    Each source is followed during the exposure of its own row: of the moments t + delay(y(t)). Its
    motion beyond the nodes is that of the parabola through the first, middle and last of them.
    Returns x, y, delay_s (..., K); where a node is not finite nothing is changed.
    """
    known = np.isfinite(later(x_px, time_s, 0.0)) & np.isfinite(later(y_px, time_s, 0.0))
    delay, y = np.zeros(y_px.shape), y_px
    with np.errstate(invalid="ignore", over="ignore"):
        for _ in range(TURNS):
            delay = row_delay_s(y, line_s, rows)
            y = later(y_px, time_s, delay)
        x = later(x_px, time_s, delay)
    return (
        np.where(known, x, x_px),
        np.where(known, y, y_px),
        np.where(known, delay, 0.0),
    )


def exposed_longer(delay_s: Array, time_s: Array) -> Array:
    """How much longer (...,) than a row's exposure a source is followed that moves along the rows.

    Its time runs at dt/du = 1 + d delay/du of the rows' own time u: 1 / (1 - line rate).
    """
    return np.asarray(1.0 + (delay_s[..., -1] - delay_s[..., 0]) / _took(time_s)[..., 0])


def rolled_sources(
    x_px: Array,
    y_px: Array,
    light: Array,
    late: Array,
    clear: Array,
    time_s: Array,
    line_s: float,
    rows: int,
) -> tuple[Array, Array, Array, Array]:
    """Paths, light and clearance (..., K) of sources as the rows of a rolling shutter see them.

    See `rolled`. Light and clearance of the Earth are those of the later moment, straight between
    nodes. late : light (..., K) at as many even moments from the last node to the end of the last
    row's exposure; beyond them it is as there.
    """
    x, y, delay = rolled(x_px, y_px, time_s, line_s, rows)
    steps = light.shape[-1] - 1
    times = np.broadcast_to(time_s, light.shape)
    took, readout_s = _took(times), abs(line_s) * max(1, rows - 1)
    since = times - times[..., :1] + delay
    after = np.maximum(0.0, since - took) / readout_s
    at = (np.clip(since / took, 0.0, 1.0) + np.clip(after, 0.0, 1.0)) * steps
    every = np.concatenate([light, late[..., 1:]], axis=-1)
    low = np.minimum(at.astype(np.int64), 2 * steps - 1)
    before, behind = (np.take_along_axis(every, low + k, axis=-1) for k in (0, 1))
    seen = before + (at - low) * (behind - before)
    return x, y, seen * exposed_longer(delay, times)[..., None], later(clear, times, delay)
