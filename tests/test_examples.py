"""The example scenes and the packaged demo scene are valid; those that need no catalogue render."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from pipeline.capacity.run import forecast_of
from pipeline.physics.targets.disc import photocentre_offset
from pipeline.route.run import render
from pipeline.spec.load import load_scene, parse_scene
from pipeline.spec.study_load import read_study
from pipeline.store.cube import open_cube
from pipeline.sweep.check import check
from pipeline.sweep.run import gather_course

ROOT = Path(__file__).resolve().parents[1]
SCENES = [*sorted((ROOT / "examples").glob("*.yaml")), ROOT / "pipeline" / "scenes" / "demo.yaml"]

SWEEPS = sorted((ROOT / "examples" / "sweeps").glob("*.yaml"))
STUDIES = sorted((ROOT / "examples" / "studies").glob("*.yaml"))


@pytest.mark.parametrize("path", SCENES, ids=lambda p: p.stem)
def test_scene_is_valid_and_complete(path):
    scene = load_scene(path)
    assert parse_scene(scene.as_dict()) == scene


@pytest.mark.parametrize("path", SWEEPS, ids=lambda p: p.stem)
def test_sweep_is_valid(path, tmp_path):
    """Its axes, its first, middle and last points, by the check that a run begins with."""
    course = gather_course(path, tmp_path / "out")
    names = check(course).names
    assert names == ("chaser",)
    assert course.sweep.points == 40


def test_scene_without_catalogue(tmp_path):
    """A space-based observer that follows another satellite holds it at the centre.

    The light of a sphere that is lit from a side stands off its centre by what its phase says.
    """
    render(load_scene(ROOT / "examples" / "space-based-rate.yaml"), tmp_path / "run")
    cube = open_cube(tmp_path / "run")
    assert cube["dn"].shape == (5, 512, 512)
    light = cube["targets_e"].values
    truth = pq.read_table(tmp_path / "run" / "truth" / "targets.parquet").to_pylist()
    for frame, row in zip(light, truth, strict=True):
        assert (row["x_px"], row["y_px"]) == pytest.approx((255.5, 255.5), abs=1e-6)
        off = photocentre_offset(row["radius_px"], np.radians(row["phase_deg"]))
        total = frame.sum()
        assert total > 1000
        y, x = np.indices(frame.shape)
        dx, dy = (x * frame).sum() / total - 255.5, (y * frame).sum() / total - 255.5
        assert np.hypot(dx, dy) == pytest.approx(off, abs=1e-2)


@pytest.mark.parametrize("path", STUDIES, ids=lambda p: p.stem)
def test_study_is_valid(path):
    """Its sensors and objects, by the forecast that `--dry-run` prints."""
    told = forecast_of(read_study(path), path.parent)
    assert told["objects"] == 1000
    assert told["cpu_s"] < 120.0
