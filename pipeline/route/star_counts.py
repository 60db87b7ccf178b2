"""How many stars of how much light a frame holds: read and placed as the drawing does it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import reduce
from operator import or_

import numpy as np

from pipeline.arrays import Array, Geometry, StarTable, select
from pipeline.execute.sources import place_stars
from pipeline.inputs.stars.stars import Catalogue, Shard, gather_leaf
from pipeline.plan.scene_plan import Plan

LOOKED_AT = 5  # frames, spread over the scene
PLACED = 400_000  # stars placed in all of them together: of more, some stand for all


def frame_lights(
    plan: Plan,
    catalogues: Sequence[Catalogue],
    left_out: Sequence[Array],
    geometry: Geometry,
    shards_of: Callable[[Geometry], Sequence[Shard]],
) -> tuple[Array, float]:
    """Light of the stars of the fullest of some frames [e-], sorted, and how many each stands for.

    geometry : of frames of the scene; shards_of : the shards that a frame needs
    """
    frames = _looked_at(plan, geometry, shards_of)
    if not frames:
        return np.empty(0), 1.0
    needed = [_by_leaf(shards_of(g)) for g in frames]
    step = max(1, max(_rows(shards.values()) for shards in needed) // PLACED)
    found: list[list[Array]] = [[] for _ in frames]
    for key, shard in reduce(or_, needed).items():
        stars = _read(plan, catalogues[shard.catalogue], shard, left_out[shard.catalogue])
        stars = select(stars, np.arange(0, len(stars), step))
        epoch = catalogues[shard.catalogue].ref_epoch_jyear
        for g, shards, lights in zip(frames, needed, found, strict=True):
            if key in shards:
                lights.append(place_stars(plan, stars, g, epoch, shard.catalogue).light_e)
    each = [np.sort(np.concatenate(lights or [np.empty(0)])) for lights in found]
    return max(each, key=len), float(step)


def _looked_at(
    plan: Plan, geometry: Geometry, shards_of: Callable[[Geometry], Sequence[Shard]]
) -> list[Geometry]:
    """Some of the frames that are exposed to light: the fewer, the more stars they hold."""
    lit = [i for i, k in enumerate(geometry.frame) if plan.integration_s(int(k)) > 0.0]
    if not lit:
        return []
    first = _rows(shards_of(geometry.frame_slice(lit[0])))
    most = int(np.clip(PLACED // max(1, first), 1, LOOKED_AT))
    looked = np.unique(np.linspace(0, len(lit) - 1, most).astype(int))
    return [geometry.frame_slice(lit[i]) for i in looked]


def _by_leaf(shards: Iterable[Shard]) -> dict[tuple[int, int, int], Shard]:
    return {(s.catalogue, s.leaf.order, s.leaf.pixel): s for s in shards}


def _rows(shards: Iterable[Shard]) -> int:
    return sum(group.rows for shard in shards for group in shard.leaf.row_groups)


def _read(plan: Plan, catalogue: Catalogue, shard: Shard, left_out: Array) -> StarTable:
    wish = plan.scene.stars
    assert wish is not None
    assert plan.colour is not None
    return gather_leaf(
        catalogue,
        shard.leaf,
        wish.faintest_g_mag,
        plan.colour,
        plan.facts.area_m2,
        not wish.space_motion,
        left_out,
    )
