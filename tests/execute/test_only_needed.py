"""What the scene does not need costs no task, no import and no read."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest

from pipeline.execute.graph import Inputs, Work, window_graph
from pipeline.plan.geometry import plan_geometry
from pipeline.run import prepare
from pipeline.spec.load import parse_scene
from pipeline.store.cube import CubeWriter

SKY = {
    "schema": "nightglass/scene/1",
    "name": "sky",
    "epoch": "2019-07-20T09:00:00Z",
    "observer": {"kind": "fixed", "position_au": [1, 0, 0]},
    "sensor": {
        "shape": [512, 512],
        "pixel_pitch_um": 9.0,
        "focal_length_m": 0.5,
        "aperture_m": 0.1,
        "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
        "psf": {"kind": "airy"},
    },
    "pointing": {"mode": "sidereal", "boresight_ra_deg": 10.0, "boresight_dec_deg": 5.0},
    "exposure": {"integration_s": 1.0, "frames": 3},
    "background": {"uniform_e_per_s": 9.0},
    "output": {"tile_shape": [256, 512]},
}
TARGET = {
    "name": "t",
    "orbit": {"kind": "state", "position_m": [4.2e7, 0, 0], "velocity_m_s": [0, 3070, 0]},
    "body": {"kind": "sphere", "diameter_m": 1.0, "albedo": 0.5},
}
UNNEEDED = {
    "sky": ["healpy", "pyarrow", "speclite", "sgp4", "astropy", "distributed", "fastapi", "pandas",
            "catalog_tools.query", "catalog_tools.layers", "catalog_tools.regions",
            "catalog_tools.ingest", "sqlalchemy", "xarray", "pipeline.plan.stray_light",
            "pipeline.physics.sky.extinction", "pipeline.physics.sky.night"],
    "target": ["healpy", "speclite", "sgp4", "astropy", "distributed", "fastapi",
               "catalog_tools.query", "sqlalchemy", "xarray"],
}  # fmt: skip
SCENES = {"sky": SKY, "target": SKY | {"targets": [TARGET]}}


@pytest.mark.parametrize("name", SCENES)
def test_imports(name, tmp_path):
    """A render in a process of its own loads only what its components use."""
    code = (
        "import sys, json, pathlib\n"
        "from pipeline.run import render\n"
        "from pipeline.spec.load import parse_scene\n"
        "render(parse_scene(json.loads(sys.argv[1])), pathlib.Path(sys.argv[2]))\n"
        "print(json.dumps(sorted(sys.modules)))\n"
    )
    command = [sys.executable, "-c", code, json.dumps(SCENES[name]), str(tmp_path / "run")]
    result = subprocess.run(command, capture_output=True, text=True, check=True)
    loaded = set(json.loads(result.stdout.splitlines()[-1]))
    assert not loaded & set(UNNEEDED[name])


def tasks(data) -> dict[str, int]:
    prepared = prepare(parse_scene(data))
    plan = prepared.plan
    frames = np.arange(plan.frames, dtype=np.int64)
    geometry = plan_geometry(plan.scene, frames, plan.dut1_s)
    tiles = tuple((int(f), tile) for f in frames for tile in plan.tiles)
    truth = tuple(range(plan.frames)) if plan.scene.targets else ()
    inputs = Inputs(plan, prepared.maps, (), (), CubeWriter("nowhere", ("dn",)))
    graph, keys = window_graph(inputs, plan, Work(geometry, tiles, (), truth), {})
    assert set(keys) <= set(graph)
    kinds = [key[0] for key in graph]
    return {kind: kinds.count(kind) for kind in set(kinds)}


def test_tasks():
    """A sky needs one task a tile and nothing else; a target adds its truth and its blocks."""
    assert tasks(SKY) == {"tile": 6}
    assert tasks(SCENES["target"]) == {"tile": 6, "target_truth": 3, "block": 3}
    gaussian = json.loads(json.dumps(SCENES["target"]))
    gaussian["sensor"]["psf"] = {"kind": "gaussian", "sigma_px": 1.0}
    assert tasks(gaussian) == {"tile": 6, "target_truth": 3}
