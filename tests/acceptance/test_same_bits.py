"""Same scene and seed, same bits: for every tile shape, worker count, scheduler, and resume."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from pipeline.run import Options, render
from pipeline.spec.load import scene_yaml
from pipeline.store.cube import open_cube
from pipeline.store.product import check

TILES = [[256, 256], [512, 256], [256, 768], [768, 512], [768, 768]]


@pytest.fixture(scope="module")
def scene(rate_track, build):
    """A scene with every component: streaked real stars, a target, sky, dark, all noise, wings."""
    changes = {
        "sensor.shape": [768, 768],
        "sensor.psf": {"kind": "airy", "jitter_px": 0.4},
        "exposure": {"integration_s": 2.0, "frames": 2, "cadence_s": 4.0},
        "output": {"layers": ["dn", "stars_e", "targets_e"]},
    }

    def make(more: dict | None = None):
        return build(rate_track, changes | (more or {}))

    return make


def layers(path: Path) -> dict[str, np.ndarray]:
    cube = open_cube(path)
    return {n: cube[n].values for n in cube.data_vars if cube[n].dims == ("frame", "y", "x")}


def truth(path: Path) -> list[bytes]:
    import pyarrow.parquet as pq

    return [
        repr(pq.read_table(path / "truth" / f"{k}.parquet").to_pydict()).encode()
        for k in ("stars", "targets")
    ]


@pytest.fixture(scope="module")
def reference(scene, tmp_path_factory):
    path = tmp_path_factory.mktemp("reference") / "run"
    report = render(scene(), path, Options(scheduler="synchronous"))
    assert layers(path)["stars_e"].max() > 100
    assert layers(path)["targets_e"].max() > 100
    return path, report


def assert_same(path: Path, report: dict, reference) -> None:
    other, wanted = reference
    for name, values in layers(other).items():
        assert np.array_equal(layers(path)[name], values), name
    assert truth(path) == truth(other)
    assert report["content_digest"] == wanted["content_digest"]


@pytest.mark.parametrize("tile", TILES, ids=str)
def test_same_bits_for_every_tile_shape(tile, scene, reference, tmp_path):
    made = scene({"output": {"layers": ["dn", "stars_e", "targets_e"], "tile_shape": tile}})
    assert_same(tmp_path / "run", render(made, tmp_path / "run"), reference)


@pytest.mark.parametrize("workers", [1, 2, 4])
def test_same_bits_for_threads(workers, scene, reference, tmp_path):
    tile = {"output": {"layers": ["dn", "stars_e", "targets_e"], "tile_shape": [256, 256]}}
    report = render(scene(tile), tmp_path / "run", Options("threads", workers))
    assert_same(tmp_path / "run", report, reference)


@pytest.mark.slow
def test_same_bits_for_processes(scene, reference, tmp_path):
    tile = {"output": {"layers": ["dn", "stars_e", "targets_e"], "tile_shape": [256, 256]}}
    report = render(scene(tile), tmp_path / "run", Options("processes", 2))
    assert_same(tmp_path / "run", report, reference)


def test_same_bits_for_a_cluster(scene, reference, tmp_path):
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=1, threads_per_worker=2, processes=True, dashboard_address=None, silence_logs=50,
        host="127.0.0.1",
    ) as cluster:  # fmt: skip
        options = Options(cluster.scheduler_address)
        assert_same(tmp_path / "run", render(scene(), tmp_path / "run", options), reference)


def test_same_bits_after_kill_and_resume(scene, reference, tmp_path):
    """kill -9 in the middle, twice; what was finished stays, and the end is the same."""
    more = {"output": {"layers": ["dn", "stars_e", "targets_e"], "tile_shape": [256, 256]}}
    (tmp_path / "scene.yaml").write_text(scene_yaml(scene(more)))
    product = tmp_path / "run"
    command = [sys.executable, "-m", "pipeline", "render", str(tmp_path / "scene.yaml"),
               "-o", str(product), "--workers", "1"]  # fmt: skip
    for enough in (2, 6):
        process = subprocess.Popen(
            command + (["--resume"] if product.exists() else []), start_new_session=True
        )
        deadline = time.monotonic() + 120
        while process.poll() is None and time.monotonic() < deadline:
            if len(list((product / "markers").glob("f*.json"))) >= enough:
                os.killpg(process.pid, signal.SIGKILL)
                break
            time.sleep(0.02)
        assert process.wait() == -signal.SIGKILL
        with pytest.raises(Exception, match="not complete"):
            open_cube(product)
    kept = len(list((product / "markers").glob("f*.json")))
    damaged = sorted((product / "cube.zarr" / "dn" / "c").rglob("*"))
    chunk = next(p for p in damaged if p.is_file())
    chunk.write_bytes(chunk.read_bytes()[:-7])  # a chunk cut short is found and drawn again
    verdict = check(product)
    assert not verdict.complete
    assert any("instead of" in fault for fault in verdict.faults)
    report = render(scene(more), product, Options(resume=True))
    assert report["tiles_resumed"] == kept - 1
    assert len(report["redrawn"]) == 1
    assert_same(product, report, reference)
    assert check(product).whole


def test_components_leave_each_others_draws_alone(scene, tmp_path):
    """Without stars and target only the pixels that their light reached change."""
    plain = {"stars": None, "targets": [], "output": {"layers": ["dn"]}}
    plain["pointing"] = {"mode": "sidereal", "boresight_ra_deg": 0.7, "boresight_dec_deg": -0.45}
    quiet = {"sensor.psf": {"kind": "gaussian", "sigma_px": 1.1}}
    full = scene({"output": {"layers": ["dn", "stars_e", "targets_e"]}, **quiet})
    render(full, tmp_path / "full")
    render(scene(plain | quiet), tmp_path / "plain")
    with_light, without = layers(tmp_path / "full"), layers(tmp_path / "plain")
    dark = (with_light["stars_e"] == 0) & (with_light["targets_e"] == 0)
    assert 0.02 < dark.mean() < 1.0
    assert np.array_equal(with_light["dn"][dark], without["dn"][dark])
    assert not np.array_equal(with_light["dn"], without["dn"])


def test_limits_of_resume(scene, reference, tmp_path, build):
    """A finished product is left as it is; another scene's product is not taken up."""
    path, report = reference
    before = json.loads((path / "_COMPLETE").read_text())
    again = render(scene(), path, Options(resume=True))
    assert again["content_digest"] == report["content_digest"]
    assert json.loads((path / "_COMPLETE").read_text()) == before
    with pytest.raises(Exception, match="scene_sha256"):
        render(scene({"seed": 12}), path, Options(resume=True))
    with pytest.raises(Exception, match="does not exist yet"):
        render(scene(), path)
