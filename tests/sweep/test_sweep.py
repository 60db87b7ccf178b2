"""Sweeps end to end: rows, failures, resume after a kill, damage, refusals before anything runs."""

from __future__ import annotations

import copy
import hashlib
import json
import math
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from distributed.scheduler import KilledWorker

from catalog_tools.engine.code import code_digest
from catalog_tools.ingest.ingest import ingest
from pipeline.errors import BadInput, DiskFull, Incomplete, TryLater
from pipeline.execute.sources import place_targets
from pipeline.inputs.sensor.sensor import gather_sensor_maps
from pipeline.plan.pointing.geometry import plan_geometry
from pipeline.plan.tiles import Tile
from pipeline.route.prepare import prepare
from pipeline.route.run import Options
from pipeline.spec.load import InvalidScene, parse_scene
from pipeline.spec.sweep import Detection
from pipeline.spec.sweep_load import parse_sweep
from pipeline.store.layout import only_writer
from pipeline.sweep import ledger, run, task
from pipeline.sweep.check import check
from pipeline.sweep.design import Design
from pipeline.sweep.metrics import Measurement, target_windows
from pipeline.sweep.points import scene_of, with_floor
from pipeline.sweep.run import gather_course, point_scene, sweep
from pipeline.sweep.stages import Stages
from pipeline.sweep.summary import _messages, _spread, summarise
from tests.command import nightglass
from tests.service.conftest import SCENE as SMALL

NOISE = {"field": "sensor.read_noise_e", "values": [2.0, 40.0]}
SKY = {"stars": None, "targets": None}  # changes of the scene: the sky alone
TIMES = ("seconds", "light_s")


def table(out):
    return pq.read_table(out / "points.parquet")


def comparable(out):
    return table(out).drop_columns(list(TIMES)).to_pylist()


def test_metrics_follow_the_scene(sweep_file, tmp_path):
    """More read noise: less SNR, a brighter limit, a fainter peak; more light: a higher sky."""
    path = sweep_file([
        {"kind": "table", "fields": ["background.uniform_mag_arcsec2", "sensor.read_noise_e"],
         "rows": [[21.0, 2.0], [21.0, 40.0], [17.0, 2.0]]}])  # fmt: skip
    report = sweep(path, tmp_path / "out", Options("synchronous"))
    low, noisy, bright = table(tmp_path / "out").to_pylist()
    assert report["failed"] == 0
    assert low["snr.ball"] > 1.5 * noisy["snr.ball"] > 0
    assert low["peak_sigma.ball"] > 1.5 * noisy["peak_sigma.ball"]
    assert low["detected_fraction.ball"] == 1.0
    assert low["limiting_g_mag"] > noisy["limiting_g_mag"] + 1.0
    assert bright["sky_e"] == pytest.approx(low["sky_e"] * 10 ** (0.4 * 4.0))
    assert bright["background_e"] == pytest.approx(bright["sky_e"], rel=0.05)
    assert "snr.ball" in (tmp_path / "out" / "summary.html").read_text()
    drawn = ElementTree.parse(tmp_path / "out" / "summary.svg").getroot()
    assert len(list(drawn.iter("{http://www.w3.org/2000/svg}path"))) == 2 * 8
    names = {f.name for f in (tmp_path / "out").iterdir()}
    assert names >= {"points.parquet", "report.json", "summary.html", "sweep.json", "_COMPLETE"}


def test_a_targets_window_holds_its_own_light_alone(scene_data):
    """The response that a target is looked for with is the same with another one beside it."""
    plain = copy.deepcopy(scene_data) | {"stars": None}
    plain["sensor"]["psf"] = {"kind": "gaussian", "sigma_px": 1.0}
    [ball] = plain["targets"]
    beside = copy.deepcopy(ball) | {"name": "beside"}
    beside["orbit"]["position_m"][2] += 2.0

    def window(targets):
        plan = prepare(parse_scene(plain | {"targets": targets})).plan
        g = plan_geometry(plan.scene, np.zeros(1, int), 0.0)
        return target_windows(plan, g, ("ball",), 3.0)

    far = copy.deepcopy(beside) | {"body": ball["body"] | {"diameter_m": 0.8}}
    [(_, alone)], [(_, among)] = window([ball]), window([ball, beside])
    [(_, behind)] = window([far, ball])  # the first, larger on the sky than a pixel
    assert np.array_equal(alone.response, among.response)
    assert np.array_equal(alone.response, behind.response)
    assert alone.response.sum() > 0.9


@pytest.mark.parametrize("way", [(0, 34), (0, -34), (34, 0), (-34, 0), (-34, -33)])
def test_a_targets_response_lies_where_it_is_drawn(way, scene_data):
    """Also in windows that an edge of the frame cuts, by rows, by columns or both."""
    plain = copy.deepcopy(scene_data) | {"stars": None}
    [ball] = plain["targets"]
    place = np.array(ball["orbit"]["position_m"])
    east = np.cross([0.0, 0.0, 1.0], place)
    place += way[0] * east / np.linalg.norm(east) + way[1] * np.array([0.0, 0.0, 1.0])
    ball["orbit"]["position_m"] = place.tolist()
    plan = prepare(parse_scene(plain)).plan
    g = plan_geometry(plan.scene, np.zeros(1, int), 0.0)
    [(_, window)] = target_windows(plan, g, ("ball",), 3.0)
    [ours] = place_targets(plan, g)
    y, x = np.unravel_index(np.argmax(window.response), window.response.shape)
    assert window.place.y0 + window.corner[0] + y == pytest.approx(ours.y_px, abs=0.51)
    assert window.place.x0 + window.corner[1] + x == pytest.approx(ours.x_px, abs=0.51)
    assert min(window.place.y0, window.place.x0) >= 0
    assert max(np.abs(np.array([ours.y_px, ours.x_px]) - 127.5)) > 100.0


@pytest.mark.parametrize(
    ("north_px", "rate_px_s", "seen"),
    [(0, 0, 1), (127, 0, 1), (129, 0, 0), (200, 0, 0), (0, 600, 1), (0, 2400, 0)],
)
def test_a_target_that_is_not_wholly_in_view_has_no_window(north_px, rate_px_s, seen, scene_data):
    """At the frame's edge or beyond it, or with a streak too long to look along."""
    plain = copy.deepcopy(scene_data) | {"stars": None}
    plain["sensor"]["psf"] = {"kind": "gaussian", "sigma_px": 1.0}
    plain["sensor"]["shape"] = [256, 2600]
    plain["pointing"] |= {"mode": "rate", "boresight_dec_deg": 20.0 + north_px * 2.0 / 3600.0,
                          "rate_ra_arcsec_s": 2.0 * rate_px_s,
                          "rate_dec_arcsec_s": 0.0}  # fmt: skip
    plan = prepare(parse_scene(plain)).plan
    g = plan_geometry(plan.scene, np.zeros(1, int), 0.0)
    assert len(target_windows(plan, g, ("ball",), 3.0)) == seen


def test_metrics_of_what_is_never_seen_are_empty(sweep_file, tmp_path):
    """A target outside the frame; noise in which no star of 1e12 electrons is found."""
    axis = {"kind": "table", "fields": ["pointing.boresight_ra_deg", "sensor.read_noise_e"],
            "rows": [[160.0, 5.0], [160.12, 1e9]]}  # fmt: skip
    path = sweep_file([axis], {"accept": ["coverage"], "sensor.flat": 1e-3})
    sweep(path, tmp_path / "out", Options("synchronous"))
    there, gone = table(tmp_path / "out").to_pylist()
    assert [r["message"] for r in (there, gone)] == [None, None]
    assert 1.0 < there["limiting_light_e"] < 1e12
    assert there["limiting_g_mag"] < 20.0
    assert there["frames_in_view.ball"] == 2
    assert there["snr.ball"] > 0.0
    assert (gone["limiting_light_e"], gone["limiting_g_mag"]) == (None, None)
    assert (gone["snr.ball"], gone["frames_in_view.ball"]) == (0.0, 0)
    assert (gone["peak_sigma.ball"], gone["detected_fraction.ball"]) == (None, None)


def test_a_sky_without_sources_and_a_streak_that_noise_hides_have_no_limit(sweep_file, tmp_path):
    """Of 200 px, in a noise in which 1e12 electrons are lost and of which 1e-4 shows."""
    hidden = {
        "sensor.psf": {"kind": "gaussian", "sigma_px": 50.0}, "sensor.aperture_m": 1.0,
        "sensor.read_noise_e": 1e9, "accuracy": {"noise_fraction": 1e-4}, "targets": [],
        "sensor.shape": [64, 64], "exposure.frames": 1, "output": {},
        "pointing.mode": "rate", "pointing.rate_ra_arcsec_s": 800.0,
        "pointing.rate_dec_arcsec_s": 0.0, "accept": ["coverage", "sun", "moon"],
    }  # fmt: skip
    for name, changes in {"dark": {"stars": None, "targets": []}, "hidden": hidden}.items():
        axes = [{"field": "sensor.bias_dn", "values": [300]}]
        path = sweep_file(axes, changes, metrics=["limiting_magnitude", "background"])
        sweep(path, tmp_path / name, Options("synchronous"))
        [row] = table(tmp_path / name).to_pylist()
        assert (row["status"], row["noise_floor_e"] > 5.0) == ("done", True)
        assert (row["limiting_light_e"], row["limiting_g_mag"]) == (None, None)


def test_the_limit_moves_as_stars_do_where_the_scene_has_none(sweep_file, tmp_path):
    """A camera that turns: the same light is needed with a catalogue and without one."""
    turning = {"pointing.mode": "rate", "pointing.rate_ra_arcsec_s": 40.0,
               "pointing.rate_dec_arcsec_s": 0.0}  # fmt: skip
    axes = [{"field": "exposure.integration_s", "values": [0.01, 0.5]}]
    found = []
    for name, more in {"stars": {}, "none": {"stars": None}}.items():
        path = sweep_file(axes, turning | more, metrics=["limiting_magnitude"])
        sweep(path, tmp_path / name, Options("synchronous"))
        found.append([row["limiting_light_e"] for row in table(tmp_path / name).to_pylist()])
    assert found[1] == pytest.approx(found[0], rel=1e-3)
    assert found[1][1] > 1.5 * found[1][0]


def test_metrics_take_each_frames_own_time(sweep_file, tmp_path):
    """Frames of 0.5 and 2 s: every metric is that of its own frame, as of scenes of one time."""
    plain = {"background.uniform_mag_arcsec2": None, "background.uniform_e_per_s": 30.0,
             "sensor.dark_e_per_s": 50.0, "exposure.cadence_s": 4.0}  # fmt: skip
    found = {}
    for name, times in {"both": [0.5, 2.0], "short": 0.5, "long": 2.0}.items():
        changes = plain | {"dwells": [{"integration_s": times}]}
        out = tmp_path / name
        sweep(sweep_file([{"field": "sensor.bias_dn", "values": [300]}], changes), out,
              Options("synchronous"))  # fmt: skip
        [found[name]] = table(out).to_pylist()
    both, short, long = found["both"], found["short"], found["long"]
    assert short["background_e"] == pytest.approx(30.0 * 0.5, rel=0.2)  # with wings of stars
    mean = 0.5 * (short["background_e"] + long["background_e"])
    assert both["background_e"] == pytest.approx(mean, rel=0.01)
    assert long["limiting_g_mag"] > short["limiting_g_mag"] + 0.5
    for name in ("limiting_g_mag", "limiting_light_e", "snr.ball"):
        assert both[name] == pytest.approx(long[name], rel=1e-3), name
    assert both["peak_sigma.ball"] == pytest.approx(long["peak_sigma.ball"], rel=0.2)
    assert (both["noise_floor_e"], both["sky_e"]) == (short["noise_floor_e"], short["sky_e"])


def test_one_failed_point_is_recorded_and_the_rest_go_on(sweep_file, tmp_path):
    """An exposure longer than the cadence is no scene; its row says so."""
    path = sweep_file(
        [{"kind": "table", "fields": ["exposure.integration_s", "exposure.cadence_s"],
          "rows": [[0.5, 1.0], [2.0, 1.0], [0.25, 1.0]]}], SKY)  # fmt: skip
    with pytest.raises(BadInput, match=r"axes.0 \(exposure.cadence_s\)"):
        sweep(path, tmp_path / "refused", Options("synchronous"))  # a value that no point may take
    assert not (tmp_path / "refused").exists()
    path = sweep_file(
        [{"field": "exposure.integration_s", "values": [0.5, 2.0]},
         {"field": "exposure.cadence_s", "values": [3.0, 1.0]}], SKY)  # fmt: skip
    report = sweep(path, tmp_path / "out", Options("threads"))
    rows = table(tmp_path / "out").to_pylist()
    assert [r["status"] for r in rows] == ["done", "done", "done", "failed"]
    assert "exposure.cadence_s" in rows[3]["message"]
    assert rows[3]["exposure.integration_s"] == 2.0
    assert report["failed"] == 1
    assert list(report["messages"].values()) == [1]


def test_a_first_point_that_fails_stops_no_sweep(sweep_file, tmp_path):
    """An accuracy that no plan reaches is a fault of its points, not of the sweep."""
    axis = {"field": "accuracy.noise_fraction", "values": [1e-9, 0.05]}
    sweep(sweep_file([axis]), tmp_path / "out", Options("synchronous"))
    assert [r["status"] for r in table(tmp_path / "out").to_pylist()] == ["failed", "done"]


def test_a_target_too_bright_to_draw_fails_its_points(sweep_file, tmp_path):
    """Found when the first frame is drawn; the second one of those points is left out."""
    axes = [{"field": "targets.0.body.magnitudes", "values": [[-45, -45], [9, 9]]}, NOISE]
    body = {"kind": "light_curve", "times_s": [-10, 10], "magnitudes": [9, 9]}
    ball = json.loads(sweep_file([NOISE]).read_text())["scene"]["targets"][0] | {"body": body}
    small = {"targets": [ball], "accept": ["error"], "stars": None,
             "sensor.psf": {"kind": "gaussian", "sigma_px": 1.0}}  # fmt: skip
    path = sweep_file(axes, small, metrics=["snr", "timing"])
    sweep(path, tmp_path / "out", Options("synchronous"))
    rows = table(tmp_path / "out").to_pylist()
    assert [r["status"] for r in rows] == ["failed", "failed", "done", "done"]
    for row in rows[:2]:
        assert row["message"].startswith("accuracy.noise_fraction: 'a source of ")
        assert (row["content_digest"], row["snr.ball"]) == (None, None)


@pytest.mark.parametrize(
    ("fault", "told"),
    [(PermissionError(13, "Permission denied", "gain.npy"), "gain.npy: Permission denied"),
     (OSError(5, "Input/output error"), "Input/output error"),
     (ZeroDivisionError("by zero"), "internal fault: ZeroDivisionError: 'by zero'"),
     (ValueError("x" * 1000), f"internal fault: ValueError: '{'x' * 100}"),
     (OSError("image file is truncated"), "image file is truncated")],
    ids=["file", "disk", "fault", "long", "library"],
)  # fmt: skip
def test_what_fails_in_a_point_is_told_in_its_row(fault, told, sweep_file, tmp_path, monkeypatch):
    """Whatever it is; the other points go on."""
    tile = task.render_tile

    def fails(plan, *rest):
        if plan.scene.sensor.read_noise_e == 2.0:
            raise fault
        return tile(plan, *rest)

    monkeypatch.setattr(task, "render_tile", fails)
    sweep(sweep_file([NOISE], SKY), tmp_path / "out", Options("synchronous"))
    first, second = table(tmp_path / "out").to_pylist()
    assert first["status"] == "failed"
    assert first["message"].startswith(told)
    assert len(first["message"]) < 500
    assert (second["status"], second["message"]) == ("done", None)


@pytest.mark.parametrize("fault", [OSError(28, "No space left"), DiskFull("out", 28, "empty it")])
def test_a_full_disk_is_no_points_fault(fault, sweep_file, tmp_path, monkeypatch):
    """It ends the sweep, which goes on from there."""

    def fails(*_):
        raise fault

    path, out = sweep_file([NOISE], SKY), tmp_path / "out"
    with monkeypatch.context() as full:
        full.setattr(task, "render_tile", fails)
        with pytest.raises(DiskFull, match=f"{out}: the disk is full .* go on with --resume"):
            sweep(path, out, Options("synchronous"))
    assert sweep(path, out, Options("synchronous", resume=True))["failed"] == 0


def test_points_that_kill_their_processes_are_rows(sweep_file, tmp_path, monkeypatch):
    """A cluster gives up on a task whose workers die: its points are tried one by one."""
    work, asked = run.run_points, []

    def dies(course, numbers):
        asked.append(numbers)
        if 1 in numbers:
            raise KilledWorker("draw", SimpleNamespace(address="tcp://10.0.0.1:4000"), 3)
        return work(course, numbers)

    monkeypatch.setattr(run, "run_points", dies)
    axis = {"field": "sensor.read_noise_e", "values": [2.0, 3.0, 4.0]}
    report = sweep(sweep_file([axis], SKY), tmp_path / "out", Options("synchronous"))
    rows = table(tmp_path / "out").to_pylist()
    assert asked == [(0, 1, 2), (0,), (1,), (2,)]
    assert [r["status"] for r in rows] == ["done", "failed", "done"]
    assert [r["sensor.read_noise_e"] for r in rows] == [2.0, 3.0, 4.0]
    told = "the point's task keeps killing the processes that run it"
    assert report["messages"] == {told: 1}


@pytest.mark.parametrize(
    ("fault", "kind", "told"),
    [(DiskFull("/tmp", 28, "make room"), DiskFull, "make room"),
     (PermissionError(13, "Permission denied", "a"), PermissionError, "Permission denied"),
     (KeyError("gain"), Incomplete, "^KeyError: 'gain'; what is finished is kept$")],
)  # fmt: skip
def test_a_task_that_fails_as_a_whole_ends_the_sweep(
    fault, kind, told, sweep_file, tmp_path, monkeypatch
):
    """What was finished before stays: with --resume the rest is done."""
    axis = {"field": "exposure.integration_s", "values": [0.5, 0.6]}  # a task each
    work, path, out = run.run_points, sweep_file([axis], SKY), tmp_path / "out"

    def fails(course, numbers):
        if 1 in numbers:
            raise fault
        return work(course, numbers)

    with monkeypatch.context() as failing:
        failing.setattr(run, "run_points", fails)
        with pytest.raises(kind, match=told):
            sweep(path, out, Options("synchronous"))
    heard = []
    report = sweep(path, out, Options("synchronous", resume=True), listen=heard.append)
    assert (heard[0].done, heard[-1].done, report["failed"]) == (1, 2, 0)


def test_what_points_share_is_counted_once(sweep_file, tmp_path, monkeypatch):
    """Six points of one drawing, one after the other: together no more than the whole took; half a
    second more for what they share is in their light."""
    look = task._look
    monkeypatch.setattr(task, "_look", lambda *given: time.sleep(0.5) or look(*given))
    axis = {"field": "sensor.read_noise_e", "values": [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]}
    path, began = sweep_file([axis], metrics=["timing"]), time.perf_counter()
    sweep(path, tmp_path / "out", Options("synchronous"))
    taken, found = time.perf_counter() - began, table(tmp_path / "out")
    assert sum(found["seconds"].to_pylist()) < taken
    assert len(set(found["light_s"].to_pylist())) == 1
    assert 0.5 < sum(found["light_s"].to_pylist()) < taken


def test_another_sweep_is_not_gone_on_with(tmp_path):
    known = {"axes": "a", "scene": "b"}
    ledger.begin(tmp_path / "out", known, resume=False)
    ledger.begin(tmp_path / "out", known, resume=True)
    with pytest.raises(BadInput, match="a sweep of the same scene"):
        ledger.begin(tmp_path / "out", known | {"scene": "c"}, resume=True)
    for what in ("sweep", "study"):
        record = tmp_path / "out" / ledger.BEGUN
        record.write_text(json.dumps(json.loads(record.read_text()) | {"code": "0"}))
        with pytest.raises(BadInput, match=f"a {what} of the same code"):
            ledger.begin(tmp_path / "out", known, resume=True, what=what)


def test_what_was_killed_before_its_record_was_whole_is_begun_again(tmp_path):
    out, known = tmp_path / "out", {"axes": "a"}
    with pytest.raises(BadInput, match="a study that was begun before"):
        ledger.begin(out, known, resume=True, what="study")
    assert not out.exists()
    out.write_text("no folder")
    with pytest.raises(BadInput, match="a study that was begun before"):
        ledger.begin(out, known, resume=True, what="study")
    out.unlink()
    for left in ((), ("parts",), ("parts", f".{ledger.BEGUN}.0a.tmp")):
        shutil.rmtree(out, ignore_errors=True)
        out.mkdir()
        for name in left:
            (out / name).write_text("{") if name.endswith("tmp") else (out / name).mkdir()
        with pytest.raises(BadInput, match="does not exist yet"):
            ledger.begin(out, known, resume=False)
        ledger.begin(out, known, resume=True)
        assert json.loads((out / ledger.BEGUN).read_text()) == known | {"code": code_digest()}
    (out / ledger.BEGUN).rename(out / "another")
    with pytest.raises(BadInput, match="a sweep begun by"):
        ledger.begin(out, known, resume=True)


def test_a_sweep_goes_on_with_the_files_that_it_was_begun_with(sweep_file, tmp_path):
    """A flat changed at its path, of the base scene or of an axis: no half of the points each."""
    flat, other = (tmp_path / name for name in ("flat.npy", "other.npy"))
    for path in (flat, other):
        np.save(path, np.ones((256, 256)))
    axes = [{"field": "sensor.flat", "values": ["other.npy", 1.0]},
            {"field": "sensor.psf", "values": [{"kind": "airy"}]}]  # fmt: skip
    wish = sweep_file(axes, {"sensor.flat": "flat.npy"}, metrics=["background"])
    sweep(wish, tmp_path / "out", Options("synchronous"))
    again = Options("synchronous", resume=True)
    for path in (flat, other):
        np.save(path, np.full((256, 256), 0.5))
        with pytest.raises(BadInput, match="a sweep of the same files"):
            sweep(wish, tmp_path / "out", again)
        np.save(path, np.ones((256, 256)))
    assert sweep(wish, tmp_path / "out", again)["points"] == 2


def test_a_sweep_goes_on_with_the_catalogues_that_its_axes_name(sweep_file, tmp_path, catalogue):
    """One made anew at its path after the first points: no half of the points from each."""
    other = tmp_path / "other"
    shutil.copytree(catalogue, other)
    axis = {"field": "stars.catalogue", "values": [catalogue, "other", "nowhere"]}
    path = sweep_file([axis], {"targets": None}, metrics=["background"])
    report = sweep(path, tmp_path / "out", Options("synchronous"))
    assert (report["points"], report["failed"]) == (3, 1)
    again = Options("synchronous", resume=True)
    assert sweep(path, tmp_path / "out", again) == report
    (other / "nightglass.json").rename(other / "away")
    with pytest.raises(BadInput, match=r"stars\.catalogue"):
        sweep(path, tmp_path / "out", again)  # there, but no catalogue: not passed over
    shutil.rmtree(other)
    rows = "source_id,ref_epoch,ra,dec,phot_g_mean_mag\n1,2015.5,160.0,20.0,12.0\n"
    (tmp_path / "one.csv").write_text(rows)
    ingest([tmp_path / "one.csv"], other)
    with pytest.raises(BadInput, match="a sweep of the same files"):
        sweep(path, tmp_path / "out", again)


def test_points_of_a_catalogue_that_was_missing_are_tried_again(sweep_file, tmp_path, catalogue):
    """Be it that of the first point: the others stay as they are."""
    axis = {"field": "stars.catalogue", "values": ["later", catalogue]}
    path = sweep_file([axis], {"targets": None}, metrics=["background"])
    assert sweep(path, tmp_path / "out", Options("synchronous"))["failed"] == 1
    rows = "source_id,ref_epoch,ra,dec,phot_g_mean_mag\n1,2015.5,160.0,20.0,12.0\n"
    (tmp_path / "one.csv").write_text(rows)
    ingest([tmp_path / "one.csv"], tmp_path / "later")
    again = Options("synchronous", resume=True)
    report = sweep(path, tmp_path / "out", again, retry_failed=True)
    assert (report["points"], report["failed"]) == (2, 0)


@pytest.mark.slow
def test_same_table_by_every_scheduler(sweep_file, tmp_path):
    path = sweep_file([NOISE], SKY, seeds=3)
    found = []
    for kind in ("synchronous", "threads", "processes"):
        sweep(path, tmp_path / kind, Options(kind, 2))
        found.append(comparable(tmp_path / kind))
        assert not list((tmp_path / kind).glob(f"{ledger.PARTS}/*"))
    assert found[0] == found[1] == found[2]
    assert [r["point"] for r in found[0]] == list(range(6))


@pytest.mark.slow
def test_killed_at_any_moment_it_goes_on(sweep_file, tmp_path, monkeypatch):
    """Killed twice, then resumed: the same table, and no finished point done again."""
    path, out = sweep_file([NOISE], SKY, seeds=120), tmp_path / "out"
    sweep(path, tmp_path / "whole", Options("threads", 2))
    code = (
        "import sys, pathlib, pipeline.sweep.ledger as l\n"
        "l.PART_S = 0.05\n"
        "from pipeline.route.run import Options\nfrom pipeline.sweep.run import sweep\n"
        "sweep(pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[2]),"
        " Options('threads', 2, resume=pathlib.Path(sys.argv[2]).exists()))\n"
    )
    for k in range(2):
        one = subprocess.Popen([sys.executable, "-c", code, str(path), str(out)])
        end = time.monotonic() + 120
        while len(list(out.glob("parts/part-*.parquet"))) < 2 * (k + 1):
            assert one.poll() is None or (out / ledger.COMPLETE).exists()
            assert time.monotonic() < end
            time.sleep(0.01)
        os.kill(one.pid, signal.SIGKILL)
        one.wait()
    kept = len(list(out.glob("parts/part-*.parquet")))
    broken = sorted(out.glob("parts/part-*.parquet"))[0]
    broken.write_bytes(broken.read_bytes()[:-20])
    with pytest.raises(BadInput, match="--resume"):
        sweep(path, out)
    with pytest.raises(BadInput, match="same axes"):
        sweep(sweep_file([NOISE], SKY, seeds=121), out, Options(resume=True))
    report = sweep(path, out, Options("threads", 2, resume=True))
    assert kept >= 4
    assert [text.split(":")[0] for text in report["parts_damaged"]] == [broken.name]
    assert comparable(out) == comparable(tmp_path / "whole")
    assert sweep(path, out, Options(resume=True)) == report  # nothing left to do


@pytest.mark.parametrize(("points", "taken"), [([0, 2], True), ([-1, 1], False), ([1, 3], False)])
def test_a_part_of_points_that_the_sweep_does_not_have_is_removed(tmp_path, points, taken):
    """Before the first and behind the last of three."""
    (tmp_path / "parts").mkdir()
    part = tmp_path / "parts" / "part-0000004.parquet"
    pq.write_table(pa.table({"point": points, "status": ["done", "failed"]}), part)
    found = ledger.PointLedger(tmp_path, pa.schema([("point", pa.int64())]), 3)
    found.take_up(retry_failed=False)
    assert part.exists() == taken
    assert found.done.tolist() == [taken, False, taken]
    assert found.failed.tolist() == [False, False, taken]
    reason = "part-0000004.parquet: points that the sweep does not have"
    assert found.removed == [reason] * (not taken)


def test_points_are_joined_wherever_their_parts_begin_and_end(tmp_path, monkeypatch):
    """Four at a time: a part ends with the first of the next four, another begins with the last."""
    monkeypatch.setattr(ledger, "JOIN_POINTS", 4)
    (tmp_path / "parts").mkdir()
    schema = pa.schema([("point", pa.int64()), ("x", pa.float64())])
    for k, points in enumerate(([0, 1, 2, 4], [7, 8], [6, 5, 3], [9])):
        rows = pa.table({"point": points, "x": [10.0 * p + k for p in points]}, schema)
        pq.write_table(rows, tmp_path / "parts" / f"part-{k:07d}.parquet")
    ledger.PointLedger(tmp_path, schema, 10).join()
    found = table(tmp_path).to_pydict()
    assert found["point"] == list(range(10))
    assert found["x"] == [0.0, 10.0, 20.0, 32.0, 40.0, 52.0, 62.0, 71.0, 81.0, 93.0]


def test_failed_points_are_tried_again_when_asked(sweep_file, tmp_path):
    """A missing file makes points fail; once it is there, only they are done again."""
    image = tmp_path / "flat.npy"
    np.save(image, np.ones((256, 256)))
    path = sweep_file([{"field": "sensor.flat", "values": [1.0, str(image), 0.9]}], SKY)
    hidden = image.rename(tmp_path / "away.npy")
    report = sweep(path, tmp_path / "out", Options("synchronous"))
    assert report["failed"] == 1
    assert "flat.npy" in next(iter(report["messages"]))
    hidden.rename(image)
    again = Options("synchronous", resume=True)
    report = sweep(path, tmp_path / "out", again, retry_failed=True)
    rows = table(tmp_path / "out").to_pylist()
    assert report["failed"] == 0
    assert [r["status"] for r in rows] == ["done"] * 3
    assert rows[0]["content_digest"] == rows[1]["content_digest"]  # a flat of one is no flat
    np.save(image, np.full((256, 256), 0.5))  # known by now: it may not change any more
    with pytest.raises(BadInput, match="a sweep of the same files"):
        sweep(path, tmp_path / "out", again, retry_failed=True)


BAD = {
    "no such field": ([{"field": "sensor.red_noise_e", "values": [1]}], {}, "sensor.red_noise_e"),
    "bad value": ([{"field": "sensor.read_noise_e", "values": [1, -1]}], {}, "value 1"),
    "text for a number": ([{"field": "exposure.frames", "values": ["x"]}], {}, "exposure.frames"),
    "range beyond the field": (
        [{"field": "sensor.adc_bits", "kind": "range", "start": 8, "stop": 80, "count": 3,
          "integer": True}], {}, "sensor.adc_bits"),
    "no values": ([{"field": "sensor.read_noise_e", "values": []}], {}, "axes.0.values"),
    "twice": ([NOISE, NOISE], {}, "axes.1"),
    "a parent and its child": (
        [NOISE, {"field": "sensor", "values": [{}]}], {}, "axes.1"),
    "the output": ([{"field": "output.layers", "values": [["dn"]]}], {}, "axes.0"),
    "log of zero": (
        [{"field": "sensor.read_noise_e", "kind": "log_range", "start": 0, "stop": 1, "count": 2}],
        {}, "axes.0.start"),
    "whole numbers that doubles do not hold": (
        [{"field": "seed", "kind": "range", "start": 0, "stop": 2**53, "count": 4,
          "integer": True}], {}, "axes.0.stop"),
    "no count": (
        [{"field": "sensor.read_noise_e", "kind": "range", "start": 0, "stop": 1}], {},
        "axes.0.count"),
    "lengths": ([NOISE, {"field": "sensor.bias_dn", "values": [1]}],
                {"design": {"kind": "zip"}}, "axes"),
    "short row": ([{"kind": "table", "fields": ["sensor.bias_dn", "seed"], "rows": [[1]]}], {},
                  "axes.0.rows"),
    "long row": ([{"kind": "table", "fields": ["sensor.bias_dn", "seed"], "rows": [[1, 2, 3]]}], {},
                 "axes.0.rows"),
    "too many": ([{"field": "seed", "kind": "range", "start": 0, "stop": 1, "count": 99999}],
                 {"seeds": 1000}, "axes"),
    "unknown metric": ([NOISE], {"metrics": ["snr", "beauty"]}, "metrics.1"),
    "unknown target": ([NOISE], {"targets": ["moon"]}, "targets.0"),
    "cube beyond": ([NOISE], {"cubes": [2]}, "cubes"),
    "unknown key": ([NOISE], {"axis": []}, "axis"),
    "no design": ([NOISE], {"design": {"kind": "random"}}, "design.kind"),
    "too many to draw": (
        [{"field": f"sensor.{name}", "kind": "range", "start": 1, "stop": 2}
         for name in ("read_noise_e", "gain_e_per_dn", "dark_e_per_s", "flat", "bias_dn")],
        {"design": {"kind": "latin_hypercube", "points": 8_000_001}}, "design.points"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_bad_sweeps_are_named_and_nothing_runs(name, sweep_file, tmp_path):
    axes, rest, field = BAD[name]
    path = sweep_file(axes, **rest)
    with pytest.raises(BadInput) as refused:
        sweep(path, tmp_path / "out")
    mistakes = refused.value.mistakes if isinstance(refused.value, InvalidScene) else None
    text = str(refused.value) if mistakes is None else mistakes[0][0]
    assert field in text, str(refused.value)
    assert len(str(refused.value)) < 2000
    assert not (tmp_path / "out").exists()


def test_more_targets_than_are_measured_are_refused(sweep_file, tmp_path):
    """Unless the sweep names those that it measures, or measures none."""
    [ball] = json.loads(sweep_file([NOISE]).read_text())["scene"]["targets"]
    many = {"stars": None, "targets": [ball | {"name": f"ball-{k}"} for k in range(65)]}
    with pytest.raises(BadInput) as refused:
        sweep(sweep_file([NOISE], many), tmp_path / "out")
    assert str(refused.value) == (
        "targets: '65 targets' is not accepted; "
        "allowed: targets: a list of up to 64 names to measure"
    )
    assert check(gather_course(sweep_file([NOISE], many, targets=["ball-3"]), tmp_path))
    assert check(gather_course(sweep_file([NOISE], many, metrics=["background"]), tmp_path))


def test_a_mistake_of_the_base_scene_is_told_as_its_own(sweep_file, tmp_path):
    """Under the name of its field: no axis is to blame."""
    path = sweep_file([NOISE], {"sensor.adc_bits": 99})
    with pytest.raises(InvalidScene) as refused:
        sweep(path, tmp_path / "out")
    assert [field for field, *_ in refused.value.mistakes] == ["sensor.adc_bits"]


def test_a_mistake_of_an_axis_is_told_before_those_of_the_base(sweep_file, tmp_path):
    path = sweep_file([NOISE | {"values": [-1.0, 2.0]}], {"sensor.adc_bits": 99})
    with pytest.raises(BadInput, match=r"^axes\.0 \(sensor\.read_noise_e\), value 0: -1"):
        sweep(path, tmp_path / "out")


def test_values_that_a_table_does_not_take_are_text():
    plain = [None, True, 3, 2.5, "a"]
    assert [task._plain(value) for value in plain] == plain
    assert task._plain({"b": [1, None], "a": 2.0}) == '{"a": 2.0, "b": [1, null]}'


def test_exit_code_of_a_bad_sweep(sweep_file, tmp_path):
    path = sweep_file([NOISE], {"stars.catalogue": str(tmp_path / "nowhere")})
    result = nightglass("sweep", path, "-o", tmp_path / "out")
    assert result.returncode == 2
    assert "nowhere" in result.stderr
    assert "Traceback" not in result.stderr
    assert not (tmp_path / "out").exists()


def test_point_shows_its_scene(sweep_file):
    path = sweep_file([NOISE])
    result = nightglass("sweep", path, "--point", "1")
    assert result.returncode == 0
    assert "read_noise_e: 40.0" in result.stdout
    assert "noise_floor_e" in result.stdout
    assert json.loads(path.read_text())["scene"]["name"] in result.stdout
    set_ = "--set", "axes.0.values=[7, 9]", "--set", "scene.seed=41"
    result = nightglass("sweep", path, *set_, "--point", "1")
    assert "read_noise_e: 9.0" in result.stdout
    assert "seed: 41" in result.stdout
    result = nightglass("sweep", path, *set_, "--dry-run", "--json")
    assert json.loads(result.stdout)["points"] == 2


def test_points_of_several_seeds_have_seeds_of_their_own(sweep_file, tmp_path):
    """Three seeds for each value: the base's own and the two after it."""
    file = sweep_file([{"field": "sensor.read_noise_e", "values": [5.0, 7.0]}], seeds=3)
    course = gather_course(file, tmp_path / "out")
    scenes = [scene_of(course, course.design, point) for point in range(6)]
    assert [s.seed for s in scenes] == [3, 4, 5, 3, 4, 5]
    assert [s.sensor.read_noise_e for s in scenes] == [5.0] * 3 + [7.0] * 3


def test_background_and_saturation_by_hand():
    """DN less bias, times gain, less dark, over the flat; tiles count by their pixels; full is
    the lesser of the well and the converter's top, and reached when it is met."""
    sensor = {"flat": 0.8, "bias_dn": 100, "gain_e_per_dn": 2.0, "dark_e_per_s": 4.0}
    for well, adc_bits in ((500.0, 16), (90_000.0, 8)):
        more = sensor | {"full_well_e": well, "adc_bits": adc_bits}
        scene = parse_scene(SMALL | {"sensor": SMALL["sensor"] | more})
        plan, maps = prepare(scene).plan, gather_sensor_maps(scene)
        wish = ("background", "saturation")
        measured = Measurement(plan, maps, wish, (), Detection())
        full = {16: 500.0, 8: (255 - 100) * 2.0}[adc_bits]
        mean_e = np.full((4, 8), full - 0.1)
        mean_e[1, 2:5] = full, full, full + 100.0
        measured.take(Tile(0, 0, 0, 0, 4, 8), 0, np.full((4, 8), 150, np.uint16), mean_e)
        measured.take(Tile(0, 1, 0, 8, 4, 4), 0, np.full((4, 4), 200, np.uint16), mean_e[:, :4] * 0)
        row = measured.row()
        first, second = ((dn - 100) * 2.0 - 4.0 * 2.0 for dn in (150, 200))
        assert row["background_e"] == pytest.approx((32 * first + 16 * second) / 48 / 0.8)
        assert row["saturated_fraction"] == 3 / 48


def test_pixels_are_full_by_their_own_gain_and_bias(tmp_path):
    """Of two tiles, each pixel where it is: half a DN below the converter's top, or above it."""
    rows, columns = SMALL["sensor"]["shape"]
    gain, bias = 1.0 + np.arange(rows * columns).reshape(rows, columns) / 7.0, np.eye(rows, columns)
    np.save(tmp_path / "gain.npy", gain)
    np.save(tmp_path / "bias.npy", bias)
    files = {"gain_e_per_dn": str(tmp_path / "gain.npy"), "bias_dn": str(tmp_path / "bias.npy")}
    scene = parse_scene(SMALL | {"sensor": SMALL["sensor"] | files | {"adc_bits": 8}})
    plan, maps = prepare(scene).plan, gather_sensor_maps(scene)
    measured = Measurement(plan, maps, ("saturation",), (), Detection())
    above = np.random.default_rng(2).uniform(size=(rows, columns)) < 0.3
    mean_e = (255.0 - bias + np.where(above, 0.5, -0.5)) * gain
    for x0 in (0, 12):
        cut, tile = np.s_[5:20, x0 : x0 + 12], Tile(0, 0, 5, x0, 15, 12)
        measured.take(tile, 0, np.zeros((15, 12), np.uint8), mean_e[cut])
    assert measured.row()["saturated_fraction"] == above[5:20, :24].mean()


def test_what_makes_two_sweeps_the_same():
    """Every key of the file but its name, each in its own digest; also scene and catalogues."""
    head = {"schema": "nightglass/sweep/1", "name": "d", "scene": "s.yaml"}
    axes = [{"field": "a", "values": [1, 2]}]
    plain = {"axes": axes, "metrics": ["snr", "detection"]}

    def identity(data="x", digests=("c",), files=(), **changes):
        wish = parse_sweep(head | plain | changes)
        return ledger.identity_of(wish, {"a": data}, list(digests), list(files))

    known = identity()
    assert identity(name="other") == known
    for changes, key in (
        ({"axes": [{"field": "a", "values": [1, 3]}]}, "axes"), ({"seeds": 2}, "axes"),
        ({"design": {"kind": "zip"}}, "axes"), ({"metrics": ["snr"]}, "metrics"),
        ({"targets": ["t"]}, "metrics"), ({"detection": {"threshold_sigma": 9.0}}, "metrics"),
        ({"cubes": [1]}, "metrics"), ({"data": "y"}, "scene"), ({"digests": ["e"]}, "catalogues"),
        ({"files": [["sensor.flat", "a.npy", "0"]]}, "files"),
    ):  # fmt: skip
        assert {k for k, v in identity(**changes).items() if v != known[k]} == {key}, changes


def test_a_record_older_than_files_is_gone_on_with_where_there_are_none(tmp_path):
    """Begun before files counted: as then without any, refused with one that nobody looked at."""
    ledger.begin(tmp_path / "out", {"format": ledger.FORMAT}, resume=False)
    ledger.begin(tmp_path / "out", {"format": ledger.FORMAT, "files": []}, resume=True)
    (tmp_path / "out" / ledger.BEGUN).write_text(json.dumps({"format": ledger.FORMAT}))
    one = {"format": ledger.FORMAT, "files": [["sensor.flat", "a.npy", "0"]]}
    with pytest.raises(BadInput, match="a sweep of the same files"):
        ledger.begin(tmp_path / "out", one, resume=True)


def test_the_summary_of_a_large_table_is_of_all_its_pieces(tmp_path):
    """Tables are read 65,536 rows at a time."""
    n = 70_000
    columns = {"message": ["bad"] * (n - 1) + [None], "status": ["failed"] * (n - 1) + ["done"]}
    table = pa.table(columns | {"x": np.arange(float(n))})
    pq.write_table(table, tmp_path / "points.parquet")
    file = pq.ParquetFile(tmp_path / "points.parquet")
    nothing = {"errors": {"as_stated": None, "measured": 0, "doubted": 0}, "doubts": {}}
    assert _messages(file) == {"failed": n - 1, "messages": {"bad": n - 1}} | nothing
    told = {"known": n, "least": 0.0, "mean": (n - 1) / 2, "largest": n - 1.0}
    assert _spread(file, "x") == told


def test_all_failures_count_though_not_all_their_messages_are_listed(tmp_path):
    texts = [f"fault {i}" for i in range(30) for _ in range(1 + (i < 5))]
    rows = {"message": texts, "status": ["failed"] * len(texts)}
    pq.write_table(pa.table(rows), tmp_path / "points.parquet")
    found = _messages(pq.ParquetFile(tmp_path / "points.parquet"))
    assert found["failed"] == 35
    assert list(found["messages"].values()) == [2] * 5 + [1] * 15


def test_the_summary_and_the_seal_by_hand(tmp_path):
    """Least, mean and largest of what is known, failures by message, the commonest first; every
    file sealed."""
    values = [1.0, 2.0, 3.0, 4.0, 5.0]
    wish = parse_sweep({"schema": "nightglass/sweep/1", "name": "d", "scene": "s.yaml",
                        "axes": [{"field": "a", "values": values}]})  # fmt: skip
    failed, messages = ["done", "failed"] * 2 + ["failed"], [None, "rare", None, "bad", "bad"]
    rows = {"point": range(5), "a": values, "seed": [0] * 5, "status": failed, "message": messages,
            "content_digest": ["x"] * 5, "sky_e": [7.0, None, 2.0, None, None]}  # fmt: skip
    pq.write_table(pa.table(rows), tmp_path / "points.parquet")
    doubts = ["G < 9 & more"]
    report = summarise(wish, tmp_path, ("t",), {"seconds": 1.0, "warnings": doubts})
    assert "</b>: G &lt; 9 &amp; more</p>" in (tmp_path / "summary.html").read_text()
    assert report["metrics"] == {"sky_e": {"known": 2, "least": 2.0, "mean": 4.5, "largest": 7.0}}
    assert (report["points"], report["failed"]) == (5, 3)
    assert list(report["messages"].items()) == [("bad", 2), ("rare", 1)]
    (tmp_path / "sweep.json").write_text("{}")
    ledger.seal(tmp_path)
    sealed = json.loads((tmp_path / "_COMPLETE").read_text())["files"]
    found = {p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in tmp_path.iterdir()}
    assert sealed == {name: digest for name, digest in found.items() if name != "_COMPLETE"}
    assert set(sealed) >= {"points.parquet", "report.json", "summary.html", "summary.svg"}


def test_the_quietest_detector_sets_the_floor_of_all_points(sweep_file, tmp_path):
    """An image of 40 e-/s and its scale, or the dark current itself: a scene of 10 e-/s."""
    image = np.full((256, 256), 40.0)
    image[0, :50] = 1e5  # hot pixels are not typical
    np.save(tmp_path / "dark.npy", image)
    dark, floors = "sensor.dark_e_per_s", []
    scaled = SKY | {dark: str(tmp_path / "dark.npy")}
    for field, values, changes, points in (
        ("sensor.dark_scale", [1.0, 0.25], scaled, [0, 1]), (dark, [40.0, 10.0], SKY, [0, 1])
    ):  # fmt: skip
        path = sweep_file([{"field": field, "values": values}], changes)
        floors += [point_scene(path, k).accuracy.noise_floor_e for k in points]
        with pytest.raises(BadInput, match="--point"):
            point_scene(path, 2)
    quiet = gather_course(sweep_file([NOISE], SKY | {dark: 10.0}), Path())
    alone = prepare(parse_scene(quiet.data)).plan.facts.sigma_floor_e
    assert floors == pytest.approx([alone] * 4, rel=1e-12)


def test_the_darkest_sky_sets_the_floor_of_all_points_with_one(sweep_file):
    """A point without sky has the floor of its detector alone."""
    field = "background.uniform_e_per_s"
    plain = {"stars": None, "targets": None, "background": {"uniform_e_per_s": 3.0}}
    path = sweep_file([{"field": field, "values": [None, 5000.0, 3000.0]}], plain)
    none, bright, dark = (point_scene(path, k).accuracy.noise_floor_e for k in range(3))
    assert none == pytest.approx(math.sqrt(5.0**2 + 2.0 * 0.5 + 2.0**2 / 12.0), rel=1e-6)
    assert bright == dark == pytest.approx(math.sqrt(none**2 + 3000.0 * 0.5), rel=1e-6)


def test_a_flat_above_one_lowers_the_floor_of_the_light(sweep_file, tmp_path):
    """Errors of the light come through it as the light does; one that is not there is its own
    points' alone."""
    noise = {"stars": None, "background": None, "sensor.dark_e_per_s": 0.0}
    alone = math.hypot(5.0, 2.0 / math.sqrt(12.0))
    path = sweep_file([{"field": "sensor.flat", "values": [0.5, 4.0, 2.0]}], noise)
    floors = [point_scene(path, k).accuracy.noise_floor_e for k in range(3)]
    assert floors == pytest.approx([alone / 4.0] * 3, rel=1e-9)  # the largest is that of all
    np.save(tmp_path / "flat.npy", np.full((256, 256), 3.0))
    flat = noise | {"sensor.flat": str(tmp_path / "flat.npy")}
    path = sweep_file([{"field": "sensor.bias_dn", "values": [100, 200]}], flat)
    course, kept = gather_course(path, Path()), Stages(1e9)
    scene, base = with_floor(course, kept, scene_of(course, Design(course.sweep), 1))
    assert scene.accuracy.noise_floor_e is None
    assert base.plan.facts.light_floor_e == pytest.approx(alone / 3.0, rel=1e-9)
    axis = {"field": "sensor.flat", "values": [1.0, str(tmp_path / "none.npy")]}
    assert point_scene(sweep_file([axis], noise), 0).accuracy.noise_floor_e is None


def test_a_floor_that_the_scene_states_stays(sweep_file):
    """Whatever the axes vary: it is the user's own."""
    path = sweep_file([NOISE], SKY | {"accuracy": {"noise_floor_e": 3.25}})
    assert [point_scene(path, k).accuracy.noise_floor_e for k in (0, 1)] == [3.25, 3.25]


def test_light_that_is_not_shared_is_each_points_own(sweep_file, tmp_path):
    """Where jitter moves the pointing with the seed: skies of 10 and of 1,000 electrons."""
    jitter = [{"kind": "white", "rms_arcsec": 2.0, "low_hz": 0.01, "high_hz": 1.0}]
    sky = {"background.uniform_mag_arcsec2": None, "background.uniform_e_per_s": 1.0}
    axis = {"field": "background.uniform_e_per_s", "values": [10.0, 1000.0]}
    path = sweep_file([axis], SKY | sky | {"pointing.attitude": {"jitter": jitter}},
                      metrics=["background"])  # fmt: skip
    sweep(path, tmp_path / "out", Options("synchronous"))
    exposed_s = [point_scene(path, k).exposure.integration_s for k in (0, 1)]
    skies = [row["background_e"] for row in table(tmp_path / "out").to_pylist()]
    assert skies == pytest.approx([10.0 * exposed_s[0], 1000.0 * exposed_s[1]], rel=0.2)


def test_background_undoes_what_the_detector_does():
    """Rounding down by half a DN, a response that bends, a bad column and a dead flat."""
    sensor = {"flat": 0.8, "bias_dn": 100, "gain_e_per_dn": 20.0, "dark_e_per_s": 4.0,
              "full_well_e": 90_000.0, "adc_bits": 16, "adc_rounding": "floor",
              "detector": {"nonlinearity": {"kind": "polynomial", "coefficients": [-0.2]},
                           "bad": {"columns": [3], "reads_dn": 60_000}}}  # fmt: skip
    scene = parse_scene(SMALL | {"sensor": SMALL["sensor"] | sensor})
    plan, maps = prepare(scene).plan, gather_sensor_maps(scene)
    measured = Measurement(plan, maps, ("background",), (), Detection())
    light_e, time_s = 30_000.0, 2.0
    charge_e = light_e * 0.8 + 4.0 * time_s
    read_e = charge_e * (1.0 - 0.2 * charge_e / 90_000.0)
    dn = np.full((4, 8), math.floor(read_e / 20.0 + 100.0), np.uint16)
    dn[:, 3] = 60_000
    measured.take(Tile(0, 0, 0, 0, 4, 8), 0, dn, np.full((4, 8), charge_e))
    step_e = 20.0 / (0.8 * (1.0 - 0.4 * charge_e / 90_000.0))  # of one DN
    assert measured.row()["background_e"] == pytest.approx(light_e, abs=0.51 * step_e)


def test_metrics_of_targets_that_an_axis_brings(sweep_file, scene_data, tmp_path):
    """Also of those that the first point does not have; of a name twice nothing is begun."""
    ball = scene_data["targets"][0]
    axis = {"field": "targets", "values": [[ball], [ball | {"name": "other"}], [ball]]}
    out = tmp_path / "out"
    run.sweep(sweep_file([axis], metrics=["snr"]), out, Options("synchronous"))
    rows = pq.read_table(out / "points.parquet").to_pylist()
    assert [row["snr.ball"] is None for row in rows] == [False, True, False]
    assert rows[1]["snr.other"] == rows[0]["snr.ball"]
    with pytest.raises(BadInput, match=r"targets: .* each name once"):
        run.sweep(sweep_file([axis], targets=["ball", "ball"]), out)


def test_paths_in_mappings_of_axes_stay_as_they_are_written(sweep_file, tmp_path):
    """What one point makes of a value is not the value of the axis."""
    (tmp_path / "band.csv").write_text("wavelength_nm,transmission\n400,0.5\n900,0.5\n")
    band = {"kind": "table", "path": "band.csv"}
    axis = {"field": "sensor.bandpass", "values": [band]}
    out = tmp_path / "out"
    run.sweep(sweep_file([axis], metrics=["background"]), out, Options("synchronous"))
    (row,) = pq.read_table(out / "points.parquet").to_pylist()
    assert json.loads(row["sensor.bandpass"]) == band


def test_another_writer_is_one_of_the_sweep(sweep_file, tmp_path):
    """With no word of an option that sweeps do not have."""
    out = tmp_path / "out"
    asked = sweep_file([{"field": "seed", "values": [1]}], metrics=["background"])
    run.sweep(asked, out, Options("synchronous"))
    with only_writer(out), pytest.raises(TryLater) as told:
        run.sweep(asked, out, Options("synchronous", resume=True))
    assert str(told.value) == f"{out}: another run is writing this sweep now"
