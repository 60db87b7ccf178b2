"""The task of a sweep: a few points that share their light, tile by tile; a row for each."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.arrays import Geometry, SensorMaps
from pipeline.errors import NightglassError, shorten
from pipeline.execute.tile import render_tile
from pipeline.plan.scene_plan import Plan
from pipeline.plan.tiles import Tile
from pipeline.run import Options, prepare, render
from pipeline.spec.scene import Scene
from pipeline.store.cube import CubeWriter
from pipeline.store.product import begin
from pipeline.sweep.dependence import ReadsBarredError
from pipeline.sweep.design import Design
from pipeline.sweep.metrics import Measurement, target_windows
from pipeline.sweep.points import Course, scene_of, with_floor
from pipeline.sweep.stages import Base, Stages, maps_of, point_plan, stages

DISK_FULL = 28
CUBES = "cubes"
Row = dict[str, Any]


@dataclass
class _Point:
    """One point at work: its plan, maps and metrics, or how it failed."""

    number: int
    row: Row
    base: Base | None = None
    scene: Scene | None = None
    plan: Plan | None = None
    maps: SensorMaps | None = None
    measured: Measurement | None = None
    writer: CubeWriter | None = None
    seconds: float = 0.0
    shared_s: float = 0.0
    fault: str | None = None
    again: bool = field(default=False)

    @property
    def alive(self) -> bool:
        return self.fault is None and not self.again


def run_points(course: Course, numbers: tuple[int, ...]) -> list[Row]:
    """Render and measure some points; a point that fails is a row with its message.

    Raises OSError where the disk is full: that is no fault of a point.
    """
    kept, design = stages(course.run), course.design
    rows = _rows(course, kept, design, numbers, whole=False)
    again = tuple(n for n, row in rows.items() if row is None)
    if again:  # a stage asked for a field that it was said not to need: slower, nothing shared
        rows |= _rows(course, kept, design, again, whole=True)
    return [row for row in rows.values() if row is not None]


def _rows(
    course: Course, kept: Stages, design: Design, numbers: tuple[int, ...], whole: bool
) -> dict[int, Row | None]:
    """Rows by point; None for those that have to be taken whole."""
    points = [_begin(course, kept, design, number, whole) for number in numbers]
    groups: dict[str, list[_Point]] = {}
    for point in points:
        if point.alive and point.base is not None:
            groups.setdefault(point.base.key, []).append(point)
    for group in groups.values():
        _draw(course, kept, group)
    return {point.number: _end(course, point) for point in points}


def _begin(course: Course, kept: Stages, design: Design, number: int, whole: bool) -> _Point:
    """A point's scene, plan, and what will measure it."""
    values = {k: _plain(v) for k, v in design.values(number).items()}
    point = _Point(number, {"point": number} | values)

    def start() -> None:
        scene = scene_of(course, design, number)
        point.row["seed"] = scene.seed
        scene, base = with_floor(course, kept, scene, whole)
        maps = maps_of(kept, scene)
        plan = point_plan(base, scene, maps)
        sweep = course.sweep
        names = sweep.targets
        if names is None:
            names = tuple(t.name for t in scene.targets)
        point.base, point.scene, point.plan, point.maps = base, scene, plan, maps
        point.measured = Measurement(plan, maps, sweep.metrics, names, sweep.detection)
        if sweep.cubes == "all" or (isinstance(sweep.cubes, tuple) and number in sweep.cubes):
            point.writer = _begin_cube(course, scene, number)

    _tried(point, start)
    return point


def _begin_cube(course: Course, scene: Scene, number: int) -> CubeWriter:
    """The product of a point, begun or taken up, and what writes its tiles."""
    path = cube_path(Path(course.out), number)
    prepared = prepare(scene)
    digest = "+".join(c.digest for c in prepared.catalogues) or None
    path.parent.mkdir(parents=True, exist_ok=True)
    return begin(path, prepared.plan, digest, resume=path.exists()).writer


def cube_path(out: Path, number: int) -> Path:
    """Where the product of a point is kept."""
    return out / CUBES / f"{number:07d}"


def _draw(course: Course, kept: Stages, group: list[_Point]) -> None:
    """All frames and tiles of points that share a base: light once, then each point's noise."""
    base = group[0].base
    assert base is not None
    for frame in range(base.plan.frames):
        living = [p for p in group if p.alive]
        if not living:
            return
        shared: dict[str, Any] = {}

        def start(frame: int = frame, shared: dict[str, Any] = shared) -> None:
            shared["g"] = kept.geometry(base, frame)
            names = living[0].measured.names if living[0].measured else ()
            wanted = "detection" in course.sweep.metrics
            search = course.sweep.detection.search_px
            shared["windows"] = (
                kept.get(
                    "windows", (base.key, frame, names),
                    lambda: target_windows(base.plan, shared["g"], names, search),
                    lambda v: sum(w.image_e.nbytes + w.response.nbytes for _, w in v),
                ) if wanted else []
            )  # fmt: skip

        if not _shared(living, start):
            continue
        for p in living:
            _tried(p, lambda p=p: p.measured.begin_frame(shared["g"], shared["windows"]))
        for tile in base.plan.tiles:
            _draw_tile(kept, base, shared["g"], tile, [p for p in living if p.alive])
        for p in living:
            if p.alive:
                _tried(p, p.measured.end_frame)  # type: ignore[union-attr]


def _draw_tile(kept: Stages, base: Base, g: Geometry, tile: Tile, living: list[_Point]) -> None:
    light: dict[str, Any] = {}
    if not living or not _shared(living, lambda: light.update(kept.light(base, g, tile))):
        return
    for point in living:

        def noise(point: _Point = point) -> None:
            assert point.plan is not None and point.maps is not None and point.measured is not None
            rays = base.prepared.rays
            out, checks = render_tile(point.plan, point.maps, g, tile, [], [], rays, light)
            frame = int(g.frame[0])
            point.measured.take(tile, frame, out["dn"], out["mean_e"])
            if point.writer is not None:
                _write(point, frame, tile, light, g, rays, out)

        _tried(point, noise)


def _write(
    point: _Point, frame: int, tile: Tile, light: Any, g: Geometry, rays: Any, out: Any
) -> None:
    """One tile of a cube that is kept, with the layers that its scene asks for."""
    assert point.writer is not None and point.scene is not None and point.plan is not None
    assert point.maps is not None
    if not set(point.writer.layers) <= set(out):
        scene = point.plan.scene.model_copy(update={"output": point.scene.output})
        from dataclasses import replace

        plan = replace(point.plan, scene=scene)
        out, _ = render_tile(plan, point.maps, g, tile, [], [], rays, light)
    point.writer.write(frame, tile, out)


def _end(course: Course, point: _Point) -> Row | None:
    """A point's row, or None where it has to be taken whole."""
    if point.alive and point.writer is not None:
        path, scene = cube_path(Path(course.out), point.number), point.scene

        def finish() -> None:
            assert scene is not None
            render(scene, path, Options("synchronous", resume=True))

        _tried(point, finish)
    if point.again:
        return None
    row = point.row
    if point.fault is None and point.measured is not None:
        measured: dict[str, Any] = {}
        _tried(point, lambda: measured.update(point.measured.row()))  # type: ignore[union-attr]
        row |= measured
    row["status"] = "done" if point.fault is None else "failed"
    row["message"] = point.fault
    if "timing" in course.sweep.metrics:
        row |= {"seconds": point.seconds + point.shared_s, "light_s": point.shared_s}
    return row


def _shared(points: list[_Point], work: Callable[[], None]) -> bool:
    """Do what points share; its time is shared out. False where it failed, for all of them."""
    started = time.perf_counter()
    first = points[0]
    _tried(first, work)
    taken = time.perf_counter() - started
    first.seconds -= taken
    for point in points:
        point.shared_s += taken / len(points)
        point.fault, point.again = first.fault, first.again
    return first.alive


def _tried(point: _Point, work: Callable[[], None]) -> None:
    """Do something for a point; what fails is its fault, but a full disk is nobody's."""
    if not point.alive:
        return
    started = time.perf_counter()
    try:
        work()
    except ReadsBarredError:
        point.again = True
    except NightglassError as error:
        point.fault = str(error)
    except OSError as error:
        if error.errno == DISK_FULL:
            raise
        point.fault = f"{error.filename or ''}: {error.strerror}"
    except Exception as error:
        point.fault = f"internal fault: {type(error).__name__}: {shorten(str(error), 400)}"
    point.seconds += time.perf_counter() - started


def _plain(value: Any) -> Any:
    """A value as a table takes it: numbers, text, true and false; anything else as JSON."""
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or isinstance(value, bool | int | float | str):
        return value
    return json.dumps(value, sort_keys=True)
