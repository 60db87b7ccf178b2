"""Nothing is lost: what was finished stays, the rest is drawn, and damage is never read as data.

The task of a tile may be run any number of times, and writes whole chunks. A worker, scheduler or
API that is killed costs at most the tiles in flight: `--resume` computes just the missing ones. A
product says whether it is complete, and nobody can take an unfinished one for a finished one.
Damage to a shard of a catalogue or a chunk of a product is detected and named, never rendered or
read in silence.
"""

# Deeper, elsewhere: tests/store/test_resume.py, test_product.py and test_durable.py (every file of
# a product), tests/rules/test_same_bits.py (kill -9 of a render, twice), tests/test_parts.py (of a
# part), tests/service/test_kills.py (of workers, dispatcher and API), test_scheduler_restarts.py,
# tests/catalog_tools/test_damage.py (every bit of a shard), tests/full_disk (no room left),
# tests/test_remote.py (products on s3).

from __future__ import annotations

import json
import os
import pickle
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st

from catalog_tools.engine.schedulers import LocalScheduler
from pipeline.errors import Damaged, Incomplete
from pipeline.execute.bundles import tiles_done
from pipeline.route.prepare import prepare
from pipeline.route.run import Options, render
from pipeline.spec.load import scene_yaml
from pipeline.store.cube import open_cube, read_layer
from pipeline.store.markers import markers_present
from pipeline.store.product import begin, check, content_digest
from tests.command import nightglass
from tests.rules.conftest import SIDEREAL, layers

HERE, AGAIN = Options("synchronous"), Options("synchronous", resume=True)
TILES = 2 * 2 * 3


@pytest.fixture(scope="module")
def wish(scene):
    """Stars, sky and rays in two frames of 2 x 3 tiles."""
    return scene({"targets": None, "pointing": SIDEREAL, "output": {
        "layers": ["dn", "stars_e"], "tile_shape": [256, 256]}})  # fmt: skip


@pytest.fixture(scope="module")
def whole(wish, tmp_path_factory):
    path = tmp_path_factory.mktemp("whole") / "run"
    render(wish, path, HERE)
    return path


def chunks(product: Path) -> dict[str, bytes]:
    """Every chunk of the layers, by name."""
    cube = product / "cube.zarr"
    return {
        str(path.relative_to(cube)): path.read_bytes()
        for name in ("dn", "stars_e") for path in (cube / name / "c").rglob("*") if path.is_file()
    }  # fmt: skip


def test_a_tiles_task_may_be_run_again(wish, whole, tmp_path, monkeypatch):
    """Each is run twice and gives hardly anything back; its chunks are whole, and the same."""
    run, results = LocalScheduler.run, []

    def twice(self, graph, keys, done):
        run(self, graph, keys, lambda _: None)
        found = run(self, graph, keys, done)
        results.extend(v for k, v in zip(keys, found, strict=True) if k[0].startswith("tile"))
        return found

    monkeypatch.setattr(LocalScheduler, "run", twice)
    render(wish, tmp_path / "run", HERE)
    assert results
    assert all(len(pickle.dumps(result)) < 2000 for result in results)
    assert len(chunks(whole)) == 2 * TILES
    assert chunks(tmp_path / "run") == chunks(whole)


class CutOff(Exception):
    """Stands for whatever ends a render."""


@given(cut=st.integers(1, TILES - 1), workers=st.integers(1, 3))
@settings(max_examples=4)
def test_resume_draws_just_what_is_missing(wish, whole, tmp_path_factory, cut, workers):
    """Wherever it was cut off; what was there is not touched."""
    product = tmp_path_factory.mktemp("cut") / "run"

    def stop(progress):
        if progress.done >= cut:
            raise CutOff

    with pytest.raises(CutOff):
        render(wish, product, Options("threads", workers), stop)
    kept = {path: path.stat().st_mtime_ns for path in markers_present(product)}
    assert cut <= len(kept) <= cut + 2 * workers  # and what was in flight
    assert_unfinished(product)
    drawn = []
    report = render(wish, product, AGAIN, lambda progress: drawn.append(progress.doing))
    assert sum(map(tiles_done, drawn)) == TILES - len(kept)
    assert report["tiles_resumed"] == len(kept)
    assert {path: path.stat().st_mtime_ns for path in kept} == kept
    assert content_digest(product) == content_digest(whole)
    assert check(product).whole


def assert_unfinished(product: Path) -> None:
    """Nobody who looks takes it for a finished product."""
    assert not (product / "_COMPLETE").exists()
    assert not check(product).complete
    with pytest.raises(Incomplete, match="not complete"):
        open_cube(product)
    with pytest.raises((FileNotFoundError, KeyError, ValueError)):
        xr.open_zarr(product / "cube.zarr", consolidated=False)
    assert nightglass("check", product).returncode == 3


CHILD = """
import sys
from pathlib import Path
from pipeline.route.run import Options, render
from pipeline.spec.load import load_scene
render(load_scene(Path(sys.argv[1])), Path(sys.argv[2]), Options("threads", 2),
       lambda progress: print(progress.done, flush=True))
"""


def test_a_kill_costs_at_most_the_tiles_in_flight(wish, whole, tmp_path):
    """kill -9 after some tiles were told as done: all of these are kept."""
    (tmp_path / "scene.yaml").write_text(scene_yaml(wish))
    product = tmp_path / "run"
    child = subprocess.Popen(
        [sys.executable, "-c", CHILD, str(tmp_path / "scene.yaml"), str(product)],
        stdout=subprocess.PIPE, text=True, start_new_session=True,
    )  # fmt: skip
    told = 0
    while told < 3:
        told = int(child.stdout.readline())
    os.killpg(child.pid, signal.SIGKILL)
    told = max([told, *map(int, child.stdout.read().split())])
    assert child.wait() == -signal.SIGKILL
    kept = len(list(markers_present(product)))
    assert told <= kept <= TILES
    assert_unfinished(product)
    report = render(wish, product, AGAIN)
    assert report["tiles_resumed"] == kept
    assert report["content_digest"] == content_digest(whole)


def test_a_product_just_begun_is_no_frame_of_nothing(wish, tmp_path):
    prepared = prepare(wish)
    begin(tmp_path / "run", prepared.plan, prepared.catalogue_digest, resume=False)
    assert_unfinished(tmp_path / "run")


def test_a_finished_product_says_so(whole):
    assert json.loads((whole / "report.json").read_text())["complete"]
    assert open_cube(whole).attrs["complete"]
    assert check(whole).whole
    assert nightglass("check", whole).returncode == 0


FILES = ("cube.zarr/dn/c/0/0/1", "cube.zarr/stars_e/c/1/1/2", "markers/f000001_r000_c002.json",
         "truth/stars.parquet", "plan.json", "report.json", "scene.yaml",
         "cube.zarr/wcs_cd_deg/c/0/0/0", "cube.zarr/dn/zarr.json", "_COMPLETE")  # fmt: skip


@pytest.fixture(scope="module")
def damaged(whole, tmp_path_factory):
    """A copy of the product to damage and mend."""
    return shutil.copytree(whole, tmp_path_factory.mktemp("damaged") / "run")


@given(name=st.sampled_from(FILES), at=st.floats(0.0, 1.0, exclude_max=True), bit=st.integers(0, 7),
       how=st.sampled_from(["flipped", "cut", "gone"]))  # fmt: skip
@settings(max_examples=40)
def test_damage_to_a_product_is_named(damaged, name, at, bit, how):
    """Any bit of any file, a file cut short, a file that is gone."""
    path = damaged / name
    good = path.read_bytes()
    where = int(at * len(good))
    flipped = bytearray(good)
    flipped[where] ^= 1 << bit
    try:
        path.unlink()
        if how != "gone":
            path.write_bytes(flipped if how == "flipped" else good[:where])
        verdict = check(damaged)
        if not (name == "_COMPLETE" and how == "flipped" and not verdict.faults):
            assert not verdict.whole
            assert how == "gone" or verdict.faults
            named = name.removeprefix("cube.zarr/").split("/")[-1]
            assert name == "_COMPLETE" or any(
                named in fault or "markers are missing" in fault for fault in verdict.faults
            )
    finally:
        path.write_bytes(good)
    assert check(damaged).whole


@given(at=st.floats(0.0, 1.0, exclude_max=True), bit=st.integers(0, 7))
@settings(max_examples=25)
def test_damage_to_a_chunk_is_never_read_as_light(damaged, whole, at, bit):
    """Reading it raises, naming the layer, or gives what was written."""
    path = damaged / "cube.zarr/dn/c/1/0/1"
    good = path.read_bytes()
    flipped = bytearray(good)
    flipped[int(at * len(good))] ^= 1 << bit
    path.write_bytes(flipped)
    read, told = None, ""
    try:
        read = read_layer(damaged, "dn", 1)
    except Damaged as damage:
        told = str(damage)
    finally:
        path.write_bytes(good)
    assert "dn" in told if read is None else np.array_equal(read, layers(whole)["dn"][1])


def test_a_damaged_chunk_is_drawn_again(wish, whole, tmp_path):
    """And it alone, named in the report."""
    product = shutil.copytree(whole, tmp_path / "run")
    chunk = product / "cube.zarr/dn/c/1/0/1"
    flipped = bytearray(chunk.read_bytes())
    flipped[len(flipped) // 2] ^= 4
    chunk.write_bytes(flipped)
    report = render(wish, product, AGAIN)
    assert report["tiles_resumed"] == TILES - 1
    assert len(report["redrawn"]) == 1
    assert "dn/c/1/0/1" in report["redrawn"][0]
    assert chunks(product) == chunks(whole)
    assert check(product).whole


@given(at=st.floats(0.0, 1.0, exclude_max=True), bit=st.integers(0, 7),
       which=st.integers(0, 99))  # fmt: skip
@settings(max_examples=8)
def test_a_damaged_shard_is_never_rendered(
    scene, catalogue, whole, tmp_path_factory, at, bit, which
):
    """Any bit of a shard that is read: named, and no product made; or it lies beside the data."""
    folder = tmp_path_factory.mktemp("shard")
    copied = shutil.copytree(catalogue, folder / "stars")
    shards = sorted(copied.rglob("Npix=*.parquet"))
    path = shards[which % len(shards)]
    flipped = bytearray(path.read_bytes())
    flipped[int(at * len(flipped))] ^= 1 << bit
    path.write_bytes(flipped)
    wish = scene({"targets": None, "pointing": SIDEREAL, "stars": {"catalogue": str(copied)},
                  "output": {"layers": ["dn", "stars_e"], "tile_shape": [256, 256]}})  # fmt: skip
    digest, told = None, ""
    try:
        digest = render(wish, folder / "run", HERE)["content_digest"]
    except Damaged as damage:
        told = str(damage)
    assert path.name in told if digest is None else digest == content_digest(whole)
    assert (folder / "run").exists() == (digest is not None)


def test_a_damaged_shard_of_the_field_is_named(scene, catalogue, tmp_path):
    """Its stars' magnitudes, whichever shard of the field holds them."""
    copied = shutil.copytree(catalogue, tmp_path / "stars")
    shards = sorted(copied.rglob("Npix=*.parquet"))
    for path in shards:
        flipped = bytearray(path.read_bytes())
        flipped[len(flipped) // 2] ^= 1
        path.write_bytes(flipped)
    wish = scene({"stars": {"catalogue": str(copied)}})
    with pytest.raises(Damaged, match=r"Npix=\d+"):
        render(wish, tmp_path / "run", HERE)
    assert not (tmp_path / "run").exists()
