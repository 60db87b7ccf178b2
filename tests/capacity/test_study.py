"""Studies end to end: the same whatever runs them, resumed, counted by hand, refused in a line."""

from __future__ import annotations

import json
import re
from itertools import pairwise
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pyarrow.parquet as pq
import pytest

from pipeline.capacity import run
from pipeline.capacity.candidates import find_candidates, path_of
from pipeline.capacity.course import make_course
from pipeline.capacity.run import StudyOptions, forecast_of, run_study
from pipeline.errors import BadInput, TryLater
from pipeline.spec.dotted import changed
from pipeline.spec.study_load import parse_study, read_study
from pipeline.store.layout import only_writer

pytestmark = pytest.mark.usefixtures("coarse_signal")
ALONE = StudyOptions("synchronous")
Data = dict[str, Any]


def observations(out: Path) -> Any:
    files = sorted((out / "observations").glob("*.parquet"))
    return [pq.read_table(f).to_pylist() for f in files]


@pytest.mark.usefixtures("without_pictures")
def test_same_for_any_workers_and_resumed(
    data: Data, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Threads, batches of another order, and a study that is stopped in its middle: same rows."""
    monkeypatch.setattr("pipeline.capacity.course.STEPS", 100)
    monkeypatch.setattr("pipeline.capacity.course.BATCH", 17)
    monkeypatch.setattr("pipeline.capacity.candidates.BATCH", 17)
    alone = run_study(data, tmp_path, tmp_path / "alone", ALONE)
    threads = run_study(data, tmp_path, tmp_path / "threads", StudyOptions("threads", 3))
    assert alone["figures"] == threads["figures"]
    assert alone["figures"]["detections"] > 20
    assert observations(tmp_path / "alone") == observations(tmp_path / "threads")
    calls = []

    def stops(course: Any, item: Any) -> int:
        calls.append(item)
        if len(calls) == 11:
            raise KeyboardInterrupt
        return find_candidates(course, item)

    monkeypatch.setattr(run, "find_candidates", stops)
    with pytest.raises(KeyboardInterrupt):
        run_study(data, tmp_path, tmp_path / "again", ALONE)
    kept = sorted((tmp_path / "again" / "parts").glob("*.parquet"))
    kept[0].write_bytes(kept[0].read_bytes()[:-7])  # a part that is damaged is made again
    heard: list[Any] = []
    resumed = run_study(
        data, tmp_path, tmp_path / "again", StudyOptions("synchronous", resume=True), heard.append
    )
    assert [(h.done, h.total) for h in heard] == [(n, 20) for n in range(21 - len(heard), 21)]
    assert 0 < len(heard) < 12  # what was finished before counts as done
    assert resumed["figures"] == alone["figures"]
    assert observations(tmp_path / "again") == observations(tmp_path / "alone")
    assert not (tmp_path / "again" / "parts").exists()
    assert len(calls) <= 5 * 4 + 2


def test_gap_times_are_those_of_the_observations(data: Data, tmp_path: Path) -> None:
    """Counts, gaps and sensors' hours of a small study, by hand from its observations."""
    report = run_study(data, tmp_path, tmp_path / "out", ALONE)
    rows = [row for window in observations(tmp_path / "out") for row in window]
    objects = pq.read_table(tmp_path / "out" / "objects.parquet").to_pylist()
    for i, told in enumerate(objects):
        own = [r["time_s"] / 3600.0 for r in rows if r["object"] == i and r["detected"]]
        gaps = np.diff([0.0, *sorted(own), 8.0])
        assert told["detections"] == len(own)
        assert told["gap_longest_h"] == pytest.approx(gaps.max())
        assert told["gap_median_h"] == pytest.approx(np.median(gaps))
    assert report["figures"]["observations"] == len(rows)
    assert sum(report["by_regime"][k]["objects"] for k in report["by_regime"]) == 60
    by_unit: dict[int, list[tuple[float, float]]] = {}
    for r in rows:
        by_unit.setdefault(r["unit"], []).append((r["time_s"] - r["busy_s"], r["time_s"]))
    for spans in by_unit.values():  # none does two things at once
        spans.sort()
        assert all(b[0] >= a[1] - 1e-3 for a, b in pairwise(spans))
    page = (tmp_path / "out" / "report.html").read_text()
    assert "data:image/png" in page
    assert "Gap time by orbit" in page


@pytest.mark.usefixtures("without_pictures")
def test_priorities_and_schedulers(data: Data, tmp_path: Path) -> None:
    """What has no priority is left alone; assignment takes nothing twice in a step."""
    data["tasking"] |= {"scheduler": "assignment"}
    data["tasking"]["rules"] = [{"name_contains": "DEB", "priority": 0.0}]
    run_study(data, tmp_path, tmp_path / "out", ALONE)
    names = pq.read_table(tmp_path / "out" / "objects.parquet")["name"].to_pylist()
    rows = [row for window in observations(tmp_path / "out") for row in window]
    assert rows
    assert not any("DEB" in names[r["object"]] for r in rows)
    taken = [(r["step"], r["object"]) for r in rows]
    assert len(taken) == len(set(taken))


@pytest.mark.usefixtures("without_pictures")
@pytest.mark.parametrize("pattern", ["fence", "belt", "strip"])
def test_searches_see_what_is_in_their_fields(data: Data, tmp_path: Path, pattern: str) -> None:
    """Each observation stands in the field of its dwell, by the camera's own projection."""
    from pipeline.capacity.patterns import slots_of
    from pipeline.physics.positions.focal_plane import project

    spans = {"fence": (20.0, 80.0), "belt": (-200.0, -110.0), "strip": (-30.0, 30.0)}
    data["cameras"][0] |= {"tracking": "sidereal"}
    data["cameras"][0]["sensor"] = data["cameras"][0]["sensor"] | {"focal_length_m": 0.1}
    low, high = spans[pattern]
    data["tasking"] = {
        "kind": "serendipitous", "pattern": pattern, "from_deg": low, "to_deg": high,
        "azimuth_deg": 90.0,
    }  # fmt: skip
    data |= {"duration_h": 5.5, "detection": {"least_probability": 0.0}}
    data["catalogue"]["synthetic"]["objects"] = 150
    run_study(data, tmp_path, tmp_path / "out", ALONE)
    rows = [row for window in observations(tmp_path / "out") for row in window]
    assert rows
    course = make_course(data, tmp_path / "out")
    for row in rows[:50]:
        slots = slots_of(course, 0, row["unit"])
        middle = row["time_s"] - 0.5 * row["busy_s"]
        q = int(np.argmin(np.abs(slots.watch.offset_s - middle)))
        assert abs(slots.watch.offset_s[q] - middle) < 1e-3
        axes = slots.axes[q] @ slots.watch.to_gcrs[q].T
        u = np.array([[row["x"], row["y"], row["z"]]])
        camera = course.watchers[row["sensor"]].resolved.camera
        x, y = project(camera, axes, u / np.linalg.norm(u))
        assert abs(x[0] - 511.5) < 650.0  # it may be in the first or the last frame alone
        assert abs(y[0] - 511.5) < 650.0


@pytest.mark.usefixtures("without_pictures")
def test_searches_miss_nothing(data: Data, tmp_path: Path) -> None:
    """Against every object at every frame, by SGP4 itself and the camera's projection."""
    from pipeline.capacity.patterns import slots_of
    from pipeline.physics.positions.focal_plane import project
    from pipeline.physics.positions.orbit_screen import states_together
    from pipeline.physics.positions.orbit_sgp4 import since_epochs_s

    data["cameras"][0] |= {"tracking": "sidereal"}
    upright = {"focal_length_m": 0.05, "shape": [1024, 700]}
    data["cameras"][0]["sensor"] = data["cameras"][0]["sensor"] | upright
    data["sensors"] = data["sensors"][1:]
    data["tasking"] = {"kind": "serendipitous", "pattern": "strip", "from_deg": 30, "to_deg": 60}
    data |= {"duration_h": 5.0, "detection": {"least_probability": 0.0}}
    data["catalogue"]["synthetic"] |= {"objects": 100, "smallest_m": 5.0}
    run_study(data, tmp_path, tmp_path / "out", ALONE)
    rows = [row for window in observations(tmp_path / "out") for row in window]
    course = make_course(data, tmp_path / "out")
    slots, w = slots_of(course, 0, 0), course.watchers[0]
    satellites = course.elements.satellites()
    expected = set()
    for q, middle in enumerate(slots.watch.offset_s):
        at = middle + slots.frame_s
        place, _, _ = states_together(satellites, since_epochs_s(satellites, w.epoch), at)
        seen = w.watch(at)
        path = place - seen.observer_m
        for f in range(len(at)):
            x, y = project(w.resolved.camera, slots.axes[q], path[:, f])
            inside = (np.abs(x - 349.5) <= 350) & (np.abs(y - 511.5) <= 512)
            expected |= {(q, int(i), f) for i in np.flatnonzero(inside)}
    frames = {}
    for q, i, _ in expected:
        frames[q, i] = frames.get((q, i), 0) + 1
    found = {}
    for r in rows:
        q = int(np.argmin(np.abs(slots.watch.offset_s - (r["time_s"] - 0.5 * r["busy_s"]))))
        found[q, r["object"]] = r["frames"]
    assert len(found) > 10
    assert all(frames.get(k) == n for k, n in found.items())
    dark = [k for k in frames if k not in found]  # in the field, but in shadow, too low, by day
    from pipeline.survey.sights import sights_of

    q, i = (np.array(v) for v in zip(*dark, strict=True)) if dark else (np.zeros(0, int),) * 2
    for slot, one in zip(q, i, strict=True):
        p, v, _ = states_together(
            [satellites[one]],
            since_epochs_s([satellites[one]], w.epoch),
            slots.watch.offset_s[[slot]],
        )
        e = course.elements.take(np.array([one]))
        s = sights_of(
            w, slots.watch, np.array([slot]), np.array([0]), p[0], v[0], e.reflecting_m2, e.shaded
        )
        assert not (s.light > 0.0).any()


@pytest.mark.usefixtures("without_pictures")
def test_axes_make_points(data: Data, tmp_path: Path) -> None:
    data |= {
        "duration_h": 2.0,
        "axes": [{"field": "cameras.0.sensor.aperture_m", "values": [0.1, 0.6]}],
    }
    report = run_study(data, tmp_path, tmp_path / "out", ALONE)
    table = pq.read_table(tmp_path / "out" / "points.parquet").to_pylist()
    assert [p["cameras.0.sensor.aperture_m"] for p in table] == [0.1, 0.6]
    assert table[0]["observations"] <= table[1]["observations"]
    assert report["points"][1]["observations"] == table[1]["observations"]
    one = json.loads((tmp_path / "out" / "points" / "0001" / "report.json").read_text())
    assert one["figures"]["observations"] == table[1]["observations"]


BAD: list[tuple[dict[str, Any], str]] = [
    ({"duration_h": 0}, "duration_h: 0"),
    ({"stp_s": 60}, "stp_s: .*did you mean 'step_s'"),
    ({"schema": "nightglass/sweep/1"}, "schema: .*this is a sweep"),
    ({"catalogue": {}}, "catalogue: .*populations, synthetic or both"),
    ({"start": "tomorrow"}, "start: 'tomorrow'"),
    ({"sensors.0.camera": "none"}, "sensors.0.camera: 'none' is not accepted; allowed: camera"),
    ({"sensors.0.observer.latitude_deg": 85.0, "sensors.1.observer.latitude_deg": 80.0,
      "start": "2019-06-21T00:00:00Z"},
     "sensors.0.field_of_regard.twilight_deg: '-12 .never dark enough.'"),
    ({"sensors.0.field_of_regard": {"lowest_elevation_deg": 50, "highest_elevation_deg": 40}},
     "sensors.0.field_of_regard.highest_elevation_deg: 40"),
    ({"cameras.0.background": {"moonlight": True}},
     "^cameras.0.background.moonlight: True is not accepted; allowed: with observer.atmosphere"),
    ({"sensors.0.field_of_regard": {"lowest_elevation_deg": 50, "highest_elevation_deg": 50}},
     "highest_elevation_deg: 50 is not accepted; allowed: above lowest_elevation_deg = 50"),
    ({"sensors.0.field_of_regard": {"sun_exclusion_deg": 175, "moon_exclusion_deg": 60}},
     "sensors.0.field_of_regard: 'exclusions that leave no direction"),
    ({"catalogue": {"populations": [{"name": "old", "path": "old.tle", "body": {
        "kind": "sphere", "diameter_m": 1.0, "albedo": 0.2}}]}},
     "catalogue: 'epochs [0-9]+ to [0-9]+ days from the period' .*within 30 days"),
    ({"catalogue": {"populations": [{"name": "none", "path": "empty.tle", "body": {
        "kind": "sphere", "diameter_m": 1.0, "albedo": 0.2}}]}}, "catalogue.populations.0.path"),
    ({"catalogue": {"synthetic": {"objects": 5, "smallest_m": 1e300}}},
     "catalogue.synthetic.smallest_m: 1e.300 .*allowed: less than or equal to 10000"),
    ({"catalogue": {"synthetic": {"objects": 5, "largest_m": 1e-300}}},
     "catalogue.synthetic.largest_m: 1e-300 .*greater than or equal to 0.0001"),
    ({"catalogue": {"synthetic": {"objects": 5, "smallest_m": 2.0, "largest_m": 1.0}}},
     "catalogue.synthetic.largest_m: 1.0 is not accepted; allowed: smallest_m = 2.0 or more"),
    ({"cameras.0.tracking": "target", "tasking": {"kind": "serendipitous", "pattern": "strip",
        "from_deg": -10, "to_deg": 10}}, "cameras.0.tracking: 'target'"),
    ({"cameras.0.exposure": {"integration_s": 0.0}}, "cameras.0.exposure.integration_s: 0"),
    ({"cameras.0.sensor.quantum_efficiency": "no.csv"},
     "cameras.0.sensor.quantum_efficiency: '.*no.csv'"),
    ({"detection": {"frames_needed": 9}}, "detection.frames_needed: 9"),
    ({"cameras.0.sensor.detector": {"readout": {"kind": "tdi", "rows_per_s": 40.0}}},
     "^cameras.0.sensor.detector.readout.kind: 'tdi' is not accepted; allowed: frame_transfer"),
    ({"duration_h": 24 * 3000, "catalogue": {"synthetic": {"objects": 50_000}}},
     "study: '[0-9]+ h of one core' is not accepted; allowed: up to 24 h"),
    ({"sensors.1.name": "one"}, "^sensors: .*allowed: different names$"),
    ({"sensors.1.name": "range_km"}, "^sensors: .*allowed: other names than range_km"),
    ({"cameras.0.tracking": "sidereal", "tasking": {"kind": "serendipitous", "pattern": "fence",
        "from_deg": 60, "to_deg": 60}},
     "^tasking.to_deg: 60 is not accepted; allowed: above from_deg = 60"),
    ({"seeds": 500, "axes": [{"field": "sensors.0.count", "values": [1, 2, 3]}]},
     "^axes: .*allowed: up to 1000 points$"),
    ({"start": "2100-12-31T23:00:00Z", "duration_h": 2.0}, "^start: '7200 s after the epoch'"),
]  # fmt: skip


@pytest.mark.parametrize(("changes", "text"), BAD, ids=[b[1][:30] for b in BAD])
def test_bad_input_is_one_line(data: Data, tmp_path: Path, changes: Data, text: str) -> None:
    elements = Path(__file__).resolve().parents[2] / "examples" / "population.tle"
    (tmp_path / "old.tle").write_text(elements.read_text())
    (tmp_path / "empty.tle").write_text("")
    late = {"start": "2025-01-01T06:00:00Z"} if "old.tle" in str(changes) else {}
    with pytest.raises(BadInput) as told:
        run_study(changed(data, late | changes), tmp_path, tmp_path / "out", ALONE)
    assert re.search(text, str(told.value)), str(told.value)
    assert "\n" not in str(told.value)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("text", ["[1, 2]", "3", "hello"])
def test_what_is_no_study_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "study.yaml").write_text(text)
    data = text if text == "hello" else json.loads(text)
    allowed = "a mapping (schema, name, start, sensors, ...)"
    with pytest.raises(BadInput) as read:
        read_study(tmp_path / "study.yaml", ["seed=1"])
    with pytest.raises(BadInput) as parsed:
        parse_study(data)
    for told in (read, parsed):
        assert str(told.value) == f"study: {data!r} is not accepted; allowed: {allowed}"


def test_a_sensor_without_a_night_is_reported_and_the_others_look(
    data: Data, tmp_path: Path
) -> None:
    """A polar site in June, and one under clouds: they observe nothing, the third does."""
    data["start"] = "2019-06-21T06:00:00Z"
    data["sensors"][0]["observer"] = data["sensors"][0]["observer"] | {"latitude_deg": 85.0}
    cloudy = {"name": "cloudy", "field_of_regard": {"clear_fraction": 1e-9}}
    data["sensors"].append(data["sensors"][1] | cloudy)
    report = run_study(data, tmp_path, tmp_path / "out", ALONE)
    idle = [n for n in report["notes"] if "looks nowhere" in n]
    assert [n.split()[0] for n in idle] == ["one", "cloudy"]
    assert "-12 (never dark enough)" in idle[0]
    assert "no clear dark hour in the period" in idle[1]
    rows = pq.read_table(tmp_path / "out" / "sensors.parquet").to_pylist()
    assert [r["observations"] > 0 for r in rows] == [False, False, True, False]
    assert [r["open_h"] > 0 for r in rows] == [False, False, True, False]
    assert all(0.0 <= r["used_fraction"] <= 1.0 for r in rows)


def test_decayed_objects_are_reported(
    data: Data, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An object whose SGP4 ends in the period is counted, and named; also where the study is gone
    on with after its last window."""
    lines = (Path(__file__).resolve().parents[2] / "examples" / "population.tle").read_text()
    first, second = [x for x in lines.splitlines() if x[:2] in ("1 ", "2 ")][:2]
    second = second[:52] + "16.50000000" + second[63:68]
    first = first[:53] + " 99999-1" + first[61:68]
    both = [
        x + str(sum(int(c) if c.isdigit() else c == "-" for c in x) % 10) for x in (first, second)
    ]
    (tmp_path / "low.tle").write_text("FALLING\n" + "\n".join(both) + "\n" + lines)
    body = {"kind": "sphere", "diameter_m": 1.0, "albedo": 0.2}
    data["catalogue"] = {"populations": [{"name": "low", "path": "low.tle", "body": body}]}
    data["duration_h"] = 1.0
    monkeypatch.setattr(run, "page", lambda *_: "")  # pictures take a second
    report = run_study(data, tmp_path, tmp_path / "out", ALONE)
    assert any("SGP4 ends" in note and "FALLING" in note for note in report["notes"])
    with monkeypatch.context() as patch:
        patch.setattr(run, "summarise", MagicMock(side_effect=KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            run_study(data, tmp_path, tmp_path / "again", ALONE)
    on = StudyOptions("synchronous", resume=True)
    again = run_study(data, tmp_path, tmp_path / "again", on)
    assert again["notes"] == report["notes"]


@pytest.mark.usefixtures("without_pictures")
def test_resume_needs_the_same_study(data: Data, tmp_path: Path) -> None:
    data["duration_h"] = 1.0
    run_study(data, tmp_path, tmp_path / "out", ALONE)
    with pytest.raises(BadInput, match="a path that does not exist yet; or give --resume"):
        run_study(data, tmp_path, tmp_path / "out", ALONE)
    data["seed"] = 9
    with pytest.raises(BadInput, match="a study of the same study"):
        run_study(data, tmp_path, tmp_path / "out", StudyOptions("synchronous", resume=True))


@pytest.mark.usefixtures("without_pictures")
def test_resume_needs_the_same_files(data: Data, tmp_path: Path) -> None:
    """A curve that was changed under its name would be mixed with what was found by the old one."""
    curve, again = tmp_path / "qe.csv", StudyOptions("synchronous", resume=True)
    data["cameras"][0]["sensor"] |= {"quantum_efficiency": "qe.csv"}
    data["duration_h"] = 1.0
    curve.write_text("wavelength_nm,value\n400,0.5\n900,0.5\n")
    before = run_study(data, tmp_path, tmp_path / "out", ALONE)
    assert run_study(data, tmp_path, tmp_path / "out", again) == before
    curve.write_text("wavelength_nm,value\n400,0.6\n900,0.6\n")
    with pytest.raises(BadInput, match="a study of the same study"):
        run_study(data, tmp_path, tmp_path / "out", again)


def test_weather_and_forecast(data: Data, tmp_path: Path) -> None:
    """Clouds come by the seed alone; a forecast counts what the study does."""
    data["sensors"][0]["field_of_regard"] = {"clear_fraction": 0.5, "weather_h": 0.5}
    course = make_course(data, tmp_path)
    watcher, at = course.watchers[0], np.arange(0.0, 28_800.0, 60.0)
    clear = watcher.watch(at).works
    assert 0.1 < clear.mean() < 0.9
    np.testing.assert_array_equal(clear[240:300], watcher.watch(at[240:300]).works)
    told = forecast_of(data, tmp_path)
    assert (told["objects"], told["sensors"], told["steps"]) == (60, 3, 480)
    assert path_of(tmp_path, (1, 2)).name == "window-000001-batch-00002.parquet"


@pytest.mark.usefixtures("without_pictures")
def test_another_writer_is_one_of_the_study(data: Data, tmp_path: Path) -> None:
    data["duration_h"], out = 1.0, tmp_path / "out"
    run_study(data, tmp_path, out, ALONE)
    with only_writer(out), pytest.raises(TryLater) as told:
        run_study(data, tmp_path, out, StudyOptions("synchronous", resume=True))
    assert str(told.value) == f"{out}: another run is writing this study now"
