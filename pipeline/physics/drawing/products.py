"""Stars whose stamp is a column times a row: each is added as such, star by star in order.

The bits of a pixel do not depend on how the frame is cut into tiles.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pipeline.physics.psf.product import ProductResponse

Array = NDArray[np.float64]


def draw_products(
    image_e: Array,
    origin: tuple[int, int],
    response: ProductResponse,
    x_px: Array,
    y_px: Array,
    light_e: Array,
) -> None:
    """Add stars to an image in place.

    image_e : (ny, nx) float64, electrons; its first pixel is frame pixel `origin` (y, x)
    x_px, y_px, light_e : (n,) frame positions and light of the stars [e-]
    """
    table = response.phases, response.row0, response.column0, response.columns, response.rows
    _draw(image_e, origin[0], origin[1], *table, x_px, y_px, light_e)


@njit(cache=True, nogil=True)
def _between(values, phase, scale, out):
    """scale x values at a phase [1/phases px], by cubic Lagrange interpolation."""
    k = min(int(phase), values.shape[0] - 4)
    u = phase - k
    a = scale * (-u * (u - 1.0) * (u - 2.0) / 6.0)
    b = scale * ((u + 1.0) * (u - 1.0) * (u - 2.0) / 2.0)
    c = scale * (-(u + 1.0) * u * (u - 2.0) / 2.0)
    d = scale * ((u + 1.0) * u * (u - 1.0) / 6.0)
    v0, v1, v2, v3 = values[k], values[k + 1], values[k + 2], values[k + 3]
    for i in range(out.size):
        out[i] = a * v0[i] + b * v1[i] + c * v2[i] + d * v3[i]


@njit(cache=True, nogil=True)
def _draw(image, oy, ox, phases, row0, column0, columns, rows, xs, ys, light):
    ny, nx = image.shape
    down, along = np.empty(columns.shape[1]), np.empty(rows.shape[1])
    steps, one = along.size // 4, np.uint64(1)
    for s in range(xs.size):
        iy, ix = int(np.floor(ys[s])), int(np.floor(xs[s]))
        top, left = iy + row0 - oy, ix + column0 - ox
        if top >= ny or top + down.size <= 0 or left >= nx or left + along.size <= 0:
            continue
        _between(columns, (ys[s] - iy) * phases, light[s], down)
        _between(rows, (xs[s] - ix) * phases, 1.0, along)
        inside = left >= 0 and left + along.size <= nx
        for r in range(max(0, -top), min(down.size, ny - top)):
            e = down[r]
            if not inside:
                for k in range(max(0, -left), min(along.size, nx - left)):
                    image[top + r, left + k] += e * along[k]
                continue
            row = image[top + r, left : left + 4 * steps]
            for q in range(steps):  # ROW_STEP at once
                i = np.uint64(4 * q)
                j, n, m = i + one, i + one + one, i + one + one + one
                a, b = row[i] + e * along[i], row[j] + e * along[j]
                c, d = row[n] + e * along[n], row[m] + e * along[m]
                row[i], row[j], row[n], row[m] = a, b, c, d
