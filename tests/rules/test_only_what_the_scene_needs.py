"""Only what the scene needs: the plan decides it, and lists what is omitted with its error.

Which components, shards, stars, kernels and tiles a scene needs is decided before anything is
drawn. What is omitted, and every approximation, stands in the plan with the reason and an upper
bound on its error, in electrons a pixel and relative to the noise (or in the unit of what it
changes, where that is no pixel's charge). A component that is off costs no task, import or read.
"""

# Deeper, elsewhere: tests/plan/test_ledger.py (each line of a plan has a rule, and each rule a test
# that measures it), tests/ledger_report (the bounds measured anew), tests/plan/test_plan.py,
# tests/catalog_tools/query/test_query.py (rows that are read), tests/execute/test_detector.py and
# test_psf_field.py (nothing of the detector's extras or of a field of responses unless asked for).

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.errors import Damaged
from pipeline.execute.graph import Inputs, WindowWork, shard_key, window_graph
from pipeline.plan.pointing.geometry import plan_geometry
from pipeline.resolve.stars import shards_of
from pipeline.route.prepare import plan_scene, prepare
from pipeline.route.run import Options, render
from pipeline.spec.load import parse_scene
from pipeline.store.cube import CubeWriter
from tests.rules.conftest import SIDEREAL, truth

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
            "scipy.fft", "scipy.special",
            "catalog_tools.query.query", "catalog_tools.query.layers",
            "catalog_tools.geometry.regions",
            "catalog_tools.ingest.ingest", "sqlalchemy", "xarray", "pipeline.plan.sky.stray_light",
            "pipeline.physics.sky.extinction", "pipeline.physics.sky.night", "s3fs", "fsspec.asyn",
            "pipeline.store.bucket", "pipeline.store.remote", "catalog_tools.storage.objects"],
    "target": ["healpy", "speclite", "sgp4", "astropy", "distributed", "fastapi",
               "catalog_tools.query.query", "sqlalchemy", "xarray", "s3fs",
               "pipeline.store.bucket"],
}  # fmt: skip
EPOCHS = "finals2000A.all"  # of every scene: how the Earth had turned then
# Of the product's own: magnitudes are Vega's, whose spectrum is among the stars; the Sun lights.
OWN_DATA = {"sky": {EPOCHS, "stellar_boxes.csv"},
            "target": {EPOCHS, "stellar_boxes.csv", "solar_boxes.csv"}}  # fmt: skip
SCENES = {"sky": SKY, "target": SKY | {"targets": [TARGET]}}


# Rooms and libraries that stars alone do not need, with everything in them.
NOT_FOR_STARS = [
    "pipeline.physics.sky", "pipeline.physics.cosmic_rays", "pipeline.physics.meshes",
    "pipeline.physics.detection", "pipeline.physics.motion.jitter",
    "pipeline.physics.motion.flexible", "pipeline.physics.motion.linear_system",
    "pipeline.physics.noise.calibration", "pipeline.physics.positions.distortion",
    "pipeline.physics.positions.orbit_screen", "pipeline.physics.positions.orbit_numerical",
    "pipeline.plan.sky.sky", "pipeline.plan.sky.light", "pipeline.plan.stars.faint",
    "pipeline.plan.sky.stray_light", "pipeline.plan.sky.night", "pipeline.plan.optics.psf_field",
    "pipeline.plan.targets.populations", "pipeline.plan.bodies.meshes", "pipeline.inputs.sky.sky",
    "pipeline.inputs.sky.starlight", "pipeline.inputs.sky.stray_light",
    "pipeline.inputs.targets.meshes",
    "pipeline.inputs.sensor.cosmic_rays", "pipeline.inputs.sensor.cosmic_ray_library",
    "pipeline.inputs.targets.populations",
    "pipeline.inputs.sky.night",
    "pipeline.execute.mesh_bodies", "pipeline.studies.accuracy", "pipeline.studies.detection",
    "pipeline.studies.scenes", "pipeline.studies.selftest", "pipeline.sweep", "pipeline.importers",
    "catalog_tools.ingest.ingest", "catalog_tools.query.layers",
    "catalog_tools.synthetic.synthetic",
    "catalog_tools.fetch", "service", "healpy", "sgp4", "astropy", "speclite", "trimesh",
    "distributed", "fastapi", "sqlalchemy", "xarray", "matplotlib",
]  # fmt: skip


@pytest.fixture(scope="module")
def one_star(tmp_path_factory):
    from catalog_tools.ingest.ingest import ingest

    folder = tmp_path_factory.mktemp("one")
    (folder / "stars.csv").write_text("source_id,ra,dec,phot_g_mean_mag\n1,10.0,5.0,12.0\n")
    ingest([folder / "stars.csv"], folder / "catalogue", form="gaia_dr2", workers=1)
    return str(folder / "catalogue")


def only_stars(catalogue):
    return {k: v for k, v in SKY.items() if k != "background"} | {"stars": {"catalogue": catalogue}}


def test_imports_of_stars_alone(one_star, tmp_path):
    """No room of the sky, of rays, of meshes... is loaded for a scene that has only stars."""
    loaded, _ = used_by(only_stars(one_star), tmp_path)
    assert "pipeline.physics.drawing.stamps" in loaded
    rooms = tuple(f"{name}." for name in NOT_FOR_STARS)
    found = [m for m in loaded if m in NOT_FOR_STARS or m.startswith(rooms)]
    assert not found


def test_tasks_of_stars_alone(one_star):
    """Stars are read once, placed once a frame; a tile, a block of wings, and their truth."""
    prepared = prepare(parse_scene(only_stars(one_star)))
    plan = prepared.plan
    frames = np.arange(plan.frames, dtype=np.int64)
    geometry = plan_geometry(plan.scene, frames, plan.dut1_s)
    shards = shards_of(plan, prepared.catalogues, geometry)
    tiles = tuple((int(f), tile) for f in frames for tile in plan.tiles)
    work = WindowWork(geometry, tiles, tuple(range(plan.frames)), ())
    inputs = prepared.inputs(CubeWriter("nowhere", ("dn",)))

    def counted(plan) -> Counter[str]:
        graph, _ = window_graph(inputs, plan, work, dict.fromkeys(shards), (2015.5,))
        return Counter(key[0] for key in graph)

    of_all = {"tile": 6, "place": 3, "star_truth": 3}
    assert counted(plan) == of_all | {"stars": 2, "block": 1}  # the frames share their stars
    assert counted(replace(plan, shared_frames=1)) == of_all | {"block": 3}


def test_tasks_of_a_leaf_are_named_by_what_is_read_of_it(one_star):
    """Another window's other row groups are other rows: a cluster keeps what has a name."""
    prepared = prepare(parse_scene(only_stars(one_star)))
    geometry = plan_geometry(prepared.plan.scene, np.arange(1), 0.0)
    [shard] = shards_of(prepared.plan, prepared.catalogues, geometry)
    [group] = shard.leaf.row_groups
    more = (group, group._replace(row_group=1)), (group._replace(row_group=1),)
    keys = {shard_key(shard._replace(leaf=shard.leaf._replace(row_groups=g))) for g in more}
    assert len(keys | {shard_key(shard), shard_key(shard._replace(catalogue=1))}) == 4


@pytest.mark.parametrize("name", SCENES)
def test_imports(name, tmp_path):
    """A render in a process of its own loads only what its components use, and reads no data."""
    loaded, read = used_by(SCENES[name], tmp_path)
    assert not loaded & set(UNNEEDED[name])
    data = {Path(path).name for path in read if Path(path).suffix in DATA}
    assert data <= OWN_DATA[name] | {path.name for path in tmp_path.rglob("*")}


DATA = (".parquet", ".csv", ".fits", ".dat", ".npy", ".gz", ".all")
CODE = """
import sys, json, pathlib
read = set()
sys.addaudithook(lambda event, args: read.add(str(args[0])) if event == "open" else None)
from pipeline.route.run import render
from pipeline.spec.load import parse_scene
render(parse_scene(json.loads(sys.argv[1])), pathlib.Path(sys.argv[2]))
print(json.dumps([sorted(sys.modules), sorted(read)]))
"""


def used_by(scene, tmp_path) -> tuple[set[str], set[str]]:
    """Modules that a process has loaded after it rendered a scene, and files it has opened."""
    command = [sys.executable, "-c", CODE, json.dumps(scene), str(tmp_path / "run")]
    result = subprocess.run(command, capture_output=True, text=True, check=True)
    modules, read = json.loads(result.stdout.splitlines()[-1])
    return set(modules), set(read)


def tasks(data) -> dict[str, int]:
    prepared = prepare(parse_scene(data))
    plan = prepared.plan
    frames = np.arange(plan.frames, dtype=np.int64)
    geometry = plan_geometry(plan.scene, frames, plan.dut1_s)
    tiles = tuple((int(f), tile) for f in frames for tile in plan.tiles)
    truth = tuple(range(plan.frames)) if plan.scene.targets else ()
    inputs = Inputs(plan, prepared.maps, (), (), CubeWriter("nowhere", ("dn",)))
    graph, keys = window_graph(inputs, plan, WindowWork(geometry, tiles, (), truth), {})
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


@pytest.fixture(scope="module")
def few(scene):
    """Stars at rest on 256 x 256 px, alone."""
    bare = {"pointing": SIDEREAL, "targets": None, "background": None, "cosmic_rays": None,
            "sensor.shape": [256, 256], "exposure": {"integration_s": 1.0}}  # fmt: skip
    return lambda more=None: scene(bare | (more or {}))


def test_shards_beside_the_field_are_not_read(few, catalogue, tmp_path):
    """They may be gone; one that holds a star of the field may not."""
    copied = shutil.copytree(catalogue, tmp_path / "stars")
    wish = few({"stars": {"catalogue": str(copied)}})
    prepared = prepare(wish)
    frames = np.zeros(1, np.int64)
    needed = shards_of(prepared.plan, prepared.catalogues, plan_geometry(wish, frames, 0.0))
    paths = {copied / shard.leaf.path for shard in needed}
    every = set(copied.rglob("Npix=*.parquet"))
    assert 0 < len(paths) < len(every)
    assert plan_scene(wish)["shards"] == len(paths)
    for path in every - paths:
        path.unlink()
    render(wish, tmp_path / "run", Options("synchronous"))
    assert len(truth(tmp_path / "run", "stars")["frame"]) > 0
    for path in paths:
        path.unlink()
    with pytest.raises(Damaged, match="Npix"):
        render(wish, tmp_path / "again", Options("synchronous"))


def test_stars_below_the_limit_are_not_drawn(few, tmp_path):
    """Those above it are as before; where all are below, none is read."""
    for name, limit in (("all", None), ("bright", 12.0)):
        stars = {"stars.faintest_g_mag": limit} if limit else {}
        render(few(stars), tmp_path / name, Options("synchronous"))
    every, bright = (truth(tmp_path / name, "stars") for name in ("all", "bright"))
    kept = every["g_mag"] <= 12.0
    assert 0 < kept.sum() < kept.size
    assert np.array_equal(bright["source_id"], every["source_id"][kept])
    read = [plan_scene(few({"stars.faintest_g_mag": g})) for g in (8.0, 12.0)]
    assert [plan["star_rows_to_read"] > 0 for plan in read] == [False, True]
    assert read[0]["shards"] == 0
    asked = plan_scene(few({"stars.faintest_g_mag": 8.0, "background": {"starlight": "all"}}))
    noise = plan_scene(few({"stars.limit_from_noise": True}))  # the rest of the light is the sky's
    left_out = [sum("neither drawn nor in the sky" in r for r in p["remarks"])
                for p in (*read, asked, noise)]  # fmt: skip
    assert left_out == [1, 1, 0, 1]  # there beyond the end of the catalogue


SECTIONS = ("stars", "targets", "background", "cosmic_rays")
NEUTRAL = ("flat", "dark", "photon_noise", "full_well", "read_noise", "bias")
# Whose reason says what is missing where no number bounds it in a pixel: a choice of the scene.
UNBOUNDED = {"atmosphere", "background.zodiacal", "background.galactic", "background.starlight"}


PSFS = {"gaussian": {"kind": "gaussian", "sigma_px": 1.1}, "airy": {"kind": "airy"}}


@pytest.mark.parametrize("psf", PSFS.values(), ids=PSFS)
@pytest.mark.parametrize(
    "present", [SECTIONS, *((name,) for name in SECTIONS), ()], ids=lambda names: "+".join(names)
)
def test_what_is_left_out_is_listed(scene, present, psf):
    """Each component stands in the plan, kept or not, with a reason and the bound of its error."""
    absent = {name: None for name in SECTIONS if name not in present}
    pointing = {} if "targets" in present else {"pointing": SIDEREAL}
    plan = plan_scene(scene(absent | pointing | {"sensor.psf": psf}))
    lines = {d["component"]: d for d in plan["decisions"]}
    assert len(lines) == len(plan["decisions"])
    for name in SECTIONS:
        assert lines[name]["kept"] == (name in present)
    assert {name for name in NEUTRAL if not lines[name]["kept"]} == {"flat", "full_well"}
    for name, d in lines.items():
        assert len(d["reason"]) > 5, name
        bounds = d["error_bound_e"], d["error_bound_sigma"]
        assert (bounds[0] is None) == (bounds[1] is None), name
        if bounds[0]:
            assert np.isfinite(bounds).all(), name
            # At most as of an empty pixel: what grows with a source's light is beside its noise.
            assert 0.0 < bounds[1] <= bounds[0] / plan["noise_floor_e"] * (1 + 1e-9), name
        if not d["kept"] and name not in UNBOUNDED:
            assert bounds[0] is not None or (d["bound"] is not None and d["unit"]), name
    sources, winged = {"stars", "targets"} & set(present), psf["kind"] == "airy"
    taken = {"phase_interpolation": "stars" in present, "wings_cut_off": sources and winged}
    for name, there in taken.items():
        assert (name in lines) == bool(there), name
        assert not there or lines[name]["error_bound_sigma"] > 0.0


def test_kernels_of_what_is_drawn_alone(scene):
    """A sky without sources has no response to draw with: no cores are planned for stars."""
    bare = {"stars": None, "targets": None, "cosmic_rays": None, "pointing": SIDEREAL}
    wish = {"sensor.psf": {"kind": "airy"}}
    with_stars, sky = (prepare(scene(more | wish)).plan for more in ({}, bare))
    assert with_stars.responses.spacing_px > 0
    assert sky.responses.spacing_px == 0
    assert len(sky.responses.classes) <= 1 < len(with_stars.responses.classes)
