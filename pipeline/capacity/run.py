"""The route of a study: candidates on Dask, tasking window by window, results; resumable."""

from __future__ import annotations

import io
import json
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from catalog_tools.documents import JsonObject
from catalog_tools.engine.schedulers import Scheduler, open_scheduler
from catalog_tools.storage.durable import whole_file, write_atomically
from pipeline.capacity.candidates import ENDED, OPTIONS, Item, find_candidates, path_of
from pipeline.capacity.course import MOST_CPU_S, StudyCourse, make_course
from pipeline.capacity.page import page
from pipeline.capacity.results import OBJECTS, PAGE, REPORT, summarise
from pipeline.capacity.tasking import (
    Candidates,
    SensorState,
    Taken,
    begin_state,
    detected,
    task_window,
)
from pipeline.errors import BadInput, DiskFull, Incomplete
from pipeline.inputs.memory import free_mb
from pipeline.route.run import Options
from pipeline.spec.load import place_paths
from pipeline.spec.study import CuedTasking, Study
from pipeline.spec.study_load import parse_study
from pipeline.store.layout import full_disk, only_writer
from pipeline.sweep import ledger
from pipeline.sweep.design import Design
from pipeline.sweep.points import check_axes, later_seed, set_field
from pipeline.sweep.run import SweepProgress

STATE, STUDY, SEEN = "state.npz", "study.json", "observations"
POINTS = "points.parquet"
ORDER_OF_ROWS = ("step", "sensor", "object", "unit", "time_s")


@dataclass(frozen=True)
class StudyOptions:
    """How a study is run; none of it changes a number.

    yes : also where the forecast is beyond MOST_CPU_S
    most_cpu_s : what is forecast to take more is refused; None: beyond MOST_CPU_S, unless `yes`
    """

    scheduler: str = "processes"
    workers: int | None = None
    resume: bool = False
    yes: bool = False
    most_cpu_s: float | None = None


Listener = Callable[[SweepProgress], None]
Opened = Callable[[], Scheduler]
Begins = Callable[[JsonObject], None]


def forecast_of(data: JsonObject, folder: Path) -> JsonObject:
    """What a study takes (`StudyCourse.forecast`), of all its points together, and `remarks`.

    Every axis is tried value by value, and the first, middle and last points are looked at: a study
    is refused where none of them can be; a remark names one that cannot.
    """
    study = parse_study(data)
    check_axes(Design(study), _without_axes(data), parse_study)
    some = dict.fromkeys((0, study.points // 2, study.points - 1))
    courses: list[StudyCourse] = []
    faults: dict[int, BadInput] = {}
    for point in some:
        try:
            courses.append(make_course(_placed(_at_point(data, study, point)[0], folder), Path()))
        except BadInput as error:
            faults[point] = error
    if not courses:
        raise next(iter(faults.values()))
    told = [course.forecast for course in courses]
    remarks = [f"point {point} cannot be: {error}" for point, error in faults.items()]
    remarks += [remark for course in courses for remark in course.remarks]
    return told[0] | {
        "points": study.points,
        "cpu_s": float(np.mean([one["cpu_s"] for one in told])) * study.points,
        "remarks": list(dict.fromkeys(remarks)),
    }


def run_study(
    data: JsonObject,
    folder: Path,
    out: Path,
    options: StudyOptions | None = None,
    listen: Listener | None = None,
    begins: Begins | None = None,
) -> JsonObject:
    """Run a study's plain data into a folder and return its report.

    Of one with axes, each point runs below `points/`, and a table has a row of figures for each; of
    a point that cannot be, its message.

    begins : called with the forecast, as of `forecast_of`, before anything is done
    folder : from which relative paths are taken. BadInput before anything is begun, Incomplete
    where work stopped (what is done is kept).
    """
    study, options = parse_study(data), options or StudyOptions()
    out = out.absolute()  # Arrow takes the `a:b` of a relative `a:b/c.parquet` for a kind of URL
    with ExitStack() as stack:
        opened = cache(  # by the first task that is not done yet
            lambda: stack.enter_context(open_scheduler(options.scheduler, options.workers))
        )
        course = make_course(_placed(data, folder), out) if not study.is_varied else None
        if course is None:
            told = forecast_of(data, folder)
        else:
            told = course.forecast | {"remarks": list(course.remarks)}
        _check_room(told, options)
        check_forecast(told, options)
        if begins is not None:
            begins(told)
        if course is None:
            return _run_points(data, study, folder, out, options, opened, listen)
        return _run_point(study, course, options, opened, listen)


def _run_points(
    data: JsonObject,
    study: Study,
    folder: Path,
    out: Path,
    options: StudyOptions,
    opened: Opened,
    listen: Listener | None,
) -> JsonObject:
    ledger.begin(out, {"study": data}, options.resume, "study")
    rows: list[JsonObject] = []
    notes: dict[str, int] = {}
    for point in range(study.points):
        own, values = _at_point(data, study, point)
        place = out / "points" / f"{point:04d}"
        place.parent.mkdir(exist_ok=True)
        again = replace(options, resume=place.exists())
        heard = listen and partial(_hear_point, listen, point, study.points)
        row = {"point": point, **values, "status": "done", "message": None}
        try:
            course = make_course(_placed(own, folder), place)
            check_forecast(course.forecast, options)
        except BadInput as error:
            rows.append(row | {"status": "failed", "message": str(error)})
            continue
        report = _run_point(parse_study(own), course, again, opened, heard)
        rows.append(row | report["figures"])
        notes |= {note: point for note in report["notes"] if note not in notes}
    told = [f"point {point}: {note}" for note, point in notes.items()]
    return _write_points(study, out, rows, told)


def _write_points(study: Study, out: Path, rows: list[JsonObject], told: list[str]) -> JsonObject:
    """Write the table of a study's points and its report, which is returned."""
    columns = dict.fromkeys(name for row in rows for name in row)
    rows = [dict.fromkeys(columns) | row for row in rows]
    kinds = ledger.kinds_of(Design(study))
    fit = [row | {n: ledger.fit(row[n], kind) for n, kind in kinds.items()} for row in rows]
    with whole_file(out / POINTS) as table:
        pq.write_table(pa.Table.from_pylist(fit), table)
    failed = [row for row in rows if row["status"] == "failed"]
    told += [f"point {row['point']} failed: {row['message']}" for row in failed]
    whole = {"study": study.name, "points": rows, "failed": len(failed), "notes": told}
    write_atomically(out / REPORT, json.dumps(whole, indent=2) + "\n")
    ledger.seal(out, (POINTS, REPORT))
    return whole


def _hear_point(listen: Listener, point: int, points: int, progress: SweepProgress) -> None:
    """Tell how far a whole study is by one of its points, as if all had so many tasks."""
    done = point * progress.total + progress.done
    listen(replace(progress, done=done, total=points * progress.total))


def check_forecast(told: JsonObject, options: StudyOptions) -> None:
    """BadInput for a study that is forecast to take longer than is meant."""
    most_cpu_s = options.most_cpu_s or MOST_CPU_S
    if told["cpu_s"] > most_cpu_s and not options.yes:
        remedy = "shorten it" if options.most_cpu_s else "shorten it, or --yes"
        hours = told["cpu_s"] / 3600.0
        asked = f"{hours:.0f}" if hours >= 10.0 else f"{hours:.2g}"
        allowed = f"up to {most_cpu_s / 3600.0:.3g} h: {remedy}"
        raise BadInput("study", f"{asked} h of one core", allowed)


def _check_room(told: JsonObject, options: StudyOptions) -> None:
    """BadInput where this machine has not free what all workers take; before any is started."""
    here = Options(options.scheduler, options.workers)
    at_once, each_mb, free = here.processes * here.threads, told["worker_memory_mb"], free_mb()
    if at_once > 1 and at_once * each_mb > free:
        allowed = f"fewer workers of {each_mb:.0f} MB each: {free:.0f} MB are free here"
        raise BadInput("--workers", at_once, allowed)


def _at_point(data: JsonObject, study: Study, point: int) -> tuple[JsonObject, JsonObject]:
    """The study of one point of the axes, without axes, and the values it has."""
    own = _without_axes(data)
    design = Design(study)
    values = design.values(point)
    for name, value in values.items():
        set_field(own, name, value)
    own["seed"] = later_seed(own.get("seed", 0), design.seed_step(point))
    return own, values | ({"seed": own["seed"]} if study.seeds > 1 else {})


def _without_axes(data: JsonObject) -> JsonObject:
    """A copy of a study's data as of one without axes."""
    kept = {k: v for k, v in data.items() if k not in ("axes", "design", "seeds")}
    own: JsonObject = json.loads(json.dumps(kept))
    return own


def _placed(data: JsonObject, folder: Path) -> JsonObject:
    """A copy of a study's data whose relative paths are from a folder."""
    own: JsonObject = json.loads(json.dumps(data))
    place_paths(own, folder)
    return own


def _run_point(
    study: Study,
    course: StudyCourse,
    options: StudyOptions,
    opened: Opened,
    listen: Listener | None,
) -> JsonObject:
    """Run a study without axes into its course's folder."""
    started, out = time.perf_counter(), Path(course.out)
    ledger.begin(out, {"format": study.schema_, "study": course.key}, options.resume, "study")
    with full_disk(out), only_writer(out, busy="another run is writing this study now"):
        if ledger.is_complete(out, OBJECTS):
            report: JsonObject = json.loads((out / REPORT).read_text())
            return report
        write_atomically(out / STUDY, json.dumps(study.as_dict(), indent=2))
        (out / SEEN).mkdir(exist_ok=True)
        failed = _stream(course, out, opened, listen)
        report, tables, gaps = summarise(course, out, failed, time.perf_counter() - started)
        write_atomically(out / PAGE, page(course, report, tables, gaps))
        write_atomically(out / REPORT, json.dumps(report, indent=2, allow_nan=False) + "\n")
        ledger.seal(out, (OBJECTS, STUDY, REPORT))
        shutil.rmtree(out / "parts")
        return report


def _stream(
    course: StudyCourse, out: Path, opened: Opened, listen: Listener | None
) -> NDArray[np.int64]:
    """Find candidates and task windows as they are whole; objects that SGP4 ended."""
    state, first, failed = _taken_up(course, out)
    items = [(w, b) for w in range(first, course.windows) for b in range(course.batches)]
    done = {item for item in items if _is_whole(path_of(out, item))}
    left, total, window = (
        [i for i in items if i not in done],
        course.windows * course.batches,
        first,
    )

    def finish_windows() -> None:
        nonlocal window
        while window < course.windows and all((window, b) in done for b in range(course.batches)):
            _finish(course, out, window, state, failed)
            window += 1

    finish_windows()
    for item in _run(opened, course, left):
        done.add(item)
        if listen is not None:
            listen(SweepProgress(total - len(items) + len(done), total, 0))
        finish_windows()
    return np.array(sorted(failed), np.int64)


def _run(opened: Opened, course: StudyCourse, items: list[Item]) -> Iterator[Item]:
    for item, answer in opened().each(find_candidates, course, items) if items else ():
        if isinstance(answer, DiskFull | BadInput) or getattr(answer, "errno", None):
            raise answer
        if isinstance(answer, Exception):
            told = f"{type(answer).__name__}: {answer}; what is finished is kept"
            raise Incomplete(told) from answer
        yield item


def _is_whole(path: Path) -> bool:
    """Whether a task's file is there as it was written; one that is not is removed."""
    try:
        pq.read_table(path, page_checksum_verification=True)
    except FileNotFoundError:
        return False
    except MemoryError:
        raise  # of Arrow, too: no damage
    except (pa.ArrowException, OSError):
        path.unlink()
        return False
    return True


def _taken_up(course: StudyCourse, out: Path) -> tuple[SensorState, int, set[int]]:
    """The state after the last finished window, the next one's number, objects that ended."""
    if not (out / STATE).is_file():
        return begin_state(course), 0, set()
    with np.load(out / STATE) as kept:
        state = SensorState(kept["free_s"], kept["direction"], kept["last_s"])
        return state, int(kept["window"]) + 1, set(kept["failed"].tolist())


def _finish(
    course: StudyCourse, out: Path, window: int, state: SensorState, failed: set[int]
) -> None:
    """Write the observations of a window, then the state after it, then drop its candidates."""
    paths = [path_of(out, (window, b)) for b in range(course.batches)]
    tables = [pq.read_table(p, page_checksum_verification=True) for p in paths]
    failed.update(k for t in tables for k in json.loads(t.schema.metadata[ENDED]))
    table = pa.concat_tables(tables).sort_by([(n, "ascending") for n in ORDER_OF_ROWS])
    cued = isinstance(course.study.tasking, CuedTasking)
    seen = _tasked(course, table, state) if cued else _searched(course, table)
    with whole_file(out / SEEN / f"window-{window:06d}.parquet") as own:
        pq.write_table(seen, own, **OPTIONS)
    held = io.BytesIO()
    np.savez(held, window=window, failed=np.array(sorted(failed), np.int64), **asdict(state))
    write_atomically(out / STATE, held.getvalue())
    for path in paths:
        path.unlink()


def _tasked(course: StudyCourse, table: pa.Table, state: SensorState) -> pa.Table:
    """The observations that a cued study chooses from its candidates."""
    column = {n: table[n].to_numpy() for n in ("step", "sensor", "object", "probability")}
    direction = np.stack([table[n].to_numpy() for n in "xyz"], axis=1).astype(float)
    step, sensor, object_ = (column[n].astype(np.int64) for n in ("step", "sensor", "object"))
    chance = column["probability"].astype(float)
    t: Taken = task_window(course, Candidates(step, sensor, object_, direction, chance), state)
    return _observed(table.take(pa.array(t.row)), t.unit, t.start_s, t.length_s, t.detected)


def _searched(course: StudyCourse, table: pa.Table) -> pa.Table:
    """All rows of a search: whatever is in a field is observed."""
    when, unit_ = table["time_s"].to_numpy(), table["unit"].to_numpy().astype(np.int64)
    dwell = np.array([course.watchers[j].dwell_s for j in course.units])[unit_]
    frame = np.floor(when / np.minimum(dwell, 1.0)).astype(np.int64)  # no two dwells share one
    chance = table["probability"].to_numpy().astype(float)
    seen = detected(course, frame, unit_, table["object"].to_numpy(), chance)
    return _observed(table, unit_, when - 0.5 * dwell, dwell, seen)


def _observed(
    table: pa.Table,
    unit_: NDArray[np.int64],
    start_s: NDArray[np.float64],
    length_s: NDArray[np.float64],
    seen: NDArray[np.bool_],
) -> pa.Table:
    """Observations: `time_s` is the end of the dwell, `busy_s` goes from the slew to it."""
    i, j = (table.schema.get_field_index(n) for n in ("time_s", "unit"))
    table = table.set_column(i, "time_s", pa.array(start_s + length_s))
    table = table.set_column(j, "unit", pa.array(unit_, pa.int16()))
    table = table.append_column("busy_s", pa.array(length_s.astype(np.float32)))
    return table.append_column("detected", pa.array(seen))
