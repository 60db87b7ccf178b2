"""What a study found: tables of objects, sensors, hours and sky, and the report of all figures."""

from __future__ import annotations

import json
from dataclasses import dataclass
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

from catalog_tools.geometry.healpix import pixels_of
from catalog_tools.geometry.sphere import angles_deg
from catalog_tools.storage.durable import whole_file, write_atomically
from pipeline.capacity.course import StudyCourse, moments
from pipeline.capacity.gaps import GapTimes, gap_times
from pipeline.physics.constants import ASTRONOMICAL_UNIT_M, EARTH_GM_M3_S2
from pipeline.physics.targets.lighting import photon_rate_at_aperture
from pipeline.physics.targets.sphere import sphere_intensity_per_irradiance
from pipeline.survey.elements import Elements
from pipeline.survey.watch import Watcher

OBJECTS, SENSORS, HOURS, COVERAGE, REACH = (
    f"{name}.parquet" for name in ("objects", "sensors", "hours", "coverage", "reach")
)
REPORT, PAGE = "report.json", "report.html"
ORDER = 4  # of the HEALPix map: 3,072 pixels of 3.7 degrees
MOST_DETECTIONS = 4_000_000  # whose gaps are worked out in one go
REACH_KM = tuple(np.geomspace(300.0, 45_000.0, 40).tolist())
REACH_PHASE_RAD, REACH_ALBEDO = np.pi / 3.0, 0.175
GAP_BINS_H = np.concatenate([[0.0], np.geomspace(1.0 / 60.0, 10_000.0, 61)])


@dataclass(frozen=True, eq=False)
class StudyCounts:
    """Counts over all observations: by object (n,), by hour (h, s) and of sensors (u,), by pixel.

    observations, detections, busy_s of each; one number a window is all that grows with the period
    """

    objects: NDArray[np.int64]
    detections: NDArray[np.int64]
    hours: NDArray[np.int64]
    hour_detections: NDArray[np.int64]
    busy_s: NDArray[np.float64]
    unit_observations: NDArray[np.int64]
    unit_detections: NDArray[np.int64]
    sky: NDArray[np.int64]


def summarise(
    course: StudyCourse, out: Path, failed: NDArray[np.int64], seconds: float
) -> dict[str, Any]:
    """Write all tables, the report and its page; returns the report."""
    files = sorted((out / "observations").glob("window-*.parquet"))
    tally = _tally(course, files)
    objects, gaps_h = _objects(course, files, tally)
    hours = {
        "hour": np.arange(len(tally.hours)),
        "observations": tally.hours,
        "detections": tally.hour_detections,
    }
    tables = {
        OBJECTS: objects,
        SENSORS: _sensors(course, tally),
        HOURS: pa.table(hours),
        COVERAGE: pa.table({"pixel": np.arange(12 * 4**ORDER), "observations": tally.sky}),
        REACH: _reach(course),
    }
    for name, table in tables.items():
        with whole_file(out / name) as own:
            pq.write_table(table, own, write_page_checksum=True)
    report = _report(course, tables, failed, seconds)
    from pipeline.capacity.page import page  # figures: nothing of them is needed by workers

    write_atomically(out / PAGE, page(course, report, tables, gaps_h))
    write_atomically(out / REPORT, json.dumps(report, indent=2, allow_nan=False) + "\n")
    return report


def _tally(course: StudyCourse, files: list[Path]) -> StudyCounts:
    n, units = len(course.elements), len(course.units)
    hours = int(np.ceil(course.steps * course.study.step_s / 3600.0))
    t = StudyCounts(
        np.zeros(n, np.int64),
        np.zeros(n, np.int64),
        np.zeros(hours, np.int64),
        np.zeros(hours, np.int64),
        np.zeros(units),
        np.zeros(units, np.int64),
        np.zeros(units, np.int64),
        np.zeros(12 * 4**ORDER, np.int64),
    )
    for path in files:
        rows = pq.read_table(path, page_checksum_verification=True)
        col = {name: rows[name].to_numpy() for name in rows.column_names}
        seen = col["detected"]
        hour = np.minimum(col["time_s"] // 3600.0, hours - 1).astype(np.int64)
        ra, dec = angles_deg(np.stack([col[c] for c in "xyz"], axis=1).astype(float))
        for into, where in (
            (t.objects, col["object"]),
            (t.detections, col["object"][seen]),
            (t.hours, hour),
            (t.hour_detections, hour[seen]),
            (t.unit_observations, col["unit"]),
            (t.unit_detections, col["unit"][seen]),
            (t.sky, pixels_of(ORDER, ra, dec)),
        ):
            np.add.at(into, where, 1)
        np.add.at(t.busy_s, col["unit"], col["busy_s"])
    return t


def _objects(
    course: StudyCourse, files: list[Path], tally: StudyCounts
) -> tuple[pa.Table, dict[str, NDArray[np.int64]]]:
    """The table of objects, and of each regime how many gaps are of which length (GAP_BINS_H)."""
    period_s, custody_s = course.steps * course.study.step_s, course.study.custody_h * 3600.0
    regime = course.elements.regime
    counted = {str(r): np.zeros(len(GAP_BINS_H) - 1, np.int64) for r in np.unique(regime)}
    found: list[GapTimes] = []
    edges = _groups(tally.detections)
    for first, last in pairwise(edges):
        who, when = _detections(files, first, last)
        gaps = gap_times(who - first, when, last - first, period_s, custody_s)
        found.append(gaps)
        for name, counts in counted.items():
            mine = (regime[first:last] == name)[gaps.of]
            counts += np.histogram(gaps.all_s[mine] / 3600.0, GAP_BINS_H)[0]
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
        "observations": tally.objects,
        "detections": tally.detections,
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


def _sensors(course: StudyCourse, tally: StudyCounts) -> pa.Table:
    """Each single sensor: hours in which it could look, share of them it was used."""
    open_h = np.zeros(len(course.watchers))
    for window in range(course.windows):
        for j, watch in enumerate(moments(course, window)):
            open_h[j] += float(watch.works[:-1].sum()) * course.study.step_s / 3600.0
    names = [f"{course.watchers[j].name}-{k + 1}" for j, k in _numbered(course)]
    could = open_h[course.units]
    busy = tally.busy_s / 3600.0
    used = np.divide(busy, could, out=np.zeros_like(busy), where=could > 0.0)
    sky = [course.watchers[j].resolved.facts.background_e_s for j in course.units]
    return pa.table(
        {
            "sensor": names,
            "open_h": could,
            "busy_h": busy,
            "used_fraction": used,
            "observations": tally.unit_observations,
            "detections": tally.unit_detections,
            "sky_e_s_px": sky,
        }
    )


def _numbered(course: StudyCourse) -> list[tuple[int, int]]:
    """Of each single sensor its place in the file, and its number there."""
    first = np.searchsorted(course.units, course.units)
    return [(int(j), int(u - f)) for u, (j, f) in enumerate(zip(course.units, first, strict=True))]


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
    radius = range_m + 6_378_137.0
    rate = np.sqrt(EARTH_GM_M3_S2 / radius) / range_m
    r = watcher.resolved
    streak = rate * r.integration_s(0) / r.facts.ifov_rad * (0.0 if watcher.tracks else 1.0)
    reflected = sphere_intensity_per_irradiance(REACH_PHASE_RAD, 1.0, REACH_ALBEDO)
    light = photon_rate_at_aperture(1.0, ASTRONOMICAL_UNIT_M, 1.0, reflected, range_m)
    light_e = light * watcher.electrons_per_light
    if r.extinction is not None:
        light_e = light_e * r.extinction.transmission(np.ones(1))
    low, high = np.full(len(km := range_m), -4.0), np.full(len(km), 4.0)
    for _ in range(40):
        middle = 0.5 * (low + high)
        seen = watcher.signal.snr(light_e * 10.0 ** (2.0 * middle), streak) >= threshold
        low, high = np.where(seen, low, middle), np.where(seen, middle, high)
    return np.asarray(10.0**high)


def _report(
    course: StudyCourse, tables: dict[str, pa.Table], failed: NDArray[np.int64], seconds: float
) -> dict[str, Any]:
    """All figures of a study as plain values."""
    objects, sensors = tables[OBJECTS], tables[SENSORS]
    hours = course.steps * course.study.step_s / 3600.0
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
    notes = course.census.lines()
    if len(failed):
        names = ", ".join(course.elements.name[failed[:5]].astype(str))
        notes.append(f"{len(failed)} objects are not followed to the end (SGP4 ends): {names}")
    return {
        "study": course.study.name,
        "start": course.study.start,
        "hours": hours,
        "figures": figures,
        "by_regime": _by(objects, "regime"),
        "by_kind": _by(objects, "kind"),
        "by_altitude_km": _by_altitude(objects, course.elements),
        "threshold_sigma": course.threshold,
        "false_alarm_rate": course.study.detection.false_alarm_rate,
        "notes": notes,
        "forecast": course.forecast,
        "seconds": seconds,
        "versions": {"nightglass": version("nightglass")},
    }


def _gap_figures(objects: pa.Table, which: NDArray[np.bool_]) -> dict[str, Any]:
    """Over some objects: medians of their gaps' median and 95 %, the longest; first, custody."""
    some = objects.filter(pa.array(which))

    def over(name: str, function: Any) -> float | None:
        values = some[name].drop_null().to_numpy()
        return float(function(values)) if len(values) else None

    return {
        "gap_median_h": over("gap_median_h", np.median),
        "gap_p95_h": over("gap_p95_h", np.median),
        "gap_longest_h": over("gap_longest_h", np.max),
        "first_detection_h": over("first_detection_h", np.median),
        "revisit_h": over("revisit_h", np.median),
        "custody_fraction": over("custody_fraction", np.mean),
    }


def _by(objects: pa.Table, name: str) -> dict[str, Any]:
    """Gap figures by the values of a column."""
    values = objects[name].to_numpy(zero_copy_only=False)
    out = {}
    for value in np.unique(values.astype(str)):
        mine = values == value
        out[str(value)] = {"objects": int(mine.sum()), **_gap_figures(objects, mine)}
    return out


def _by_altitude(objects: pa.Table, elements: Elements) -> dict[str, Any]:
    """Gap figures by bins of mean altitude."""
    edges = np.array([0, 500, 800, 1200, 2000, 10_000, 25_000, 40_000, np.inf])
    at = np.digitize(elements.mean_altitude_km, edges)
    out = {}
    for k in np.unique(at):
        name = f"{edges[max(k - 1, 0)]:g}-{edges[min(k, len(edges) - 1)]:g}"
        out[name] = {"objects": int((at == k).sum()), **_gap_figures(objects, at == k)}
    return out
