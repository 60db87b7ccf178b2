"""Same scene and seed, same bits: for any tiles, workers, scheduler, order and interruption.

The cube and the truth tables of a scene do not depend on how the frame is cut into tiles, on how
many workers draw it and by which scheduler, on the order of the tasks, or on whether the render was
cut off and gone on with. The focal plane is divided into fixed cells, chosen from the scene alone;
how light is drawn belongs to them, and a tile (a task, a chunk) is a union of whole cells: other
shapes are refused, with those that are allowed. Random numbers belong to (seed, component, frame,
cell), never to a task or worker, so that switching a component on leaves the draws of the others
as they are. The promise is of one kind of processor; no arithmetic that a compiler may reorder
decides a bit.
"""

# Deeper, elsewhere: tests/physics/noise/test_streams.py (the streams against published vectors),
# tests/physics/noise/test_chain.py, tests/physics/drawing, tests/physics/cosmic_rays (each part in
# every tiling), tests/acceptance/test_layered_sky.py, test_shared_frames.py, test_curved_paths.py
# and test_distortion.py (scenes of every kind), tests/execute/test_detector.py (the detector's
# extras), tests/execute/test_bundles.py, tests/sweep/test_same_bits.py, tests/test_parts.py,
# tests/test_remote.py, tests/service/test_kills.py, tests/pins (from version to version).

from __future__ import annotations

import ast
import json
import os
import random
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from catalog_tools.engine.schedulers import LocalScheduler
from pipeline.errors import BadInput, TryLater
from pipeline.route.prepare import prepare
from pipeline.route.run import Options, render
from pipeline.spec.load import scene_yaml
from pipeline.spec.scene import CELL_PX
from pipeline.store import layout
from pipeline.store.cube import open_cube
from pipeline.store.markers import markers_present, read_marker
from pipeline.store.product import check
from tests.rules.conftest import SIDEREAL, layers, truth

KEPT = ["dn", "stars_e", "targets_e", "cosmic_rays_e"]
SIDES = {"rows": [256, 512], "columns": [256, 512, 768]}
ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def whole(scene):
    """Streaked stars with wings, a target, sky, rays, dark, all noise; 2 x 3 cells.

    whole(changes, tile_shape)
    """
    changes = {"sensor.psf": {"kind": "airy", "jitter_px": 0.4}}

    def make(more: dict[str, Any] | None = None, tile: list[int] | None = None):
        output = {"layers": KEPT} | ({"tile_shape": tile} if tile else {})
        return scene(changes | {"output": output} | (more or {}))

    return make


@pytest.fixture(scope="module")
def reference(whole, tmp_path_factory):
    path = tmp_path_factory.mktemp("reference") / "run"
    report = render(whole(), path, Options("synchronous"))
    for name in KEPT[1:]:
        assert layers(path)[name].max() > 100, name
    return path, report


def assert_same(path: Path, report: dict[str, Any], reference) -> None:
    other, wanted = reference
    found = layers(path)
    for name, values in layers(other).items():
        assert np.array_equal(found[name], values), name
    for kind in ("stars", "targets", "cosmic_rays"):
        ours, theirs = truth(path, kind), truth(other, kind)
        assert len(theirs["frame"]) > 0
        assert repr({k: v.tolist() for k, v in ours.items()}) == repr(
            {k: v.tolist() for k, v in theirs.items()}
        ), kind
    assert report["content_digest"] == wanted["content_digest"]


def in_order_of(seed: int, patch: pytest.MonkeyPatch) -> None:
    """Local schedulers then compute what is wanted of a graph one by one, in an order of chance;
    what several tasks need is computed again for each of them."""
    run, chance = LocalScheduler.run, random.Random(seed)

    def shuffled(self, graph, keys, done):
        found = {key: run(self, graph, [key], done)[0] for key in chance.sample(keys, len(keys))}
        return [found[key] for key in keys]

    patch.setattr(LocalScheduler, "run", shuffled)


class CutOff(Exception):
    """Stands for whatever ends a render."""


@given(
    rows=st.sampled_from(SIDES["rows"]), columns=st.sampled_from(SIDES["columns"]),
    scheduler=st.sampled_from(["synchronous", "threads"]), workers=st.integers(1, 4),
    order=st.none() | st.integers(0, 99), cut=st.integers(0, 12),
)  # fmt: skip
@example(256, 256, "threads", 4, None, 0)
@example(512, 256, "threads", 1, 7, 0)
@example(256, 768, "synchronous", 1, None, 2)
@settings(max_examples=3)
def test_same_bits_whatever_the_tiles_workers_order_and_interruption(
    whole, reference, tmp_path_factory, rows, columns, scheduler, workers, order, cut
):
    """cut : so many tiles are done when the render is ended, to be gone on with; 0: it is not."""
    path, wish = tmp_path_factory.mktemp("any") / "run", whole(tile=[rows, columns])

    def stop(progress):
        if cut and progress.done >= cut:
            raise CutOff

    with pytest.MonkeyPatch.context() as patch:
        if order is not None:
            in_order_of(order, patch)
        options = Options(scheduler, workers)
        try:
            report = render(wish, path, options, stop)
        except CutOff:
            report = render(wish, path, Options(scheduler, workers, resume=True))
            assert report["tiles_resumed"] >= cut
    assert_same(path, report, reference)


@pytest.mark.slow
def test_same_bits_for_processes(whole, reference, tmp_path):
    report = render(whole(tile=[256, 256]), tmp_path / "run", Options("processes", 2))
    assert_same(tmp_path / "run", report, reference)


def test_same_bits_for_a_cluster(whole, reference, tmp_path):
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=1, threads_per_worker=2, processes=True, dashboard_address=None, silence_logs=50,
        host="127.0.0.1",
    ) as cluster:  # fmt: skip
        options = Options(cluster.scheduler_address)
        assert_same(tmp_path / "run", render(whole(), tmp_path / "run", options), reference)


def test_same_bits_after_kill_and_resume(whole, reference, tmp_path):
    """kill -9 in the middle, twice; what was finished stays, and the end is the same."""
    wish = whole(tile=[256, 256])
    (tmp_path / "scene.yaml").write_text(scene_yaml(wish))
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
    kept = sorted(markers_present(product))
    m = read_marker(kept[0])
    side = m.row, m.column
    chunk = product / "cube.zarr" / "dn" / "c" / str(m.frame) / str(side[0]) / str(side[1])
    chunk.write_bytes(chunk.read_bytes()[:-7])  # a chunk cut short is found and drawn again
    verdict = check(product)
    assert not verdict.complete
    assert any("instead of" in fault for fault in verdict.faults)
    report = render(wish, product, Options(resume=True))
    assert report["tiles_resumed"] == len(kept) - 1
    assert len(report["redrawn"]) == 1
    assert_same(product, report, reference)
    assert check(product).whole


def test_limits_of_resume(whole, reference, tmp_path):
    """A finished product is left as it is; another scene's product is not taken up."""
    path, report = reference
    before = json.loads((path / "_COMPLETE").read_text())
    again = render(whole(), path, Options(resume=True))
    assert again["content_digest"] == report["content_digest"]
    assert json.loads((path / "_COMPLETE").read_text()) == before
    with pytest.raises(Exception, match="scene_sha256"):
        render(whole({"seed": 12}), path, Options(resume=True))
    with pytest.raises(Exception, match="does not exist yet"):
        render(whole(), path)


@given(
    rows=st.sampled_from(SIDES["rows"]), columns=st.sampled_from(SIDES["columns"]),
)  # fmt: skip
@settings(max_examples=6)
def test_cells_are_chosen_from_the_scene_alone(whole, rows, columns):
    """Whatever the tiles, the same is decided of how light is drawn, and they are whole cells."""
    plan = prepare(whole(tile=[rows, columns])).plan
    wanted = prepare(whole()).plan
    assert plan.decisions == wanted.decisions
    assert plan.responses == wanted.responses
    assert plan.checks == wanted.checks
    drawn = np.zeros(plan.scene.sensor.shape, int)
    for tile in plan.tiles:
        assert tile.y0 % CELL_PX == tile.x0 % CELL_PX == 0
        drawn[tile.y0 : tile.y0 + tile.rows, tile.x0 : tile.x0 + tile.columns] += 1
    assert np.all(drawn == 1)


@given(rows=st.integers(1, 900), columns=st.integers(1, 900))
@example(255, 256)
@example(256, 769)
@settings(max_examples=30)
def test_tiles_of_parts_of_cells_are_refused(scene, rows, columns):
    """With the sides that are allowed."""
    wish = {"output": {"tile_shape": [rows, columns]}}
    if rows in SIDES["rows"] and columns in SIDES["columns"]:
        assert scene(wish).output.tile_shape == (rows, columns)
        return
    with pytest.raises(BadInput, match=r"output.tile_shape.*multiple of 256.*\d"):
        scene(wish)


def test_components_leave_each_others_draws_alone(whole, reference, tmp_path):
    """Without stars, target and rays only the pixels that these reached change."""
    quiet = {"sensor.psf": {"kind": "gaussian", "sigma_px": 1.1}}
    still = {"pointing": SIDEREAL, "output": {"layers": ["dn", "cosmic_rays_e"]}}
    render(whole(quiet), tmp_path / "full")
    render(whole(quiet | still | {"stars": None, "targets": None}), tmp_path / "plain")
    bare = still | {"stars": None, "targets": None, "cosmic_rays": None}
    render(whole(quiet | bare | {"output": {"layers": ["dn"]}}), tmp_path / "bare")
    full, plain, least = (layers(tmp_path / name) for name in ("full", "plain", "bare"))
    dark = (full["stars_e"] == 0) & (full["targets_e"] == 0)
    assert 0.02 < dark.mean() < 1.0
    assert np.array_equal(full["dn"][dark], plain["dn"][dark])
    assert not np.array_equal(full["dn"], plain["dn"])
    assert np.array_equal(full["cosmic_rays_e"], plain["cosmic_rays_e"])
    free = plain["cosmic_rays_e"] == 0
    assert 0.5 < free.mean() < 1.0
    assert np.array_equal(plain["dn"][free], least["dn"][free])
    assert not np.array_equal(plain["dn"], least["dn"])


def test_draws_follow_seed_frame_and_cell(scene, tmp_path):
    """Noise of two seeds, of two frames, and of two cells has nothing in common."""
    sky = {"stars": None, "targets": None, "cosmic_rays": None, "pointing": SIDEREAL,
           "output": {"tile_shape": [256, 256]}}  # fmt: skip
    for seed in (1, 2):
        render(scene(sky | {"seed": seed}), tmp_path / str(seed))
    one, two = (layers(tmp_path / str(seed))["dn"].astype(float) for seed in (1, 2))
    cells = [
        values[frame, y : y + CELL_PX, x : x + CELL_PX].ravel()
        for values in (one, two) for frame in (0, 1) for y in (0, 256) for x in (0, 256, 512)
    ]  # fmt: skip
    alike = np.corrcoef(cells) - np.eye(len(cells))
    assert np.abs(alike).max() < 6.0 / CELL_PX  # six deviations of the correlation of noise


def test_no_arithmetic_that_a_compiler_may_reorder():
    """No compiled function asks for fast-math, or for sums in parallel."""
    for folder in ("catalog_tools", "pipeline", "service"):
        for path in (ROOT / folder).rglob("*.py"):
            found = [
                word.arg
                for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call)
                for word in node.keywords if word.arg in ("fastmath", "parallel")
            ]  # fmt: skip
            assert not found, path


@pytest.mark.parametrize("wait_s", [0.0, 30.0])
def test_a_product_is_replaced_when_whoever_writes_it_has_ended(whole, tmp_path, wait_s):
    path = tmp_path / "run"
    before = render(whole({"seed": 12}), path)["content_digest"]
    with ThreadPoolExecutor(1) as pool:
        with layout.only_writer(path):
            again = pool.submit(render, whole(), path, Options(replace=True, wait_s=wait_s))
            time.sleep(2.0)
            assert again.done() != bool(wait_s)
        if not wait_s:
            with pytest.raises(TryLater, match="another render"):
                again.result()
            return
        assert again.result()["content_digest"] != before
