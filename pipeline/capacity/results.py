"""What a study found: tables of objects, sensors, hours and sky, and the report of all figures."""

from __future__ import annotations

from importlib.metadata import version
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.dataset as ds
import pyarrow.parquet as pq
from numpy.typing import NDArray

from catalog_tools.documents import JsonObject
from catalog_tools.geometry.healpix import pixels_of
from catalog_tools.geometry.sphere import angles_deg
from catalog_tools.storage.durable import whole_file
from pipeline.capacity.course import StudyCourse, moments
from pipeline.capacity.gaps import GapTimes, gap_times
from pipeline.physics.constants import (
    ASTRONOMICAL_UNIT_M,
    EARTH_EQUATORIAL_RADIUS_M,
    EARTH_GM_M3_S2,
)
from pipeline.physics.targets.lighting import photon_rate_at_aperture
from pipeline.physics.targets.sphere import sphere_intensity_per_irradiance
from pipeline.spec.study import SearchPattern
from pipeline.survey.elements import Elements
from pipeline.survey.watch import Watcher

OBJECTS, SENSORS, HOURS, COVERAGE, REACH = (
    f"{name}.parquet" for name in ("objects", "sensors", "hours", "coverage", "reach")
)
REPORT, PAGE = "report.json", "report.html"
ORDER = 4  # of the HEALPix map
PIXELS = 12 * 4**ORDER  # of 3.7 degrees
ALTITUDES_KM = np.array([500, 800, 1200, 2000, 10_000, 25_000, 40_000])
MOST_DETECTIONS = 4_000_000  # whose gaps are worked out in one go
REACH_KM = tuple(np.geomspace(300.0, 45_000.0, 40).tolist())
REACH_PHASE_RAD, REACH_ALBEDO = np.pi / 3.0, 0.175
GAP_BINS_H = np.concatenate([[0.0], np.geomspace(1.0 / 60.0, 10_000.0, 61)])


def summarise(
    course: StudyCourse, out: Path, failed: NDArray[np.int64], seconds: float
) -> tuple[JsonObject, dict[str, pa.Table], dict[str, NDArray[np.int64]]]:
    """Write all tables; returns the report, the tables, and how many gaps are of which length."""
    files = sorted((out / "observations").glob("window-*.parquet"))
    counts, busy_s = _counts(course, files)
    objects, gaps_h = _objects(course, files, counts["object"])
    hours = dict(zip(("observations", "detections"), counts["hour"], strict=True))
    tables = {
        OBJECTS: objects,
        SENSORS: _sensors(course, counts["unit"], busy_s),
        HOURS: pa.table({"hour": np.arange(counts["hour"].shape[1]), **hours}),
        COVERAGE: pa.table({"pixel": np.arange(PIXELS), "observations": counts["pixel"][0]}),
        REACH: _reach(course),
    }
    for name, table in tables.items():
        with whole_file(out / name) as own:
            pq.write_table(table, own, write_page_checksum=True)
    return _report(course, tables, failed, seconds), tables, gaps_h


def _counts(
    course: StudyCourse, files: list[Path]
) -> tuple[dict[str, NDArray[np.int64]], NDArray[np.float64]]:
    """Observations and detections (2, n) by object, hour, single sensor and pixel; seconds (u,)
    that each of these sensors' observations took together."""
    hours, units = int(np.ceil(course.hours)), len(course.units)
    sizes = {"object": len(course.elements), "hour": hours, "unit": units, "pixel": PIXELS}
    counts = {name: np.zeros((2, n), np.int64) for name, n in sizes.items()}
    busy_s = np.zeros(units)
    for path in files:
        rows = pq.read_table(path, page_checksum_verification=True)
        col = {name: rows[name].to_numpy() for name in rows.column_names}
        col["hour"] = np.minimum(col["time_s"] // 3600.0, hours - 1).astype(np.int64)
        angles = angles_deg(np.stack([col[c] for c in "xyz"], axis=1).astype(float))
        col["pixel"] = pixels_of(ORDER, *angles)
        for name, into in counts.items():
            for k, which in enumerate((np.full(len(rows), True), col["detected"])):
                into[k] += np.bincount(col[name][which], minlength=into.shape[1])
        busy_s += np.bincount(col["unit"], col["busy_s"], units)
    return counts, busy_s


def _objects(
    course: StudyCourse, files: list[Path], counts: NDArray[np.int64]
) -> tuple[pa.Table, dict[str, NDArray[np.int64]]]:
    """The table of objects, and of each regime how many gaps are of which length (GAP_BINS_H)."""
    period_s, custody_s = course.steps * course.study.step_s, course.study.custody_h * 3600.0
    regime = course.elements.regime
    counted = {str(r): np.zeros(len(GAP_BINS_H) - 1, np.int64) for r in np.unique(regime)}
    found: list[GapTimes] = []
    for first, last in pairwise(_groups(counts[1])):
        who, when = _detections(files, first, last)
        gaps = gap_times(who - first, when, last - first, period_s, custody_s)
        found.append(gaps)
        for name, many in counted.items():
            mine = (regime[first:last] == name)[gaps.of]
            hours = np.minimum(gaps.all_s[mine] / 3600.0, GAP_BINS_H[-1])  # the last: or longer
            many += np.histogram(hours, GAP_BINS_H)[0]
    e = course.elements

    def column(name: str) -> NDArray[np.float64]:
        return np.concatenate([getattr(g, name) for g in found])

    hours = {f"gap_{n}_h": column(f"{n}_s") / 3600.0 for n in ("median", "p95", "longest")}
    columns = {
        "number": e.number,
        "name": e.name.astype(str),
        "kind": e.kind.astype(str),
        "regime": regime.astype(str),
        "altitude_km": e.mean_altitude_km,
        "reflecting_m2": e.reflecting_m2,
        "observations": counts[0],
        "detections": counts[1],
        **hours,
        "first_detection_h": column("first_s") / 3600.0,
        "revisit_h": column("revisit_s") / 3600.0,
        "custody_fraction": column("custody"),
    }
    return pa.table({k: pa.array(v, from_pandas=True) for k, v in columns.items()}), counted


def _groups(detections: NDArray[np.int64]) -> list[int]:
    """Edges of runs of objects with up to MOST_DETECTIONS together."""
    edges, total = [0], 0
    for i, count in enumerate(detections.tolist()):
        if total and total + count > MOST_DETECTIONS:
            edges.append(i)
            total = 0
        total += count
    return [*edges, len(detections)]


def _detections(
    files: list[Path], first: int, last: int
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Object and time of the detections of objects first to last."""
    wanted = (pc.field("object") >= first) & (pc.field("object") < last) & pc.field("detected")
    rows = ds.dataset(files).to_table(columns=["object", "time_s"], filter=wanted)
    return rows["object"].to_numpy().astype(np.int64), rows["time_s"].to_numpy()


def _sensors(
    course: StudyCourse, counts: NDArray[np.int64], busy_s: NDArray[np.float64]
) -> pa.Table:
    """Each single sensor: hours in which it could look, share of them it was used: of a search,
    which goes from dwell to dwell without end, all."""
    open_h = np.zeros(len(course.watchers))
    for window in range(course.windows):
        works = [watch.works[:-1].sum() for watch in moments(course, window)]
        open_h += np.array(works) * course.study.step_s / 3600.0
    number = np.arange(len(course.units)) - np.searchsorted(course.units, course.units) + 1
    watchers = [course.watchers[j] for j in course.units]
    searches = isinstance(course.study.tasking, SearchPattern)
    busy_h = open_h[course.units] if searches else busy_s / 3600.0
    columns = {
        "sensor": [f"{w.name}-{k}" for w, k in zip(watchers, number, strict=True)],
        "open_h": open_h[course.units],
        "busy_h": busy_h,
        "used_fraction": np.minimum(busy_h / np.maximum(open_h[course.units], 1e-9), 1.0),
        "observations": counts[0],
        "detections": counts[1],
        "zenith_sky_e_s_px": [w.resolved.facts.background_e_s for w in watchers],
    }
    return pa.table(columns)


def _reach(course: StudyCourse) -> pa.Table:
    """Smallest diameter [m] that each sensor detects in half of its frames, against range."""
    km = np.array(REACH_KM)
    columns = {w.name: smallest_m(w, km, course.threshold) for w in course.watchers}
    return pa.table({"range_km": km, **columns})


def smallest_m(
    watcher: Watcher, range_km: NDArray[np.float64], threshold: float
) -> NDArray[np.float64]:
    """Diameters (n,) [m] of spheres (albedo 0.175, phase 60 degrees, at the zenith) whose SNR is
    the threshold; without tracking they cross at the speed of a circular orbit of that height."""
    range_m = range_km * 1e3
    radius = range_m + EARTH_EQUATORIAL_RADIUS_M
    rate = np.sqrt(EARTH_GM_M3_S2 / radius) / range_m
    streak = watcher.streak_px(rate)
    reflected = sphere_intensity_per_irradiance(REACH_PHASE_RAD, 1.0, REACH_ALBEDO)
    light = photon_rate_at_aperture(1.0, ASTRONOMICAL_UNIT_M, 1.0, reflected, range_m)
    light_e = watcher.light_e(light, np.ones(1))
    sky_e_s = watcher.resolved.facts.background_e_s
    low, high = np.full(len(range_m), -4.0), np.full(len(range_m), 4.0)
    for _ in range(40):
        middle = 0.5 * (low + high)
        seen = watcher.snr(light_e * 10.0 ** (2.0 * middle), streak, sky_e_s) >= threshold
        low, high = np.where(seen, low, middle), np.where(seen, middle, high)
    return np.asarray(10.0**high)


def _report(
    course: StudyCourse, tables: dict[str, pa.Table], failed: NDArray[np.int64], seconds: float
) -> JsonObject:
    """All figures of a study as plain values."""
    objects, sensors = tables[OBJECTS], tables[SENSORS]
    hours = course.hours
    seen = objects["detections"].to_numpy() > 0
    total = int(pc.sum(objects["observations"]).as_py())
    figures = {
        "objects": len(seen),
        "observations": total,
        "observations_per_hour": total / hours,
        "observations_per_object": total / len(seen),
        "detections": int(pc.sum(objects["detections"]).as_py()),
        "objects_detected": int(seen.sum()),
        "sensor_time_used": float(pc.mean(sensors["used_fraction"]).as_py()),
        **_gap_figures(objects, np.ones(len(seen), bool)),
    }
    skies: dict[str, list[str]] = {}
    for watcher in course.watchers:
        skies.setdefault(watcher.sky_note, []).append(watcher.name)
    notes = [
        *course.census.lines(),
        *course.idle,
        *course.remarks,
        *(f"{', '.join(w)}: {sky}" for sky, w in skies.items()),
    ]
    if len(failed):
        names = ", ".join(course.elements.name[failed[:5]].astype(str))
        notes.append(f"SGP4 ends within the period for {len(failed)} of the objects: {names}")
    return {
        "study": course.study.name,
        "start": course.study.start,
        "hours": hours,
        "figures": figures,
        "by_regime": _by(objects, course.elements.regime),
        "by_kind": _by(objects, course.elements.kind),
        "by_altitude_km": _by(objects, _altitudes(course.elements)),
        "threshold_sigma": course.threshold,
        "false_alarm_rate": course.study.detection.false_alarm_rate,
        "notes": notes,
        "forecast": course.forecast,
        "seconds": seconds,
        "versions": {"nightglass": version("nightglass")},
    }


def _gap_figures(objects: pa.Table, which: NDArray[np.bool_]) -> JsonObject:
    """Over some objects: medians of their gaps' median and 95 %, the longest; first, custody.

    An object without a first detection, or a second, has it after the period's end, nobody knows
    when: a median that lies among those is null.
    """
    some = objects.filter(pa.array(which))

    def over(name: str, function: Any) -> float | None:
        values = some[name].drop_null().to_numpy()
        return float(function(values)) if len(values) else None

    def median_with_never(name: str) -> float | None:
        values = np.nan_to_num(some[name].to_numpy(zero_copy_only=False), nan=np.inf)
        middle = float(np.median(values)) if len(values) else np.inf
        return middle if np.isfinite(middle) else None

    return {
        "gap_median_h": over("gap_median_h", np.median),
        "gap_p95_h": over("gap_p95_h", np.median),
        "gap_longest_h": over("gap_longest_h", np.max),
        "first_detection_h": median_with_never("first_detection_h"),
        "revisit_h": median_with_never("revisit_h"),
        "custody_fraction": over("custody_fraction", np.mean),
    }


def _by(objects: pa.Table, labels: NDArray[np.str_]) -> JsonObject:
    """Gap figures of the objects of each label (n,)."""
    out = {}
    for label in dict.fromkeys(labels.tolist()):
        mine = labels == label
        out[label] = {"objects": int(mine.sum()), **_gap_figures(objects, mine)}
    return dict(sorted(out.items(), key=lambda item: _first_number(item[0])))


def _first_number(label: str) -> tuple[float, str]:
    """Numbers by size, words after them by the alphabet."""
    head = label.split("-")[0]
    return (float(head), "") if head.isdigit() else (np.inf, label)


def _altitudes(elements: Elements) -> NDArray[np.str_]:
    """The bin of mean altitude of each object (n,): from-to [km]."""
    at = np.digitize(elements.mean_altitude_km, ALTITUDES_KM)
    edges = ["0", *(f"{km}" for km in ALTITUDES_KM), "inf"]
    return np.array([f"{a}-{b}" for a, b in pairwise(edges)])[at]
