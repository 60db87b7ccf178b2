"""Stages of this process, kept by content: plans, stars, blocks, light of tiles; drawn once."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import lru_cache, partial
from typing import Any

import numpy as np
from dask.tokenize import tokenize

from catalog_tools.documents import Arguments, JsonObject
from catalog_tools.engine.ahead import cores
from pipeline.arrays import Array, FrameStars, Geometry, SensorMaps
from pipeline.execute.blocks import LightBlock, plan_blocks, render_block
from pipeline.execute.check import cells_to_check
from pipeline.execute.graph import Inputs, place_task, read_shard, shard_key
from pipeline.execute.tables import ContentCache
from pipeline.execute.tile import LIGHTS, TileSources, check_light, tile_light
from pipeline.inputs.memory import free_mb
from pipeline.inputs.sensor.sensor import gather_sensor_maps
from pipeline.plan.facts import noise_floor_e, quieter_e2
from pipeline.plan.plan import Plan
from pipeline.plan.pointing.geometry import plan_geometry
from pipeline.plan.sensor.detector import converter_top_e, quiet_terms
from pipeline.plan.tiles import Tile, overlap
from pipeline.plan.timing import integration_range_s
from pipeline.resolve.stars import shards_of
from pipeline.route.prepare import Prepared, prepare
from pipeline.spec.scene import Scene
from pipeline.store.cube import CubeWriter
from pipeline.sweep.dependence import (
    DETECTOR,
    LightPlan,
    is_plain,
    light_is_shared,
    parts_of,
)

MOST_BYTES = 1.5e9
MEMORY_SHARE = 0.5  # of what is free, all processes together
PLANS_BYTES = 200e6
FRAMES_AHEAD = 16  # frames whose geometry is computed at once


@dataclass(frozen=True)
class Base:
    """What points that differ in their detector alone share.

    key : its content; inputs : for the tasks that read and place stars; parts : of its light,
    each with a key
    """

    key: str
    prepared: Prepared
    inputs: Inputs
    parts: dict[str, tuple[LightPlan, str]]

    @property
    def plan(self) -> Plan:
        return self.prepared.plan


class Stages:
    """Every stage by the content that it depends on; the least recently used are dropped.

    drawn, asked : how often each stage was computed, and asked for
    """

    def __init__(self, most_bytes: float) -> None:
        self._plans = ContentCache(PLANS_BYTES)
        self._light = ContentCache(most_bytes)
        self._lock = threading.Lock()
        self.drawn: Counter[str] = Counter()
        self.asked: Counter[str] = Counter()

    def get(
        self,
        stage: str,
        key: tuple[object, ...],
        make: Callable[[], object],
        size: Callable[[Any], int],
        *,
        small: bool = False,
    ) -> Any:
        """The value of a stage, computed where nothing of this key is kept."""

        def counted() -> object:
            with self._lock:
                self.drawn[stage] += 1
            return make()

        with self._lock:
            self.asked[stage] += 1
        return (self._plans if small else self._light).get((stage, *key), counted, size)

    def base(self, scene: Scene) -> Base:
        """The plan of a scene's light.

        scene : of a point, with numbers in place of its detector's images
        """
        key = _token(("base", scene.model_dump_json(by_alias=True)))
        return self.get("plan", (key,), lambda: _make_base(key, scene), _few, small=True)

    def geometry(self, base: Base, frame: int) -> Geometry:
        """Geometry of one frame."""
        first = frame - frame % FRAMES_AHEAD
        plan = base.plan

        def make() -> Geometry:
            frames = np.arange(first, min(first + FRAMES_AHEAD, plan.frames), dtype=np.int64)
            return plan_geometry(plan.scene, frames, plan.dut1_s)

        g = self.get("geometry", (base.key, first), make, _bytes_of, small=True)
        return g.frame_slice(frame - first)

    def stars(self, base: Base, g: Geometry) -> tuple[str, list[FrameStars]]:
        """Stars of a frame, and the key of what they are."""
        part, content = base.parts["stars"]
        mine = part.geometry(g)
        name = _token((content, mine))

        def make() -> list[FrameStars]:
            inputs = replace(base.inputs, plan=part.plan)
            found = []
            for shard in shards_of(part.plan, base.prepared.catalogues, mine):
                key = _read_key(base, part.plan), shard_key(shard)
                table = self.get("star rows", key, partial(read_shard, inputs, shard), _bytes_of)
                found.append(place_task(inputs, table, mine, shard.catalogue))
            return found

        return name, self.get("stars", (name,), make, lambda v: sum(map(_bytes_of, v)))

    def light(self, base: Base, g: Geometry, tile: Tile) -> dict[str, Array]:
        """Noise-free light of a tile, each kind drawn once for all that it depends on."""
        out: dict[str, Array] = {}
        for kind in LIGHTS:
            out |= self._light_of(base, kind, g, tile)
        return out

    def checked(
        self, base: Base, g: Geometry, tile: Tile, light: dict[str, Array]
    ) -> list[JsonObject]:
        """How far a tile's light is from the reference, against the noise of the base's detector,
        which is that of the quietest point."""
        frame = int(g.frame[0])
        if not cells_to_check(base.plan, frame, tile):
            return []

        def make() -> list[JsonObject]:
            parts = [] if base.plan.scene.stars is None else self.stars(base, g)[1]
            sources = TileSources(parts, [], base.prepared.rays, light)
            return check_light(base.plan, base.prepared.maps, g, tile, sources)

        key = base.key, frame, tile
        return self.get("check", key, make, lambda records: 1000 * len(records), small=True)

    def _light_of(self, base: Base, kind: str, g: Geometry, tile: Tile) -> dict[str, Array]:
        part, key = base.parts[kind]
        if kind == "stars" and base.plan.shared_frames > 1:
            g = self.geometry(base, base.plan.drawn_frame(int(g.frame[0])))
        if kind != "sky" and not getattr(base.plan.scene, kind):
            return {}
        plan, mine = part.plan, part.geometry(g)
        stars: list[FrameStars] = []
        if kind == "stars":
            key, stars = self.stars(base, g)
        else:
            key = _token((key, mine if kind == "targets" else mine.frame))

        def make() -> dict[str, Array]:
            blocks = [] if kind == "sky" else self._blocks(key, plan, mine, tile, stars)
            return tile_light(plan, mine, tile, stars, blocks, (kind,))

        place = (tile.y0, tile.x0, tile.rows, tile.columns)
        return self.get(
            f"{kind} light", (key, place), make, lambda v: sum(a.nbytes for a in v.values())
        )

    def _blocks(
        self, key: str, plan: Plan, g: Geometry, tile: Tile, stars: list[FrameStars]
    ) -> list[LightBlock]:
        """Blocks that a tile overlaps, with the light of stars or of targets alone."""
        found = []
        for block in plan_blocks(plan, sum(len(s) for s in stars)):
            shared = overlap(tile, block)
            if shared.rows and shared.columns:
                make = partial(render_block, plan, g, block, stars)
                found.append(self.get("blocks", (key, block), make, _block_bytes))
        return found


@lru_cache(maxsize=1)
def stages(run: str) -> Stages:
    """The stages of this process for a run of a sweep: files are taken not to change during it.

    What a process keeps leaves room for as many as there are cores.
    """
    assert run
    return Stages(min(MOST_BYTES, MEMORY_SHARE * free_mb() * 1e6 / cores()))


def point_plan(base: Base, scene: Scene, maps: SensorMaps) -> Plan:
    """The base's plan with a point's own detector, seed and name, and the noise that follows; its
    light is checked where it is drawn."""
    if not is_plain(scene):
        return replace(base.plan, checks=())
    sensor = base.plan.scene.sensor.model_copy(
        update={name: getattr(scene.sensor, name) for name in DETECTOR}
    )
    mine = base.plan.scene.model_copy(
        update={"sensor": sensor, "seed": scene.seed, "name": scene.name}
    )
    dark_e_s = maps.typical("dark_e_per_s")
    read, gain = maps.typical("read_noise_e"), maps.typical("gain_e_per_dn")
    sky_e, quiet = base.plan.facts.background_e, quiet_terms(scene, maps)
    facts = replace(
        base.plan.facts,
        dark_e=dark_e_s * integration_range_s(scene)[0],  # as in gather_facts
        read_noise_e=read,
        sigma_floor_e=noise_floor_e(scene, sky_e, quiet),
        flat=maps.typical("flat"),
        quieter_e2=quieter_e2(scene, (dark_e_s, read, gain), quiet),
        top_e=converter_top_e(scene, maps),
    )
    return replace(base.plan, scene=mine, facts=facts, checks=())


def maps_of(kept: Stages, base: Base, scene: Scene) -> SensorMaps:
    """The detector's maps of a point; images are read once for points that share them."""
    if not is_plain(scene):
        return base.prepared.maps
    names = DETECTOR[:3] + ("read_noise_e", "gain_e_per_dn", "bias_dn")
    key = (tuple(getattr(scene.sensor, n) for n in names), scene.sensor.shape)
    return kept.get("sensor maps", key, lambda: gather_sensor_maps(scene), _bytes_of)


def without_noise(scene: Scene, numbers: dict[str, float]) -> Scene:
    """A point's scene for its base: a plain detector with these numbers, no seed."""
    output = scene.output.model_copy(update={"layers": ("dn", "mean_e")})
    update: dict[str, object] = {"output": output, "name": "base"}
    if not is_plain(scene):
        return scene.model_copy(update=update)
    plain: Arguments = {
        "flat": 1.0,
        "full_well_e": None,
        "bias_dn": 0.0,
        "adc_bits": 16,
        "adc_rounding": "half_even",
    } | numbers
    update["sensor"] = scene.sensor.model_copy(update=plain)
    if light_is_shared(scene):
        update["seed"] = 0
    return scene.model_copy(update=update)


def _make_base(key: str, scene: Scene) -> Base:
    prepared = prepare(scene)
    plan = prepared.plan
    parts = {
        kind: (part, _token(part.content or (key, kind))) for kind, part in parts_of(plan).items()
    }
    return Base(key, prepared, prepared.inputs(CubeWriter("", ()), plan), parts)


def _read_key(base: Base, plan: Plan) -> str:
    """What the rows of a shard depend on besides the shard."""
    stars = plan.scene.stars
    assert stars is not None
    return _token(
        (
            [c.digest for c in base.prepared.catalogues],
            base.prepared.left_out,
            stars.faintest_g_mag,
            plan.colour,
            plan.facts.area_m2,
            stars.space_motion,
        )
    )


def _token(value: object) -> str:
    return str(tokenize(value))


def _bytes_of(table: Any) -> int:
    """Bytes of the arrays of a table or geometry."""
    return sum(getattr(getattr(table, f.name), "nbytes", 0) for f in fields(table)) + 1000


def _block_bytes(block: LightBlock) -> int:
    arrays = (block.star_wings, block.target_wings, block.crowd_e)
    return sum(a.nbytes for a in arrays if a is not None) + 1000


def _few(base: Base) -> int:
    """About what a plan takes."""
    sky = base.plan.sky
    return 1_000_000 + (0 if sky is None else int(np.asarray(sky.grids).nbytes))
