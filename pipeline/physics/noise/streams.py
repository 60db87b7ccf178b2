"""Random numbers keyed by (seed, component, frame, pixel), drawn for whole images at a time.

Every pixel of every frame owns its stream (`pixel_draws`), so a draw depends on no tile, worker or
order, and a component that is switched on, or a pixel that changes, leaves all other draws as they
were. Rows are cut into runs of RUN_PX pixels, and what all pixels of a run need is computed without
branches, so that the compiler fills vector registers. The bits are those of `pixel_draws`: where a
test is done in an approximate form, a pixel within its error of the edge goes to the exact one.
"""

from __future__ import annotations

import hashlib

import numpy as np
from numba import int64, njit

from pipeline.physics.noise.pixel_draws import (
    EXACT_BELOW,
    GAUSSIAN_ABOVE,
    gaussian_poisson,
    normal_quantile,
    philox,
    poisson,
    uniform,
)
from pipeline.physics.noise.runs import (
    RUN_PX,
    count_below,
    draw_low,
    draw_low_among,
    draw_middle,
    quantiles,
    to_uniforms,
    words,
)

__all__ = [
    "normal_quantile",
    "philox",
    "poisson",
    "poisson_image",
    "standard_normals",
    "stream_key",
    "uniform",
    "uniforms",
]


def stream_key(seed: int, component: str) -> tuple[int, int]:
    """The 64-bit key of a component's stream, as two 32-bit words.

    A hash of the seed and the name (BLAKE2b), so that any two components differ.
    """
    digest = hashlib.blake2b(f"{seed}/{component}".encode(), digest_size=8).digest()
    word = int.from_bytes(digest, "little")
    return word & 0xFFFFFFFF, word >> 32


@njit(cache=True, nogil=True)
def uniforms(rows, columns, y0, x0, frame, k0, k1):
    """(rows, columns) uniform draws in (0, 1) of the pixels from (y0, x0) on."""
    out = np.empty((rows, columns))
    for r in range(rows):
        for c in range(columns):
            a, b, _, _ = philox(x0 + c, y0 + r, frame, 0, k0, k1)
            out[r, c] = uniform(a, b)
    return out


@njit(cache=True, nogil=True)
def _columns(n, x0, buffers):
    """The columns of n pixels side by side, the first x0, in the buffers' first place."""
    x = buffers[0]
    for i in range(n):
        x[i] = x0 + i
    return x


@njit(cache=True, nogil=True, error_model="numpy")
def normals_run(n, x, y, frame, k0, k1, out, buffers):
    """Standard normal draws out[i] of the pixels (x[i], y), i < n <= RUN_PX."""
    first, second = buffers[1], buffers[2]
    p = first.view(np.float64)
    words(n, x, y, frame, int64(0), k0, k1, first, second)
    to_uniforms(n, p)
    quantiles(n, p, out)


@njit(cache=True, nogil=True, error_model="numpy")
def standard_normals(rows, columns, y0, x0, frame, k0, k1):
    """(rows, columns) standard normal draws of the pixels from (y0, x0) on."""
    out, buffers = np.empty((rows, columns)), poisson_buffers()
    for r in range(rows):
        for start in range(0, columns, RUN_PX):
            n = min(RUN_PX, columns - start)
            line = out[r, start : start + n]
            x = _columns(n, x0 + start, buffers)
            normals_run(n, x, y0 + r, frame, k0, k1, line, buffers)
    return out


@njit(cache=True, nogil=True)
def poisson_buffers():
    """What draws of a run of pixels are worked out in: words, indices, numbers."""
    scratch, ints = np.empty((10, RUN_PX)), np.empty((5, RUN_PX), np.uint64)
    words = np.empty((5, RUN_PX), np.uint64)
    return words[0], words[1], words[2], words[3], words[4], scratch, ints


@njit(cache=True, nogil=True, error_model="numpy")
def poisson_run(mean, x, y, frame, k0, k1, out, buffers):
    """Poisson draws out[i] of means (n,), n <= RUN_PX, of the pixels (x[i], y)."""
    _, first, second, low, middle, scratch, ints = buffers
    u, v, n = first.view(np.float64), second.view(np.float64), mean.size
    words(n, x, y, frame, int64(0), k0, k1, first, second)
    to_uniforms(n, u)
    if count_below(n, mean, EXACT_BELOW) == n:
        draw_low(n, mean, u, out, scratch)
        return
    to_uniforms(n, v)
    lows, middles = 0, 0
    for i in range(n):
        low[lows], middle[middles] = i, i
        lows += mean[i] < EXACT_BELOW
        middles += (mean[i] >= EXACT_BELOW) & (mean[i] <= GAUSSIAN_ABOVE)
    if lows + middles < n:
        for i in range(n):
            if mean[i] > GAUSSIAN_ABOVE:
                out[i] = gaussian_poisson(mean[i], u[i])
    if lows:
        draw_low_among(low[:lows], mean, u, out, scratch)
    if middles:
        place = x, y, frame, k0, k1
        draw_middle(middle[:middles], mean, u, v, place, out, scratch, ints)


@njit(cache=True, nogil=True, error_model="numpy")
def poisson_image(mean_e, y0, x0, frame, k0, k1):
    """(ny, nx) Poisson draws of an image of means whose first pixel is frame pixel (y0, x0)."""
    out, buffers = np.empty_like(mean_e), poisson_buffers()
    for r in range(mean_e.shape[0]):
        for start in range(0, mean_e.shape[1], RUN_PX):
            end = min(start + RUN_PX, mean_e.shape[1])
            mean, line = mean_e[r, start:end], out[r, start:end]
            x = _columns(mean.size, x0 + start, buffers)
            poisson_run(mean, x, y0 + r, frame, k0, k1, line, buffers)
    return out
