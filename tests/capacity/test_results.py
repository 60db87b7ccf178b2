"""Tables and figures of a study against counts by hand from its observations, and closed forms."""

from __future__ import annotations

import copy
import json
from collections import Counter
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import astropy.coordinates as coord
import astropy.units as u
import healpy
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from astropy.time import Time

from pipeline.capacity import course as courses
from pipeline.capacity import results
from pipeline.capacity.course import make_course
from pipeline.capacity.results import smallest_m
from pipeline.capacity.run import StudyOptions, run_study
from pipeline.execute.truth import matched_snr
from pipeline.survey.signal import straight
from tests.capacity.conftest import SITE, SMALL
from tests.survey.conftest import watcher

Data = dict[str, Any]
Rows = list[Data]
HOURS = 10.5
CHANGES: dict[str, Any] = {
    "duration_h": HOURS,
    "custody_h": 1.5,
    "detection": {"false_alarm_rate": 1e-4, "frames_needed": 2, "least_probability": 0.2},
    "catalogue": {"synthetic": {"objects": 80, "seed": 4, "smallest_m": 0.1}},
}


class Made:
    """A small study of three windows and what it wrote."""

    def __init__(self, folder: Path) -> None:
        data = copy.deepcopy(SMALL) | CHANGES
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(courses, "STEPS", 250)
            patch.setattr(results, "MOST_DETECTIONS", 7)
            self.report = run_study(data, folder, folder / "out", StudyOptions("synchronous"))
        self.folder, self.course = folder / "out", make_course(data, folder)
        self.rows: Rows = []
        for path in sorted((self.folder / "observations").glob("*.parquet")):
            self.rows += pq.read_table(path).to_pylist()
        self.seen = [r for r in self.rows if r["detected"]]

    def table(self, name: str) -> Rows:
        return list(pq.read_table(self.folder / f"{name}.parquet").to_pylist())


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    made = Made(tmp_path_factory.mktemp("study"))
    assert len(list((made.folder / "observations").iterdir())) == 3
    assert 30 < len(made.seen) < len(made.rows) - 10
    return made


def test_objects(made: Made) -> None:
    """Gaps and custody by a clock of seconds; a detection that ends after the period is at its
    end."""
    end = HOURS * 3600.0
    clock = np.arange(0.5, end)
    told = made.table("objects")
    assert sum(o["detections"] for o in told) == len(made.seen)
    for i, o in enumerate(told):
        times = sorted(min(r["time_s"], end) for r in made.seen if r["object"] == i)
        gaps = np.diff([0.0, *times, end]) / 3600.0
        assert o["observations"] == sum(r["object"] == i for r in made.rows)
        assert o["detections"] == len(times)
        assert o["gap_longest_h"] == pytest.approx(gaps.max())
        assert o["gap_p95_h"] == pytest.approx(np.percentile(gaps, 95))
        first, between = o["first_detection_h"], o["revisit_h"]
        assert first == (pytest.approx(times[0] / 3600.0) if times else None)
        several = len(times) > 1
        assert between == (pytest.approx(np.diff(times).mean() / 3600.0) if several else None)
        last = np.searchsorted(times, clock) - 1
        age = clock - np.array([*times, -1e9])[last]  # -1: of none
        assert o["custody_fraction"] == pytest.approx((age < 1.5 * 3600.0).mean(), abs=1e-3)


def test_observations_begin_in_their_step(made: Made) -> None:
    """`time_s` is the end of a dwell that begins, with its slew, `busy_s` before: settling of 5 s
    and three frames in 5 s at least. No sensor does two things at once."""
    for unit in range(3):
        own = sorted((r for r in made.rows if r["unit"] == unit), key=lambda r: r["time_s"])
        start = np.array([r["time_s"] - r["busy_s"] for r in own])
        assert (np.floor(start / 60.0 + 1e-4) == [r["step"] for r in own]).all()
        assert min(r["busy_s"] for r in own) >= 10.0
        assert (start[1:] - [r["time_s"] for r in own[:-1]]).min() > -1e-2


@pytest.mark.parametrize("together", [7, 10**6])
def test_gaps_are_counted_by_orbit(
    made: Made, monkeypatch: pytest.MonkeyPatch, together: int
) -> None:
    """What the page draws: how many gaps of the objects of each orbit are how long, also where
    objects are looked at group by group."""
    monkeypatch.setattr(results, "MOST_DETECTIONS", together)
    files = sorted((made.folder / "observations").glob("*.parquet"))
    objects, end = made.table("objects"), HOURS * 3600.0
    counts = np.array([[o[n] for o in objects] for n in ("observations", "detections")])
    _, counted = results._objects(made.course, files, counts)
    assert set(counted) == {o["regime"] for o in objects}
    for regime, many in counted.items():
        gaps: list[float] = []
        for i in (i for i, o in enumerate(objects) if o["regime"] == regime):
            times = sorted(min(r["time_s"], end) for r in made.seen if r["object"] == i)
            gaps += np.diff([0.0, *times, end]).tolist()
        wanted, _ = np.histogram(np.array(gaps) / 3600.0, results.GAP_BINS_H)
        np.testing.assert_array_equal(many, wanted)
    whole = {regime: many.sum() for regime, many in counted.items()}
    monkeypatch.setattr(results, "GAP_BINS_H", np.array([0.0, 0.1, 0.2]))  # longer ones: the last
    _, short = results._objects(made.course, files, counts)
    assert {regime: many.sum() for regime, many in short.items()} == whole


def test_hours_and_sensors(made: Made) -> None:
    """Open hours are those of astropy's Sun below -12 degrees."""
    for which, name in ((made.rows, "observations"), (made.seen, "detections")):
        hours = Counter(min(int(r["time_s"] // 3600), 10) for r in which)
        assert [h[name] for h in made.table("hours")] == [hours[k] for k in range(11)]
        units = Counter(r["unit"] for r in which)
        assert [s[name] for s in made.table("sensors")] == [units[k] for k in range(3)]
    sensors = made.table("sensors")
    assert [s["sensor"] for s in sensors] == ["one-1", "one-2", "two-1"]
    when = Time("2019-04-20T06:00:00") + np.arange(0, HOURS * 60) * u.min
    for k, s in enumerate(sensors):
        busy = sum(r["busy_s"] for r in made.rows if r["unit"] == k) / 3600.0
        site = coord.EarthLocation.from_geodetic(-120.0 if k == 2 else -156.3, 20.7, 3055.0)
        up = coord.get_sun(when).transform_to(coord.AltAz(obstime=when, location=site)).alt.deg
        assert s["open_h"] == pytest.approx((up <= -12.0).sum() / 60.0)
        assert s["busy_h"] == pytest.approx(busy, rel=1e-5)
        assert s["used_fraction"] == pytest.approx(busy / s["open_h"], rel=1e-5)


def test_the_moment_after_a_window_is_of_the_next_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """A sensor that always may look: two windows of two steps of half an hour are two hours."""
    watch = SimpleNamespace(works=np.ones(3, bool))
    monkeypatch.setattr(results, "moments", lambda course, window: (watch,))
    sky = SimpleNamespace(facts=SimpleNamespace(background_e_s=1.0))
    study = SimpleNamespace(step_s=1800.0, tasking=None)
    course: Any = SimpleNamespace(
        watchers=(SimpleNamespace(name="one", resolved=sky),),
        units=np.zeros(1, np.int64),
        windows=2,
        study=study,
    )
    none = np.zeros((2, 1), np.int64)
    (told,) = results._sensors(course, none, np.array([3600.0])).to_pylist()
    assert (told["open_h"], told["busy_h"], told["used_fraction"]) == (2.0, 1.0, 0.5)


def test_a_search_uses_all_the_time_in_which_it_may_look(data: Data, tmp_path: Path) -> None:
    """However many objects its dwells hold: the last site's night has not begun yet."""
    data["cameras"][0] |= {"tracking": "sidereal"}
    data["cameras"][0]["sensor"] = data["cameras"][0]["sensor"] | {"focal_length_m": 0.03}
    data["sensors"].append({"name": "day", "observer": SITE | {"longitude_deg": 20.0}})
    data["tasking"] = {"kind": "serendipitous", "pattern": "fence"}
    data |= {"duration_h": 3.0, "detection": {"least_probability": 0.0}}
    report = run_study(data, tmp_path, tmp_path / "out", StudyOptions("synchronous"))
    sensors = pq.read_table(tmp_path / "out" / "sensors.parquet").to_pylist()
    assert [s["open_h"] > 1.0 for s in sensors] == [True, True, True, False]
    assert [s["busy_h"] for s in sensors] == [s["open_h"] for s in sensors]
    assert [s["used_fraction"] for s in sensors] == pytest.approx([1.0, 1.0, 1.0, 0.0])
    assert report["figures"]["sensor_time_used"] == pytest.approx(0.75)


def test_coverage_is_healpys(made: Made) -> None:
    ra, dec = (np.degrees(a) for a in (
        np.arctan2([r["y"] for r in made.rows], [r["x"] for r in made.rows]),
        np.arcsin([r["z"] for r in made.rows])))  # fmt: skip
    pixel = healpy.ang2pix(16, ra, dec, nest=True, lonlat=True)
    told = [row["observations"] for row in made.table("coverage")]
    assert told == np.bincount(pixel, minlength=3072).tolist()


def test_figures(made: Made) -> None:
    """Of all, by orbit, by kind and by altitude: medians over objects, and the longest of all."""
    objects, f = made.table("objects"), made.report["figures"]
    assert json.loads((made.folder / "report.json").read_text())["figures"] == f
    assert f["observations"] == len(made.rows)
    assert f["observations_per_hour"] == pytest.approx(len(made.rows) / HOURS)
    assert f["observations_per_object"] == pytest.approx(len(made.rows) / 80)
    assert f["objects_detected"] == len({r["object"] for r in made.seen})
    assert (f["objects"], f["detections"]) == (80, len(made.seen))
    used = [s["used_fraction"] for s in made.table("sensors")]
    assert f["sensor_time_used"] == pytest.approx(np.mean(used))

    def height(o: dict[str, Any]) -> str:
        edges = [0, 500, 800, 1200, 2000, 10_000, 25_000, 40_000, np.inf]
        k = next(k for k, edge in enumerate(edges) if o["altitude_km"] < edge)
        return f"{edges[k - 1]}-{edges[k]}"

    groups = {"by_regime": lambda o: o["regime"], "by_kind": lambda o: o["kind"],
              "by_altitude_km": height}  # fmt: skip
    told = [(f, objects)]
    for name, of in groups.items():
        assert set(made.report[name]) == {of(o) for o in objects}
        for label, figures in made.report[name].items():
            mine = [o for o in objects if of(o) == label]
            assert figures["objects"] == len(mine)
            told.append((figures, mine))
    for figures, mine in told:
        for key, over in (("gap_median_h", np.median), ("gap_p95_h", np.median),
                          ("gap_longest_h", np.max), ("custody_fraction", np.mean)):
            assert figures[key] == pytest.approx(over([o[key] for o in mine]))  # fmt: skip
        for key in ("first_detection_h", "revisit_h"):  # of all, those that have none the latest
            assert figures[key] == pytest.approx(middle([o[key] for o in mine]))


def middle(values: list[float | None]) -> float | None:
    """The median by order, where None comes last; None where it is one, or next to one."""
    order = sorted(values, key=lambda v: (v is None, v or 0.0))
    low, high = order[(len(order) - 1) // 2], order[len(order) // 2]
    return None if low is None or high is None else 0.5 * (low + high)


def test_never_detected_objects_come_last_in_medians() -> None:
    """Three of five detected, two of them twice: the middle is the latest first detection, and half
    have no second one."""
    nan = np.nan
    first, between = [1.0, nan, 3.0, nan, 2.0], [nan, nan, 4.0, nan, 5.0]
    columns = {"first_detection_h": first, "revisit_h": between}
    gaps = {f"gap_{n}_h": [10.0] * 5 for n in ("median", "p95", "longest")}
    table = pa.table(
        {k: pa.array(np.array(v), from_pandas=True) for k, v in (columns | gaps).items()}
        | {"custody_fraction": [0.0] * 5}
    )
    told = [results._gap_figures(table, np.arange(5) < n) for n in (5, 4, 1)]
    assert [t["first_detection_h"] for t in told] == [3.0, None, 1.0]
    assert [t["revisit_h"] for t in told] == [None, None, None]
    assert results._gap_figures(table, np.arange(5) >= 2)["first_detection_h"] == 3.0
    assert results._gap_figures(table, np.arange(5) % 2 == 0)["revisit_h"] == 5.0


def test_figures_of_labels_stand_by_size_then_by_the_alphabet() -> None:
    labels = np.array(["LEO", "500-1000", "GEO", "1000-2000", "0-500"])
    order = sorted(labels.tolist(), key=results._first_number)
    assert order == ["0-500", "500-1000", "1000-2000", "GEO", "LEO"]


def test_the_page_has_the_figures(made: Made) -> None:
    """Each group's row under its own heads."""
    page = (made.folder / "report.html").read_text()
    heads = ["objects", "median gap [h]", "95 % [h]", "longest [h]", "first detection [h]"]
    assert "".join(f"<th>{h}</th>" for h in heads) in page
    for name in ("by_regime", "by_kind", "by_altitude_km"):
        for label, g in made.report[name].items():
            keys = ("gap_median_h", "gap_p95_h", "gap_longest_h", "first_detection_h")
            cells = [label, f"{g['objects']}"]
            cells += ["–" if g[k] is None else f"{g[k]:.4g}" for k in keys]
            assert "".join(f"<td>{c}</td>" for c in cells) in page


@pytest.mark.parametrize("tracks", [True, False])
def test_reach(tracks: bool) -> None:
    """The light of that sphere at 60 degrees of phase, 1 au and its range has the threshold's SNR;
    without tracking along the streak of a circular orbit overhead."""
    w = watcher(tracks)
    km = np.array([500.0, 2000.0, 36_000.0])
    found = smallest_m(w, km, 4.75)
    phase = np.pi / 3.0
    bracket = np.sin(phase) + (np.pi - phase) * np.cos(phase)
    light = 0.175 / np.pi * (2.0 / 3.0) * (found / 2.0) ** 2 * bracket / (1e3 * km) ** 2
    r = w.resolved
    air = 10.0 ** (-0.4 * 0.12)
    light_e = light * air * r.sun_rate_e_s_m2 * np.pi * 0.2**2 * 1.0
    speed = np.sqrt(3.986004418e14 / (6_378_137.0 + 1e3 * km))
    streak = 0.0 * km if tracks else speed / (1e3 * km) / 13.5e-6 * 1.0
    for e, length in zip(light_e, streak, strict=True):
        inside = min(1.0, 1024.0 / max(length, 1e-9))
        middle = np.array([511.5])
        path = straight(min(length, 1024.0))
        snr = matched_snr(r, path, np.array([e * inside]), middle, middle)  # type: ignore[arg-type]
        assert snr[0] == pytest.approx(4.75, rel=3e-3)
