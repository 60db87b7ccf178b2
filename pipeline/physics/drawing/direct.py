"""Sources drawn one by one at their exact places in a small window: the reference of a check."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy
from numpy.typing import NDArray

from pipeline.physics.fast_sizes import fast_size
from pipeline.physics.motion.streak import Path, add_rising, transfer
from pipeline.physics.psf.response import Core, core_spectrum, frequencies

Array = NDArray[np.float64]

CHUNK = 256  # sources whose phases are held at a time
SPARE_PX = 4


@dataclass(frozen=True)
class Swept:
    """Sources that share a path.

    x_px, y_px, light_e : (n,) frame places at the path's origin and light
    rise : (k,) by how much the light of each segment's end exceeds that of its middle, as a share
        of all light; None where it lies evenly along each
    """

    path: Path
    x_px: Array
    y_px: Array
    light_e: Array
    rise: Array | None = None


def reach_px(core: Core, path: Path) -> float:
    """How far from the place of a source its swept core lights pixels, on either axis."""
    sweep = float(max(np.abs(path.x_px).max(), np.abs(path.y_px).max()))
    return core.radius_px + sweep + SPARE_PX


def terms(core: Core, groups: Sequence[Swept], shape: tuple[int, int]) -> int:
    """Products that one source of some groups costs in a window of `shape` pixels."""
    reach = _reach_of(core, groups)
    sides = [_period(n, reach) * core.oversampling for n in shape]
    return sides[0] * (sides[1] // 2 + 1)


def draw_direct(
    core: Core, groups: Sequence[Swept], shape: tuple[int, int], origin: tuple[int, int]
) -> Array:
    """Electrons of sources of one core: (rows, columns) float64 at frame pixel `origin`.

    groups : of sources within `reach_px` of the window. The spectrum is the sum of the sources'
    own phases, each taken at its exact place (a discrete Fourier transform by its definition): no
    phase table, no spreading, no float32.
    """
    os, reach = core.oversampling, _reach_of(core, groups)
    period = tuple(_period(n, reach) for n in shape)
    fy, fx = frequencies(core, *period)
    total = np.zeros((fy.size, fx.size), complex)
    for group in groups:
        if group.rise is None:
            total += _swept(group, fy, fx, origin)
        else:
            _add_each(total, group, group.rise, fy, fx, origin)
    total *= _spectrum(core, *period)
    rows = total.reshape(os, period[0], -1).sum(axis=0) / os
    swept = scipy.fft.ifft(rows, axis=0)[: shape[0]]
    fine = scipy.fft.irfft(swept, n=period[1] * os, axis=1)
    return np.ascontiguousarray(fine[:, : shape[1] * os : os])


def _swept(group: Swept, fy: Array, fx: Array, origin: tuple[int, int]) -> NDArray[np.complex128]:
    """The spectrum of a group's light along its path, from its sources' phases."""
    out = np.zeros((fy.size, fx.size), complex)
    for i in range(0, len(group.x_px), CHUNK):
        part = slice(i, i + CHUNK)
        down = np.exp(-2j * np.pi * fy[:, None] * (group.y_px[part] - origin[0])[None, :])
        along = np.exp(-2j * np.pi * (group.x_px[part] - origin[1])[:, None] * fx[None, :])
        out += (down * group.light_e[part]) @ along
    path = group.path
    if path.length_px or path.x_px.any() or path.y_px.any():
        out *= transfer(fy, fx, path.x_px, path.y_px, path.weight)
    return out


def _add_each(
    total: NDArray[np.complex128],
    group: Swept,
    rise: Array,
    fy: Array,
    fx: Array,
    origin: tuple[int, int],
) -> None:
    """Add the spectrum of each source of a group whose light rises along its path."""
    path = group.path
    for x, y, light in zip(group.x_px, group.y_px, group.light_e, strict=True):
        nodes = path.x_px + (x - origin[1]), path.y_px + (y - origin[0])
        add_rising(total, fy, fx, *nodes, light * path.weight, light * rise)


@lru_cache(maxsize=6)
def _spectrum(core: Core, rows_px: int, columns_px: int) -> NDArray[np.complex128]:
    """The core's spectrum over a period; sources of one class have one between them."""
    return core_spectrum(core, rows_px, columns_px)


def _reach_of(core: Core, groups: Sequence[Swept]) -> float:
    """The largest `reach_px` of some groups."""
    return max(reach_px(core, group.path) for group in groups)


def _period(side: int, reach_px: float) -> int:
    """Period [px] beyond which no light of a source off the window comes back into it."""
    return fast_size(side + 2 * int(np.ceil(reach_px)), real=True)
