"""The route of a study: its points with their axes and seeds, and the draws of a search."""

from __future__ import annotations

import hashlib
import json
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from pipeline.capacity.course import make_course
from pipeline.capacity.run import (
    StudyOptions,
    _at_point,
    _is_whole,
    _searched,
    forecast_of,
    run_study,
)
from pipeline.errors import BadInput, Incomplete
from pipeline.spec.study_load import parse_study, read_study
from pipeline.sweep.ledger import PointLedger
from pipeline.sweep.run import SweepProgress
from tests.command import nightglass

Data = dict[str, Any]


def test_points_have_their_values_of_all_axes_and_their_seeds(
    data: Data, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pipeline.capacity.run.page", lambda *_: "")  # pictures take a second
    data |= {"duration_h": 1.0, "seeds": 2, "design": {"kind": "zip"}}
    data["catalogue"]["synthetic"]["objects"] = 20
    data["axes"] = [{"field": "sensors.0.count", "values": [1, 3]},
                    {"field": "cameras.0.sensor.aperture_m", "values": [0.1, 0.6]}]  # fmt: skip
    out = tmp_path / "out"
    heard: list[SweepProgress] = []
    report = run_study(data, tmp_path, out, StudyOptions("synchronous"), heard.append)
    assert [(p.done, p.total) for p in heard] == [(n, 4) for n in (1, 2, 3, 4)]  # a task a point
    told = pq.read_table(out / "points.parquet").to_pylist()
    assert [p.name for p in tmp_path.iterdir()] == ["out"]
    assert json.loads((out / "report.json").read_text()) == report
    assert (report["study"], report["points"]) == (data["name"], told)
    sealed = json.loads((out / "_COMPLETE").read_text())["files"]
    assert sealed == {
        name: hashlib.sha256((out / name).read_bytes()).hexdigest()
        for name in ("points.parquet", "report.json")
    }
    found, notes = [], []
    for row in told:
        place = out / "points" / f"{row['point']:04d}"
        own = json.loads((place / "study.json").read_text())
        values = own["sensors"][0]["count"], own["cameras"][0]["sensor"]["aperture_m"], own["seed"]
        keys = "sensors.0.count", "cameras.0.sensor.aperture_m", "seed"
        assert tuple(row[k] for k in keys) == values
        alone = json.loads((place / "report.json").read_text())
        assert {k: row[k] for k in alone["figures"]} == alone["figures"]
        notes += [note for note in alone["notes"] if note not in notes]
        found.append(values)
    assert [note.partition(": ")[2] for note in report["notes"]] == notes != []
    assert sorted(found) == [(n, a, s) for n, a in ((1, 0.1), (3, 0.6)) for s in (3, 4)]


def test_a_seed_is_a_value_only_where_there_are_several(data: Data) -> None:
    data |= {"axes": [{"field": "sensors.0.count", "values": [1, 3]}]}
    for seeds, keys in ((1, {"sensors.0.count"}), (2, {"sensors.0.count", "seed"})):
        study = parse_study(data | {"seeds": seeds})
        assert set(_at_point(data | {"seeds": seeds}, study, 1)[1]) == keys


@pytest.mark.usefixtures("without_pictures")
def test_an_axis_of_one_value_is_set_and_seeds_are_the_axes(data: Data, tmp_path: Path) -> None:
    """Values of one axis may be numbers, files, mappings and nothing: text in the table."""
    data |= {"duration_h": 1.0}
    data["catalogue"]["synthetic"]["objects"] = 5
    (tmp_path / "qe.csv").write_text("wavelength_nm,quantum_efficiency\n400,0.5\n900,0.5\n")
    mixed, sky = [0.5, "qe.csv"], {"twilight_deg": -15}
    for name, field, values, kept in (
        ("one", "custody_h", [0.1], [0.1]),
        ("seeds", "seed", [5, 9.0], [5, 9]),
        ("mixed", "cameras.0.sensor.quantum_efficiency", mixed, ["0.5", "qe.csv"]),
        ("empty", "sensors.0.field_of_regard", [{}, sky], ["{}", json.dumps(sky)]),
    ):
        made = data | {"axes": [{"field": field, "values": values}]}
        report = run_study(made, tmp_path, tmp_path / name, StudyOptions("synchronous"))
        table = pq.read_table(tmp_path / name / "points.parquet").to_pylist()
        assert [row[field] for row in table] == kept
        assert [row[field] for row in report["points"]] == values
        own = [json.loads((tmp_path / name / "points" / f"{k:04d}" / "study.json").read_text())
               for k in range(len(values))]  # fmt: skip
        assert [study["seed"] for study in own] == (kept if field == "seed" else [3] * len(own))
        assert own[0]["custody_h"] == (0.1 if name == "one" else 24.0)


def test_a_key_that_an_axis_changes_is_not_set(data: Data, tmp_path: Path) -> None:
    data["axes"] = [{"field": "custody_h", "values": [1, 2]}]
    (tmp_path / "study.json").write_text(json.dumps(data))
    with pytest.raises(BadInput, match=r"--set: .*a field that no axis of the study changes"):
        read_study(tmp_path / "study.json", ["custody_h=3"])
    assert read_study(tmp_path / "study.json", ["seed=9"])["seed"] == 9


BAD_AXES: dict[str, tuple[Data, str]] = {
    "lengths": ({"design": {"kind": "zip"}, "axes": [
        {"field": "custody_h", "values": [5, 9, 3]}, {"field": "step_s", "values": [60, 120]}]},
        "axes: .* axes of one length; these have 3, 2"),
    "twice": ({"axes": [{"field": "custody_h", "values": [1, 2]},
                        {"field": "custody_h", "values": [3, 4]}]}, "in one axis; twice"),
    "no count": ({"axes": [{"field": "custody_h", "kind": "range", "start": 1, "stop": 10}]},
                 r"axes\.0\.count: .* a count elsewhere"),
    "its axes": ({"axes": [{"field": "axes", "values": [[]]}]}, "may differ in, not axes"),
    "no axes": ({"design": {"kind": "sobol", "points": 4}}, "design: .* axes, or no design"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD_AXES)
def test_axes_that_do_not_fit_are_refused_as_those_of_sweeps(case: str, data: Data) -> None:
    changes, told = BAD_AXES[case]
    with pytest.raises(BadInput, match=told):
        forecast_of(data | changes, Path())


def test_dwells_of_a_search_draw_each_for_itself(data: Data, tmp_path: Path) -> None:
    """One object in one sensor's fields a thousand times; `time_s` becomes the end of the dwell."""
    data["cameras"][0]["tracking"] = "sidereal"
    data["tasking"] = {"kind": "serendipitous", "pattern": "fence"}
    course = make_course(data, tmp_path)
    middles = 17.5 + 23.0 * np.arange(1000)
    table = pa.table({
        "time_s": middles, "unit": np.full(1000, 1), "object": np.zeros(1000, np.int32),
        "probability": np.full(1000, 0.3, np.float32),
    })  # fmt: skip
    seen = _searched(course, table)
    assert seen["detected"].to_numpy().mean() == pytest.approx(0.3, abs=4 * 0.46 / np.sqrt(1000))
    np.testing.assert_allclose(seen["time_s"].to_numpy(), middles + 2.5)  # 3 frames in 5 s
    np.testing.assert_allclose(seen["busy_s"].to_numpy(), 5.0)


@pytest.mark.usefixtures("without_pictures")
def test_a_window_is_finished_as_soon_as_it_is_whole(data: Data, tmp_path: Path) -> None:
    """Of a day's four: the candidates of one alone are kept, however long a study is."""
    out, found = tmp_path / "out", []

    def look(_: object) -> None:
        found.append([len(list((out / name).iterdir())) for name in ("parts", "observations")])

    run_study(data | {"duration_h": 24.0}, tmp_path, out, StudyOptions("synchronous"), look)
    assert found == [[1, 0], [1, 1], [1, 2], [1, 3]]


def test_options_of_the_command(
    data: Data, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Fields that are set, the forecast, its limit, and going on."""
    monkeypatch.setattr("pipeline.capacity.run.page", lambda *_: "")
    (tmp_path / "study.json").write_text(json.dumps(data))
    short = ("--set", "duration_h=0.5", "--set", "catalogue.synthetic.objects=10", "--json")
    file, out = tmp_path / "study.json", tmp_path / "out"
    told = json.loads(nightglass("study", file, *short, "--dry-run").stdout)
    assert (told["objects"], told["steps"], out.exists()) == (10, 30, False)
    monkeypatch.setattr("pipeline.capacity.run.MOST_CPU_S", 1e-6)
    run = ("study", file, *short, "--scheduler", "synchronous", "-o", out)
    monkeypatch.setattr("pipeline.commands.study.LONG_S", 1e-6)
    refused = nightglass(*run)
    assert (refused.returncode, "or --yes" in refused.stderr) == (2, True)
    report = json.loads(nightglass(*run, "--yes").stdout)
    assert (report["hours"], report["figures"]["objects"]) == (0.5, 10)
    assert "--resume" in nightglass(*run, "--yes").stderr
    assert json.loads(nightglass(*run, "--yes", "--resume").stdout) == report
    first, *_ = nightglass(*run[:-5], *run[-4:], "--yes", "--resume").stdout.splitlines()
    assert first == "0 min of one core"  # a study that takes long


def test_points_are_forecast_together(
    data: Data, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before any is begun: each of them alone is within the limit."""
    data |= {"duration_h": 0.5, "seeds": 4}
    data["catalogue"]["synthetic"]["objects"] = 10
    asked = forecast_of(data, tmp_path)["cpu_s"]
    for most in (asked / 3.0, None):
        monkeypatch.setattr("pipeline.capacity.run.MOST_CPU_S", most or asked / 3.0)
        options = StudyOptions("synchronous", most_cpu_s=most)
        with pytest.raises(BadInput, match=r"h of one core.*shorten it") as refused:
            run_study(data, tmp_path, tmp_path / "out", options)
        assert ("--yes" in str(refused.value)) == (most is None)
        assert not (tmp_path / "out").exists()
    report = run_study(data, tmp_path, tmp_path / "out", StudyOptions("synchronous", yes=True))
    assert len(report["points"]) == 4


@pytest.mark.parametrize("scheduler", ["processes", "threads"])
def test_workers_that_this_machine_does_not_hold_are_refused(
    data: Data, tmp_path: Path, scheduler: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pipeline.capacity.run.page", lambda *_: "")
    data["catalogue"]["synthetic"]["objects"], data["duration_h"] = 10, 0.5
    each_mb = forecast_of(data, tmp_path)["worker_memory_mb"]
    monkeypatch.setattr("pipeline.capacity.run.free_mb", lambda: 2.5 * each_mb)
    with pytest.raises(BadInput, match=f"fewer workers of {each_mb:.0f} MB each") as refused:
        run_study(data, tmp_path, tmp_path / "out", StudyOptions(scheduler, 3))
    assert refused.value.field == "--workers"
    assert not (tmp_path / "out").exists()
    free_mb = iter([2.5 * each_mb])  # and none, once they hold what they need
    monkeypatch.setattr("pipeline.capacity.run.free_mb", lambda: next(free_mb, 0.0))
    data["seeds"] = 2
    report = run_study(data, tmp_path, tmp_path / "out", StudyOptions(scheduler, 2))
    assert report["failed"] == 0


def test_a_value_that_cannot_be_is_refused_before_any_point_is_begun(
    data: Data, tmp_path: Path
) -> None:
    data["axes"] = [{"field": "cameras.0.sensor.aperture_m", "values": [0.1, 0.2, -5.0, 0.3]}]
    with pytest.raises(BadInput, match=r"axes.0 \(.*\), value 2: -5"):
        run_study(data, tmp_path, tmp_path / "out", StudyOptions("synchronous"))
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("nights", [[10.0, 85.0, 20.0, 30.0], [85.0, 84.0, 10.0]])
def test_a_point_that_cannot_be_is_a_row_with_its_message(
    data: Data, tmp_path: Path, nights: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """In summer it does not get dark there; of points looked at before that is told first."""
    monkeypatch.setattr("pipeline.capacity.run.page", lambda *_: "")
    field, out = "sensors.0.observer.latitude_deg", tmp_path / "out"
    data |= {"start": "2019-06-21T00:00:00Z", "axes": [{"field": field, "values": nights}]}
    data["sensors"], data["duration_h"] = data["sensors"][:1], 24.0
    data["catalogue"]["synthetic"]["objects"] = 10
    (tmp_path / "study.json").write_text(json.dumps(data))
    never = [point for point, latitude in enumerate(nights) if latitude > 60.0]
    told: list[Data] = []
    run = data, tmp_path, out, StudyOptions("synchronous"), None, told.append
    report = run_study(*run)
    rows = pq.read_table(out / "points.parquet").to_pylist()
    assert (rows, len(never)) == (report["points"], report["failed"])
    for point, row in enumerate(rows):
        assert (row["point"], row[field]) == (point, nights[point])
        assert row["status"] == ("failed" if point in never else "done")
        assert (row["objects"] is None) == (row["message"] is not None) == (point in never)
        alone = tmp_path / "alone" / str(point)
        if point not in never:
            data["sensors"][0]["observer"]["latitude_deg"] = nights[point]
            own = {k: v for k, v in data.items() if k != "axes"}
            figures = run_study(own, tmp_path, alone, StudyOptions("synchronous"))["figures"]
            assert {k: row[k] for k in figures} == figures
    looked_at = {0, len(nights) // 2, len(nights) - 1}
    foretold = [remark for remark in told[0]["remarks"] if "cannot be" in remark]
    assert [int(remark.split()[1]) for remark in foretold] == sorted(looked_at & set(never))
    assert all("never dark enough" in text for text in foretold)
    lines = nightglass("study", tmp_path / "study.json", "-o", tmp_path / "b").stdout.split("\n")
    assert f"{len(nights)} points, {len(never)} failed" in lines[0]
    for point in never:
        assert any(f"point {point} failed: sensors.0.field_of_regard" in line for line in lines)


def test_a_study_none_of_whose_points_can_be_is_refused(data: Data, tmp_path: Path) -> None:
    axis = {"field": "sensors.0.observer.latitude_deg", "values": [82.0, 83.0, 85.0]}
    data |= {"start": "2019-06-21T00:00:00Z", "axes": [axis], "sensors": data["sensors"][:1]}
    with pytest.raises(BadInput, match="never dark enough"):
        run_study(data, tmp_path, tmp_path / "out", StudyOptions("synchronous"))
    assert not (tmp_path / "out").exists()


DIES = """
import json, os, signal, sys
from pathlib import Path
from pipeline.capacity import run
from pipeline.spec.study_load import parse_study
file, out, last = Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3])
changes = 0
def die_at_the_last(event, _):
    global changes
    if event in ("os.rename", "os.remove"):
        changes += 1
        if changes == last:
            os.kill(os.getpid(), signal.SIGKILL)
sys.addaudithook(die_at_the_last)
run.page = lambda *_: ""
options = run.StudyOptions("synchronous", resume=out.exists())
run.run_study(json.loads(file.read_text()), file.parent, out, options)
"""


@pytest.mark.slow
@pytest.mark.parametrize("first", [1, 2])
def test_killed_at_any_change_of_its_files_it_goes_on(
    data: Data, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, first: int
) -> None:
    """Each process is killed before one more renaming or removal than the last, until one comes to
    the end: the same tables as of a study that nothing disturbed."""
    monkeypatch.setattr("pipeline.capacity.run.page", lambda *_: "")
    data["catalogue"]["synthetic"]["objects"] = 20
    data["axes"] = [{"field": "sensors.0.count", "values": [1, 2]}]
    (tmp_path / "study.json").write_text(json.dumps(data))
    run_study(data, tmp_path, tmp_path / "whole", StudyOptions("synchronous"))
    command = [sys.executable, "-c", DIES, tmp_path / "study.json", tmp_path / "out"]
    last = first
    while (died := subprocess.run([*command, str(last)], check=False).returncode) != 0:
        assert died == -signal.SIGKILL
        last += 2
    assert last >= first + 4
    whole = sorted(
        p.relative_to(tmp_path / "whole") for p in (tmp_path / "whole").rglob("*.parquet")
    )
    assert len(whole) >= 8
    for name in whole:
        assert pq.read_table(tmp_path / "out" / name) == pq.read_table(tmp_path / "whole" / name)


@pytest.mark.parametrize(
    ("fault", "kind", "told"),
    [(BadInput("sensors", "x", "another"), BadInput, "^sensors: 'x' is .*allowed: another$"),
     (PermissionError(13, "Permission denied", "a"), PermissionError, "Permission denied"),
     (KeyError("gain"), Incomplete, "^KeyError: 'gain'; what is finished is kept$")],
)  # fmt: skip
def test_a_task_that_fails_ends_the_study(
    fault: Exception, kind: type[Exception], told: str, data: Data, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch, without_pictures: None,
) -> None:  # fmt: skip
    """With --resume it goes on from there."""
    data["duration_h"] = 1.0
    with monkeypatch.context() as failing:
        failing.setattr("pipeline.capacity.run.find_candidates", Mock(side_effect=fault))
        with pytest.raises(kind, match=told):
            run_study(data, tmp_path, tmp_path / "out", StudyOptions("synchronous"))
    assert not (tmp_path / "out" / "_COMPLETE").exists()
    run_study(data, tmp_path, tmp_path / "out", StudyOptions("synchronous", resume=True))
    assert (tmp_path / "out" / "_COMPLETE").exists()


def test_where_memory_ends_no_finished_window_is_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is no damage: what is there, of a study or a sweep, stays for the next run."""
    window, part = tmp_path / "a.parquet", tmp_path / "parts" / "part-0000000.parquet"
    part.parent.mkdir()
    points = pa.table({"point": [0], "status": ["done"]})
    for path in (window, part):
        pq.write_table(points, path)
    full = Mock(side_effect=pa.ArrowMemoryError("malloc of size 64 failed"))
    monkeypatch.setattr(pq, "read_table", full)
    with pytest.raises(MemoryError):
        _is_whole(window)
    with pytest.raises(MemoryError):
        PointLedger(tmp_path, points.schema, 1).take_up(retry_failed=False)
    assert window.is_file()
    assert part.is_file()
