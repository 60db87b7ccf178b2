"""How far stars move otherwise than the one streak that sweeps the wings of their block."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.arrays import Array, Geometry
from pipeline.physics.motion.streak import Path, path_through
from pipeline.physics.positions.focal_plane import Camera
from pipeline.plan.pointing.star_light import ChangingLight
from pipeline.plan.response.own_paths import star_offsets
from pipeline.plan.response.zones import zone_of_frame
from pipeline.plan.tiles import BLOCK_PX, Tile, cut_up

PLACES = 9  # looked at along each side of a block
AT_ONCE = 16  # blocks whose places are followed together
NEAR_PX = 16.0  # a streak this long or shorter is all near its wing
MERGE_PX = 0.01  # straight runs of the paths compared


@dataclass(frozen=True, eq=False)
class WingSweeps:
    """How stars all over the frames looked at move, beside what sweeps their wings.

    slowest_px : length of the shortest path; off_px : largest mean distance between a star's path
        and its block's
    pairs : (a star's path, its block's) of the slowest star, of that farthest off, and of that
        farthest off for the length of its path
    """

    slowest_px: float
    off_px: float
    pairs: tuple[tuple[Path, Path], ...]


def wing_sweeps(
    camera: Camera, g: Geometry, zones: int, aberration: bool, light: ChangingLight | None = None
) -> WingSweeps:
    """Look at places all over each block, in the frames of `g`; light : as of `star_offsets`.

    zones : per axis; a block's wings are swept as stars move in the middle of its middle's zone
    """
    blocks = cut_up((camera.rows, camera.columns), (BLOCK_PX, BLOCK_PX))
    best: list[tuple[float, Array, Array]] = []  # of each measure: its value, the two paths
    for start in range(0, len(blocks), AT_ONCE):
        some = blocks[start : start + AT_ONCE]
        places = [_places(camera, block, zones) for block in some]
        x, y = (np.concatenate([place[k] for place in places]) for k in (0, 1))
        offsets = star_offsets(camera, g, x, y, aberration, light)
        offsets = offsets.reshape(2, len(some), -1, *offsets.shape[2:])  # (2, b, places, frames, K)
        length = np.hypot(*np.diff(offsets, axis=-1)).sum(axis=-1)
        apart = np.hypot(*(offsets - offsets[:, :, -1:])).mean(axis=-1)
        found = []
        for measure in (-length, apart, apart / (length + NEAR_PX)):
            block, place, frame = np.unravel_index(int(np.argmax(measure)), measure.shape)
            own, common = offsets[:, block, place, frame], offsets[:, block, -1, frame]
            found.append((float(measure[block, place, frame]), own, common))
        best = [max(pair, key=lambda m: m[0]) for pair in zip(best or found, found, strict=True)]
    pairs = tuple((_path(own), _path(common)) for _, own, common in best)
    return WingSweeps(-best[0][0], best[1][0], pairs)


def _path(offsets: Array) -> Path:
    steps = offsets.shape[-1] - 1
    return path_through(offsets[0], offsets[1], np.full(steps, 1.0 / steps), MERGE_PX)


def _places(camera: Camera, block: Tile, zones: int) -> tuple[Array, Array]:
    """(x, y) of places all over a block, and last of the star that its wings are swept like."""
    y = block.y0 + np.linspace(0.0, block.rows - 1.0, PLACES)
    x = block.x0 + np.linspace(0.0, block.columns - 1.0, PLACES)
    middle_y, middle_x = _middle(camera, block, zones)
    return np.append(np.tile(x, PLACES), middle_x), np.append(np.repeat(y, PLACES), middle_y)


def _middle(camera: Camera, block: Tile, zones: int) -> tuple[float, float]:
    """(y, x) of the middle of the zone that holds a block's middle."""
    row, column = (
        min(zones - 1, int((first + 0.5 * count + 0.5) * zones / whole))
        for first, count, whole in (
            (block.y0, block.rows, camera.rows),
            (block.x0, block.columns, camera.columns),
        )
    )
    zone = zone_of_frame(camera, row, column, zones)
    x, y = zone.places(np.zeros(1), np.zeros(1))
    return float(y[0]), float(x[0])
