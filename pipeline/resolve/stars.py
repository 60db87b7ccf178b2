"""The stars around a scene's field: where they are read, how bright and how many they are."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import reduce
from operator import or_
from typing import TYPE_CHECKING

import numpy as np

from catalog_tools.engine.schedulers import TASKS_PER_WINDOW
from pipeline.arrays import Array, FrameStars, Geometry, StarTable, concatenate, select
from pipeline.inputs.stars.catalogues import gather_left_out, layer_decisions
from pipeline.inputs.stars.stars import (
    Catalogue,
    Shard,
    brightest_g_mags,
    cones_of,
    gather_leaf,
    gather_shards,
)
from pipeline.physics.colour import ColourFit
from pipeline.plan.cones import catalogue_cones, field_cones
from pipeline.plan.coverage import FieldCoverage
from pipeline.plan.pointing.geometry import epochs_jyear, observer_distances_au, plan_geometry
from pipeline.plan.resolved import ResolvedScene
from pipeline.plan.response.sources import known_of_frames, stars_known
from pipeline.plan.stars.brightest import brightest_star_e, star_radius_rad
from pipeline.plan.stars.field_stars import FieldStars, OwnMotion, StarCounts
from pipeline.plan.tiles import distance_px
from pipeline.spec.scene import Scene

if TYPE_CHECKING:
    from catalog_tools.geometry.regions import Cone

LOOKED_AT = 5  # frames, spread over the scene
PLACED = 400_000  # stars placed in all of them together: of more, some stand for all


def shards_of(
    resolved: ResolvedScene, catalogues: tuple[Catalogue, ...], g: Geometry
) -> tuple[Shard, ...]:
    """Shards that the frames of a geometry need."""
    stars = resolved.scene.stars
    if stars is None:
        return ()
    return gather_shards(catalogues, _cones(g, field_cones(resolved, g)), stars.faintest_g_mag)


def brightest_in_field_e(
    scene: Scene, catalogues: tuple[Catalogue, ...], g: Geometry, colour: ColourFit | None
) -> float:
    """Light of the brightest star in or beside the frames of a geometry [e-]; 0 without stars."""
    if scene.stars is None or colour is None:
        return 0.0
    around = catalogue_cones(scene, g, g.attitude[:, g.middle, 2], star_radius_rad(scene, g))
    cones, limit = _cones(g, around), scene.stars.faintest_g_mag
    groups = [
        brightest_g_mags(catalogues[s.catalogue], s.leaf, limit)
        for s in gather_shards(catalogues, cones, limit)
    ]
    return brightest_star_e(scene, colour, (float(m) for g_mag in groups for m in g_mag))


def stars_left_out(
    resolved: ResolvedScene, catalogues: tuple[Catalogue, ...]
) -> tuple[np.ndarray, ...]:
    """Of each catalogue, the stars in the field of any frame that an earlier one holds."""
    if len(catalogues) < 2:
        return gather_left_out(catalogues, (), None)
    assert resolved.scene.stars is not None
    frames = np.arange(resolved.frames, dtype=np.int64)
    cones: list[Cone] = []
    for start in range(0, resolved.frames, TASKS_PER_WINDOW):
        g = plan_geometry(resolved.scene, frames[start:][:TASKS_PER_WINDOW], resolved.dut1_s)
        cones += _cones(g, field_cones(resolved, g))
    return gather_left_out(catalogues, cones, resolved.scene.stars.faintest_g_mag)


def gather_field_stars(
    resolved: ResolvedScene,
    catalogues: tuple[Catalogue, ...],
    left_out: Sequence[Array],
    g: Geometry,
    coverage: FieldCoverage | None,
) -> FieldStars | None:
    """The stars of the fullest of some frames counted; nothing is imported or read without stars.

    g : of frames of the scene; left_out : as of `stars_left_out`
    """
    if resolved.scene.stars is None:
        return None
    found, each = _placed(resolved, catalogues, left_out, g)
    counts = _counts(resolved, max(found, key=len), each) if found else StarCounts(np.empty(0))
    every = each == 1.0 and len(found) == len(lit_frames(resolved, g))
    every = every and len(g.frame) == resolved.frames
    sources = None
    if every:
        r = resolved.responses
        sources = known_of_frames(
            [
                stars_known(r, np.full(len(stars), k), stars.x_px, stars.y_px, stars.light_e)
                for k, stars in enumerate(found)
            ]
        )
    leaves = [shard.leaf for shard in shards_of(resolved, catalogues, g)]
    own = OwnMotion(
        max((leaf.max_proper_motion_mas_yr for leaf in leaves), default=0.0),
        max((leaf.max_parallax_mas for leaf in leaves), default=0.0),
    )
    layers = tuple(layer_decisions(catalogues, left_out))
    return FieldStars(counts, own, layers, coverage, sources)


def _counts(resolved: ResolvedScene, stars: FrameStars, each: float) -> StarCounts:
    """The stars of a frame by their light, of which each that was placed stands for some."""
    order = np.argsort(stars.light_e, kind="stable")
    frame = (0, 0, *resolved.scene.sensor.shape)
    beyond_px = distance_px(stars.x_px, stars.y_px, *frame)
    return StarCounts(stars.light_e[order], each, beyond_px[order])


def lit_frames(resolved: ResolvedScene, g: Geometry) -> list[int]:
    """Which of the frames of `g` (by index) are exposed to light: all but those of a bias."""
    return [i for i, k in enumerate(g.frame) if resolved.integration_s(int(k)) > 0.0]


def _cones(g: Geometry, caps: tuple[Array, Array]) -> tuple[Cone, ...]:
    """Cones (centres (F, 3), radii (F,) [rad]) at the times and places of the frames."""
    return cones_of(*caps, epochs_jyear(g), observer_distances_au(g))


def _placed(
    resolved: ResolvedScene,
    catalogues: tuple[Catalogue, ...],
    left_out: Sequence[Array],
    g: Geometry,
) -> tuple[list[FrameStars], float]:
    """The stars of some frames, and how many each stands for: read and placed as the drawing does
    it."""
    from pipeline.execute.sources import place_stars

    frames = _looked_at(resolved, catalogues, g)
    if not frames:
        return [], 1.0
    needed = [_by_leaf(shards_of(resolved, catalogues, one)) for one in frames]
    step = max(1, max(_rows(shards.values()) for shards in needed) // PLACED)
    found: list[list[FrameStars]] = [[] for _ in frames]
    for key, shard in reduce(or_, needed).items():
        catalogue = catalogues[shard.catalogue]
        stars = _read(resolved, catalogue, shard, left_out[shard.catalogue])
        stars = select(stars, np.arange(0, len(stars), step))
        epoch = catalogue.ref_epoch_jyear
        for one, shards, placed in zip(frames, needed, found, strict=True):
            if key in shards:
                placed.append(place_stars(resolved, stars, one, epoch, shard.catalogue))
    return [concatenate(placed, FrameStars) for placed in found], float(step)


def _looked_at(
    resolved: ResolvedScene, catalogues: tuple[Catalogue, ...], g: Geometry
) -> list[Geometry]:
    """Some of the frames that are exposed to light: the fewer, the more stars they hold."""
    lit = lit_frames(resolved, g)
    if not lit:
        return []
    first = _rows(shards_of(resolved, catalogues, g.frame_slice(lit[0])))
    most = int(np.clip(PLACED // max(1, first), 1, LOOKED_AT))
    looked = np.unique(np.linspace(0, len(lit) - 1, most).astype(int))
    return [g.frame_slice(lit[i]) for i in looked]


def _by_leaf(shards: Iterable[Shard]) -> dict[tuple[int, int, int], Shard]:
    return {(s.catalogue, s.leaf.order, s.leaf.pixel): s for s in shards}


def _rows(shards: Iterable[Shard]) -> int:
    return sum(group.rows for shard in shards for group in shard.leaf.row_groups)


def _read(
    resolved: ResolvedScene, catalogue: Catalogue, shard: Shard, left_out: Array
) -> StarTable:
    request = resolved.scene.stars
    assert request is not None
    assert resolved.colour is not None
    return gather_leaf(
        catalogue,
        shard.leaf,
        request.faintest_g_mag,
        resolved.colour,
        resolved.facts.area_m2,
        not request.space_motion,
        left_out,
    )
