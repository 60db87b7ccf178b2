"""Sources drawn one by one at their exact places in a small window: the reference of a check."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import scipy
from numpy.typing import NDArray

from pipeline.physics.fast_sizes import fast_size
from pipeline.physics.motion.streak import Path, transfer
from pipeline.physics.psf.response import Core, core_spectrum, frequencies

Array = NDArray[np.float64]

CHUNK = 256  # sources whose phases are held at a time
SPARE_PX = 4


def reach_px(core: Core, path: Path) -> float:
    """How far from the place of a source its swept core lights pixels, on either axis."""
    sweep = float(max(np.abs(path.x_px).max(), np.abs(path.y_px).max()))
    return core.radius_px + sweep + SPARE_PX


def terms(core: Core, path: Path, shape: tuple[int, int]) -> int:
    """Products that one source costs in a window of `shape` pixels."""
    sides = [_period(n, core, path) * core.oversampling for n in shape]
    return sides[0] * (sides[1] // 2 + 1)


def draw_direct(
    core: Core,
    path: Path,
    shape: tuple[int, int],
    origin: tuple[int, int],
    x_px: Array,
    y_px: Array,
    light_e: Array,
) -> Array:
    """Electrons of sources that share a path: (rows, columns) float64 at frame pixel `origin`.

    x_px, y_px, light_e : (n,) frame places at the path's origin and light, within `reach_px` of
    the window. The spectrum is the sum of the sources' own phases, each taken at its exact place
    (a discrete Fourier transform by its definition): no phase table, no spreading, no float32.
    """
    os = core.oversampling
    period = tuple(_period(n, core, path) for n in shape)
    fy, fx = frequencies(core, *period)
    total = np.zeros((fy.size, fx.size), complex)
    for i in range(0, len(x_px), CHUNK):
        part = slice(i, i + CHUNK)
        down = np.exp(-2j * np.pi * fy[:, None] * (y_px[part] - origin[0])[None, :])
        along = np.exp(-2j * np.pi * (x_px[part] - origin[1])[:, None] * fx[None, :])
        total += (down * light_e[part]) @ along
    total *= _spectrum(core, *period)
    if path.length_px or path.x_px.any() or path.y_px.any():
        total *= transfer(fy, fx, path.x_px, path.y_px, path.weight)
    rows = total.reshape(os, period[0], -1).sum(axis=0) / os
    swept = scipy.fft.ifft(rows, axis=0)[: shape[0]]
    fine = scipy.fft.irfft(swept, n=period[1] * os, axis=1)
    return np.ascontiguousarray(fine[:, : shape[1] * os : os])


@lru_cache(maxsize=6)
def _spectrum(core: Core, rows_px: int, columns_px: int) -> NDArray[np.complex128]:
    """The core's spectrum over a period; sources of one class have one between them."""
    return core_spectrum(core, rows_px, columns_px)


def _period(side: int, core: Core, path: Path) -> int:
    """Period [px] beyond which no light of a source off the window comes back into it."""
    return fast_size(side + 2 * int(np.ceil(reach_px(core, path))), real=True)
