"""One approximation at a time switched off: what it changes, its bound, and what it saves."""

from __future__ import annotations

import copy
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from catalog_tools.documents import JsonObject
from pipeline.arrays import Array
from pipeline.execute.blocks import around
from pipeline.execute.light import add_wings_of, draw_along
from pipeline.execute.sources import excursion_px
from pipeline.plan.plan import Plan
from pipeline.plan.tiles import Tile
from pipeline.studies.scenes.exact import Exact, exact_sky
from pipeline.studies.scenes.level import cut_e, lights_near
from pipeline.studies.scenes.stage import Light, Stage, blocks_by, light_by, mean_of, open_stage
from pipeline.studies.worst import worst_of

MANY = 12  # wavelengths
MOST = 640  # that a scene may ask for
LARGEST_DOUBLED_PX = 72.0  # of cores: tables of larger ones take minutes
FEW_STARS = 60  # that may be drawn one by one under the clock
Drawing = Callable[[], Light]  # anew: nothing of an earlier one is kept but tables
REGIONS_PX = (1024, 256, 128, 64, 32, 16)


@dataclass(frozen=True)
class Switch:
    """An approximation of a plan, drawn with it and without it.

    off : draws the light without it; on : light that differs in nothing else
    bound_e : what the plan says that a pixel may err by at the noise floor [e-]; where it is of a
        source's light, that times the brightest one's that reaches a window (all of theirs for the
        end of their wings)
    one_by_one : `off` draws star by star, too slow for a whole frame
    """

    component: str
    on: Drawing
    off: Drawing
    bound_e: float
    one_by_one: bool = False
    of_light: bool = False


def measure_switches(stage: Stage, tiles: tuple[Tile, ...], exact: Exact) -> list[JsonObject]:
    """A record for each approximation of the stage's plan: error, bound, seconds of a frame."""
    return [_measured(stage, tiles, exact, s) for s in switches(stage, tiles, exact.windows)]


def _measured(stage: Stage, tiles: tuple[Tile, ...], exact: Exact, switch: Switch) -> JsonObject:
    error_e = error_sigma = 0.0
    lights = switch.on(), switch.off()
    for window, noise in zip(exact.windows, exact.noise_e, strict=True):
        on, off = (mean_of(stage, light(window), window) for light in lights)
        error_e = worst_of(error_e, np.abs(on - off).max())
        error_sigma = worst_of(error_sigma, (np.abs(on - off) / noise).max())
    seconds_on = _seconds(partial(light_by, stage, stage.plan), tiles)
    scaled = 1.0
    region = tiles
    if switch.one_by_one:
        region, scaled = _few(stage, tiles)
    seconds_off = _seconds(switch.off, region, scaled)
    sigma = stage.plan.facts.sigma_floor_e
    return {
        "component": switch.component,
        "error_e": error_e,
        "error_sigma": error_sigma,
        "bound_e": switch.bound_e,
        "bound_sigma": switch.bound_e / sigma,
        "of_light": switch.of_light,
        "seconds_on": seconds_on,
        "seconds_off": seconds_off,
        "scaled_from": scaled if scaled != 1.0 else None,
        "holds": (
            error_e <= switch.bound_e if switch.of_light else error_sigma <= switch.bound_e / sigma
        ),
    }


def _seconds(drawing: Drawing, tiles: tuple[Tile, ...], scaled: float = 1.0) -> float:
    """CPU seconds of the light of some tiles, once tables are there: of the blocks that hold wings
    and crowds once, of the rest so many times as much."""
    drawing()(_corner(tiles[0]))
    light, began = drawing(), time.process_time()
    for tile in tiles:
        light(_corner(tile))
    blocks_s = time.process_time() - began
    for tile in tiles:
        light(tile)
    return blocks_s + scaled * (time.process_time() - began - blocks_s)


def _corner(tile: Tile) -> Tile:
    """A few pixels of a tile."""
    return Tile(0, 0, tile.y0, tile.x0, min(16, tile.rows), min(16, tile.columns))


def _few(stage: Stage, tiles: tuple[Tile, ...]) -> tuple[tuple[Tile, ...], float]:
    """A part of the frame with few stars, and how many times as many all tiles hold."""
    reach = stage.plan.responses.classes[-1].radius_px + excursion_px(stage.plan, stage.g)
    every = sum(len(around(stage.stars, t, reach)) for t in tiles)
    t = tiles[len(tiles) // 2]
    for side in REGIONS_PX:
        part = Tile(0, 0, t.y0, t.x0, min(side, t.rows), min(side, t.columns))
        count = len(around(stage.stars, part, reach))
        if count <= FEW_STARS:
            break
    return (part,), every / max(count, 1)


def switches(stage: Stage, tiles: tuple[Tile, ...], windows: Sequence[Tile]) -> Iterator[Switch]:
    """Every approximation of the stage's plan that can be omitted by drawing otherwise.

    windows : that are looked at: a share of a source's light is that of those that reach them
    """
    plan = stage.plan
    bounds = {d.component: d.error_bound_e for d in plan.decisions if d.error_bound_e}

    def drawn_by(other: Plan) -> Drawing:
        return partial(light_by, stage, other)

    on = drawn_by(plan)

    def told(component: str, off: Drawing, **more: Any) -> Iterator[Switch]:
        if component in bounds:
            yield Switch(component, more.pop("on", on), off, float(bounds[component] or 0), **more)

    yield from told("background.grid", _with_exact_sky(stage, on))
    if not plan.responses.classes:
        return
    plain = _without_tables(plan)
    brightest_e, all_e = _lights(stage, windows)
    if plan.scene.stars is not None:
        yield from told("phase_interpolation", drawn_by(plain), one_by_one=True)
    if plan.responses.streaks.longest_px:
        yield from told(
            "common_streak", partial(_own_paths, stage, plain), on=drawn_by(plain), one_by_one=True
        )
    if _in_crowds(stage, tiles):
        yield from told("crowds_by_transforms", _apart(stage, plain))
    finer = drawn_by(_without_tables(_finer_wings(plan)))
    yield from told(
        "wings_on_a_coarse_grid",
        finer,
        on=drawn_by(plain),
        one_by_one=plan.scene.stars is not None,
    )
    if "wings_cut_off" in bounds:
        bound = cut_e(plan, all_e)
        yield Switch("wings_cut_off", on, drawn_by(_farther(stage)), bound, of_light=True)
    yield from told("targets.point_sources", drawn_by(_with_discs(plan)))
    if plan.facts.band is not None:
        yield from _wavelengths(stage, brightest_e)


def _lights(stage: Stage, windows: Sequence[Tile]) -> tuple[float, float]:
    """Light of the brightest source that reaches a window, and the most that all bring to one."""
    near = [[*stars, *targets] for stars, targets in (lights_near(stage, w) for w in windows)]
    return max(max(light, default=0.0) for light in near), max(map(sum, near))


def _apart(stage: Stage, plain: Plan) -> Drawing:
    """No stars drawn together: as stamps of the streaks in common, or along their own paths."""
    r = stage.plan.responses
    if any(core.together_from for core in r.classes):
        return partial(_own_paths, stage, plain)
    return partial(light_by, stage, replace(stage.plan, responses=replace(r, spectral_from=0)))


def _without_tables(plan: Plan) -> Plan:
    """Every star drawn at its exact place by its own transform."""
    alone = {"phases": 0, "fine_phases": 0, "point_phases": 0, "together_from": 0}
    classes = tuple(replace(c, **alone) for c in plan.responses.classes)
    return replace(plan, responses=replace(plan.responses, classes=classes))


def _finer_wings(plan: Plan) -> Plan:
    """Cores of twice the radius, and what is left on a grid of half the spacing (2 px at least)."""
    r = plan.responses
    classes = tuple(
        replace(c, radius_px=max(c.radius_px, min(2.0 * c.radius_px, LARGEST_DOUBLED_PX)))
        for c in r.classes
    )
    spacing = max(2, r.spacing_px // 2) if r.spacing_px else 0
    return replace(plan, responses=replace(r, classes=classes, spacing_px=spacing))


def _farther(stage: Stage) -> Plan:
    """Wings drawn as far as the stars were read for: the reach of the finest plan."""
    r = stage.plan.responses
    reach = max(stage.wide.responses.reach_px, r.reach_px)
    return replace(stage.plan, responses=replace(r, reach_px=reach))


def _with_discs(plan: Plan) -> Plan:
    """Every body drawn with its disc, however small."""
    return replace(plan, responses=replace(plan.responses, budget_e=0.0))


def _in_crowds(stage: Stage, tiles: tuple[Tile, ...]) -> bool:
    """Whether any block of the frame is drawn by transforms."""
    if not stage.plan.responses.crowds_from:
        return False
    blocks = blocks_by(stage, stage.plan)
    return any(block.crowd_e is not None for tile in tiles for block in blocks(tile))


def _with_exact_sky(stage: Stage, on: Drawing) -> Drawing:
    """The sky of each pixel at its own place."""
    sky = exact_sky(stage)

    def anew() -> Light:
        light = on()
        return lambda tile: light(tile) | {"background_e": sky(tile)}

    return anew


def _own_paths(stage: Stage, plan: Plan) -> Light:
    """Every star along its own path, by its own transforms; wings as they are."""
    rest, blocks = light_by(stage, plan), blocks_by(stage, plan)

    def draw(tile: Tile) -> dict[str, Array]:
        image = np.zeros((tile.rows, tile.columns))
        reach = plan.responses.classes[-1].radius_px + excursion_px(plan, stage.g) + 8.0
        stars = around(stage.stars, tile, reach)
        draw_along(_without_tables(plan), stage.g, image, tile, stars)
        for block in blocks(tile):
            add_wings_of(image, tile, block, block.star_wings)
        return rest(tile) | {"stars_e": image}

    return draw


def _wavelengths(stage: Stage, brightest_e: float) -> Iterator[Switch]:
    """The response at many wavelengths in place of few, each star at its exact place.

    brightest_e : light of the brightest source that is looked at
    """
    data = copy.deepcopy(stage.plan.scene.as_dict())
    band, psf = stage.plan.facts.band, data["sensor"]["psf"]
    if band is None or not band.error or "wavelengths" not in psf:
        return
    name = "monochromatic_psf" if len(band.wavelengths_m) == 1 else "few_wavelengths"
    psf["wavelengths"] = min(max(MANY, 2 * len(band.wavelengths_m)), MOST)
    finer = open_stage(data)
    plan = replace(
        stage.plan,
        facts=finer.plan.facts,
        responses=replace(stage.plan.responses, blur=finer.plan.responses.blur),
    )
    on, off = (partial(light_by, stage, _without_tables(p)) for p in (stage.plan, plan))
    one_by_one = plan.scene.stars is not None
    yield Switch(name, on, off, band.error * brightest_e, one_by_one, of_light=True)
