"""Stamps engine: adds the tabulated core of each star to an image, star by star in order.

Each pixel receives its stars in the order of the list, whatever part of the frame the image
shows; so the bits of a pixel do not depend on how the frame is cut into tiles.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pipeline.physics.drawing.products import draw_products
from pipeline.physics.psf.product import ProductResponse
from pipeline.physics.psf.response import PixelResponse

Array = NDArray[np.float64]


def draw_stamps(
    image_e: Array,
    origin: tuple[int, int],
    response: PixelResponse | ProductResponse,
    x_px: Array,
    y_px: Array,
    light_e: Array,
    cubic: NDArray[np.bool_],
) -> None:
    """Add stars to an image in place.

    image_e : (ny, nx) float64, electrons; its first pixel is frame pixel `origin` (y, x)
    x_px, y_px, light_e : (n,) frame positions and light of the stars [e-]
    cubic : (n,) interpolate between phases with 4 x 4 instead of 2 x 2 points; products always do
    """
    if x_px.size == 0:
        return
    if isinstance(response, ProductResponse):
        draw_products(image_e, origin, response, x_px, y_px, light_e)
        return
    _draw(
        image_e,
        origin[0],
        origin[1],
        response.phases,
        response.row0,
        response.starts,
        response.stops,
        response.offsets,
        response.values,
        x_px,
        y_px,
        light_e,
        cubic,
    )


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
    wide_col = (starts + offsets[1:] - offsets[:-1]).max()
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
                w = e * wy[i]
                a, b, c, d = w * wx[0], w * wx[1], w * wx[2], w * wx[3]
                v0, v1 = values[ky + i, kx], values[ky + i, kx + 1]
                v2, v3 = values[ky + i, kx + 2], values[ky + i, kx + 3]
                for k in range(buffer.size):
                    buffer[k] = buffer[k] + a * v0[k] + b * v1[k] + c * v2[k] + d * v3[k]
        else:
            a, b, c, d = e * wy[1] * wx[1], e * wy[1] * wx[2], e * wy[2] * wx[1], e * wy[2] * wx[2]
            v00, v01 = values[ky + 1, kx + 1], values[ky + 1, kx + 2]
            v10, v11 = values[ky + 2, kx + 1], values[ky + 2, kx + 2]
            _blend(buffer, a, v00, b, v01, c, v10, d, v11)
        left = ix - ox
        if top >= 0 and top + starts.size <= ny and left + first_col >= 0 and left + wide_col <= nx:
            _add_inside(image, top, left, starts, offsets, buffer)
        else:
            _add_cut(image, top, left, starts, stops, offsets, buffer)


@njit(cache=True, nogil=True)
def _blend(out, a, v00, b, v01, c, v10, d, v11):
    """Weighted sum of four stamps."""
    for k in range(out.size):
        out[k] = a * v00[k] + b * v01[k] + c * v10[k] + d * v11[k]


@njit(cache=True, nogil=True)
def _add_inside(image, top, left, starts, offsets, stamp):
    """Add a stamp that lies in the image with the zeros at its rows' ends: ROW_STEP at a time."""
    one = np.uint64(1)
    for r in range(starts.size):
        first = left + starts[r]
        steps = (offsets[r + 1] - offsets[r]) // 4
        row = image[top + r, first : first + 4 * steps]
        part = stamp[offsets[r] : offsets[r] + 4 * steps]
        for q in range(steps):
            i = np.uint64(4 * q)
            j, k, m = i + one, i + one + one, i + one + one + one
            a, b, c, d = row[i] + part[i], row[j] + part[j], row[k] + part[k], row[m] + part[m]
            row[i], row[j], row[k], row[m] = a, b, c, d


@njit(cache=True, nogil=True)
def _add_cut(image, top, left, starts, stops, offsets, stamp):
    """Add what falls into the image of a stamp that may lie partly outside."""
    ny, nx = image.shape
    for r in range(max(0, -top), min(starts.size, ny - top)):
        skip, end = max(0, -left - starts[r]), min(stops[r], nx - left)
        for k in range(starts[r] + skip, end):
            image[top + r, left + k] += stamp[offsets[r] + k - starts[r]]
