"""A bright list layered over a deep catalogue: each star once, the same bits everywhere."""

from __future__ import annotations

import copy
import json
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from catalog_tools.columns import INCOMING
from catalog_tools.geometry.sphere import angles_deg, moved
from catalog_tools.ingest import shards
from catalog_tools.ingest.build import About, build
from pipeline.errors import BadInput
from pipeline.resolve.resolve import resolve
from pipeline.route.prepare import plan_scene, prepare
from pipeline.route.run import Options, render
from pipeline.spec.load import load_scene, parse_scene, scene_yaml
from pipeline.store.cube import open_cube
from pipeline.store.product import check
from tests.command import nightglass
from tests.slow import slow

LAYER_JYEAR, MAIN_JYEAR = 1991.25, 2015.5
COLUMNS = ("source_id", "ra", "dec", "pmra", "pmdec", "phot_g_mean_mag")
SCENE = {
    "schema": "nightglass/scene/1", "name": "layered", "epoch": "2019-10-20T05:42:30Z", "seed": 4,
    "observer": {"kind": "fixed", "position_au": [0.9, 0.4, 0.1], "velocity_m_s": [0, 2.9e4, 0]},
    "sensor": {
        "shape": [512, 512], "pixel_pitch_um": 11.0, "focal_length_m": 0.25, "aperture_m": 0.05,
        "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
        "psf": {"kind": "airy", "jitter_px": 0.4}, "read_noise_e": 5.0, "adc_bits": 24,
    },
    "pointing": {
        "mode": "rate", "boresight_ra_deg": 101.0, "boresight_dec_deg": 30.0,
        "rate_ra_arcsec_s": 20.0, "rate_dec_arcsec_s": 3.0,
    },
    "exposure": {"integration_s": 2.0, "frames": 2, "cadence_s": 40.0},
    "accuracy": {"check_cells": 0},
    "output": {"layers": ["dn", "stars_e"]},
}  # fmt: skip


@dataclass(frozen=True)
class Rows:
    """Columns as a source of `build`; those that it lacks are absent."""

    columns: dict[str, np.ndarray]
    label: str

    def identity(self) -> list:
        return [self.label]

    def tables(self, record: dict) -> Iterator[pa.Table]:
        n = len(self.columns["ra"])
        absent = np.full(n, np.nan)
        arrays = [
            pa.array(self.columns.get(f.name, absent), from_pandas=True).cast(f.type)
            for f in INCOMING
        ]
        yield pa.table(arrays, schema=INCOMING)


def make(folder: Path, columns: dict[str, np.ndarray], epoch: float, rows_per_leaf: int = 10**5):
    about = About(folder.name, "", folder.name == "bright", epoch, {})  # not a real star there
    build([Rows(columns, folder.name)], folder, about, rows_per_leaf=rows_per_leaf)


def sky() -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Main stars of G 6 to 13; a bright list of those above 8, 24.25 years earlier, and 12 more.

    Six of the list's own are as bright as Polaris to 3.6; one has the id of a star of the main
    catalogue that stands elsewhere. Some of the common ones move by arcseconds a year.
    """
    rng = np.random.default_rng(9)
    n = 3000
    main = {
        "source_id": np.arange(n) + 1000, "ra": rng.uniform(98, 104, n),
        "dec": rng.uniform(27, 33, n), "phot_g_mean_mag": np.linspace(6, 13, n),
        "pmra": rng.normal(0, 30, n), "pmdec": rng.normal(0, 30, n),
    }  # fmt: skip
    main["pmra"][:80] *= 100.0
    common = main["phot_g_mean_mag"] < 8
    ra, dec = angles_deg(
        moved(*(main[k] for k in ("ra", "dec", "pmra", "pmdec")), LAYER_JYEAR - MAIN_JYEAR)
    )
    own = {
        "ra": rng.uniform(100.3, 101.7, 12), "dec": rng.uniform(29.3, 30.7, 12),
        "pmra": rng.normal(0, 100, 12), "pmdec": rng.normal(0, 100, 12),
        "phot_g_mean_mag": np.concatenate([np.linspace(2.0, 3.6, 6), np.full(6, 7.0)]),
    }  # fmt: skip
    layer = {k: np.concatenate([main[k][common], own[k]]) for k in COLUMNS[1:]}
    count = common.sum()
    layer["ra"][:count] = ra[common]
    layer["dec"][:count] = dec[common] + rng.normal(0, 0.3 / 3600, count)
    layer["phot_g_mean_mag"][:count] += rng.normal(0, 0.1, count)
    layer["source_id"] = np.arange(len(layer["ra"])) + 1
    layer["source_id"][-1] = main["source_id"][2000]
    return main, layer


@pytest.fixture(scope="module")
def folders(tmp_path_factory) -> dict[str, Path]:
    """The same main stars in few row groups and in hundreds, and the bright list."""
    root = tmp_path_factory.mktemp("layers")
    main, layer = sky()
    make(root / "main", main, MAIN_JYEAR)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(shards, "MIN_BAND_ROWS", 1)
        patch.setattr(shards, "MAX_ROW_GROUP_ROWS", 12)
        make(root / "cut", main, MAIN_JYEAR, rows_per_leaf=200)
    make(root / "bright", layer, LAYER_JYEAR)
    (root / "file").write_text("no catalogue")
    return {name: root / name for name in ("main", "cut", "bright")}


def scene_of(catalogue, **changes):
    data = copy.deepcopy(SCENE)
    data["stars"] = {"catalogue": catalogue}
    for section, values in changes.items():
        data[section] = data[section] | values
    return parse_scene(data)


@pytest.fixture(scope="module")
def layered(folders):
    """A scene of both catalogues, with changes to its sections."""
    paths = [str(folders["main"]), str(folders["bright"])]

    def make(**changes):
        return scene_of(paths, **changes)

    return make


def truth_of(product: Path) -> dict[str, np.ndarray]:
    table = pq.read_table(product / "truth" / "stars.parquet")
    return {name: np.asarray(table[name]) for name in table.column_names}


def light_of(product: Path) -> np.ndarray:
    return open_cube(product)["stars_e"].values


@pytest.fixture(scope="module")
def reference(layered, tmp_path_factory):
    path = tmp_path_factory.mktemp("reference") / "run"
    return path, render(layered(), path, Options("synchronous"))


def assert_same(path: Path, report: dict, reference) -> None:
    other, wanted = reference
    assert report["content_digest"] == wanted["content_digest"]
    for name, values in truth_of(other).items():
        assert np.array_equal(truth_of(path)[name], values), name


def test_each_star_once(reference, folders, tmp_path):
    """Common stars come from the main catalogue, the bright ones from the layer: rows and light."""
    path, report = reference
    main, layer = sky()
    truth = truth_of(path)
    own = set(layer["source_id"][-12:].tolist())
    from_layer = truth["catalogue"] == 1
    assert set(truth["source_id"][from_layer].tolist()) <= own
    assert truth["g_mag"][from_layer].min() == pytest.approx(2.0, abs=1e-4)
    assert len(np.unique(truth["source_id"][from_layer])) >= 10
    once = np.stack([truth["frame"], truth["catalogue"], truth["source_id"]])
    assert np.unique(once, axis=1).shape == once.shape
    by_id = np.lexsort((truth["catalogue"], truth["source_id"], truth["frame"]))
    assert (np.diff(by_id) == 1).all()  # whichever catalogue a row is of
    # The light is that of the main catalogue's stars and of the layer's own, each drawn alone.
    render(scene_of(str(folders["main"])), tmp_path / "main", Options("synchronous"))
    left = {k: v[-12:] for k, v in layer.items()}
    make(tmp_path / "own", left, LAYER_JYEAR)
    render(scene_of(str(tmp_path / "own")), tmp_path / "alone", Options("synchronous"))
    parts = [light_of(tmp_path / name).astype(float) for name in ("main", "alone")]
    both = light_of(path).astype(float)
    assert np.abs(both - sum(parts)).max() < 1e-6 * both.max()
    assert both.sum() > 5 * parts[0].sum()
    assert 0 < report["layers"][0]["left_out"] <= (main["phot_g_mean_mag"] < 8).sum()


def test_a_fast_star_of_a_layer_is_found_where_it_now_is(folders, tmp_path):
    """At 20 arcsec a year it is 571 from where its catalogue, of 28.55 years ago, has it."""
    off_deg = (2019.8 - LAYER_JYEAR) * 20.0 / 3600.0
    layer = {"source_id": 7, "ra": 101.0, "dec": 30.0 - off_deg, "pmra": 0.0, "pmdec": 2e4,
             "phot_g_mean_mag": 5.0}  # fmt: skip
    make(tmp_path / "fast", {k: np.array([v]) for k, v in layer.items()}, LAYER_JYEAR)
    scene = scene_of(
        [str(folders["main"]), str(tmp_path / "fast")],
        sensor={
            "shape": [64, 64],
            "focal_length_m": 2.5,
            "psf": {"kind": "gaussian", "sigma_px": 1.0},
        },
        pointing={"rate_ra_arcsec_s": 0.0, "rate_dec_arcsec_s": 0.0},
        exposure={"frames": 1},
    )
    render(scene, tmp_path / "run", Options("synchronous"))
    truth = truth_of(tmp_path / "run")
    fast = truth["catalogue"] == 1
    assert truth["source_id"][fast].tolist() == [7]
    assert light_of(tmp_path / "run").sum() >= truth["electrons"][fast].sum() * 0.99 > 1e4


def test_stars_of_both_are_counted_once(layered, reference):
    """As many as the truth of the fullest frame has."""
    _, many = np.unique(truth_of(reference[0])["frame"], return_counts=True)
    assert resolve(layered()).stars.counts.total == many.max()


def test_stars_that_are_looked_at_stand_for_those_that_are_not(layered, monkeypatch):
    """One of some is placed: about as many are counted as where all are."""
    every = resolve(layered()).stars.counts
    monkeypatch.setattr("pipeline.resolve.stars.PLACED", 700)
    some = resolve(layered()).stars.counts
    assert len(some.light_e) < 0.4 * len(every.light_e)
    assert some.total == pytest.approx(every.total, abs=3 * np.sqrt(every.total * some.each))


def test_stars_are_not_looked_for_in_frames_without_light(layered):
    """Of two bias frames: the plan is of the stars of the third, as where that is all there is."""
    some = {"integration_s": [0.0, 0.0, 2.0], "frames": 3, "cadence_s": 40.0}
    data = layered().as_dict() | {"exposure": {"integration_s": 2.0}, "dwells": [some]}
    found = resolve(parse_scene(data)).stars.counts
    assert found.light_e.min() > 0.0
    alone = resolve(layered(exposure={"frames": 1})).stars.counts
    assert found.total == pytest.approx(alone.total, rel=0.05)


def test_what_is_told(reference, folders):
    """Plan, report and cube name both catalogues; the plan has the rule and how many it took."""
    path, report = reference
    plan = json.loads((path / "plan.json").read_text())
    cube = open_cube(path).attrs
    manifests = [
        json.loads((folders[n] / "nightglass.json").read_text()) for n in ("main", "bright")
    ]
    digests = [m["sha256"] for m in manifests]
    for told in (plan, report):
        assert [told["catalogue"]["digest"], told["layers"][0]["digest"]] == digests
        assert told["layers"][0]["ref_epoch_jyear"] == LAYER_JYEAR
    assert (cube["catalogue_digest"], cube["layer_digests"]) == (digests[0], digests[1:])
    assert cube["synthetic_stars"] is True  # by the layer; the main catalogue is of real ones
    reason = {d["component"]: d["reason"] for d in plan["decisions"]}["stars.layer_1"]
    assert f"{plan['layers'][0]['left_out']} of its stars" in reason
    assert "2.97 arcsec" in reason
    assert "1 mag" in reason
    told = " ".join(plan["remarks"])
    assert "brighter real stars are missing" not in told
    alone = plan_scene(scene_of(str(folders["main"])))
    assert any("begins at G = 6.0: brighter" in remark for remark in alone["remarks"])
    assert (alone["layers"], alone["catalogue"]["digest"]) == ([], digests[0])


@pytest.mark.parametrize(
    "tile",
    [[256, 256], *(slow(t) for t in ([512, 256], [256, 512]))],
    ids=str,
)
def test_same_bits_for_every_tile_shape(tile, layered, reference, tmp_path):
    scene = layered(output={"tile_shape": tile})
    assert_same(tmp_path / "run", render(scene, tmp_path / "run"), reference)


@pytest.mark.slow
def test_same_bits_for_processes(layered, reference, tmp_path):
    scene = layered(output={"tile_shape": [256, 256]})
    report = render(scene, tmp_path / "run", Options("processes", 2))
    assert_same(tmp_path / "run", report, reference)


@pytest.mark.slow
def test_same_bits_for_every_cut_of_the_catalogue(folders, reference, tmp_path):
    """Which leaves and row groups are read, and what else lies in them, changes nothing."""
    scene = scene_of([str(folders["cut"]), str(folders["bright"])])
    cut, whole = plan_scene(scene), json.loads((reference[0] / "plan.json").read_text())
    assert cut["shards"] > whole["shards"]
    assert cut["star_rows_to_read"] < whole["star_rows_to_read"]
    assert_same(tmp_path / "run", render(scene, tmp_path / "run"), reference)


def test_fields_of_later_windows_are_searched_too(layered, monkeypatch):
    """Two fields three degrees apart: what both catalogues hold is found in each."""
    far = layered(pointing={"rate_ra_arcsec_s": 270.0, "rate_dec_arcsec_s": 0.0})
    at_once = prepare(far).left_out
    monkeypatch.setattr("pipeline.resolve.stars.TASKS_PER_WINDOW", 1)
    for found, wanted in zip(prepare(far).left_out, at_once, strict=True):
        assert found.tolist() == wanted.tolist()
    first = layered(exposure={"frames": 1}, pointing={"rate_ra_arcsec_s": 270.0})
    assert sum(map(len, prepare(first).left_out)) < sum(map(len, at_once))


@pytest.mark.slow
def test_same_bits_window_by_window(layered, reference, tmp_path, monkeypatch):
    """A window reads the row groups of its own frames."""
    for module in ("resolve.stars", "route.draw"):
        monkeypatch.setattr(f"pipeline.{module}.TASKS_PER_WINDOW", 1)
    assert_same(tmp_path / "run", render(layered(), tmp_path / "run"), reference)


def test_same_bits_after_resume(layered, reference, folders, tmp_path):
    """What was lost is drawn again; with other catalogues a product is not taken up."""
    product = tmp_path / "run"
    render(layered(output={"tile_shape": [256, 256]}), product)
    for name in ("_COMPLETE", "cube.zarr/zarr.json"):
        (product / name).unlink()
    for marker in sorted((product / "markers").iterdir())[::3]:
        marker.unlink()
    options = Options(resume=True)
    report = render(layered(output={"tile_shape": [256, 256]}), product, options)
    assert 0 < report["tiles_resumed"] < report["tiles"]
    assert_same(product, report, reference)
    assert check(product).whole
    other = scene_of(
        [str(folders["cut"]), str(folders["bright"])], output={"tile_shape": [256, 256]}
    )
    with pytest.raises(BadInput, match="--resume"):
        render(other, product, options)


@pytest.mark.slow
def test_a_list_of_one_is_that_one(folders, tmp_path):
    """Layers cost nothing where there are none: not even an import."""
    one, path = scene_of([str(folders["main"])]), str(folders["main"])
    assert one == scene_of(path)
    (tmp_path / "scene.yaml").write_text(scene_yaml(one))
    code = (
        "import sys, json, pathlib\n"
        "from pipeline.route.run import render\n"
        "from pipeline.spec.load import load_scene\n"
        "render(load_scene(pathlib.Path(sys.argv[1])), pathlib.Path(sys.argv[2]))\n"
        "print(json.dumps(sorted(sys.modules)))\n"
    )
    command = [sys.executable, "-c", code, str(tmp_path / "scene.yaml"), str(tmp_path / "run")]
    result = subprocess.run(command, capture_output=True, text=True, check=True)
    loaded = json.loads(result.stdout.splitlines()[-1])
    assert "catalog_tools.query.query" in loaded
    assert not {"catalog_tools.query.layers", "healpy"} & set(loaded)
    assert set(truth_of(tmp_path / "run")["catalogue"].tolist()) == {0}


@pytest.mark.slow
def test_limiting_magnitude_holds_for_all(folders, tmp_path):
    """A star that the main catalogue holds below the limit is not drawn from the layer."""
    data = copy.deepcopy(SCENE)
    paths = [str(folders["main"]), str(folders["bright"])]
    data["stars"] = {"catalogue": paths, "faintest_g_mag": 7.2}
    render(parse_scene(data), tmp_path / "run", Options("synchronous"))
    truth = truth_of(tmp_path / "run")
    assert truth["g_mag"].max() <= 7.2
    _, layer = sky()
    own = set(layer["source_id"][-12:].tolist())
    assert set(truth["source_id"][truth["catalogue"] == 1].tolist()) <= own


@pytest.mark.slow
def test_order_of_the_list_decides(folders, tmp_path):
    """With the bright list as the main catalogue its rows are drawn, the deep one's omitted."""
    render(scene_of([str(folders["bright"]), str(folders["main"])]), tmp_path / "run")
    truth = truth_of(tmp_path / "run")
    _, layer = sky()
    held = truth["catalogue"] == 0
    assert (truth["g_mag"][~held] > 7.9).all()
    assert set(layer["source_id"].tolist()) >= set(truth["source_id"][held].tolist())


@pytest.mark.parametrize(
    ("catalogue", "field", "allowed"),
    [
        (["main", "nowhere"], "stars.catalogue[1]", "catalog ingest"),
        (["nowhere", "main"], "stars.catalogue[0]", "catalog ingest"),
        (["main", "file"], "stars.catalogue[1]", "a file"),
        (["main", "bright", "./main"], "stars.catalogue[2]", "once"),
        (["main", "copy"], "stars.catalogue[1]", "another catalogue"),
        ([], "stars.catalogue", "list of 1 to 8"),
        (["main", ""], "stars.catalogue[1]", "1 to 1024"),
    ],
)
def test_bad_lists_name_their_place(catalogue, field, allowed, folders, tmp_path):
    """One message with field, value and remedy, and nothing left behind."""
    root = folders["main"].parent
    if not (root / "copy").exists():
        shutil.copytree(root / "main", root / "copy")
    data = copy.deepcopy(SCENE) | {"stars": {"catalogue": catalogue}}
    file = root / "bad.json"
    file.write_text(json.dumps(data))
    result = nightglass("render", file, "-o", tmp_path / "run")
    assert result.returncode == 2
    assert f"{field}: " in result.stderr
    assert allowed in result.stderr
    assert "Traceback" not in result.stderr
    assert not (tmp_path / "run").exists()


def test_set_takes_a_list(folders, tmp_path):
    data = copy.deepcopy(SCENE) | {"stars": {"catalogue": "main"}}
    file = folders["main"].parent / "scene.json"
    file.write_text(json.dumps(data))
    scene = load_scene(file, ["stars.catalogue=[main, bright]"])
    assert scene.stars.catalogues == (str(folders["main"]), str(folders["bright"]))
    scene = load_scene(file, ["stars.catalogue=[main, 's3://bucket/x']", "stars.catalogue.0=cut"])
    assert scene.stars.catalogues == (str(folders["cut"]), "s3://bucket/x")


def test_sirius_over_real_dr2(wide_catalogue, sidereal, shared_data, tmp_path):
    """Hipparcos under the real field's sky: Sirius, which no release of Gaia holds, is there."""
    from catalog_tools.ingest.ingest import ingest

    file = shared_data / "bright_stars" / "hip_main_bright.dat.gz"
    ingest([file], tmp_path / "hip", form="hipparcos", workers=1)
    data = copy.deepcopy(sidereal) | {"epoch": "2019-01-20T09:00:00Z", "accept": ["coverage"]}
    data["observer"] = {"kind": "fixed", "position_au": [-0.5, 0.8, 0.35]}
    data["pointing"] = {
        "mode": "sidereal", "boresight_ra_deg": 101.2843, "boresight_dec_deg": -16.7226,
    }  # fmt: skip
    data["sensor"] = data["sensor"] | {"shape": [256, 256]}
    data["stars"] = {"catalogue": [str(wide_catalogue), str(tmp_path / "hip")]}
    render(parse_scene(data), tmp_path / "run")
    truth = truth_of(tmp_path / "run")
    assert truth["source_id"].tolist() == [32349]
    # Sirius, J2019.05, ICRS: SIMBAD's place at J2000 and proper motion (van Leeuwen 2007).
    ra, dec = 101.28715533 - 0.54601 * 19.05 / 3600 / np.cos(np.radians(16.7)), -16.71611586
    assert truth["ra_deg"][0] == pytest.approx(ra, abs=0.5 / 3600)
    assert truth["dec_deg"][0] == pytest.approx(dec - 1.22307 * 19.05 / 3600, abs=0.5 / 3600)
