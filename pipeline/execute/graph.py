"""The Dask graph: shard, place, wing, tile and truth tasks of a window of frames."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from pipeline.arrays import FrameStars, Geometry, SensorMaps, StarTable, concatenate, select
from pipeline.execute.light import Wings, plan_blocks, render_wings
from pipeline.execute.sources import place_stars
from pipeline.execute.tile import render_tile
from pipeline.execute.truth import star_truth, target_truth
from pipeline.inputs.stars import Catalogue, Leaf, gather_leaf
from pipeline.physics.positions.focal_plane import deproject
from pipeline.physics.vectors import separation
from pipeline.plan.scene_plan import Plan
from pipeline.plan.tiles import Tile
from pipeline.store.cube import CubeWriter
from pipeline.store.truth import write_part

Key = tuple[Any, ...]


@dataclass(frozen=True)
class Inputs:
    """What every task may need; sent to each worker once."""

    plan: Plan
    maps: SensorMaps
    catalogue: Catalogue | None
    writer: CubeWriter


@dataclass(frozen=True)
class Work:
    """What is still to be done in a window of frames: indices into its geometry."""

    geometry: Geometry
    tiles: tuple[tuple[int, Tile], ...]
    star_truth: tuple[int, ...]
    target_truth: tuple[int, ...]


def shard_graph(inputs: Any, leaves: Iterable[Leaf]) -> dict[Key, Any]:
    """One task per shard: its bright enough rows, with their light."""
    return {("shard", leaf.order, leaf.pixel): (read_shard, inputs, leaf) for leaf in leaves}


def window_graph(
    inputs: Any, plan: Plan, work: Work, shards: dict[Leaf, Any]
) -> tuple[dict[Key, Any], list[Key]]:
    """Graph of a window and the keys to compute.

    inputs : the Inputs, or a future of them; shards : each leaf's stars, or a future of them.
    A tile depends on the shards whose stars can reach it and on the wings of its blocks, a block
    on the shards around it; nothing that no tile asks for gets a task.
    """
    graph: dict[Key, Any] = {}
    wanted: list[Key] = []
    blocks = plan_blocks(plan)
    for index, tile in work.tiles:
        g = work.geometry.frame_slice(index)
        frame = int(g.frame[0])
        parts = _places(graph, inputs, g, shards, plan, tile)
        wings = []
        for block in blocks:
            if _overlap(tile, block):
                key = ("wings", frame, block.row, block.column)
                if key not in graph:
                    around = _places(graph, inputs, g, shards, plan, block)
                    graph[key] = (wing_task, inputs, g, block, around)
                wings.append(key)
        name = ("tile", frame, tile.row, tile.column)
        graph[name] = (tile_task, inputs, g, tile, parts, wings)
        wanted.append(name)
    for index in work.star_truth:
        g = work.geometry.frame_slice(index)
        everywhere = _places(graph, inputs, g, shards, plan, None)
        graph["star_truth", int(g.frame[0])] = (star_truth_task, inputs, g, everywhere)
        wanted.append(("star_truth", int(g.frame[0])))
    for index in work.target_truth:
        g = work.geometry.frame_slice(index)
        graph[("target_truth", int(g.frame[0]))] = (target_truth_task, inputs, g)
        wanted.append(("target_truth", int(g.frame[0])))
    return graph, wanted


def _places(
    graph: dict[Key, Any],
    inputs: Any,
    g: Geometry,
    shards: dict[Leaf, Any],
    plan: Plan,
    tile: Tile | None,
) -> list[Key]:
    """Keys of the place tasks of the shards that can reach a tile (None: the whole frame)."""
    keys = []
    for leaf, table in shards.items():
        if tile is not None and not _reaches(plan, g, leaf, tile):
            continue
        key = ("place", int(g.frame[0]), leaf.order, leaf.pixel)
        if key not in graph:
            graph[key] = (place_task, inputs, table, g)
        keys.append(key)
    return keys


MOTION_MARGIN_RAD = 2e-3  # 7 arcmin: aberration, parallax and 40 years of the fastest star


def _reaches(plan: Plan, g: Geometry, leaf: Leaf, tile: Tile) -> bool:
    """Whether a star of a leaf may send light to a tile (never wrongly no)."""
    x, y = tile.x0 + (tile.columns - 1) / 2, tile.y0 + (tile.rows - 1) / 2
    centre = deproject(plan.camera, g.attitude[0, g.middle], np.array([x]), np.array([y]))[0]
    half_px = 0.5 * float(np.hypot(tile.rows, tile.columns)) + plan.halo_px
    way = float(separation(g.attitude[0, :, 2], g.attitude[0, g.middle, 2]).max())
    radius = half_px * plan.facts.ifov_rad + way + leaf.radius_rad + MOTION_MARGIN_RAD
    return float(separation(centre, np.array(leaf.centre))) <= radius


def _overlap(a: Tile, b: Tile) -> bool:
    rows = a.y0 < b.y0 + b.rows and b.y0 < a.y0 + a.rows
    return rows and a.x0 < b.x0 + b.columns and b.x0 < a.x0 + a.columns


def read_shard(inputs: Inputs, leaf: Leaf) -> StarTable:
    """Task: the rows of one shard."""
    plan, wish = inputs.plan, inputs.plan.scene.stars
    assert wish is not None
    assert plan.colour is not None
    assert inputs.catalogue is not None
    return gather_leaf(
        inputs.catalogue, leaf, wish.faintest_g_mag, plan.colour, plan.facts.area_m2,
        unmoving=not wish.space_motion,
    )  # fmt: skip


def place_task(inputs: Inputs, stars: StarTable, g: Geometry) -> FrameStars:
    """Task: the stars of one shard that one frame sees."""
    assert inputs.catalogue is not None
    return place_stars(inputs.plan, stars, g, inputs.catalogue.ref_epoch_jyear)


def wing_task(inputs: Inputs, g: Geometry, block: Tile, parts: list[FrameStars]) -> Wings:
    """Task: the wings of one block of one frame."""
    return render_wings(inputs.plan, g, block, parts)


def tile_task(
    inputs: Inputs, g: Geometry, tile: Tile, parts: list[FrameStars], wings: list[Wings]
) -> tuple[int, int, int]:
    """Task: render one tile of one frame and store it; returns only its name."""
    layers = render_tile(inputs.plan, inputs.maps, g, tile, parts, wings)
    inputs.writer.write(int(g.frame[0]), tile, layers)
    return int(g.frame[0]), tile.row, tile.column


def star_truth_task(inputs: Inputs, g: Geometry, parts: list[FrameStars]) -> int:
    """Task: the stars' truth of one frame; returns the rows."""
    stars = concatenate(parts, FrameStars)
    stars = select(stars, np.argsort(stars.source_id, kind="stable"))
    return _write_truth(inputs, "stars", g, star_truth(inputs.plan, g, stars))


def target_truth_task(inputs: Inputs, g: Geometry) -> int:
    """Task: the targets' truth of one frame; returns the rows."""
    return _write_truth(inputs, "targets", g, target_truth(inputs.plan, g))


def _write_truth(inputs: Inputs, kind: str, g: Geometry, columns: dict[str, Any]) -> int:
    from pathlib import Path

    import pyarrow as pa

    table = pa.table(columns)
    write_part(Path(inputs.writer.product), kind, int(g.frame[0]), table)
    return int(table.num_rows)
