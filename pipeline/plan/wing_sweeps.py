"""How far stars move otherwise than the one streak that sweeps the wings of their block."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.arrays import Array, Geometry
from pipeline.physics.motion.streak import Path, path_through
from pipeline.physics.positions.focal_plane import Camera
from pipeline.plan.own_paths import star_offsets
from pipeline.plan.tiles import BLOCK_PX, cut_up
from pipeline.plan.zones import zone_of_frame

PLACES = 9  # looked at along each side of a block
MERGE_PX = 0.01  # straight runs of the paths compared


@dataclass(frozen=True, eq=False)
class WingSweeps:
    """How stars all over the frames looked at move, beside what sweeps their wings.

    slowest_px : length of the shortest path; off_px : largest mean distance between a star's path
        and its block's
    pairs : (a star's path, its block's): of the star farthest off, and of the slowest one
    """

    slowest_px: float
    off_px: float
    pairs: tuple[tuple[Path, Path], ...]


def wing_sweeps(camera: Camera, g: Geometry, zones: int, aberration: bool) -> WingSweeps:
    """Look at places all over each block, in the frames of `g`.

    zones : per axis; a block's wings are swept as stars move in the middle of its middle's zone
    """
    found = []
    for block in cut_up((camera.rows, camera.columns), (BLOCK_PX, BLOCK_PX)):
        y = block.y0 + np.linspace(0.0, block.rows - 1.0, PLACES)
        x = block.x0 + np.linspace(0.0, block.columns - 1.0, PLACES)
        middle_y, middle_x = _middle(camera, block.y0, block.rows, block.x0, block.columns, zones)
        every_x = np.append(np.tile(x, PLACES), middle_x)
        every_y = np.append(np.repeat(y, PLACES), middle_y)
        offsets = star_offsets(camera, g, every_x, every_y, aberration)  # (2, places, frames, K)
        length = np.hypot(*np.diff(offsets, axis=-1)).sum(axis=-1)
        apart = np.hypot(*(offsets - offsets[:, -1:])).mean(axis=-1)
        for at in (np.argmax(apart), np.argmin(length)):
            place, frame = np.unravel_index(at, apart.shape)
            pair = _path(offsets[:, place, frame]), _path(offsets[:, -1, frame])
            found.append((float(length.min()), float(apart[place, frame]), pair))
    farthest = max(found, key=lambda f: f[1])
    slowest = min(found, key=lambda f: f[0])
    pairs = (farthest[2], slowest[2]) if slowest is not farthest else (farthest[2],)
    return WingSweeps(slowest[0], farthest[1], pairs)


def _path(offsets: Array) -> Path:
    steps = offsets.shape[-1] - 1
    return path_through(offsets[0], offsets[1], np.full(steps, 1.0 / steps), MERGE_PX)


def _middle(
    camera: Camera, y0: int, rows: int, x0: int, columns: int, zones: int
) -> tuple[float, float]:
    """(y, x) of the middle of the zone that holds a block's middle."""
    row = min(zones - 1, int((y0 + 0.5 * rows + 0.5) * zones / camera.rows))
    column = min(zones - 1, int((x0 + 0.5 * columns + 0.5) * zones / camera.columns))
    zone = zone_of_frame(camera, row, column, zones)
    x, y = zone.places(np.zeros(1), np.zeros(1))
    return float(y[0]), float(x[0])
