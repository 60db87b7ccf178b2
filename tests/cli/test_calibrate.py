"""`nightglass calibrate`: a whole product of calibrated frames, and what it refuses."""

from __future__ import annotations

import copy
import json
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits

from pipeline.calibrate import calibrate
from pipeline.errors import BadInput
from pipeline.store.cube import open_cube
from pipeline.store.layout import LONG_NAMES
from pipeline.store.seal import seal
from tests.command import nightglass

SCENE = {
    "schema": "nightglass/scene/1",
    "name": "calibrated",
    "epoch": "2019-07-20T09:00:00Z",
    "observer": {"kind": "fixed", "position_au": [1, 0, 0]},
    "sensor": {
        "shape": [300, 280],
        "pixel_pitch_um": 9.0,
        "focal_length_m": 1.0,
        "aperture_m": 0.4,
        "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
        "psf": {"kind": "gaussian", "sigma_px": 1.0},
        "read_noise_e": 3.0,
        "gain_e_per_dn": 1.5,
        "full_well_e": 50000,
        "flat": "flat.npy",
        "dark_e_per_s": "dark.npy",
        "bias_dn": "bias.npy",
        "detector": {"bad": {"rows": [4], "columns": [7]}, "prnu": 0.01},
    },
    "pointing": {"mode": "sidereal", "boresight_ra_deg": 276.0, "boresight_dec_deg": -3.2},
    "exposure": {"integration_s": 2.0, "frames": 2},
    "background": {"uniform_e_per_s": 400.0},
    "output": {"tile_shape": [256, 256], "layers": ["dn", "calibrated_e"]},
}


@pytest.fixture(scope="module")
def product(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("calibrate")
    rng = np.random.default_rng(0)
    np.save(folder / "flat.npy", rng.uniform(0.5, 1.0, (300, 280)))
    np.save(folder / "dark.npy", rng.uniform(0.0, 50.0, (300, 280)))
    np.save(folder / "bias.npy", rng.uniform(200.0, 400.0, (300, 280)))
    (folder / "scene.json").write_text(json.dumps(SCENE))
    made = nightglass("render", folder / "scene.json", "-o", folder / "run")
    assert made.returncode == 0, made.stderr
    return folder / "run"


@pytest.mark.slow
def test_a_product_of_its_own(product, tmp_path):
    done = nightglass("calibrate", product, "-o", tmp_path / "copy", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["masked_pixels"] == 280 + 300 - 1
    copy_, first = open_cube(tmp_path / "copy"), open_cube(product)
    light = copy_["calibrated_e"].values
    assert np.array_equal(light, first["calibrated_e"].values, equal_nan=True)
    masked = np.zeros((300, 280), bool)
    masked[4] = masked[:, 7] = True
    assert np.array_equal(np.isnan(light[1]), masked)
    assert np.nanmean(light) == pytest.approx(800.0, abs=0.5)  # the sky, of 400 e-/s in 2 s
    assert np.nanstd(light) < 50.0
    assert (copy_["time_mid"].values == first["time_mid"].values).all()
    assert nightglass("check", tmp_path / "copy").returncode == 0
    for kind in ("fits", "png"):
        out = tmp_path / kind
        made = nightglass(
            "export", tmp_path / "copy", "--to", kind, "--layer", "calibrated_e", "-o", out
        )
        assert made.returncode == 0, made.stderr
    with fits.open(tmp_path / "fits" / "frame-00001.fits") as hdus:
        assert hdus[0].header["BUNIT"] == "electron"
        assert hdus[0].header.comments["BUNIT"] == LONG_NAMES["calibrated_e"][0]
        assert np.array_equal(hdus[0].data, light[1], equal_nan=True)


def test_each_frame_is_rid_of_its_own_dark_current(product, tmp_path):
    scene = copy.deepcopy(SCENE)
    scene["sensor"]["shape"] = scene["output"]["tile_shape"] = [64, 64]
    for name in ("flat", "bias_dn"):
        del scene["sensor"][name]
    scene["sensor"]["dark_e_per_s"] = 500.0
    scene["dwells"] = [{"frames": 1, "integration_s": s} for s in (1.0, 5.0)]
    (tmp_path / "scene.json").write_text(json.dumps(scene))
    assert nightglass("render", tmp_path / "scene.json", "-o", tmp_path / "run").returncode == 0
    done = nightglass("calibrate", tmp_path / "run", "-o", tmp_path / "copy", "--json")
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert (told["frames"], told["masked_pixels"]) == (2, 64 + 64 - 1)
    assert told["calibrated_from"] == str(tmp_path / "run")
    light = open_cube(tmp_path / "copy")["calibrated_e"].values
    assert np.nanmean(light, axis=(1, 2)) == pytest.approx([400.0, 2000.0], abs=5.0)


def test_refusals(product, tmp_path):
    (tmp_path / "there").mkdir()
    gone = tmp_path / "gone"
    shutil.copytree(product, gone)
    unfinished = tmp_path / "unfinished"
    shutil.copytree(product, unfinished)
    (unfinished / "_COMPLETE").unlink()
    calibrated = tmp_path / "calibrated"
    assert nightglass("calibrate", product, "-o", calibrated).returncode == 0
    for source, output, word, code in (
        (product, tmp_path / "there", "does not exist yet", 2),
        (product, product / "scene.yaml" / "x", f"a path in a folder; {product / 'scene.yaml'}", 2),
        (product, Path("/dev/null/x"), "a path in a folder; /dev/null is a file", 2),
        (calibrated, tmp_path / "x", "dn", 2),
        (tmp_path / "there", tmp_path / "x", "product", 2),
        (unfinished, tmp_path / "x", "not complete", 3),
        (product, product / "mine", "a path outside of the product", 2),
    ):
        done = nightglass("calibrate", source, "-o", output)
        assert done.returncode == code, done.stderr
        assert word in done.stderr
        assert "Traceback" not in done.stderr
        assert not (tmp_path / "x").exists()
    flat = product.parent / "flat.npy"
    flat.rename(product.parent / "moved.npy")
    try:
        done = nightglass("calibrate", gone, "-o", tmp_path / "x")
    finally:
        (product.parent / "moved.npy").rename(flat)
    assert done.returncode == 2
    assert "sensor.flat" in done.stderr
    assert not list(tmp_path.glob("x*"))


def test_images_are_found_elsewhere_by_their_content(product, tmp_path):
    """Of a product that was moved, by any name; what is not there is named, as is no folder."""
    kept = tmp_path / "kept"
    kept.mkdir()
    (kept / "other.txt").write_text("no image")
    files = [product.parent / f"{name}.npy" for name in ("flat", "dark", "bias")]
    for file in files:
        shutil.copy(file, kept / f"my-{file.name}")
        file.rename(file.with_suffix(".away"))
    try:
        calibrate(product, tmp_path / "copy", kept)
        with pytest.raises(BadInput, match=r"sensor\.bias_dn: .*bias\.npy.*--images DIR with its"):
            calibrate(product, tmp_path / "x")
        with pytest.raises(BadInput, match=r"--images: .*nowhere.*; allowed: a folder"):
            calibrate(product, tmp_path / "x", tmp_path / "nowhere")
        np.save(kept / "my-bias.npy", np.zeros((300, 280)))
        done = nightglass("calibrate", product, "-o", tmp_path / "x", "--images", kept)
    finally:
        for file in files:
            file.with_suffix(".away").rename(file)
    assert done.returncode == 2
    assert "sensor.bias_dn" in done.stderr
    assert not list(tmp_path.glob("x*"))
    light = [open_cube(path)["calibrated_e"].values for path in (tmp_path / "copy", product)]
    assert np.array_equal(*light, equal_nan=True)


@pytest.mark.parametrize("name", ["flat", "bias"])
def test_another_image_than_the_product_was_rendered_with_is_refused(product, tmp_path, name):
    """Its name is told; a product of an earlier version, without a record of it, is calibrated."""
    file = product.parent / f"{name}.npy"
    was = file.read_bytes()
    np.save(file, np.full((300, 280), 0.5))
    try:
        done = nightglass("calibrate", product, "-o", tmp_path / "copy")
        older = tmp_path / "older"
        shutil.copytree(product, older)
        begun = json.loads((older / ".begun.json").read_text())
        del begun["images_sha256"]
        (older / ".begun.json").write_text(json.dumps(begun))
        seal(older, json.loads((older / "report.json").read_text())["content_digest"])
        assert nightglass("calibrate", older, "-o", tmp_path / "other").returncode == 0
    finally:
        file.write_bytes(was)
    assert done.returncode == 2
    assert str(file) in done.stderr
    assert f"sensor.{name}" in done.stderr
    assert not (tmp_path / "copy").exists()


@pytest.mark.parametrize("name", ["report.json", "truth/pixels.parquet", "cube.zarr/zarr.json"])
def test_what_is_damaged_is_not_copied_and_sealed_as_whole(product, tmp_path, name):
    """The file is told; a preview that is gone is drawn anew."""
    damaged = tmp_path / "run"
    shutil.copytree(product, damaged)
    (damaged / "preview.png").unlink()
    assert nightglass("calibrate", damaged, "-o", tmp_path / "whole").returncode == 0
    (damaged / name).write_text("{}")
    done = nightglass("calibrate", damaged, "-o", tmp_path / "copy")
    assert done.returncode == 2
    assert done.stderr.startswith(f"nightglass: {damaged}: damaged: ")
    assert f"{name}: the digest differs" in done.stderr
    assert not (tmp_path / "copy").exists()


BAD = {
    "shape of a map": ({"bad": {"map": "small.npy"}}, ["sensor.detector.bad.map", "(4, 4)"]),
    "NaN map": ({"dead": {"map": "nan.npy"}}, ["sensor.detector.dead.map", "NaN"]),
    "no such map": ({"dead": {"map": "none.zarr"}}, ["sensor.detector.dead.map", "none.zarr"]),
    "a folder": ({"dead": {"map": "empty.zarr"}}, ["sensor.detector.dead.map", "Zarr"]),
    "pixel outside": ({"bad": {"pixels": [[300, 0]]}}, ["sensor.detector.bad.pixels", "300"]),
    "row outside": ({"bad": {"rows": [300]}}, ["sensor.detector.bad.rows", "300"]),
    "negative row": ({"bad": {"rows": [-1]}}, ["sensor.detector.bad.rows", "-1"]),
    "reads too much": ({"bad": {"reads_dn": 65536}}, ["sensor.detector.bad.reads_dn", "65535"]),
    "negative dark": ({"hot": {"pixels": [[1, 1, -5]]}}, ["sensor.detector.hot.pixels", "-5"]),
    "fraction": ({"hot": {"fraction": 1.5}}, ["sensor.detector.hot.fraction", "1.5"]),
    "negative prnu": ({"prnu": -0.1}, ["sensor.detector.prnu", "-0.1"]),
    "unknown key": ({"prnuu": 0.1}, ["sensor.detector.prnuu", "prnu"]),
    "polynomial that turns": (
        {"nonlinearity": {"kind": "polynomial", "coefficients": [-0.6]}},
        ["sensor.detector.nonlinearity.coefficients", "increases"],
    ),
    "table that falls": (
        {"nonlinearity": {"kind": "table", "true_e": [0, 1e4, 6e4], "read_e": [0, 9e3, 8e3]}},
        ["sensor.detector.nonlinearity", "read_e", "monotonic"],
    ),
    "table too short": (
        {"nonlinearity": {"kind": "table", "true_e": [0, 1e4], "read_e": [0, 9e3]}},
        ["sensor.detector.nonlinearity.true_e", "50000"],
    ),
    "tables unlike": (
        {"nonlinearity": {"kind": "table", "true_e": [0, 1e4, 6e4], "read_e": [0, 9e3]}},
        ["sensor.detector.nonlinearity", "read_e", "3"],
    ),
    "amplifiers overlap": (
        {"amplifiers": [{"rows": [0, 9], "columns": [0, 9]}, {"rows": [8, 20], "columns": [8, 9]}]},
        ["sensor.detector.amplifiers", "share no pixel"],
    ),
    "amplifier outside": (
        {"amplifiers": [{"rows": [0, 301], "columns": [0, 9]}]},
        ["sensor.detector.amplifiers", "300"],
    ),
    "amplifier backwards": (
        {"amplifiers": [{"rows": [9, 9], "columns": [0, 9]}]},
        ["sensor.detector.amplifiers", "rows"],
    ),
    "lag": ({"lag": {"fraction": 0.5}}, ["sensor.detector.lag.fraction", "0.5", "0.1"]),
    "rolling shutter": ({"readout": {"kind": "rolling"}}, ["sensor.detector.readout", "line_s"]),
    "rolling shutter key": (
        {"rolling_shutter": {}}, ["sensor.detector.rolling_shutter", "readout"],
    ),
    "rolling shutter of an hour": (
        {"readout": {"kind": "rolling", "line_s": 10}}, ["sensor.detector.readout", "line_s", "1"],
    ),
    "tile of half columns": ({"blooming": True}, ["output.tile_shape", "300"]),
    "tdi that blooms": (
        {"blooming": True, "readout": {"kind": "tdi", "rows_per_s": 1}},
        ["sensor.detector.blooming", "tdi"],
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_bad_detectors(name, tmp_path, capsys):
    """One clear message, exit code 2, nothing written."""
    from pipeline.cli import main

    detector, words = BAD[name]
    data = copy.deepcopy(SCENE)
    for key, value in (("flat", 1.0), ("dark_e_per_s", 0.0), ("bias_dn", 0.0)):
        data["sensor"][key] = value
    data["sensor"]["detector"] = detector
    np.save(tmp_path / "small.npy", np.zeros((4, 4)))
    np.save(tmp_path / "nan.npy", np.full((300, 280), np.nan))
    (tmp_path / "empty.zarr").mkdir()
    (tmp_path / "scene.json").write_text(json.dumps(data))
    with pytest.MonkeyPatch.context() as patch:
        command = ["nightglass", "render", tmp_path / "scene.json", "-o", tmp_path / "run"]
        patch.setattr(sys, "argv", [*map(str, command)])
        with pytest.raises(SystemExit) as exit_:
            main()
    error = capsys.readouterr().err
    assert exit_.value.code == 2, error
    assert "Traceback" not in error
    assert "internal" not in error
    for word in words:
        assert word in error
    assert not (tmp_path / "run").exists()


def test_what_needs_a_full_well(tmp_path, capsys):
    from pipeline.errors import BadInput
    from pipeline.spec.load import parse_scene

    for detector in (
        {"blooming": True}, {"lag": {"fraction": 0.01}},
        {"nonlinearity": {"kind": "polynomial", "coefficients": [0.1]}},
    ):  # fmt: skip
        data = copy.deepcopy(SCENE)
        data["sensor"]["full_well_e"] = None
        data["sensor"]["detector"] = detector
        data["output"] = {}
        with pytest.raises(BadInput, match=r"with sensor\.full_well_e"):
            parse_scene(data)


def test_what_another_has_begun_stays(product, tmp_path):
    other = tmp_path / "copy.partial" / "theirs"
    other.parent.mkdir()
    other.write_text("x")
    with pytest.raises(BadInput, match="left of a calibration cut off"):
        calibrate(product, tmp_path / "copy")
    assert other.read_text() == "x"
