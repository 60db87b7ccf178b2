"""The Dask graph: shard, place, block, tile and truth tasks of a window of frames."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from catalog_tools.documents import JsonObject
from catalog_tools.engine.ahead import Key, Tasks
from pipeline.arrays import Array, FrameStars, Geometry, SensorMaps, StarTable, concatenate
from pipeline.execute.blocks import LightBlock, plan_blocks, render_block
from pipeline.execute.coordinates import frame_coordinates
from pipeline.execute.sources import excursion_px, place_stars, truth_order
from pipeline.execute.tile import StarLight, TileSources, charge_of_tile, render_tile, star_light
from pipeline.execute.truth import star_truth, target_truth
from pipeline.inputs.stars.stars import Catalogue, Shard, gather_leaf, leaf_pad_rad
from pipeline.lazily import arrow
from pipeline.physics.positions.focal_plane import deproject, stretch
from pipeline.physics.vectors import separation
from pipeline.plan.cones import catalogue_cones
from pipeline.plan.plan import Plan
from pipeline.plan.pointing.geometry import epochs_jyear, observer_distances_au
from pipeline.plan.tiles import Tile, overlap
from pipeline.store.cube import CubeWriter

if TYPE_CHECKING:
    from pipeline.physics.cosmic_rays.frame import CosmicRays


@dataclass(frozen=True)
class Inputs:
    """What every task may need; sent to each worker once.

    catalogues : the main one and the layers over it; left_out : of each, the sorted source_ids of
    stars that an earlier one holds
    """

    plan: Plan
    maps: SensorMaps
    catalogues: tuple[Catalogue, ...]
    left_out: tuple[np.ndarray, ...]
    writer: CubeWriter
    rays: CosmicRays | None = None


@dataclass(frozen=True)
class WindowWork:
    """What is still to be done in a window of frames: indices into its geometry.

    Where charge stays behind, the geometry begins with frames before the window. It ends with
    those whose stars the others share, where they are not among them.
    """

    geometry: Geometry
    tiles: tuple[tuple[int, Tile], ...]
    star_truth: tuple[int, ...]
    target_truth: tuple[int, ...]
    ray_truth: tuple[int, ...] = ()


def shard_key(shard: Shard) -> Key:
    """Names a shard and the row groups that are read of it: another window may want others."""
    leaf = shard.leaf
    groups = ",".join(str(group.row_group) for group in leaf.row_groups)
    return "shard", shard.catalogue, leaf.order, leaf.pixel, groups


def rows_wanted(shard: Shard) -> int:
    """Rows that are read of a shard: no more stars come from it."""
    return sum(group.rows for group in shard.leaf.row_groups)


def shard_graph(inputs: object, shards: Iterable[Shard]) -> Tasks:
    """One task per shard: its bright enough rows, with their light."""
    return {shard_key(shard): (read_shard, inputs, shard) for shard in shards}


def window_graph(
    inputs: object,
    plan: Plan,
    work: WindowWork,
    shards: dict[Shard, object],
    ref_epochs_jyear: tuple[float, ...] = (),
) -> tuple[Tasks, list[Key]]:
    """Graph of a window and the keys to compute.

    inputs : the Inputs, or a future of them; shards : each shard's stars, or a future of them;
    ref_epochs_jyear : of the catalogues.
    A tile depends on the shards whose stars can reach it and on its blocks, a block
    on the shards around it; nothing that no tile asks for gets a task.
    """
    graph: Tasks = {}
    wanted: list[Key] = []
    g, frames, lag = work.geometry, work.geometry.frame.tolist(), plan.lag_frames
    blocks = plan_blocks(plan, sum(rows_wanted(shard) for shard in shards))
    views = _views(plan, work, shards, ref_epochs_jyear, blocks)
    for index, tile in work.tiles:
        before = []
        for earlier in frames[max(0, index - lag) : index]:
            key = ("charge", earlier, tile.row, tile.column)
            if key not in graph:
                seen = _light_of(graph, inputs, plan, views, earlier, tile, blocks)
                graph[key] = (charge_task, inputs, views[earlier].g, tile, *seen)
            before.append(key)
        frame = frames[index]
        seen = _light_of(graph, inputs, plan, views, frame, tile, blocks)
        wanted.append(("tile", frame, tile.row, tile.column))
        graph[wanted[-1]] = (tile_task, inputs, views[frame].g, tile, *seen, before)
    for index in work.star_truth:
        view = views[frames[index]]
        everywhere = _places(graph, inputs, view, None)
        wanted.append(("star_truth", frames[index]))
        graph[wanted[-1]] = (star_truth_task, inputs, view.g, everywhere)
    for name, task, indices in (
        ("target_truth", target_truth_task, work.target_truth),
        ("ray_truth", ray_truth_task, work.ray_truth),
    ):
        for index in indices:
            wanted.append((name, frames[index]))
            graph[wanted[-1]] = (task, inputs, g.frame_slice(index))
    return graph, wanted


def _views(
    plan: Plan,
    work: WindowWork,
    shards: dict[Shard, object],
    ref_epochs_jyear: tuple[float, ...],
    blocks: Iterable[Tile],
) -> dict[int, _View]:
    """The frames, by number, whose stars the tasks of a window ask for."""
    g, lag = work.geometry, plan.lag_frames
    place = {int(frame): i for i, frame in enumerate(g.frame)}
    needed = {i - j for i, _ in work.tiles for j in range(min(i, lag) + 1)}
    needed |= {place[plan.drawn_frame(int(g.frame[i]))] for i in needed}
    needed |= set(work.star_truth)
    rectangles = tuple(dict.fromkeys((*(tile for _, tile in work.tiles), *blocks)))  # each once
    return {
        int(g.frame[i]): _view(plan, g.frame_slice(i), shards, ref_epochs_jyear, rectangles)
        for i in sorted(needed)
    }


def _light_of(
    graph: Tasks,
    inputs: object,
    plan: Plan,
    views: dict[int, _View],
    frame: int,
    tile: Tile,
    blocks: Iterable[Tile],
) -> tuple[list[Key], list[Key], list[Key]]:
    """Keys of what a tile of a frame is drawn from: its stars' places, its blocks, and the
    light of its stars, where that is drawn for several frames."""
    view = views[frame]
    if plan.shared_frames == 1:
        return *_seen_by(graph, inputs, view, tile, blocks), []
    first = plan.drawn_frame(frame)
    key = ("stars", first, tile.row, tile.column)
    if key not in graph:
        seen = _seen_by(graph, inputs, views[first], tile, blocks)
        graph[key] = (star_task, inputs, views[first].g, tile, *seen)
    of_targets = blocks if plan.scene.targets and plan.responses.spacing_px else ()
    bare = replace(view, shards={}, near={r: [] for r in view.near})
    around = _seen_by(graph, inputs, bare, tile, of_targets, "target_block")[1]
    return _places(graph, inputs, view, tile), around, [key]


def _seen_by(
    graph: Tasks,
    inputs: object,
    view: _View,
    tile: Tile,
    blocks: Iterable[Tile],
    kind: str = "block",
) -> tuple[list[Key], list[Key]]:
    """Keys of what a tile of a frame is drawn from: its stars' places, and its blocks."""
    parts = _places(graph, inputs, view, tile)
    frame, around = int(view.g.frame[0]), list[Key]()
    for block in blocks:
        shared = overlap(tile, block)
        if shared.rows and shared.columns:
            key = (kind, frame, block.row, block.column)
            if key not in graph:
                near = _places(graph, inputs, view, block)
                graph[key] = (block_task, inputs, view.g, block, near)
            around.append(key)
    return parts, around


@dataclass(frozen=True)
class _View:
    """One frame: its geometry, each shard's stars, and which of the shards may send light to each
    of its tiles and blocks (never wrongly omitted)."""

    g: Geometry
    shards: dict[Shard, object]
    near: dict[Tile, list[Shard]]


def _view(
    plan: Plan,
    g: Geometry,
    shards: dict[Shard, object],
    ref_epochs_jyear: tuple[float, ...],
    rectangles: tuple[Tile, ...],
) -> _View:
    near: dict[Tile, list[Shard]] = {tile: [] for tile in rectangles}
    if not shards or not rectangles:
        return _View(g, shards, near)
    epoch, distance = float(epochs_jyear(g)[0]), float(observer_distances_au(g)[0])
    # A star may be so far off a tile at mid-exposure and still light it.
    centres, radii_rad = _cones(plan, g, rectangles, plan.halo_px + excursion_px(plan, g))
    for shard in shards:
        leaf, years = shard.leaf, epoch - ref_epochs_jyear[shard.catalogue]
        pad_rad = leaf_pad_rad(leaf, years, distance)  # how far from their catalogue places
        apart = separation(centres, np.array(leaf.centre))
        for i in np.flatnonzero(apart <= radii_rad + leaf.radius_rad + pad_rad):
            near[rectangles[i]].append(shard)
    return _View(g, shards, near)


def _cones(
    plan: Plan, g: Geometry, rectangles: tuple[Tile, ...], reach_px: float
) -> tuple[np.ndarray, np.ndarray]:
    """Cones of the catalogue's sky (centres, radii [rad]) that may send light to rectangles."""
    x = np.array([r.x0 + (r.columns - 1) / 2 for r in rectangles])
    y = np.array([r.y0 + (r.rows - 1) / 2 for r in rectangles])
    centres = deproject(plan.camera, g.attitude[0, g.middle], x, y)
    half_px = 0.5 * np.hypot([r.rows for r in rectangles], [r.columns for r in rectangles])
    radii_rad = (half_px + reach_px) * stretch(plan.camera) * plan.facts.ifov_rad
    return catalogue_cones(plan.scene, g, centres, radii_rad)


def _places(graph: Tasks, inputs: object, view: _View, tile: Tile | None) -> list[Key]:
    """Keys of the place tasks of the shards that can reach a tile (None: the whole frame)."""
    keys: list[Key] = []
    for shard in view.shards if tile is None else view.near[tile]:
        place = shard.catalogue, shard.leaf.order, shard.leaf.pixel
        key = ("place", int(view.g.frame[0]), *place)
        if key not in graph:
            graph[key] = (place_task, inputs, view.shards[shard], view.g, shard.catalogue)
        keys.append(key)
    return keys


def read_shard(inputs: Inputs, shard: Shard) -> StarTable:
    """Task: the rows of one shard."""
    plan, request = inputs.plan, inputs.plan.scene.stars
    assert request is not None
    assert plan.colour is not None
    return gather_leaf(
        inputs.catalogues[shard.catalogue],
        shard.leaf,
        request.faintest_g_mag,
        plan.colour,
        plan.facts.area_m2,
        not request.space_motion,
        inputs.left_out[shard.catalogue],
    )


def place_task(inputs: Inputs, stars: StarTable, g: Geometry, catalogue: int) -> FrameStars:
    """Task: the stars of one shard of a catalogue that one frame sees."""
    epoch = inputs.catalogues[catalogue].ref_epoch_jyear
    return place_stars(inputs.plan, stars, g, epoch, catalogue)


def block_task(inputs: Inputs, g: Geometry, place: Tile, parts: list[FrameStars]) -> LightBlock:
    """Task: what one block of one frame gives to its tiles."""
    return render_block(inputs.plan, g, place, parts)


def star_task(
    inputs: Inputs, g: Geometry, tile: Tile, parts: list[FrameStars], blocks: list[LightBlock]
) -> StarLight:
    """Task: the light of a tile's stars, for several frames."""
    return star_light(inputs.plan, g, tile, parts, blocks)


def tile_task(
    inputs: Inputs,
    g: Geometry,
    tile: Tile,
    parts: list[FrameStars],
    blocks: list[LightBlock],
    shared: list[StarLight],
    before: list[Array],
) -> tuple[int, int, int]:
    """Task: render one tile of one frame and store it; returns only its name."""
    sources = TileSources(parts, blocks, inputs.rays, shared=next(iter(shared), None))
    layers, checks = render_tile(inputs.plan, inputs.maps, g, tile, sources, before)
    first = (tile.row, tile.column) == (0, 0)
    coordinates = frame_coordinates(inputs.plan, g) if first else None
    inputs.writer.write(int(g.frame[0]), tile, layers, checks, coordinates)
    return int(g.frame[0]), tile.row, tile.column


def charge_task(
    inputs: Inputs,
    g: Geometry,
    tile: Tile,
    parts: list[FrameStars],
    blocks: list[LightBlock],
    shared: list[StarLight],
) -> Array:
    """Task: what a tile of one frame collects, for the frames after in which a share is left."""
    sources = TileSources(parts, blocks, inputs.rays, shared=next(iter(shared), None))
    return charge_of_tile(inputs.plan, inputs.maps, g, tile, sources)


def star_truth_task(inputs: Inputs, g: Geometry, parts: list[FrameStars]) -> int:
    """Task: the stars' truth of one frame; returns the rows."""
    stars = truth_order(concatenate(parts, FrameStars))
    return _write_truth(inputs, "stars", g, star_truth(inputs.plan, g, stars))


def target_truth_task(inputs: Inputs, g: Geometry) -> int:
    """Task: the targets' truth of one frame; returns the rows."""
    return _write_truth(inputs, "targets", g, target_truth(inputs.plan, g))


def ray_truth_task(inputs: Inputs, g: Geometry) -> int:
    """Task: the cosmic rays' truth of one frame; returns the rows."""
    from pipeline.physics.cosmic_rays.frame import exposed_for, no_truth, truth_columns

    frame = int(g.frame[0])
    columns = (
        no_truth()
        if inputs.rays is None
        else truth_columns(
            exposed_for(inputs.rays, inputs.plan.integration_s(frame)),
            inputs.plan.scene.seed,
            frame,
        )
    )
    return _write_truth(inputs, "cosmic_rays", g, columns)


def _write_truth(inputs: Inputs, kind: str, g: Geometry, columns: JsonObject) -> int:
    table = arrow().table(columns)
    inputs.writer.write_truth(kind, int(g.frame[0]), table)
    return int(table.num_rows)
