"""Stamps engine: adds the tabulated core of each star to an image, star by star in order.

Each pixel receives its stars in the order of the list, whatever part of the frame the image
shows; so the bits of a pixel do not depend on how the frame is cut into tiles.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pipeline.physics.psf.response import PixelResponse

Array = NDArray[np.float64]


def draw_stamps(
    image_e: Array,
    origin: tuple[int, int],
    response: PixelResponse,
    x_px: Array,
    y_px: Array,
    light_e: Array,
    cubic: NDArray[np.bool_],
) -> None:
    """Add stars to an image in place.

    image_e : (ny, nx) float64, electrons; its first pixel is frame pixel `origin` (y, x)
    x_px, y_px, light_e : (n,) frame positions and light of the stars [e-]
    cubic : (n,) interpolate between phases with 4 x 4 instead of 2 x 2 points
    """
    if x_px.size == 0:
        return
    _draw(
        image_e, origin[0], origin[1], response.phases, response.row0, response.starts,
        response.stops, response.offsets, response.values, x_px, y_px, light_e, cubic,
    )  # fmt: skip


@njit(cache=True, nogil=True)
def _weights(u, cubic, out):
    """Lagrange weights at u in [0, 1) for points -1, 0, 1, 2; linear weights use 0 and 1 only."""
    if cubic:
        out[0] = -u * (u - 1.0) * (u - 2.0) / 6.0
        out[1] = (u + 1.0) * (u - 1.0) * (u - 2.0) / 2.0
        out[2] = -(u + 1.0) * u * (u - 2.0) / 2.0
        out[3] = (u + 1.0) * u * (u - 1.0) / 6.0
    else:
        out[0] = 0.0
        out[1] = 1.0 - u
        out[2] = u
        out[3] = 0.0


@njit(cache=True, nogil=True)
def _draw(image, oy, ox, phases, row0, starts, stops, offsets, values, xs, ys, light, cubic):
    ny, nx = image.shape
    wy, wx = np.empty(4), np.empty(4)
    buffer = np.empty(values.shape[2])
    first_col, last_col = starts.min(), stops.max()
    for s in range(xs.size):
        iy, ix = int(np.floor(ys[s])), int(np.floor(xs[s]))
        top = iy + row0 - oy
        if top >= ny or top + starts.size <= 0:
            continue
        if ix + first_col - ox >= nx or ix + last_col - ox <= 0:
            continue
        py, px = (ys[s] - iy) * phases, (xs[s] - ix) * phases
        ky, kx = min(int(py), phases - 1), min(int(px), phases - 1)
        _weights(py - ky, cubic[s], wy)
        _weights(px - kx, cubic[s], wx)
        e = light[s]
        if cubic[s]:
            buffer[:] = 0.0
            for i in range(4):
                for j in range(4):
                    w = e * wy[i] * wx[j]
                    v = values[ky + i, kx + j]
                    for k in range(buffer.size):
                        buffer[k] += w * v[k]
        else:
            a, b, c, d = e * wy[1] * wx[1], e * wy[1] * wx[2], e * wy[2] * wx[1], e * wy[2] * wx[2]
            v00, v01 = values[ky + 1, kx + 1], values[ky + 1, kx + 2]
            v10, v11 = values[ky + 2, kx + 1], values[ky + 2, kx + 2]
            for k in range(buffer.size):
                buffer[k] = a * v00[k] + b * v01[k] + c * v10[k] + d * v11[k]
        for r in range(max(0, -top), min(starts.size, ny - top)):
            left = ix + starts[r] - ox
            begin = offsets[r] + max(0, -left)
            end = offsets[r + 1] - max(0, left + stops[r] - starts[r] - nx)
            if end > begin:
                first = left + begin - offsets[r]
                row = image[top + r, first : first + end - begin]  # slices: no wrapped indices
                part = buffer[begin:end]
                for k in range(row.size):
                    row[k] += part[k]
