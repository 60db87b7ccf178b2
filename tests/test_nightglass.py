"""`import nightglass`: quick to import, thin over the product, and every error one message."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import nightglass
from catalog_tools.ingest.ingest import ingest
from tests.capacity.conftest import SMALL

ROOT = Path(__file__).resolve().parents[1]
SCENE = {
    "schema": "nightglass/scene/1", "name": "one-target", "epoch": "2019-07-20T09:00:00Z",
    "observer": {"kind": "fixed", "position_au": [0.9, 0.3, 0.1]},
    "sensor": {
        "shape": [64, 48], "pixel_pitch_um": 9.0, "focal_length_m": 1.0, "aperture_m": 0.4,
        "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
        "psf": {"kind": "gaussian", "sigma_px": 1.0}, "read_noise_e": 5.0,
    },
    "pointing": {"mode": "target", "target": "one"},
    "exposure": {"integration_s": 1.0, "frames": 2, "cadence_s": 2.0},
    "targets": [{
        "name": "one", "eclipse": False,
        "orbit": {"kind": "state", "position_m": [4.2e7, 0, 0], "velocity_m_s": [0, 3075, 0]},
        "body": {"kind": "sphere", "diameter_m": 4.0, "albedo": 0.25},
    }],
}  # fmt: skip
COSMIC_RAYS = {"kind": "generated", "rate_per_cm2_s": 50.0}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("door") / "run"
    return nightglass.render(SCENE, folder, scheduler="synchronous")


@pytest.fixture
def copy(made, tmp_path) -> Path:
    return Path(shutil.copytree(made.path, tmp_path / "copy"))


@pytest.fixture(scope="module")
def stars(tmp_path_factory) -> Path:
    """Three stars beside each other, G 9 to 11."""
    folder = tmp_path_factory.mktemp("stars")
    names = "source_id,ref_epoch,ra,dec,parallax,pmra,pmdec,radial_velocity,phot_g_mean_mag,"
    rows = [f"{i},2015.5,{10 + i / 100},20,1,0,0,,{8 + i},{8.4 + i},{7.4 + i}" for i in (1, 2, 3)]
    text = "\n".join([f"{names}phot_bp_mean_mag,phot_rp_mean_mag", *rows]) + "\n"
    (folder / "stars.csv").write_text(text)
    return Path(ingest([folder / "stars.csv"], folder / "catalogue").catalogue.path)


def refused(kind, words, call, *given, **more) -> None:
    """A call raises an error of the product in one line that holds these words."""
    with pytest.raises(kind, match=re.escape(words)) as caught:
        call(*given, **more)
    assert len(str(caught.value).splitlines()) == 1


def test_the_import_is_quick():
    """Under 0.05 s of CPU time, and nothing large is imported."""
    code = "import time; t = time.process_time(); import nightglass; t = time.process_time() - t\n"
    code += "import sys; print(t, *{n.partition('.')[0] for n in sys.modules})"
    took = []
    for _ in range(5):
        line = subprocess.run(
            [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
        ).stdout
        seconds, *modules = line.split()
        took.append(float(seconds))
        assert not {"numpy", "pydantic", "dask", "xarray", "pyarrow", "astropy"} & set(modules)
    assert min(took) < 0.05


def test_nothing_behind_the_door_imports_it():
    for package in ("service", "pipeline", "catalog_tools"):
        for path in (ROOT / package).rglob("*.py"):
            assert not re.search(r"(?m)^\s*(import|from) nightglass\b", path.read_text()), path


def test_the_wheel_holds_it():
    wheel = pytest.importorskip("hatchling.builders.wheel").WheelBuilder(str(ROOT))
    names = {file.distribution_path for file in wheel.recurse_included_files()}
    assert {"nightglass.py", "pipeline/cli.py", "service/main.py"} <= names
    assert not [name for name in names if name.startswith(("tests", "docs"))]


def test_a_scene_from_a_file_a_mapping_or_a_scene(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    given = SCENE | {"stars": {"catalogue": "sky"}}
    scene = nightglass.load_scene(given)
    assert scene.stars.catalogue == str(tmp_path / "sky")
    assert given["stars"] == {"catalogue": "sky"}
    (tmp_path / "scene.yaml").write_text(json.dumps(given))
    assert nightglass.load_scene(tmp_path / "scene.yaml") == scene
    assert nightglass.load_scene("scene.yaml") == scene
    assert nightglass.load_scene(scene) == scene
    louder = nightglass.load_scene(scene, "sensor.read_noise_e=9")
    assert louder == nightglass.load_scene("scene.yaml", ["sensor.read_noise_e=9"])
    assert (louder.sensor.read_noise_e, scene.sensor.read_noise_e) == (9.0, 5.0)


def test_errors_of_a_scene(tmp_path):
    bad = nightglass.BadInput
    refused(bad, "SCENE: ", nightglass.load_scene, tmp_path / "none.yaml")
    refused(bad, "scene: 5 is not accepted", nightglass.load_scene, 5)
    refused(bad, "sensor.read_noise_e", nightglass.load_scene, SCENE, ["sensor.read_noise_e=-1"])
    refused(bad, "did you mean 'exposure'", nightglass.plan, SCENE | {"exposur": {}})
    refused(bad, "sensor.read_noise_e", nightglass.load_scene, SCENE, "sensor.read_noise_e=-1")


def test_a_plan():
    plan = nightglass.plan(SCENE)
    assert (plan["frames"], plan["shape"]) == (2, [64, 48])
    assert plan["outlook"]["targets"][0]["name"] == "one"


def test_a_product(made):
    again = nightglass.open_product(str(made.path))
    assert "cube" not in vars(again)
    assert dict(again.cube["dn"].sizes) == {"frame": 2, "y": 64, "x": 48}
    assert not again.cube["dn"].variable._in_memory
    assert again.report == made.report
    assert again.plan["frames"] == 2
    assert repr(again) == f"<Product {str(made.path)!r}>"


def test_truth_tables_by_name(made):
    truth = made.truth
    assert list(truth) == ["targets"]
    assert len(truth) == 1
    assert "stars" not in truth
    assert truth.get("stars") is None
    assert truth.get("targets").equals(truth["targets"])
    assert truth["targets"]["frame"].to_pylist() == [0, 1]
    assert repr(truth) == "<TruthTables targets>"
    refused(nightglass.BadInput, "truth: 'stars' is not accepted; allowed: targets",
            lambda: truth["stars"])  # fmt: skip


def test_the_truth_has_the_faulty_pixels(tmp_path):
    """Every table that a render writes is among them."""
    sensor = {**SCENE["sensor"], "detector": {"hot": {"pixels": [[3, 5, 80.0]]}}}
    scene = SCENE | {"sensor": sensor, "cosmic_rays": COSMIC_RAYS}
    made = nightglass.render(scene, tmp_path / "run", scheduler="synchronous")
    written = {path.stem for path in (made.path / "truth").glob("*.parquet")}
    assert set(made.truth) == written == {"targets", "cosmic_rays", "pixels"}
    pixels = made.truth["pixels"].to_pylist()
    assert [(p["row"], p["column"], p["fault"]) for p in pixels] == [(3, 5, "hot")]
    assert repr(made.truth) == "<TruthTables targets, cosmic_rays, pixels>"


def test_the_wcs_of_a_frame_gives_the_pixels_of_the_truth(made):
    for row in made.truth["targets"].to_pylist():
        wcs = made.wcs(row["frame"])
        pixel = wcs.world_to_pixel_values(row["ra_deg"], row["dec_deg"])
        assert pixel == pytest.approx((row["x_px"], row["y_px"]), abs=1e-3)
        assert wcs.array_shape == (64, 48)
    assert made.wcs(np.int64(1)).wcs.dateobs.startswith("2019-07-20T09:00:02")


@pytest.mark.parametrize("frame", [2, -1, 0.5, "first", None])
def test_a_frame_that_is_not_there(made, frame):
    refused(nightglass.BadInput, "frame: ", made.wcs, frame)


def test_what_is_no_product(made, copy, tmp_path):
    for path in (tmp_path / "none", tmp_path, "s3://bucket/run", made.path / "plan.json"):
        refused(nightglass.BadInput, "made by `nightglass render`", nightglass.open_product, path)
    for words in ("PRODUCT: 's3://bucket/run' is", "object store is read by xarray"):
        refused(nightglass.BadInput, words, nightglass.open_product, "s3://bucket/run")
    refused(nightglass.BadInput, "product: None", nightglass.open_product, None)
    (copy / "_COMPLETE").unlink()
    refused(nightglass.Incomplete, "not complete", nightglass.open_product, copy)


def test_damaged_files_are_named(copy):
    product = nightglass.open_product(copy)
    (copy / "plan.json").write_text("{")
    (copy / "report.json").unlink()
    (copy / "truth" / "targets.parquet").write_bytes(b"PAR1 and no more")
    refused(nightglass.Damaged, "plan.json: damaged", lambda: product.plan)
    refused(nightglass.Damaged, "report.json: damaged", lambda: product.report)
    refused(nightglass.Damaged, "targets.parquet: damaged", lambda: product.truth["targets"])


def test_a_table_that_finds_no_memory_is_not_told_as_damaged(copy, monkeypatch):
    product, full = nightglass.open_product(copy), pa.ArrowMemoryError("malloc of size 64 failed")
    monkeypatch.setattr(pq, "read_table", Mock(side_effect=full))
    with pytest.raises(MemoryError, match="malloc of size 64"):
        product.truth["targets"]


def test_a_flipped_bit_of_the_truth_is_not_read_as_a_number(copy):
    product, path = nightglass.open_product(copy), copy / "truth" / "targets.parquet"
    place = pq.read_schema(path).get_field_index("electrons")
    column = pq.read_metadata(path).row_group(0).column(place)
    data = bytearray(path.read_bytes())
    data[column.data_page_offset + column.total_compressed_size - 1] ^= 128  # the sign of the last
    path.write_bytes(data)
    refused(nightglass.Damaged, "targets.parquet: damaged", lambda: product.truth["targets"])


def test_where_a_product_cannot_be_made(made):
    bad = nightglass.BadInput
    refused(bad, "does not exist yet", nightglass.render, SCENE, made.path)
    refused(bad, "the path of a folder", nightglass.render, SCENE, "s3://bucket/run")
    refused(bad, "the path of a folder", nightglass.render, SCENE, None)
    seen = []
    again = nightglass.render(SCENE, made.path, resume=True, listen=seen.append)
    assert again.report == made.report
    assert not seen


def test_progress_is_heard(tmp_path):
    seen = []
    nightglass.render(SCENE, tmp_path / "run", scheduler="synchronous", listen=seen.append)
    assert (seen[0].done, seen[-1].done, seen[-1].total) == (0, 2, 2)


def test_a_plain_script_may_draw_by_processes(tmp_path):
    """Without `if __name__ == "__main__"`: each process ran the script again, and drew, too."""
    script, run = tmp_path / "script.py", str(tmp_path / "run")
    script.write_text(
        "import nightglass\nprint('once')\n"
        f"nightglass.render({SCENE!r}, {run!r}, scheduler='processes', workers=2)\n"
    )
    done = subprocess.run([sys.executable, script], cwd=ROOT, capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "once\n", "")
    assert nightglass.open_product(run).report["frames"] == 2


def test_a_calibrated_product_opens_too(made, tmp_path):
    from pipeline.calibrate import calibrate

    calibrate(made.path, tmp_path / "calibrated")
    product = nightglass.open_product(tmp_path / "calibrated")
    assert "dn" not in product.cube
    assert product.wcs(0).to_header() == made.wcs(0).to_header()
    assert product.truth["targets"].equals(made.truth["targets"])


def test_each_wish_of_a_search_is_passed_on():
    scene, wish = ROOT / "examples" / "population.yaml", {"at": "2019-04-20T09:00:00Z"}
    many = wish | {"hours": 72.0, "step_s": 1.0, "least_snr": 2.0}
    refused(nightglass.BadInput, "--step: 1.0 ", nightglass.find, scene, **many)
    found = nightglass.find(scene, **wish, hours=0.1, step_s=60.0, least_snr=1e12)
    assert (found.objects, found.end) == ([], "2019-04-20T09:06:00Z")


def test_a_sweep_from_a_mapping_or_a_file(tmp_path, monkeypatch):
    """The same table; what its points need is found from where each is, and progress is heard."""
    sweep = {"schema": "nightglass/sweep/1", "name": "two", "scene": "base.json",
             "axes": [{"field": "sensor.read_noise_e", "values": [2.0, 8.0]}]}  # fmt: skip
    (tmp_path / "base.json").write_text(json.dumps(SCENE))
    (tmp_path / "sweep.json").write_text(json.dumps(sweep))
    heard = []
    report = nightglass.sweep(tmp_path / "sweep.json", tmp_path / "file", listen=heard.append)
    assert (report["points"], report["failed"], heard[-1].done) == (2, 0, 2)
    monkeypatch.chdir(tmp_path)
    nightglass.sweep(sweep, "mapping", scheduler="synchronous")
    tables = [pq.read_table(tmp_path / n / "points.parquet") for n in ("file", "mapping")]
    digests = [t["content_digest"].to_pylist() for t in tables]
    assert digests[0] == digests[1]
    assert len({*digests[0]}) == 2
    refused(nightglass.BadInput, "does not exist yet", nightglass.sweep, sweep, "mapping")
    assert nightglass.sweep(sweep, "mapping", resume=True)["points"] == 2
    refused(nightglass.BadInput, "the path of a folder", nightglass.sweep, sweep, None)
    refused(nightglass.NightglassError, "axes", nightglass.sweep, sweep | {"axes": 1}, "other")


def test_only_retry_failed_tries_failed_points_again(tmp_path):
    """Of two points one lacks its file at first: going on leaves it as it is."""
    flat = tmp_path / "flat.npy"
    sweep = {"schema": "nightglass/sweep/1", "name": "two", "scene": SCENE,
             "axes": [{"field": "sensor.flat", "values": [1.0, str(flat)]}]}  # fmt: skip
    again = {"sweep": sweep, "out": tmp_path / "out", "scheduler": "synchronous"}
    assert nightglass.sweep(**again)["failed"] == 1
    np.save(flat, np.ones(SCENE["sensor"]["shape"]))
    assert nightglass.sweep(**again, resume=True)["failed"] == 1
    assert nightglass.sweep(**again, retry_failed=True)["failed"] == 0


def test_a_study_from_a_mapping_or_a_file(tmp_path):
    short = SMALL | {"duration_h": 0.5}
    (tmp_path / "study.json").write_text(json.dumps(short))
    heard, options = [], {"scheduler": "synchronous"}
    found = [
        nightglass.study(given, tmp_path / name, **options, listen=heard.append)["figures"]
        for given, name in ((short, "mapping"), (tmp_path / "study.json", "file"))
    ]
    assert found[0] == found[1]
    assert heard[-1].done == heard[-1].total >= 1
    refused(nightglass.BadInput, "the path of a folder", nightglass.study, SMALL, "s3://a/b")


def test_a_cone_of_stars(stars):
    catalogue = nightglass.open_catalogue(str(stars))
    assert catalogue.facts["rows"] == 3
    assert "3 stars" in repr(catalogue)
    found = catalogue.cone(10.01, 20.0, 0.015, columns=["source_id", "ra"])
    assert sorted(found["source_id"].to_pylist()) == [1, 2]
    assert found.column_names == ["source_id", "ra"]
    assert catalogue.cone(10.02, 20.0, 1.0, faintest_g_mag=9.5).num_rows == 1


def test_errors_of_a_catalogue(stars, tmp_path):
    bad = nightglass.BadInput
    refused(bad, "catalogue: ", nightglass.open_catalogue, tmp_path / "none")
    refused(bad, "catalogue: 5", nightglass.open_catalogue, 5)
    catalogue = nightglass.open_catalogue(stars)
    refused(bad, "radius", catalogue.cone, 10.0, 20.0, 200.0)
    refused(bad, "columns: 'colour'", catalogue.cone, 10.0, 20.0, 1.0, columns=["colour"])
    manifest = stars / "nightglass.json"
    text = manifest.read_text()
    manifest.write_text(text[:-20])
    refused(nightglass.Damaged, "nightglass.json: damaged", nightglass.open_catalogue, stars)
    manifest.write_text(text)


def test_times_are_a_path_too_and_others_are_named(tmp_path):
    (tmp_path / "times.txt").write_text("1\n2\n")
    for asked in (tmp_path / "times.txt", str(tmp_path / "times.txt"), [1, 2]):
        assert nightglass.observe(SCENE, asked).table.num_rows == 2
    for wrong in (3, [None]):
        with pytest.raises(nightglass.BadInput, match=r"^times: "):
            nightglass.observe(SCENE, wrong)
