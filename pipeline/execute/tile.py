"""One tile of one frame: light, layers, noise, digital numbers. Pure: same input, same bits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from catalog_tools.documents import JsonObject
from pipeline.arrays import Array, FrameStars, Geometry, SensorMaps
from pipeline.execute.blocks import LightBlock
from pipeline.execute.check import Part, check_tile
from pipeline.execute.detector import stream_place, tile_chain
from pipeline.execute.guards import guard_mean
from pipeline.execute.light import draw_stars, draw_targets
from pipeline.physics.noise.chain import (
    calibrated_e,
    held_e,
    layers_e,
    noise_e,
    read_mean_e,
    to_dn,
)
from pipeline.physics.noise.terms import Chain
from pipeline.plan.plan import Plan
from pipeline.plan.tiles import Tile

if TYPE_CHECKING:
    from pipeline.physics.cosmic_rays.frame import CosmicRays


class StarLight(NamedTuple):
    """The light of a tile's stars [e-], drawn once for several frames; what its wings err by."""

    light_e: Array
    wing_error_e: float


class TileSources(NamedTuple):
    """What lights a tile in a frame, and what of that is known already.

    parts : places of the frame's stars, by shard; blocks : those over the tile; rays : cosmic rays;
    light_e : what `tile_light` gave for this tile; shared : its stars' light where an earlier
    frame's serves, `blocks` are then those of targets
    """

    parts: list[FrameStars]
    blocks: list[LightBlock]
    rays: CosmicRays | None = None
    light_e: dict[str, Array] | None = None
    shared: StarLight | None = None


def render_tile(
    plan: Plan,
    maps: SensorMaps,
    g: Geometry,
    tile: Tile,
    sources: TileSources,
    before: Sequence[Array] = (),
) -> tuple[dict[str, NDArray], list[JsonObject]]:
    """The layers of a tile that the scene asks for, and what the reference path found in it.

    The layers are `dn`, and the noise-free ones in float32. The light layers are what the pixels
    collect (after the flat, with smear), so that with the dark and the lag they sum to `mean_e`,
    the mean of the noisy frame before full well and ADC. `cosmic_rays_e` is drawn charge and not
    in it. before : `charge_of_tile` of the frames before, where charge stays behind.
    """
    found = _collected(plan, maps, g, tile, sources)
    layers, chain, own, drawn = found.layers, found.chain, found.mean_e, found.drawn_e
    if drawn is not None:
        layers["cosmic_rays_e"] = drawn
    mean = read_mean_e(own, before, chain)
    if mean is not own:
        layers["lag_e"] = mean - own
    place = stream_place(plan.scene, tile, int(g.frame[0]))
    out: dict[str, NDArray] = {"dn": to_dn(mean, chain, place, drawn)}
    for name in plan.scene.output.layers:
        if name == "calibrated_e":
            out[name] = calibrated_e(out["dn"], chain).astype(np.float32)
        elif name != "dn":
            value = mean if name == "mean_e" else layers.get(name, np.zeros(mean.shape))
            out[name] = value.astype(np.float32)
    return out, _checked(plan, g, tile, sources.parts, found, mean)


def check_light(
    plan: Plan, maps: SensorMaps, g: Geometry, tile: Tile, sources: TileSources
) -> list[JsonObject]:
    """What the reference path finds in a tile, as `render_tile` tells it, and no more."""
    found = _collected(plan, maps, g, tile, sources)
    return _checked(plan, g, tile, sources.parts, found, found.mean_e)


def charge_of_tile(
    plan: Plan, maps: SensorMaps, g: Geometry, tile: Tile, sources: TileSources
) -> Array:
    """What the pixels of a tile collect in one frame [e-]: of it a share is left for the next."""
    found = _collected(plan, maps, g, tile, sources)
    return held_e(found.mean_e, found.drawn_e, found.chain)


class _Collected(NamedTuple):
    """What a tile collects: its detector's terms, light and layers by name, mean, rays' charge."""

    chain: Chain
    light_e: dict[str, Array]
    layers: dict[str, Array]
    mean_e: Array
    drawn_e: Array | None


def _checked(
    plan: Plan, g: Geometry, tile: Tile, parts: list[FrameStars], found: _Collected, mean_e: Array
) -> list[JsonObject]:
    images = [image for name, image in found.light_e.items() if name in ("stars_e", "targets_e")]

    def light_noise_e(part: Part) -> Array:
        """The noise of a part's pixels as it is of their light, before the flat."""
        flat = np.broadcast_to(found.chain.flat, mean_e.shape)[part]
        with np.errstate(divide="ignore"):  # a pixel that takes no light errs by nothing
            return np.asarray(noise_e(mean_e, found.chain, part) / flat)

    return check_tile(plan, g, tile, parts, images, light_noise_e)


def _collected(
    plan: Plan, maps: SensorMaps, g: Geometry, tile: Tile, sources: TileSources
) -> _Collected:
    parts, blocks, rays, light, shared = sources
    chain = tile_chain(plan.scene, maps, tile, plan.integration_s(int(g.frame[0])))
    if light is None:
        light = light_with(plan, g, tile, parts, blocks, shared)
    layers, mean = _mean(plan, g, tile, chain, light, _wing_error_e(blocks, shared))
    drawn = None if rays is None else _cosmic_rays_e(plan, rays, chain, g, tile)
    return _Collected(chain, light, layers, mean, drawn)


def _mean(
    plan: Plan,
    g: Geometry,
    tile: Tile,
    chain: Chain,
    light: dict[str, Array],
    error_e: float,
) -> tuple[dict[str, Array], Array]:
    """The noise-free layers of a tile, and their sum: the mean of what its pixels collect.

    error_e : what the wings may err by, also below zero
    """
    layers = layers_e(light, chain, (tile.rows, tile.columns))
    first, *others = layers.values() or [np.zeros((tile.rows, tile.columns))]
    mean = first + 0.0
    for layer in others:
        mean += layer
    return layers, guard_mean(plan, g, tile, mean, layers, error_e)


LIGHTS = ("stars", "targets", "sky")  # in the order in which they are summed


def star_light(
    plan: Plan, g: Geometry, tile: Tile, parts: list[FrameStars], blocks: list[LightBlock]
) -> StarLight:
    """The light of a tile's stars where they stand in the frame of `g`."""
    light = tile_light(plan, g, tile, parts, blocks, ("stars",))["stars_e"]
    return StarLight(light, _wing_error_e(blocks, None))


def light_with(
    plan: Plan,
    g: Geometry,
    tile: Tile,
    parts: list[FrameStars],
    blocks: list[LightBlock],
    shared: StarLight | None,
) -> dict[str, Array]:
    """`tile_light`, or the same with the light of stars that another frame's drawing gave."""
    if shared is None:
        return tile_light(plan, g, tile, parts, blocks)
    return {"stars_e": shared.light_e} | tile_light(plan, g, tile, parts, blocks, LIGHTS[1:])


def _wing_error_e(blocks: list[LightBlock], shared: StarLight | None) -> float:
    error_e = max((b.wing_error_e for b in blocks), default=0.0)
    return error_e if shared is None else error_e + shared.wing_error_e


def tile_light(
    plan: Plan,
    g: Geometry,
    tile: Tile,
    parts: list[FrameStars],
    blocks: list[LightBlock],
    which: tuple[str, ...] = LIGHTS,
) -> dict[str, Array]:
    """Mean light of a tile before the detector, by layer [e-]: arrays, or one for all pixels.

    which : only the light of these, to be drawn apart from the rest
    """
    light: dict[str, Array] = {}
    if "stars" in which and plan.scene.stars is not None:
        light["stars_e"] = draw_stars(plan, g, tile, parts, blocks)
    if "targets" in which and plan.scene.targets:
        light["targets_e"] = draw_targets(plan, g, tile, blocks)
    if "sky" not in which:
        return light
    frame = int(g.frame[0])
    if plan.sky is not None:
        from pipeline.plan.sky.sky import sky_tile

        part = replace(tile, rows=1, columns=1) if plan.sky.even else tile  # one value for all
        light["background_e"] = sky_tile(plan.sky, frame, part) * plan.integration_s(frame)
    return light


def _cosmic_rays_e(plan: Plan, rays: CosmicRays, chain: Chain, g: Geometry, tile: Tile) -> Array:
    """Charge of cosmic rays in a tile; before the flat, or after it."""
    from pipeline.physics.cosmic_rays.frame import charge_e, exposed_for

    assert plan.scene.cosmic_rays is not None
    place = (tile.y0, tile.x0, tile.rows, tile.columns)
    frame = int(g.frame[0])
    rays = exposed_for(rays, plan.integration_s(frame))
    charge = charge_e(rays, plan.scene.seed, frame, *place)
    return charge if plan.scene.cosmic_rays.after_flat else charge * chain.flat
