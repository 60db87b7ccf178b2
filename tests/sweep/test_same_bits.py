"""Points that share stages have the bits of each point alone, and pay only for what differs."""

from __future__ import annotations

import json
from dataclasses import fields
from types import SimpleNamespace

import numpy as np
import pyarrow.parquet as pq
import pytest

from pipeline.execute.tile import tile_light
from pipeline.inputs.sensor.sensor import gather_sensor_maps
from pipeline.plan.accuracy import INSTEAD
from pipeline.plan.pointing.geometry import plan_geometry
from pipeline.route.prepare import plan_scene
from pipeline.route.run import Options, render
from pipeline.spec.load import parse_scene
from pipeline.store.product import content_digest
from pipeline.sweep.dependence import NEUTRAL
from pipeline.sweep.run import gather_course, point_scene, sweep
from pipeline.sweep.stages import Stages, _read_key, maps_of, stages
from pipeline.sweep.task import run_points
from tests.command import nightglass
from tests.slow import slow

SPHERE = "targets.0.body.albedo"
CASES = {
    "detector": [
        {"field": "sensor.read_noise_e", "values": [2.0, 9.0]},
        {"field": "sensor.gain_e_per_dn", "values": [1.5, 3.0]},
        {"field": "sensor.full_well_e", "values": [None, 3000.0]},
    ],
    "sky": [{"field": "background.uniform_mag_arcsec2", "values": [19.0, 21.5]},
            {"field": "sensor.dark_e_per_s", "values": [0.0, 40.0]}],
    "target": [{"field": SPHERE, "values": [0.1, 0.6]},
               {"field": "sensor.bias_dn", "values": [100, 900.5]}],
    "time": [{"field": "exposure.integration_s", "values": [0.5, 1.0]}],
    "flat": [{"field": "sensor.flat", "values": [1.0, 3.0]}],
    "optics": [{"kind": "table", "fields": ["sensor.aperture_m", "stars.faintest_g_mag"],
                "rows": [[0.1, 15.0], [0.12, 14.0], [0.1, 14.0]]}],
}  # fmt: skip


def rows_of(path, out, **options):
    sweep(path, out, Options(**({"scheduler": "synchronous"} | options)))
    return pq.read_table(out / "points.parquet").to_pylist()


@pytest.mark.parametrize("case", [slow(c) if c in ("detector", "optics") else c for c in CASES])
def test_same_bits_as_each_point_alone(case, sweep_file, tmp_path):
    """Also by other schedulers, and by the cube that is kept of a point."""
    path = sweep_file(CASES[case], cubes=[1])
    rows = rows_of(path, tmp_path / "swept", scheduler="threads", workers=2)
    assert [r["message"] for r in rows] == [None] * len(rows)
    assert len({r["content_digest"] for r in rows}) == len(rows)
    for row in rows[1::3] if case == "detector" else rows[1:3]:  # the first shares nothing yet
        alone = tmp_path / f"alone-{row['point']}"
        render(point_scene(path, row["point"]), alone, Options("synchronous"))
        assert content_digest(alone) == row["content_digest"]
    assert content_digest(tmp_path / "swept" / "cubes" / "0000001") == rows[1]["content_digest"]


@pytest.mark.parametrize("more", [{}, {"stars": None}], ids=["stars", "targets alone"])
def test_what_a_point_may_err_by_stands_beside_its_time(more, sweep_file, tmp_path):
    """As in the plan of its scene alone, with what its product finds; more where it is allowed."""
    asked = [0.003, 0.3]
    axis = {"field": "accuracy.noise_fraction", "values": asked}
    path = sweep_file([axis], more, metrics=["timing"])
    rows = rows_of(path, tmp_path / "swept")
    for row, most in zip(rows, asked, strict=True):
        told = plan_scene(point_scene(path, row["point"]))["decisions"]
        bounds = [d["error_bound_sigma"] for d in told if d["component"] not in INSTEAD]
        assert row["error_bound_sigma"] == pytest.approx(sum(b or 0.0 for b in bounds))
        assert 0.0 < row["error_bound_sigma"] <= most
        scene = point_scene(path, row["point"])
        alone = render(scene, tmp_path / str(most), Options("synchronous"))
        found = alone["errors"]["achieved_error_sigma"]
        assert row["achieved_error_sigma"] == pytest.approx(found, rel=1e-3)
        assert 0.0 < found <= row["error_bound_sigma"]
    assert rows[1]["error_bound_sigma"] > 3.0 * rows[0]["error_bound_sigma"]


def test_what_a_point_may_err_by_grows_with_its_flat(sweep_file, tmp_path):
    """Bound and error of the light that points share are told after each one's flat."""
    axis = {"field": "sensor.flat", "values": [0.5, 5.0]}
    path = sweep_file([axis], {"background": None}, metrics=["timing"])
    for row in rows_of(path, tmp_path / "swept"):
        scene = point_scene(path, row["point"])
        alone = render(scene, tmp_path / str(row["point"]), Options("synchronous"))["errors"]
        found, bound = row["achieved_error_sigma"], row["error_bound_sigma"]
        assert 0.0 < alone["achieved_error_sigma"] <= found <= bound <= alone["asked_sigma"]


def test_snr_of_points_that_share_light_is_that_of_each_ones_flat(sweep_file, tmp_path):
    """As in the truth of each alone: a tenth of the light has a third of the SNR, or less."""
    axis = {"field": "sensor.flat", "values": [1.0, 0.1]}
    path = sweep_file([axis], {"stars": None, "exposure.frames": 1}, metrics=["snr"])
    found = []
    for row in rows_of(path, tmp_path / "swept"):
        alone = tmp_path / str(row["point"])
        render(point_scene(path, row["point"]), alone, Options("synchronous"))
        truth = pq.read_table(alone / "truth" / "targets.parquet")["snr"].to_pylist()
        assert [row["snr.ball"]] == pytest.approx(truth, rel=1e-6)
        found += truth
    assert found[0] > 3.0 * found[1] > 0.0


@pytest.mark.parametrize("detector", [None, {"prnu": 0.01}], ids=["shared light", "own light"])
def test_light_that_errs_by_more_than_was_stated_is_told(
    detector, sweep_file, tmp_path, monkeypatch
):
    """In its rows, the report, the page and the terminal, with exit code 5; checked once for all
    points that share it. Nothing is checked where nothing of it is told."""
    axis = {"field": "sensor.read_noise_e", "values": [5.0, 9.0]}
    more = {"sensor.detector": detector, "exposure.frames": 1}
    path = sweep_file([axis], more, metrics=["timing"])

    def drawn(*arguments):
        light = tile_light(*arguments)
        return {name: image * 1.01 for name, image in light.items()}

    monkeypatch.setattr("pipeline.sweep.stages.tile_light", drawn)
    kept = Stages(1e9)
    monkeypatch.setattr("pipeline.sweep.task.stages", lambda run: kept)
    out = tmp_path / "out"
    done = nightglass("sweep", path, "-o", out, "--scheduler", "synchronous")
    rows = pq.read_table(out / "points.parquet").to_pylist()
    assert (done.returncode, [row["status"] for row in rows]) == (5, ["done", "done"])
    for row in rows:
        assert row["achieved_error_sigma"] > 2.0 * row["error_bound_sigma"]
        assert f"err by {row['achieved_error_sigma']:.3g} of their noise" in row["message"]
    report = json.loads((out / "report.json").read_text())
    assert report["errors"] == {"as_stated": False, "measured": 2, "doubted": 2}
    assert sorted(report["doubts"]) == sorted({row["message"] for row in rows})
    assert (report["failed"], report["messages"]) == (0, {})
    assert "pixels were found to err" in " ".join(done.stdout.split())
    assert "Warning</b>: " in (out / "summary.html").read_text()
    assert kept.drawn["check"] == (1 if detector is None else 2)
    less = sweep_file([axis], more, metrics=["background"])
    assert nightglass("sweep", less, "-o", tmp_path / "less").returncode == 0
    assert kept.drawn["check"] == (1 if detector is None else 2)


def test_light_is_checked_frame_by_frame(sweep_file, tmp_path, monkeypatch):
    """What is found in the first frame does not stand for a later one."""

    def drawn(plan, g, *others):
        light = tile_light(plan, g, *others)
        return {name: image + 10.0 * g.frame[0] for name, image in light.items()}

    monkeypatch.setattr("pipeline.sweep.stages.tile_light", drawn)
    axis = {"field": "sensor.read_noise_e", "values": [5.0]}
    path = sweep_file([axis], {"exposure.frames": 2}, metrics=["timing"])
    (row,) = rows_of(path, tmp_path / "out")
    assert row["achieved_error_sigma"] > 2.0 * row["error_bound_sigma"]


@pytest.mark.parametrize(
    "more",
    [{"cosmic_rays": {"kind": "generated", "rate_per_cm2_s": 2000.0}},
     {"sensor.detector": {"lag": {"fraction": 2e-4}}, "exposure.frames": 3},
     {"pointing.attitude": {"jitter": [
         {"kind": "white", "rms_arcsec": 2.0, "low_hz": 0.01, "high_hz": 1.0}]}}],
    ids=["cosmic rays", "lag", "jitter"],
)  # fmt: skip
def test_same_rows_with_seeds(more, sweep_file, tmp_path):
    """Random parts follow the seed of each point, and charge the frames before it; the light of
    all seeds is one, but where the seed moves the pointing."""
    path = sweep_file([{"field": "sensor.read_noise_e", "values": [3.0]}], more, seeds=2)
    rows = rows_of(path, tmp_path / "swept")
    assert [r["seed"] for r in rows] == [3, 4]
    render(point_scene(path, 1), tmp_path / "alone", Options("synchronous"))
    assert content_digest(tmp_path / "alone") == rows[1]["content_digest"]


def test_same_rows_however_a_frame_is_cut(sweep_file, tmp_path):
    """Six tiles that are not alike, the target on a border: one tile's bits and metrics."""
    axis, rows = [{"field": "sensor.read_noise_e", "values": [2.0, 9.0]}], []
    for k, tile in enumerate(([256, 256], [300, 520])):
        more = {"sensor.shape": [300, 520], "sensor.full_well_e": 2000.0, "exposure.frames": 1}
        path = sweep_file(axis, more | {"output.tile_shape": tile})
        rows.append(rows_of(path, tmp_path / f"swept-{k}"))
    render(point_scene(path, 1), tmp_path / "alone", Options("synchronous"))
    assert content_digest(tmp_path / "alone") == rows[0][1]["content_digest"]
    for cut, whole in zip(*rows, strict=True):
        assert cut.pop("background_e") == pytest.approx(whole.pop("background_e"), rel=0.02)
        others = [name for name in cut if name not in ("seconds", "light_s")]
        assert [cut[name] for name in others] == [whole[name] for name in others]
        assert 0.0 < cut["saturated_fraction"] < 0.01
        assert cut["detected_fraction.ball"] == 1.0


def _rows_key(**changes):
    stars = {"faintest_g_mag": None, "space_motion": True} | changes.pop("stars", {})
    plan = {"colour": "fit", "facts": SimpleNamespace(area_m2=changes.pop("area_m2", 1.0))}
    plan |= {k: changes.pop(k) for k in ("colour",) if k in changes}
    catalogues = [SimpleNamespace(digest=d) for d in changes.pop("digests", ["a", "b"])]
    prepared = SimpleNamespace(catalogues=catalogues, left_out=changes.pop("left_out", ()))
    assert not changes
    scene = SimpleNamespace(stars=SimpleNamespace(**stars))
    return _read_key(SimpleNamespace(prepared=prepared), SimpleNamespace(scene=scene, **plan))


def test_rows_of_stars_are_those_of_all_that_is_read():
    """The rows of a shard are shared by points whose catalogue, limit, colour and light agree."""
    keys = [
        _rows_key(),
        _rows_key(digests=["a", "c"]),
        _rows_key(left_out=(1,)),
        _rows_key(stars={"faintest_g_mag": 15.0}),
        _rows_key(stars={"space_motion": False}),
        _rows_key(colour="another"),
        _rows_key(area_m2=2.0),
    ]
    assert len(set(keys)) == len(keys)
    assert _rows_key() == keys[0]


def test_maps_of_the_detector_are_those_of_each_point(scene_data, tmp_path):
    """Points that share all but one of a sensor's numbers have maps of their own."""
    np.save(tmp_path / "dark.npy", np.full((256, 256), 4.0))
    sensor = scene_data["sensor"] | {"dark_e_per_s": str(tmp_path / "dark.npy")}
    kept = Stages(1e8)
    for change in (
        {"adc_bits": 12}, {"flat": 0.9}, {"dark_e_per_s": 7.0}, {"dark_scale": 3.0},
        {"read_noise_e": 1.0}, {"gain_e_per_dn": 1.5}, {"bias_dn": 5.0},
    ):  # fmt: skip
        scene = parse_scene(scene_data | {"sensor": sensor | change})
        maps, alone = maps_of(kept, None, scene), gather_sensor_maps(scene)
        for field in fields(alone):
            name = field.name
            assert np.array_equal(getattr(maps, name), getattr(alone, name)), (change, name)
    assert kept.drawn["sensor maps"] == 7


def test_frames_far_into_a_sweep_have_their_own_geometry(scene_data, monkeypatch):
    """It is worked out for some frames at once; those of the next lot are others."""
    monkeypatch.setattr("pipeline.sweep.stages.FRAMES_AHEAD", 2)
    exposure = {"integration_s": 0.5, "frames": 5, "cadence_s": 60.0}
    scene = parse_scene(scene_data | {"exposure": exposure, "stars": None, "accept": ["sun"]})
    kept = Stages(1e8)
    base = kept.base(scene)
    every = plan_geometry(base.plan.scene, np.arange(5), base.plan.dut1_s)
    for frame in (0, 4, 1, 3, 2):
        ours, theirs = kept.geometry(base, frame), every.frame_slice(frame)
        assert int(ours.frame[0]) == frame
        assert np.array_equal(ours.target_light, theirs.target_light)


def test_same_bits_whatever_the_detector_is(sweep_file, tmp_path):
    """Light is drawn with neutral values of all that acts on it later; here none is neutral."""
    odd = {"flat": 0.9, "dark_e_per_s": 7.0, "full_well_e": 900.0,
           "read_noise_e": 4.0, "gain_e_per_dn": 1.7, "bias_dn": 55.0, "adc_bits": 12,
           "adc_rounding": "floor", "photon_noise": False}  # fmt: skip
    assert all(odd[name] != NEUTRAL[name] for name in odd)
    more = {f"sensor.{name}": value for name, value in odd.items()} | {"exposure.frames": 1}
    path = sweep_file([{"field": SPHERE, "values": [0.3]}], more)
    [row] = rows_of(path, tmp_path / "swept")
    render(point_scene(path, 0), tmp_path / "alone", Options("synchronous"))
    assert content_digest(tmp_path / "alone") == row["content_digest"]


def drawn(path, tmp_path, numbers) -> dict[str, int]:
    """How often each stage is computed for some points."""
    course = gather_course(path, tmp_path / "out")
    kept = stages(course.run)
    kept.drawn.clear()
    rows = run_points(course, numbers)
    assert [r["message"] for r in rows] == [None] * len(rows)
    return dict(kept.drawn)


def test_only_what_differs_is_drawn(sweep_file, tmp_path):
    """Two frames of one tile, which share their stars: each kind of light once for each of its
    own values."""
    path = sweep_file(CASES["detector"])
    found = drawn(path, tmp_path, tuple(range(8)))
    assert found["plan"] == 2  # one that sets the noise floor, one planned for it
    assert (found["stars light"], found["targets light"], found["sky light"]) == (1, 2, 2)
    found = drawn(sweep_file(CASES["sky"]), tmp_path, (0, 1, 2, 3))
    assert (found["stars light"], found["targets light"], found["sky light"]) == (1, 2, 4)
    found = drawn(sweep_file(CASES["target"]), tmp_path, (0, 1, 2, 3))
    assert (found["stars light"], found["targets light"], found["sky light"]) == (1, 4, 2)
    assert found["star rows"] == 1
    found = drawn(sweep_file(CASES["optics"]), tmp_path, (0, 1, 2))
    assert (found["stars light"], found["star rows"]) == (3, 3)


@pytest.mark.parametrize(("metrics", "known"), [(["timing"], True), (["saturation"], None)])
def test_errors_that_no_point_measured_are_not_said_to_be_as_stated(
    metrics, known, sweep_file, tmp_path
):
    """The light is drawn again where time is told, as that is what it is spent for."""
    axis = {"field": "sensor.read_noise_e", "values": [5.0, 9.0]}
    path = sweep_file([axis], {"exposure.frames": 1}, metrics=metrics)
    errors = sweep(path, tmp_path / "out", Options("synchronous"))["errors"]
    assert errors == {"as_stated": known, "measured": 2 if known else 0, "doubted": 0}
