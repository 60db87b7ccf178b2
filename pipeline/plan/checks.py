"""Which small parts of a product are drawn again by the reference path, to tell its real error."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pipeline.arrays import Geometry
from pipeline.spec.scene import CELL_PX, Scene

FINE_POINTS = 384  # of the finest grid from a source to the end of its wings
FINE_KERNELS = 8  # of the wings on such grids, that a process keeps


@dataclass(frozen=True)
class CheckCell:
    """A cell of CELL_PX pixels of a frame; the window checked lies in it, at its brightest."""

    frame: int
    row: int
    column: int


def choose_checks(scene: Scene, ends: Geometry) -> tuple[CheckCell, ...]:
    """Up to `accuracy.check_cells` cells: of targets, the middle, corners, and others, in turn.

    ends : some of the scene's frames, the first and the last among them. The choice follows from
    the scene alone, so that tiles and workers do not change it.
    """
    wanted = scene.accuracy.check_cells
    if not wanted or not (scene.stars or scene.targets):
        return ()
    rows, columns = (-(-n // CELL_PX) for n in scene.sensor.shape)
    frames = len(ends.frame)
    places = [_cell_of(scene, ends, k) for k in range(min(len(scene.targets), 8 * wanted))]
    found = [(0, row, column) for row, column in places if row >= 0][: (wanted + 1) // 2]
    fixed = [(rows // 2, columns // 2), (0, 0), (rows - 1, columns - 1)]
    found += [(i % frames, *fixed[i]) for i in range(len(fixed))]
    turn = np.random.default_rng(scene.seed)
    found += [
        (int(turn.integers(frames)), int(turn.integers(rows)), int(turn.integers(columns)))
        for _ in range(2 * wanted)
    ]
    kept = list(dict.fromkeys(found))[:wanted]
    return tuple(CheckCell(int(ends.frame[f]), r, c) for f, r, c in kept)


def _cell_of(scene: Scene, ends: Geometry, target: int) -> tuple[int, int]:
    """Cell of a target in the first frame; (-1, -1) where it is not in it."""
    x, y = ends.target_x_px[target, 0, ends.middle], ends.target_y_px[target, 0, ends.middle]
    rows, columns = scene.sensor.shape
    if not (-0.5 <= x < columns - 0.5 and -0.5 <= y < rows - 0.5):
        return -1, -1
    return int(y + 0.5) // CELL_PX, int(x + 0.5) // CELL_PX


def fine_ends(spacing_px: int, reach_px: float) -> list[tuple[int, float, float]]:
    """(spacing [px], from where, to where [px]) of the grids that wings are drawn again on.

    One of half the planned spacing; where that takes more than FINE_POINTS to the reach it ends
    there, and a coarser one has the rest, as smooth as it is so far out.
    """
    spacing = max(1, spacing_px // 2)
    ends = [(spacing, 0.0, min(reach_px, float(spacing * FINE_POINTS)))]
    if ends[0][2] < reach_px:
        ends.append((math.ceil(reach_px / FINE_POINTS), ends[0][2], reach_px))
    return ends
