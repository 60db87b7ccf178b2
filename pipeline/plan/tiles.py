"""Tiles: how the focal plane is divided into tasks and chunks, and how much work each is."""

from __future__ import annotations

from dataclasses import dataclass

from pipeline.spec.scene import CELL_PX, Scene

DEFAULT_TILE_PX = 1024


@dataclass(frozen=True)
class Tile:
    """A rectangle of one frame that one task renders and one chunk holds."""

    row: int
    column: int
    y0: int
    x0: int
    rows: int
    columns: int


def tile_shape(scene: Scene) -> tuple[int, int]:
    """Rows and columns of a tile: as the scene says, else 1024 px or the whole axis."""
    if scene.output.tile_shape is not None:
        return scene.output.tile_shape
    rows, columns = (min(n, DEFAULT_TILE_PX) for n in scene.sensor.shape)
    return rows, columns


def plan_tiles(scene: Scene) -> tuple[Tile, ...]:
    """The tiles of a frame, row by row; those at the far edges may be smaller."""
    (rows, columns), (ny, nx) = scene.sensor.shape, tile_shape(scene)
    return tuple(
        Tile(i, j, y0, x0, min(ny, rows - y0), min(nx, columns - x0))
        for i, y0 in enumerate(range(0, rows, ny))
        for j, x0 in enumerate(range(0, columns, nx))
    )


def allowed_tiles(scene: Scene) -> list[int]:
    """Tile sides that the scene allows on its longer axis (multiples of the cell, or all of it)."""
    longest = max(scene.sensor.shape)
    return [*range(CELL_PX, longest, CELL_PX), longest]
