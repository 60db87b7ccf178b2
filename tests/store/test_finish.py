"""Finishing many small frames: what a frame's task knows is not worked out again by one process."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from dataclasses import replace
from itertools import permutations
from pathlib import Path

import numpy as np
import pytest
import zarr

from catalog_tools.engine.heap import peak_mb
from pipeline.execute import coordinates
from pipeline.route import run
from pipeline.route.finish import _achieved
from pipeline.route.run import Options, render
from pipeline.spec.load import parse_scene
from pipeline.store.cube import _write_coordinate
from pipeline.store.markers import markers_present, read_marker, write_marker
from pipeline.store.product import check
from tests.service.conftest import SCENE

HERE = Options("synchronous")


def scene(frames: int):
    exposure = {"integration_s": 0.1, "frames": frames, "cadence_s": 0.2}
    return parse_scene(SCENE | {"exposure": exposure})


def finishing(monkeypatch, before=lambda: None):
    """What `finish` takes, noted; `before` is called when it begins."""
    took, finish = {}, run.finish

    def timed(*arguments):
        before()
        at_s = time.process_time()
        report = finish(*arguments)
        took["cpu_s"] = time.process_time() - at_s
        return report

    monkeypatch.setattr(run, "finish", timed)
    return took


def cube_files(product: Path) -> dict[str, bytes]:
    cube = product / "cube.zarr"
    return {p.relative_to(cube).as_posix(): p.read_bytes() for p in cube.rglob("*") if p.is_file()}


def test_same_coordinates_from_markers_and_worked_out(tmp_path, monkeypatch):
    """Markers of the first tiles hold them; a product whose markers do not is finished the same."""
    wish = parse_scene(
        SCENE | {"sensor": SCENE["sensor"] | {"shape": [512, 256]}, "output": {
            "tile_shape": [256, 256]}}
    )  # fmt: skip
    product = tmp_path / "run"

    def fit_no_more():
        monkeypatch.setattr(coordinates, "fit_wcs", None)

    finishing(monkeypatch, fit_no_more)
    report = render(wish, product, HERE)
    assert 0.2 * peak_mb() < report["memory"]["peak_driver_mb"] <= peak_mb()
    monkeypatch.undo()
    first = cube_files(product)
    held = [read_marker(path) for path in markers_present(product)]
    assert [m.coordinates is not None for m in held] == [m.row == 0 for m in held]
    for marker in held:
        write_marker(product, replace(marker, coordinates=None))
    (product / "_COMPLETE").unlink()
    for part in (product / "truth").glob("*.parquet"):
        part.unlink()
    render(wish, product, replace(HERE, resume=True))
    assert cube_files(product) == first
    assert check(product).whole


def test_the_report_tells_the_memory_of_the_render_not_of_its_starter(tmp_path):
    (tmp_path / "scene.json").write_text(json.dumps(SCENE))
    large = bytearray(600_000_000)
    command = [sys.executable, "-m", "pipeline", "render", tmp_path / "scene.json", "-o"]
    subprocess.run([*command, tmp_path / "run"], check=True, capture_output=True)
    report = json.loads((tmp_path / "run" / "report.json").read_text())
    assert report["memory"]["peak_driver_mb"] < 500.0 < peak_mb()
    del large


@pytest.mark.parametrize(
    "values",
    [
        np.arange(7, dtype=np.int64), np.arange(5, dtype=np.int16),
        np.random.default_rng(1).normal(size=(9, 3, 3)),
        np.zeros((4, 2)),
    ],
)  # fmt: skip
def test_shards_are_those_of_zarr(tmp_path, values):
    names = ("frame", "a", "b")[: values.ndim]
    _write_coordinate(tmp_path / "ours", "x", names, values, {"units": "s"})
    theirs = zarr.create_array(
        store=tmp_path / "theirs", shape=values.shape, dtype=values.dtype, fill_value=None,
        chunks=(1, *values.shape[1:]), shards=values.shape, dimension_names=names,
        compressors=[zarr.codecs.Crc32cCodec()], attributes={"units": "s"},
        config={"write_empty_chunks": True},
    )  # fmt: skip
    theirs[...] = values
    found = [
        {p.relative_to(f).as_posix(): p.read_bytes() for p in f.rglob("*") if p.is_file()}
        for f in (tmp_path / "ours", tmp_path / "theirs")
    ]
    assert found[0] == found[1]
    assert np.array_equal(zarr.open_array(tmp_path / "ours")[...], values)


@pytest.mark.slow
def test_many_frames_are_finished_in_a_millisecond_each(tmp_path, monkeypatch):
    """CPU time, on whatever machine runs this: 5,000 frames in 5 s."""
    took = finishing(monkeypatch)
    render(scene(1000), tmp_path / "run", HERE)
    assert took["cpu_s"] < 1.0 + 0.5  # half a second for imports
    assert check(tmp_path / "run").whole


def test_windows_are_told_by_frame_row_and_column_in_whatever_order_they_come():
    told = [
        {"frame": frame, "y0": y0, "x0": x0, "skipped": "by the test"}
        for frame, y0, x0 in ((0, 0, 256), (0, 256, 0), (1, 0, 0), (1, 0, 256))
    ]
    assert all(_achieved(list(one))["checked"] == told for one in permutations(told))
