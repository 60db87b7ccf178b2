"""A prepared scene whose stars are placed once, and its light drawn by any plan that is asked."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.arrays import Array, FrameStars, Geometry, concatenate
from pipeline.execute.blocks import LightBlock, plan_blocks, render_block
from pipeline.execute.detector import tile_chain
from pipeline.execute.graph import read_shard, rows_wanted
from pipeline.execute.sources import place_stars
from pipeline.execute.tile import tile_light
from pipeline.physics.noise.chain import noise_e
from pipeline.plan.plan import Plan
from pipeline.plan.pointing.geometry import plan_geometry
from pipeline.plan.tiles import Tile, overlap
from pipeline.resolve.stars import shards_of
from pipeline.route.prepare import Prepared, prepare
from pipeline.route.shares import Share
from pipeline.spec.load import parse_scene
from pipeline.store.cube import CubeWriter

Light = Callable[[Tile], dict[str, Array]]


@dataclass(frozen=True, eq=False)
class Stage:
    """One frame of a scene, ready to be drawn.

    wide : the plan that the stars were read and placed for: none that reaches farther is drawn
    stars : all that may light the frame; rows : of the shards that they are from
    """

    prepared: Prepared
    wide: Plan
    g: Geometry
    stars: FrameStars
    rows: int

    @property
    def plan(self) -> Plan:
        return self.prepared.plan


def open_stage(scene: dict, wide: Plan | None = None, frame: int = 0) -> Stage:
    """Prepare a scene, and read and place its stars for one frame.

    wide : a plan of the same scene that reaches farther; default its own
    """
    prepared = prepare(parse_scene(scene))
    plan = wide or prepared.plan
    g = plan_geometry(plan.scene, np.array([frame]), plan.dut1_s)
    stars, rows = gather_stars(prepared, plan, g)
    return Stage(prepared, plan, g, stars, rows)


def gather_stars(prepared: Prepared, plan: Plan, g: Geometry) -> tuple[FrameStars, int]:
    """Stars that may light the one frame of a geometry, and the rows that were read for them."""
    if plan.scene.stars is None:
        return concatenate([], FrameStars), 0
    inputs = prepared.inputs(CubeWriter("nowhere", ("dn",)), plan)
    shards, parts = shards_of(plan, prepared.catalogues, g), []
    for shard in shards:
        epoch = prepared.catalogues[shard.catalogue].ref_epoch_jyear
        parts.append(place_stars(plan, read_shard(inputs, shard), g, epoch, shard.catalogue))
    return concatenate(parts, FrameStars), sum(rows_wanted(s) for s in shards)


def blocks_by(stage: Stage, plan: Plan) -> Callable[[Tile], list[LightBlock]]:
    """The blocks that a tile is drawn from, as a plan says; each is drawn once."""
    made: dict[tuple[int, int], LightBlock] = {}
    places = plan_blocks(plan, stage.rows)

    def around(tile: Tile) -> list[LightBlock]:
        found = []
        for place in places:
            shared = overlap(tile, place)
            if not (shared.rows and shared.columns):
                continue
            key = place.row, place.column
            if key not in made:
                made[key] = render_block(plan, stage.g, place, [stage.stars])
            found.append(made[key])
        return found

    return around


def light_by(stage: Stage, plan: Plan) -> Light:
    """Draws the light of any part of the frame as a plan says."""
    blocks = blocks_by(stage, plan)
    return lambda tile: tile_light(plan, stage.g, tile, [stage.stars], blocks(tile))


def tiles_of(stage: Stage, share: Sequence[int]) -> tuple[Tile, ...]:
    """The tiles of the first frame that a share (part, of how many) holds."""
    wanted = Share(*share)
    return tuple(t for i, t in enumerate(stage.plan.tiles) if wanted.holds(stage.plan, 0, i))


def mean_of(stage: Stage, light: dict[str, Array], tile: Tile) -> Array:
    """Mean electrons (rows, columns) of a part of the frame, with the flat and the dark."""
    chain = tile_chain(stage.plan.scene, stage.prepared.maps, tile, stage.plan.integration_s(0))
    total = np.zeros((tile.rows, tile.columns))
    for image in light.values():
        total += image * chain.flat
    return np.asarray(total + chain.dark_e)


def noise_of(stage: Stage, mean_e: Array, tile: Tile) -> Array:
    """Noise (rows, columns) of the pixels of a part of the frame of this mean [e-]."""
    chain = tile_chain(stage.plan.scene, stage.prepared.maps, tile, stage.plan.integration_s(0))
    return noise_e(np.maximum(mean_e, 0.0), chain, np.s_[:, :])
