"""Spectral engine: all sources of a block at once, by a non-uniform FFT and transfer functions.

Sources are spread onto a periodic grid, transformed, multiplied by the transfer functions of the
response and of the streak, folded to the pixels' frequencies, and transformed back once. The cost
hardly depends on the number of sources or on the streak. A block's image depends on its sources
alone, never on tiles.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from pipeline.errors import BadInput
from pipeline.physics.drawing.spectral_band import roll_off
from pipeline.physics.drawing.spectral_fold import fold_modes
from pipeline.physics.drawing.spectral_plan import SpectralPlan
from pipeline.physics.drawing.spectral_spread import spread_onto
from pipeline.physics.drawing.spectral_threads import each, strips
from pipeline.physics.motion.streak import Path, pieces
from pipeline.physics.psf.response import Core

Array = NDArray[np.float64]

STRIP = 64  # rows or columns that are transformed at a time


@dataclass(frozen=True, eq=False)
class Sources:
    """Sources that move alike: (n,) frame positions at the path's origin, and their light [e-]."""

    x_px: Array
    y_px: Array
    light_e: Array
    path: Path


def draw_spectral(
    plan: SpectralPlan,
    table: NDArray,
    groups: Sequence[Sources],
    origin: tuple[int, int],
    threads: int = 1,
) -> NDArray[np.floating]:
    """Electrons of the sources in a block: (rows, columns) in the plan's precision.

    table : from `transfer_table`, of the same plan; origin : (y, x) frame pixel of the block
    threads : how many may work on it; the bits are the same for any number
    Sources outside of the block add what falls inside; those farther than they reach are omitted.
    Pixels may be negative by as much as the plan's errors. Raises BadInput for light or positions
    that are not finite.
    """
    spectrum = np.zeros((plan.period[0], plan.period[1] // 2 + 1), plan.complex_type)
    for path, *places in _by_piece(plan, groups, origin):
        modes = _modes(plan, [places], threads)
        moving = path if path.length_px else None
        fold_modes(spectrum, plan.period[1], modes, table, moving, threads)
    return _image(plan, spectrum, threads)


def draw_points(
    plan: SpectralPlan,
    table: NDArray,
    parts: Iterable[tuple[Array, Array, Array]],
    origin: tuple[int, int],
    threads: int = 1,
) -> NDArray[np.floating]:
    """The same of points at rest that come in parts: x, y [px] and light [e-] of some at a time,
    all finite."""
    spectrum = np.zeros((plan.period[0], plan.period[1] // 2 + 1), plan.complex_type)
    x0, y0 = origin[1] - plan.pad[1], origin[0] - plan.pad[0]
    modes = _modes(plan, ((x - x0, y - y0, light) for x, y, light in parts), threads)
    fold_modes(spectrum, plan.period[1], modes, table, None, threads)
    return _image(plan, spectrum, threads)


def _by_piece(
    plan: SpectralPlan, groups: Sequence[Sources], origin: tuple[int, int]
) -> list[tuple[Path, Array, Array, Array]]:
    """(piece, x, y, light) of the sources of each piece of path, in pixels of the period."""
    found: dict[Path, list[tuple[Array, Array, Array]]] = {}
    for g in groups:
        x, y, light = (np.asarray(a, float) for a in (g.x_px, g.y_px, g.light_e))
        for name, values in (("x_px", x), ("y_px", y), ("light_e", light)):
            if not np.isfinite(values).all():
                raise BadInput(f"sources.{name}", values[~np.isfinite(values)][0], "finite numbers")
        x, y = x - (origin[1] - plan.pad[1]), y - (origin[0] - plan.pad[0])
        for x0, y0, piece, share in pieces(g.path, plan.longest_px):
            near = _inside(plan, x + x0, y + y0)
            if near.any():
                one = (x[near] + x0, y[near] + y0, light[near] * share)
                found.setdefault(piece, []).append(one)
    joined = []
    for piece, parts in found.items():
        x, y, light = (np.concatenate(column) for column in zip(*parts, strict=True))
        joined.append((piece, x, y, light))
    return joined


def _inside(plan: SpectralPlan, x: Array, y: Array) -> NDArray[np.bool_]:
    """Which places are on the period at all, so that the rest costs nothing."""
    return (x >= 0) & (x < plan.period[1]) & (y >= 0) & (y < plan.period[0])


def _modes(
    plan: SpectralPlan, parts: Iterable[Sequence[Array]], threads: int
) -> NDArray[np.complexfloating]:
    """Transform of sources: row k mod points_y, column l is frequency (k, l) / period.

    parts : x, y [px of the period] and light of some at a time
    Grid and modes share their memory: rows of the grid become rows of half a spectrum.
    """
    ny, nx = plan.points
    modes = np.zeros((ny, nx // 2 + 1), plan.complex_type)
    grid = modes.view(plan.real_type)
    for x, y, light in parts:
        y_cells, x_cells = y * (ny / plan.period[0]), x * (nx / plan.period[1])
        spread_onto(grid, nx, plan.kernel, y_cells, x_cells, light, threads)
    rows, columns = strips(ny, STRIP), strips(plan.keep[1] + 1, STRIP)

    def along(k: int) -> None:
        modes[rows[k]] = scipy.fft.rfft(grid[rows[k], :nx], axis=1, workers=1)

    def down(k: int) -> None:
        modes[:, columns[k]] = scipy.fft.fft(modes[:, columns[k]], axis=0, workers=1)

    each(along, len(rows), threads)
    each(down, len(columns), threads)
    return modes


def _image(
    plan: SpectralPlan, spectrum: NDArray[np.complexfloating], threads: int
) -> NDArray[np.floating]:
    """The pixels of the block from the folded spectrum, which is used up."""
    image = np.empty(plan.shape, plan.real_type)
    inside = [slice(p, p + n) for p, n in zip(plan.pad, plan.shape, strict=True)]
    rows, columns = strips(plan.shape[0], STRIP), strips(spectrum.shape[1], STRIP)

    def down(k: int) -> None:
        spectrum[:, columns[k]] = scipy.fft.ifft(spectrum[:, columns[k]], axis=0, workers=1)

    def along(k: int) -> None:
        lit = spectrum[inside[0]][rows[k]]
        image[rows[k]] = scipy.fft.irfft(lit, n=plan.period[1], axis=1, workers=1)[:, inside[1]]

    each(down, len(columns), threads)
    each(along, len(rows), threads)
    return image


def transfer_table(core: Core, plan: SpectralPlan) -> NDArray:
    """Transfer function of a core at the plan's frequencies, over that of the spreading kernel.

    Returns (2 keep_y + 1, keep_x + 1): real where the core is the same when turned by 180 degrees,
    else complex. Made by zero-padded FFTs, exact for the core's samples.
    """
    rows = _row_transforms(core, plan)
    fine = plan.period[0] * core.oversampling
    ky = np.arange(-plan.keep[0], plan.keep[0] + 1)
    scale = _factor(plan, ky, 0)[:, None].astype(plan.real_type)
    at = (np.arange(len(rows)) - len(rows) // 2) % fine
    even = _is_even(core.samples)
    table = np.empty((ky.size, rows.shape[1]), plan.real_type if even else plan.complex_type)
    for j in range(0, rows.shape[1], STRIP):
        tall = np.zeros((fine, min(STRIP, rows.shape[1] - j)), plan.complex_type)
        tall[at] = rows[:, j : j + STRIP]
        made = scipy.fft.fft(tall, axis=0, overwrite_x=True, workers=1)[ky % fine] * scale
        table[:, j : j + STRIP] = made.real if even else made
    return table


def _row_transforms(core: Core, plan: SpectralPlan) -> NDArray[np.complexfloating]:
    """Transform of each row of the core's samples: (samples, keep_x + 1)."""
    n, fine, kx = len(core.samples), plan.period[1] * core.oversampling, plan.keep[1] + 1
    scale = _factor(plan, np.arange(kx), 1) / core.oversampling**2
    at = (np.arange(n) - n // 2) % fine
    out = np.empty((n, kx), plan.complex_type)
    for i in range(0, n, STRIP):
        wide = np.zeros((min(STRIP, n - i), fine))
        wide[:, at] = core.samples[i : i + STRIP]
        out[i : i + STRIP] = scipy.fft.rfft(wide, axis=1, workers=1)[:, :kx] * scale
    return out


def _factor(plan: SpectralPlan, modes: NDArray[np.int_], axis: int) -> Array:
    """What modes of one axis are multiplied by: the band's end over the spreading kernel."""
    kept = roll_off(modes / plan.period[axis], plan.limit)
    return kept / plan.kernel.transform(modes / plan.points[axis])


def _is_even(samples: Array) -> bool:
    """Same when turned by 180 degrees, to rounding: the transfer function is then real."""
    odd = np.abs(samples - samples[::-1, ::-1]).max()
    return bool(odd <= 1e-13 * np.abs(samples).max())
