"""Tiles: how the focal plane is divided into tasks and chunks, and how much work each is."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pipeline.arrays import Array
from pipeline.spec.scene import CELL_PX, Scene

DEFAULT_TILE_PX = 1024


BLOCK_PX = 2048  # wings and crowds are drawn in fixed blocks of the focal plane


@dataclass(frozen=True)
class Tile:
    """A rectangle of one frame that one task renders and one chunk holds."""

    row: int
    column: int
    y0: int
    x0: int
    rows: int
    columns: int


def blocks_of(shape: tuple[int, int]) -> int:
    """How many blocks a focal plane is drawn in."""
    return math.prod(math.ceil(n / BLOCK_PX) for n in shape)


def distance_px(x_px: Array, y_px: Array, y0: int, x0: int, rows: int, columns: int) -> Array:
    """Distances (n,) from places to a rectangle of pixels (to their centres), 0 inside it.

    Stars are omitted by this distance, and read from the catalogue in circles that hold it, so
    that what else is read changes nothing.
    """
    dx = np.maximum(np.maximum(x0 - x_px, x_px - (x0 + columns - 1)), 0.0)
    dy = np.maximum(np.maximum(y0 - y_px, y_px - (y0 + rows - 1)), 0.0)
    return np.hypot(dx, dy)


def tile_shape(scene: Scene) -> tuple[int, int]:
    """Rows and columns of a tile: as the scene says, else 1024 px or the whole axis.

    Where charge runs along columns (blooming, frame transfer) a tile holds whole ones.
    """
    if scene.output.tile_shape is not None:
        return scene.output.tile_shape
    rows, columns = (min(n, DEFAULT_TILE_PX) for n in scene.sensor.shape)
    detector = scene.sensor.detector
    if detector is not None and detector.whole_columns:
        rows = scene.sensor.shape[0]
        cells = max(1, DEFAULT_TILE_PX**2 // rows // CELL_PX)
        columns = min(scene.sensor.shape[1], cells * CELL_PX)
    return rows, columns


def plan_tiles(scene: Scene) -> tuple[Tile, ...]:
    """The tiles of a frame, row by row; those at the far edges may be smaller."""
    return cut_up(scene.sensor.shape, tile_shape(scene))


def cut_up(shape: tuple[int, int], sides: tuple[int, int]) -> tuple[Tile, ...]:
    """Rectangles of at most `sides` (rows, columns) that cover a frame, row by row."""
    (rows, columns), (ny, nx) = shape, sides
    return tuple(
        Tile(i, j, y0, x0, min(ny, rows - y0), min(nx, columns - x0))
        for i, y0 in enumerate(range(0, rows, ny))
        for j, x0 in enumerate(range(0, columns, nx))
    )


def overlap(a: Tile, b: Tile) -> Tile:
    """The pixels that two rectangles share; without rows or columns where there are none."""
    y0, x0 = max(a.y0, b.y0), max(a.x0, b.x0)
    y1, x1 = min(a.y0 + a.rows, b.y0 + b.rows), min(a.x0 + a.columns, b.x0 + b.columns)
    return Tile(a.row, a.column, y0, x0, max(0, y1 - y0), max(0, x1 - x0))
