"""Charge that moves under the light, and charge that stays behind: smear, TDI, image lag."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Smear(NamedTuple):
    """How charge is moved out under the light: `smear_e`'s terms."""

    integration_s: float
    transfer_s: float
    to_high: bool
    cleared: bool


def smear_e(
    light_e: Array, integration_s: float, transfer_s: float, to_high: bool, cleared: bool
) -> Array:
    """Electrons (ny, nx) that frame transfer adds to the light of whole columns.

    light_e : (ny, nx) mean electrons of an exposure, after the flat. While the rows are moved out,
    in steps of transfer_s / ny, the charge of a row passes all rows on its way and collects their
    light; unless the charge was `cleared` before, it has also passed the rows on the other side,
    when the frame before was moved out. Sources send what they send on average. A bias frame (0 s)
    is read without any light.
    """
    if integration_s == 0.0:
        return np.zeros_like(light_e)
    step = transfer_s / light_e.shape[0] / integration_s
    below = np.cumsum(light_e, axis=0) - light_e  # light of all rows before
    total = below[-1] + light_e[-1]
    ahead = total - below - light_e if to_high else below
    behind = below if to_high else total - below - light_e
    return step * np.maximum(ahead if cleared else ahead + behind, 0.0)


def lag_frames(fraction: float, light_e: float, error_e: float) -> int:
    """How many frames before leave charge: the rest, fraction^(n + 1) of a pixel's light, is less
    than error_e."""
    if light_e <= error_e:
        return 1
    return max(1, math.ceil(math.log(error_e / light_e) / math.log(fraction)) - 1)


def lagged_e(frames_e: list[Array], fraction: float) -> Array:
    """Mean electrons read in the last of some frames, of which a share stays behind each time.

    frames_e : (ny, nx) collected in each frame, in order of time; before them there was nothing.
    Of a pixel's charge (1 - fraction) is read, the rest waits: read_k = (1 - a) sum_j a^j c_(k-j).
    """
    out = np.zeros_like(frames_e[0])
    for collected in frames_e:
        out = fraction * out + collected
    return (1.0 - fraction) * out


def exposed_share(rows: int, rows_per_s: float, integration_s: float) -> Array:
    """Share (rows,) of an exposure that charge moved at an even rate spends on the array.

    A row is told by where its charge is at mid-exposure; at time t from then on it is at
    row + rate t, and on the array from -1/2 to rows - 1/2.
    """
    way = abs(rows_per_s) * integration_s
    if way == 0.0:
        return np.ones(rows)
    row = np.arange(rows)
    low, high = np.maximum(row - 0.5 * way, -0.5), np.minimum(row + 0.5 * way, rows - 0.5)
    return np.asarray(np.clip((high - low) / way, 0.0, 1.0))


def passed_means(value: Array, rows_per_s: float, integration_s: float) -> Array:
    """What charge meets on its way over the rows of an image (ny, nx): the mean of each column
    along as much of the way as is on the array, by where the charge is at mid-exposure, as in
    `exposed_share`.
    """
    way = abs(rows_per_s) * integration_s
    if way == 0.0:
        return value
    rows = len(value)
    sums = np.concatenate([np.zeros((1, value.shape[1])), np.cumsum(value, axis=0)])
    row = np.arange(rows) + 0.5  # from the array's lower edge

    def up_to(at: Array) -> Array:
        below = np.minimum(at.astype(np.intp), rows - 1)
        return np.asarray(sums[below] + (at - below)[:, None] * value[below])

    low, high = np.maximum(row - 0.5 * way, 0.0), np.minimum(row + 0.5 * way, rows)
    return np.asarray((up_to(high) - up_to(low)) / (high - low)[:, None])
