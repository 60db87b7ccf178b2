"""The task of a sweep: a few points that share their light, tile by tile; a row for each."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from catalog_tools.documents import JsonObject
from pipeline.arrays import Array, Geometry, SensorMaps
from pipeline.errors import NO_ROOM, DiskFull, NightglassError, shorten
from pipeline.execute.tile import TileSources, charge_of_tile, render_tile
from pipeline.plan.plan import Plan
from pipeline.plan.tiles import Tile
from pipeline.route.prepare import check_room, prepare
from pipeline.route.run import Options, render
from pipeline.spec.scene import Scene
from pipeline.store.cube import CubeWriter
from pipeline.store.layout import cube_path
from pipeline.store.product import begin
from pipeline.sweep.design import Design
from pipeline.sweep.metrics import Measurement, TargetWindow, target_windows
from pipeline.sweep.points import Course, scene_of, with_floor
from pipeline.sweep.stages import Base, Stages, maps_of, point_plan, stages

Row = JsonObject


@dataclass(frozen=True)
class _Ready:
    """What a point is rendered from and measured by."""

    base: Base
    scene: Scene
    plan: Plan
    maps: SensorMaps
    measured: Measurement
    writer: CubeWriter | None


@dataclass
class _Point:
    """One point at work, or how it failed."""

    number: int
    row: Row
    made: _Ready | None = None
    seconds: float = 0.0
    shared_s: float = 0.0
    fault: str | None = None

    @property
    def alive(self) -> bool:
        return self.fault is None

    @property
    def ready(self) -> _Ready:
        assert self.made is not None
        return self.made


def run_points(course: Course, numbers: tuple[int, ...]) -> list[Row]:
    """Render and measure some points; a point that fails is a row with its message.

    Raises DiskFull or OSError where the disk is full: that is no fault of a point.
    """
    kept, design = stages(course.run), course.design
    points = [_begin(course, kept, design, number) for number in numbers]
    groups: dict[str, list[_Point]] = {}
    for point in points:
        if point.alive:
            groups.setdefault(point.ready.base.key, []).append(point)
    for group in groups.values():
        _draw(course, kept, group)
    return [_end(course, point) for point in points]


def _begin(course: Course, kept: Stages, design: Design, number: int) -> _Point:
    """A point's scene, plan, and what will measure it."""
    values = {k: _plain(v) for k, v in design.values(number).items()}
    point, sweep = _Point(number, {"point": number} | values), course.sweep

    def start() -> None:
        scene = scene_of(course, design, number)
        point.row["seed"] = scene.seed
        scene, base = with_floor(course, kept, scene)
        check_room(base.prepared)
        maps = maps_of(kept, base, scene)
        plan = point_plan(base, scene, maps)
        names = sweep.targets
        if names is None:
            names = tuple(t.name for t in scene.targets)
        measured = Measurement(plan, maps, sweep.metrics, names, sweep.detection)
        wanted = sweep.cubes == "all" or (isinstance(sweep.cubes, tuple) and number in sweep.cubes)
        writer = _begin_cube(course, scene, number) if wanted else None
        point.made = _Ready(base, scene, plan, maps, measured, writer)

    _tried(point, start)
    return point


def _begin_cube(course: Course, scene: Scene, number: int) -> CubeWriter:
    """The product of a point, begun or taken up, and what writes its tiles."""
    path = cube_path(Path(course.out), number)
    prepared = prepare(scene)
    digest = "+".join(c.digest for c in prepared.catalogues) or None
    path.parent.mkdir(parents=True, exist_ok=True)
    return begin(path, prepared.plan, digest, resume=path.exists()).writer


def _draw(course: Course, kept: Stages, group: list[_Point]) -> None:
    """All frames and tiles of points that share a base: light once, then each point's noise."""
    base = group[0].ready.base
    for frame in range(base.plan.frames):
        living = [p for p in group if p.alive]
        found: list[tuple[Geometry, list[tuple[str, TargetWindow]]]] = []
        if not living or not _shared(living, partial(_look, course, kept, living[0], frame, found)):
            return
        g, windows = found[0]
        for point in living:
            _tried(point, partial(point.ready.measured.begin_frame, g, windows))
        for tile in base.plan.tiles:
            _draw_tile(kept, base, g, tile, [p for p in living if p.alive])
        for point in living:
            _tried(point, point.ready.measured.end_frame)


def _look(course: Course, kept: Stages, point: _Point, frame: int, found: list[Any]) -> None:
    """The geometry of a frame, and the windows around its targets."""
    base, names = point.ready.base, point.ready.measured.names
    g, request = kept.geometry(base, frame), course.sweep.detection
    if "detection" not in course.sweep.metrics:
        found.append((g, []))
        return
    windows = kept.get(
        "windows",
        (base.key, frame, names),
        lambda: target_windows(base.plan, g, names, request.search_px),
        lambda v: sum(w.image_e.nbytes + w.response.nbytes for _, w in v),
    )
    found.append((g, windows))


def _draw_tile(kept: Stages, base: Base, g: Geometry, tile: Tile, living: list[_Point]) -> None:
    light: dict[str, Array] = {}
    if living and _shared(living, lambda: light.update(kept.light(base, g, tile))):
        checked: list[JsonObject] = []
        if "timing" in living[0].ready.measured.metrics:  # what it errs by beside what it takes
            _shared(living, lambda: checked.extend(kept.checked(base, g, tile, light)))
        for point in living:
            point.ready.measured.checked += checked
            _tried(point, partial(_noise, kept, point.ready, g, tile, light))


def _noise(kept: Stages, ready: _Ready, g: Geometry, tile: Tile, light: dict[str, Array]) -> None:
    """A point's detector over the light of a tile: measured, and written where cubes are kept."""
    rays, frame = ready.base.prepared.rays, int(g.frame[0])
    before = []
    for earlier in range(max(0, frame - ready.plan.lag_frames), frame):
        then = kept.geometry(ready.base, earlier)
        theirs = kept.light(ready.base, then, tile)
        before.append(
            charge_of_tile(ready.plan, ready.maps, then, tile, TileSources([], [], rays, theirs))
        )
    sources = TileSources([], [], rays, light)
    out, _ = render_tile(ready.plan, ready.maps, g, tile, sources, before)
    ready.measured.take(tile, frame, out["dn"], out["mean_e"])
    if ready.writer is None:
        return
    if not set(ready.writer.layers) <= set(out):
        scene = ready.plan.scene.model_copy(update={"output": ready.scene.output})
        plan = replace(ready.plan, scene=scene)
        out, _ = render_tile(plan, ready.maps, g, tile, sources, before)
    ready.writer.write(frame, tile, out)


def _end(course: Course, point: _Point) -> Row:
    """A point's row."""
    if point.alive and point.ready.writer is not None:
        path = cube_path(Path(course.out), point.number)
        _tried(point, lambda: render(point.ready.scene, path, Options("synchronous", resume=True)))
    _tried(point, lambda: point.row.update(point.ready.measured.row()))
    told = point.fault or (" ".join(point.ready.measured.doubts()) or None)
    row = point.row | {"status": "done" if point.alive else "failed", "message": told}
    if "timing" in course.sweep.metrics:
        row |= {"seconds": point.seconds + point.shared_s, "light_s": point.shared_s}
    return row


def _shared(points: list[_Point], work: Callable[[], object]) -> bool:
    """Do what points share; its time is shared out. False where it failed, for all of them."""
    started = time.perf_counter()
    first = points[0]
    _tried(first, work)
    taken = time.perf_counter() - started
    first.seconds -= taken
    for point in points:
        point.shared_s += taken / len(points)
        point.fault = first.fault
    return first.alive


def _tried(point: _Point, work: Callable[[], object]) -> None:
    """Do something for a point; what fails is its fault, but a full disk is nobody's."""
    if not point.alive:
        return
    started = time.perf_counter()
    try:
        work()
    except DiskFull:
        raise
    except NightglassError as error:
        point.fault = str(error)
    except OSError as error:
        if error.errno in NO_ROOM:
            raise
        told = error.strerror or str(error)  # of libraries, who give neither code nor file
        point.fault = f"{error.filename}: {told}" if error.filename else told
    except Exception as error:
        point.fault = f"internal fault: {type(error).__name__}: {shorten(str(error), 400)}"
    point.seconds += time.perf_counter() - started


def _plain(value: object) -> object:
    """A value as a table takes it: numbers, text, true and false; anything else as JSON."""
    if value is None or isinstance(value, bool | int | float | str):
        return value
    return json.dumps(value, sort_keys=True)
