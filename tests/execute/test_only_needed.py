"""What the scene does not need costs no task, no import and no read."""

from __future__ import annotations

import json
import subprocess
import sys
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from pipeline.execute.graph import Inputs, Work, window_graph
from pipeline.plan.geometry import plan_geometry
from pipeline.prepare import prepare
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
            "pipeline.physics.sky.extinction", "pipeline.physics.sky.night", "s3fs", "fsspec.asyn",
            "pipeline.store.bucket", "pipeline.store.remote", "catalog_tools.objects"],
    "target": ["healpy", "speclite", "sgp4", "astropy", "distributed", "fastapi",
               "catalog_tools.query", "sqlalchemy", "xarray", "s3fs", "pipeline.store.bucket"],
}  # fmt: skip
SCENES = {"sky": SKY, "target": SKY | {"targets": [TARGET]}}


# Rooms and libraries that stars alone do not need, with everything in them.
NOT_FOR_STARS = [
    "pipeline.physics.sky", "pipeline.physics.cosmic_rays", "pipeline.physics.meshes",
    "pipeline.physics.detection", "pipeline.physics.motion.jitter",
    "pipeline.physics.motion.flexible", "pipeline.physics.motion.linear_system",
    "pipeline.physics.noise.calibration", "pipeline.physics.positions.distortion",
    "pipeline.physics.positions.orbit_screen", "pipeline.physics.positions.orbit_numerical",
    "pipeline.plan.sky", "pipeline.plan.sky_light", "pipeline.plan.faint_stars",
    "pipeline.plan.stray_light", "pipeline.plan.night_sky", "pipeline.plan.psf_field",
    "pipeline.plan.populations", "pipeline.plan.meshes", "pipeline.inputs.sky",
    "pipeline.inputs.starlight", "pipeline.inputs.stray_light", "pipeline.inputs.meshes",
    "pipeline.inputs.cosmic_rays", "pipeline.inputs.populations", "pipeline.inputs.night",
    "pipeline.execute.mesh_bodies", "pipeline.accuracy", "pipeline.detection",
    "pipeline.scene_report", "pipeline.selftest", "pipeline.sweep", "pipeline.importers",
    "catalog_tools.ingest", "catalog_tools.layers", "catalog_tools.synthetic",
    "catalog_tools.fetch", "service", "healpy", "sgp4", "astropy", "speclite", "trimesh",
    "distributed", "fastapi", "sqlalchemy", "xarray", "matplotlib",
]  # fmt: skip


@pytest.fixture(scope="module")
def catalogue(tmp_path_factory):
    from catalog_tools.ingest import ingest

    folder = tmp_path_factory.mktemp("one")
    (folder / "stars.csv").write_text("source_id,ra,dec,phot_g_mean_mag\n1,10.0,5.0,12.0\n")
    ingest([folder / "stars.csv"], folder / "catalogue", form="gaia_dr2", workers=1)
    return str(folder / "catalogue")


def only_stars(catalogue):
    return {k: v for k, v in SKY.items() if k != "background"} | {"stars": {"catalogue": catalogue}}


def test_imports_of_stars_alone(catalogue, tmp_path):
    """No room of the sky, of rays, of meshes... is loaded for a scene that has only stars."""
    loaded = modules_of(only_stars(catalogue), tmp_path)
    assert "pipeline.physics.drawing.stamps" in loaded
    rooms = tuple(f"{name}." for name in NOT_FOR_STARS)
    found = [m for m in loaded if m in NOT_FOR_STARS or m.startswith(rooms)]
    assert not found


def test_tasks_of_stars_alone(catalogue):
    """Stars are read once, placed once a frame; a tile, a block of wings, and their truth."""
    from pipeline.prepare import shards_of

    prepared = prepare(parse_scene(only_stars(catalogue)))
    plan = prepared.plan
    frames = np.arange(plan.frames, dtype=np.int64)
    geometry = plan_geometry(plan.scene, frames, plan.dut1_s)
    shards = shards_of(plan, prepared.catalogues, geometry)
    tiles = tuple((int(f), tile) for f in frames for tile in plan.tiles)
    work = Work(geometry, tiles, tuple(range(plan.frames)), ())
    inputs = prepared.inputs(CubeWriter("nowhere", ("dn",)))

    def counted(plan) -> Counter[str]:
        graph, _ = window_graph(inputs, plan, work, dict.fromkeys(shards), (2015.5,))
        return Counter(key[0] for key in graph)

    of_all = {"tile": 6, "place": 3, "star_truth": 3}
    assert counted(plan) == of_all | {"stars": 2, "block": 1}  # the frames share their stars
    assert counted(replace(plan, shared_frames=1)) == of_all | {"block": 3}


@pytest.mark.parametrize("name", SCENES)
def test_imports(name, tmp_path):
    """A render in a process of its own loads only what its components use."""
    assert not modules_of(SCENES[name], tmp_path) & set(UNNEEDED[name])


def modules_of(scene, tmp_path) -> set[str]:
    """Modules that a process has loaded after it rendered a scene."""
    code = (
        "import sys, json, pathlib\n"
        "from pipeline.run import render\n"
        "from pipeline.spec.load import parse_scene\n"
        "render(parse_scene(json.loads(sys.argv[1])), pathlib.Path(sys.argv[2]))\n"
        "print(json.dumps(sorted(sys.modules)))\n"
    )
    command = [sys.executable, "-c", code, json.dumps(scene), str(tmp_path / "run")]
    result = subprocess.run(command, capture_output=True, text=True, check=True)
    return set(json.loads(result.stdout.splitlines()[-1]))


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
