"""The route of a sweep: check it, stream its points in a bounded window, join and sum up."""

from __future__ import annotations

import itertools
import json
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from uuid import uuid4

from catalog_tools.documents import JsonObject
from catalog_tools.engine.schedulers import Scheduler, open_scheduler
from catalog_tools.storage.durable import write_atomically
from pipeline.errors import BadInput, DiskFull, Incomplete
from pipeline.route.run import Options
from pipeline.spec.load import place_paths
from pipeline.spec.scene import Scene
from pipeline.spec.sweep import Sweep
from pipeline.spec.sweep_load import load_sweep, read_base
from pipeline.store.layout import full_disk, only_writer
from pipeline.sweep import ledger
from pipeline.sweep.check import Checked, check
from pipeline.sweep.dependence import AFTER_LIGHT
from pipeline.sweep.forecast import forecast_course
from pipeline.sweep.ledger import PointLedger
from pipeline.sweep.points import (
    Course,
    files_of,
    floors_of,
    light_group,
    scene_of,
    with_floor,
)
from pipeline.sweep.stages import stages
from pipeline.sweep.summary import summarise
from pipeline.sweep.task import run_points

GROUP = 16  # points of one task, at most
GROUPED = 4096  # points among which those that share their light are brought together

Listener = Callable[["SweepProgress"], None]
Warned = Callable[[list[str]], None]


@dataclass(frozen=True)
class SweepProgress:
    """How far a sweep is."""

    done: int
    total: int
    failed: int


def sweep(
    path: Path,
    out: Path,
    options: Options | None = None,
    retry_failed: bool = False,
    listen: Listener | None = None,
    warn: Warned | None = None,
    overrides: Iterable[str] = (),
) -> JsonObject:
    """Run a sweep file into a folder and return its report.

    overrides : `a.b=value`, set in the file's data first; `scene.a.b=value` in its base scene
    warn : told the warnings of its first, middle and last point before any is drawn
    options.resume goes on with an unfinished one. Raises BadInput for a sweep that can't be run,
    before anything is; Incomplete where work stopped before its end (what is done is kept).
    """
    course = gather_course(path, out, overrides)
    return run_course(course, out, options, retry_failed, listen, warn)


def run_course(
    course: Course,
    out: Path,
    options: Options | None = None,
    retry_failed: bool = False,
    listen: Listener | None = None,
    warn: Warned | None = None,
) -> JsonObject:
    """Run a sweep that was read already, as `sweep` does."""
    with full_disk(out):
        return _run_course(course, out, options or Options(), retry_failed, listen, warn)


def _run_course(
    course: Course,
    out: Path,
    options: Options,
    retry_failed: bool,
    listen: Listener | None,
    warn: Warned | None,
) -> JsonObject:
    started = time.perf_counter()
    checked = check(course, options)
    _check_cost(course, checked, options.most_cpu_s)
    names, warnings = checked.names, checked.warnings
    if warn is not None:
        warn(warnings)
    identity = ledger.identity_of(course.sweep, course.data, checked.digests, files_of(course))
    ledger.begin(out, identity, options.resume)
    with only_writer(out, busy="another run is writing this sweep now"):
        schema = ledger.schema_of(course.sweep, names)
        book = PointLedger(out, schema, course.sweep.points)
        if ledger.is_complete(out) and not retry_failed:
            report: JsonObject = json.loads((out / ledger.REPORT).read_text())
            return report
        _reopen(out)
        book.take_up(retry_failed)
        write_atomically(out / ledger.SWEEP, json.dumps(course.sweep.as_dict(), indent=2))
        with open_scheduler(options.scheduler, options.workers) as scheduler:
            _stream(course, book, scheduler, listen)
            workers = scheduler.workers
        book.join()
        told = {
            "seconds": time.perf_counter() - started,
            "workers": workers,
            "scheduler": options.scheduler,
            "parts_damaged": book.removed,
            "noise_floors": course.floors,
            "warnings": warnings,
        }
        report = summarise(course.sweep, out, names, told)
        ledger.seal(out)
        book.drop_parts()
        return report


def _check_cost(course: Course, checked: Checked, most_cpu_s: float | None) -> None:
    """BadInput where the points together are predicted to take more than is allowed."""
    size = course.design.size
    if most_cpu_s is None or size * checked.point_cpu_s <= most_cpu_s:
        return
    if (asked := forecast_course(course)["cpu_s"]) > most_cpu_s:
        allowed = f"a sweep of at most {most_cpu_s:g} CPU s (predicted: {asked:.0f})"
        raise BadInput("axes", f"{size} points", allowed)


def gather_course(path: Path, out: Path, overrides: Iterable[str] = ()) -> Course:
    """Read a sweep file, with `a.b=value` overrides, and its base scene; paths in them are made
    absolute."""
    return course_of(load_sweep(path, overrides), path.parent.resolve(), out)


def course_of(request: Sweep, folder: Path, out: Path) -> Course:
    """A sweep ready to run; relative paths in it are from `folder`."""
    if isinstance(request.scene, str):
        data, home = read_base(request.scene, folder)
    else:
        data, home = json.loads(json.dumps(request.scene)), folder
    place_paths(data, home)
    floors = floors_of(request, str(folder))
    return Course(request, data, str(folder), floors, uuid4().hex, str(out.resolve()))


def point_scene(path: Path, point: int, overrides: Iterable[str] = ()) -> Scene:
    """The scene of one point as it is rendered: alone it gives the same bits."""
    course = gather_course(path, Path(), overrides)
    if not 0 <= point < course.sweep.points:
        raise BadInput("--point", point, f"0 to {course.sweep.points - 1}")
    scene = scene_of(course, course.design, point)
    return with_floor(course, stages(course.run), scene)[0]


def _reopen(out: Path) -> None:
    """A complete sweep whose failed points are tried again: its table becomes a part."""
    table = out / ledger.TABLE
    (out / ledger.COMPLETE).unlink(missing_ok=True)
    if table.is_file():
        table.replace(out / ledger.PARTS / "part-0000000.parquet")


def _stream(
    course: Course, book: PointLedger, scheduler: Scheduler, listen: Listener | None
) -> None:
    """Run all missing points; rows become durable part by part."""

    def tell() -> None:
        if listen is not None:
            listen(SweepProgress(int(book.done.sum()), book.size, int(book.failed.sum())))

    tell()
    try:
        again = list(_run(course, book, scheduler, groups(course, book), tell))
        alone = [(n,) for numbers in again for n in numbers]
        for (number,) in _run(course, book, scheduler, iter(alone), tell):
            text = "the point's task keeps killing the processes that run it"
            row = {"point": number, **course.design.values(number)}
            book.add([row | {"status": "failed", "message": text}])
    finally:
        book.flush()


def _run(
    course: Course,
    book: PointLedger,
    scheduler: Scheduler,
    work: Iterator[tuple[int, ...]],
    tell: Callable[[], None],
) -> Iterator[tuple[int, ...]]:
    """Run groups of points; yields those whose processes were killed again and again."""
    for numbers, rows in scheduler.each(run_points, course, work):
        if type(rows).__name__ == "KilledWorker":
            yield numbers
        elif isinstance(rows, DiskFull) or (isinstance(rows, OSError) and rows.errno is not None):
            raise rows
        elif isinstance(rows, Exception):
            raise Incomplete(f"{type(rows).__name__}: {rows}; what is finished is kept") from rows
        else:
            book.add(rows)
        tell()


def groups(course: Course, book: PointLedger) -> Iterator[tuple[int, ...]]:
    """Missing points in groups that share their light, in the order of the work."""
    design = course.design
    order = (p for p in design.order(frozenset(AFTER_LIGHT)) if not book.done[p])
    while window := list(itertools.islice(order, GROUPED)):
        together: dict[object, list[int]] = {}
        for point in window:
            together.setdefault(light_group(design, point), []).append(point)
        for points in together.values():
            yield from (tuple(points[i : i + GROUP]) for i in range(0, len(points), GROUP))
