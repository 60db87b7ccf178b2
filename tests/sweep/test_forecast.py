"""The forecast of a whole sweep: what it says is shared is what the sweep then draws once."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import pytest

from pipeline.commands import sweep as command
from pipeline.errors import BadInput
from pipeline.route.run import Options
from pipeline.sweep.dependence import light_is_shared
from pipeline.sweep.forecast import forecast_course
from pipeline.sweep.points import scene_of
from pipeline.sweep.run import gather_course, run_course
from pipeline.sweep.stages import stages
from tests.command import nightglass

FRAMES = 2
AXES = [
    {"field": "targets.0.body.albedo", "values": [0.1, 0.2, 0.3]},
    {"field": "background.uniform_mag_arcsec2", "values": [20.0, 21.0]},
    {"field": "sensor.read_noise_e", "values": [2.0, 40.0]},
]
SHARED = [
    (AXES, {"plans": 6, "stars": 1, "targets": 3, "sky": 2}),
    (AXES[2:], {"plans": 1, "stars": 1, "targets": 1, "sky": 1}),
    ([{"field": "exposure.integration_s", "values": [0.2, 0.4]}, AXES[2]],
     {"plans": 2, "stars": 2, "targets": 2, "sky": 2}),
]  # fmt: skip


@pytest.mark.parametrize(("axes", "expected"), SHARED)
def test_what_is_shared_is_drawn_so_often(
    sweep_file: Any, tmp_path: Path, axes: list[Any], expected: dict[str, int]
) -> None:
    """Each different light once for every frame; the time to a factor of 5."""
    course = gather_course(sweep_file(axes, seeds=2), tmp_path / "out")
    told = forecast_course(course)
    assert told["different"] == expected
    drawn = stages(course.run).drawn
    assert not any("light" in stage for stage in drawn)  # nothing was drawn for the forecast
    began = time.process_time()
    report = run_course(course, tmp_path / "out", Options("synchronous"))
    taken = time.process_time() - began
    assert report["failed"] == 0
    assert report["points"] == told["points"]
    assert drawn["stars light"] == expected["stars"]  # both frames share it
    for kind in ("targets", "sky"):
        assert drawn[f"{kind} light"] == FRAMES * expected[kind], kind
    assert told["cpu_s"] / 5.0 <= taken + 3.5 <= told["cpu_s"] * 5.0
    assert told["cpu_s"] < told["alone_cpu_s"]


def test_points_with_detector_extras_share_nothing(sweep_file: Any, tmp_path: Path) -> None:
    file = sweep_file(AXES[2:], {"sensor.detector": {"prnu": 0.01}})
    told = forecast_course(gather_course(file, tmp_path / "out"))
    assert told["different"] == dict.fromkeys(("plans", "stars", "targets", "sky"), 2)


JITTER = {"kind": "white", "rms_arcsec": 2.0, "low_hz": 0.01, "high_hz": 1.0}


@pytest.mark.parametrize(
    ("changes", "shared"),
    [({}, True), ({"sensor.detector": {"prnu": 0.01}}, False),
     ({"pointing.attitude": {"jitter": [JITTER]}}, False)],
)  # fmt: skip
def test_light_that_the_seed_changes_is_not_shared(
    changes: Any, shared: bool, sweep_file: Any, tmp_path: Path
) -> None:
    course = gather_course(sweep_file(AXES[2:], changes), tmp_path / "out")
    assert light_is_shared(scene_of(course, course.design, 0)) is shared


@pytest.mark.parametrize("design", [{"kind": "grid"}, {"kind": "sobol", "points": 8}])
def test_designs_too_large_to_count_are_told_from_their_axes(
    sweep_file: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, design: dict[str, Any]
) -> None:
    """As many as if their points were looked at one by one."""
    many = {"kind": "range", "start": 0.1, "stop": 0.3} | (
        {"count": 3} if design["kind"] == "grid" else {}
    )
    axes = [{"field": AXES[0]["field"], **many}, {"field": AXES[2]["field"], **many}]
    course = gather_course(sweep_file(axes, design=design, seeds=2), tmp_path / "out")
    counted = forecast_course(course)["different"]
    monkeypatch.setattr("pipeline.sweep.forecast.COUNTED", 2)
    assert forecast_course(course)["different"] == counted
    assert (counted["targets"], counted["sky"]) == (3 if "count" in many else 8, 1)


def test_dry_run_on_the_command_line(
    sweep_file: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A page that fits, JSON, nothing written; a sweep that cannot run is refused as ever."""
    monkeypatch.setenv("COLUMNS", "80")
    file, out = sweep_file(AXES), tmp_path / "out"
    said = nightglass("sweep", file, "-o", out, "--dry-run")
    assert said.returncode == 0, said.stderr
    assert "12, each 2 frame(s) of 256 x 256 px" in said.stdout
    assert "6 plans; different light: 1 of stars, 3 of targets, 2 of sky" in said.stdout
    assert all(len(line) <= 80 for line in said.stdout.splitlines())
    told = json.loads(nightglass("sweep", file, "--dry-run", "--json").stdout)
    assert told["points"] == 12
    assert not out.exists()
    bad = nightglass("sweep", sweep_file([{"field": "sensor.gain", "values": [1]}]), "--dry-run")
    assert (bad.returncode, "axes.0" in bad.stderr) == (2, True)


def test_warnings_of_points_are_told_first_and_kept(sweep_file: Any, tmp_path: Path) -> None:
    """A target that fills pixels at the last point alone; and none where nothing is to be told."""
    bright = {"field": "targets.0.body.albedo", "values": [1e-6, 1e-6, 1.0]}
    file = sweep_file([bright], {"sensor.full_well_e": 300.0, "sensor.bias_dn": 500.0})
    said = nightglass("sweep", file, "-o", tmp_path / "out")
    assert said.returncode == 0, said.stderr
    first = said.stdout.splitlines()[0] + said.stderr
    assert "WARNING: point 2: targets:" in first, said.stdout
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    [warning] = report["warnings"]
    assert "fills pixels" in warning
    assert warning.startswith("point 2: ")
    assert "<b>Warning</b>: point 2:" in (tmp_path / "out" / "summary.html").read_text()
    again = nightglass("sweep", file, "-o", tmp_path / "none", "--dry-run")
    assert "WARNING: point 2: targets:" in again.stdout
    dim = sweep_file([bright | {"values": [1e-6, 2e-6]}], {"sensor.bias_dn": 500.0})
    report = run_course(gather_course(dim, tmp_path / "dim"), tmp_path / "dim", Options())
    assert report["warnings"] == []


def test_warnings_of_a_service_are_told_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """And none by one that is too old to tell of any."""
    old = {"points": 2, "seconds": 1.0, "failed": 0, "metrics": {}, "messages": {}}
    for report, first in ((old | {"warnings": ["point 1: bright"]}, "WARNING:"), (old, "")):
        monkeypatch.setattr(command, "run_there", lambda *_, report=report: report)
        command._there(tmp_path, tmp_path, [], "http://there", False, False)
        said = capsys.readouterr()
        assert (said.err + said.out).startswith(first or str(tmp_path))


def test_limits_hold_for_sweeps(
    sweep_file: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """CPU seconds, of which points that share their light count it once; memory, of all points, and
    of one alone, which fails by itself."""
    course = gather_course(sweep_file(AXES, seeds=2), tmp_path / "out")
    told = forecast_course(course)
    least, most = told["cpu_s"], told["alone_cpu_s"]
    assert least < 0.5 * most
    for options, field in (
        (Options("synchronous", most_cpu_s=0.5 * least), "axes"),
        (Options("synchronous", most_memory_mb=100.0), "sensor.shape"),
    ):
        with pytest.raises(BadInput, match=f"{field}.*at most") as refused:
            run_course(course, tmp_path / "out", options)
        assert refused.value.field == field
        assert not (tmp_path / "out").exists()
    sides, own_tiles = [[48, 48], [50, 50], [52, 52], [1024, 1024]], {"output.tile_shape": None}
    courses = [
        gather_course(
            sweep_file([{"field": "sensor.shape", "values": v}], own_tiles), tmp_path / "out"
        )
        for v in (sides, sides[:1], sides[-1:])
    ]
    free = sum(forecast_course(c)["worker_memory_mb"] for c in courses[1:]) / 2.0
    monkeypatch.setattr("pipeline.route.prepare.free_mb", lambda: free)
    options = Options("synchronous", most_cpu_s=1e4)
    report = run_course(courses[0], tmp_path / "out", options)
    assert report["failed"] == 1
    [message] = report["messages"]
    assert f"the {free:.0f} MB of memory" in message
