"""Cosmic rays in a product: layer, truth and frame agree, and no tiling changes a bit."""

from __future__ import annotations

import json

import numpy as np
import pyarrow.parquet as pq
import pytest
import zarr

from pipeline.errors import BadInput
from pipeline.inputs.sensor.cosmic_ray_library import write_library
from pipeline.physics.cosmic_rays.library import Library
from pipeline.route.run import render
from pipeline.spec.load import load_scene, parse_scene

SCENE = {
    "schema": "nightglass/scene/1",
    "name": "rays",
    "epoch": "2019-04-20T03:00:00Z",
    "seed": 7,
    "observer": {"kind": "fixed", "position_au": [1, 0, 0]},
    "sensor": {
        "shape": [512, 512], "pixel_pitch_um": 10.0, "focal_length_m": 1.0, "aperture_m": 0.1,
        "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
        "psf": {"kind": "airy"}, "full_well_e": 3000.0,
    },
    "pointing": {"mode": "sidereal", "boresight_ra_deg": 10.0, "boresight_dec_deg": 5.0},
    "exposure": {"integration_s": 20.0, "frames": 2},
    "cosmic_rays": {"kind": "generated", "thickness_um": 40.0},
    "output": {"layers": ["dn", "mean_e", "cosmic_rays_e"]},
}  # fmt: skip


def product(tmp_path, name, **changes):
    data = json.loads(json.dumps(SCENE)) | changes
    render(parse_scene(data), tmp_path / name)
    cube = zarr.open(tmp_path / name / "cube.zarr")
    truth = pq.read_table(tmp_path / name / "truth" / "cosmic_rays.parquet")
    digest = json.loads((tmp_path / name / "_COMPLETE").read_text())["content_digest"]
    return cube, truth, digest


def library(path):
    """Five events of two pixels in three frames of 100 x 100."""
    places = np.arange(10, dtype=np.int64)
    write_library(path, Library(
        np.arange(0, 11, 2), 40 + places, 50 + places // 2, np.full(10, 700.0), 30.0, 10_000, 10.0,
        (100, 100), 3, np.array([0, 0, 1, 1, 1]),
    ))  # fmt: skip


def test_frame_is_the_drawn_charge_up_to_the_full_well(tmp_path):
    """Without light, dark and read noise: no photon noise is drawn from it, and it saturates."""
    cube, truth, _ = product(tmp_path, "run")
    charge = cube["cosmic_rays_e"][:].astype(float)
    assert not cube["mean_e"][:].any()
    assert charge.max() > 3000
    wanted = np.rint(np.minimum(charge, 3000.0))
    close = np.abs(np.minimum(charge, 3000.0) % 1 - 0.5) > 1e-3  # float32 may round the other way
    np.testing.assert_array_equal(cube["dn"][:][close], wanted[close])
    frame, electrons = (truth[name].to_numpy() for name in ("frame", "electrons"))
    for k in range(2):
        assert electrons[frame == k].sum() == pytest.approx(charge[k].sum(), rel=1e-5)


@pytest.mark.parametrize("kind", ["generated", "poisson", "frames"])
def test_same_bits_for_every_tiling(tmp_path, kind):
    rays = SCENE["cosmic_rays"]
    if kind != "generated":
        library(tmp_path / "lib.fits")
        rays = {"kind": "library", "path": str(tmp_path / "lib.fits"), "arrival": kind}
    layers = list(SCENE["output"]["layers"])
    _, truth, one = product(tmp_path, "one", cosmic_rays=rays)
    _, again, four = product(tmp_path, "four", cosmic_rays=rays,
                             output={"layers": layers, "tile_shape": [256, 256]})  # fmt: skip
    assert one == four
    assert truth.equals(again)


def test_flat_acts_before_or_after(tmp_path):
    dim = SCENE["sensor"] | {"flat": 0.5}
    before, after = (
        product(tmp_path, str(where), sensor=dim,
                cosmic_rays=SCENE["cosmic_rays"] | {"after_flat": where})[0]["cosmic_rays_e"][:]
        for where in (False, True)
    )  # fmt: skip
    np.testing.assert_allclose(before, 0.5 * after, rtol=1e-6)


def test_rate_of_zero_and_frames_without_events(tmp_path):
    none, truth, _ = product(tmp_path, "none", cosmic_rays={"kind": "generated",
                                                            "rate_per_cm2_s": 0})  # fmt: skip
    assert not none["cosmic_rays_e"][:].any()
    assert truth.num_rows == 0
    _, few, _ = product(tmp_path, "few", cosmic_rays={"kind": "generated", "rate_per_cm2_s": 1e-6})
    assert few.schema.equals(truth.schema)


def test_relative_paths_and_refusals(tmp_path):
    library(tmp_path / "lib.fits")
    rays = {"kind": "library", "path": "lib.fits"}
    (tmp_path / "scene.json").write_text(json.dumps(SCENE | {"cosmic_rays": rays}))
    assert load_scene(tmp_path / "scene.json").cosmic_rays.path == str(tmp_path / "lib.fits")
    for changed, says in (
        ({"kind": "lab"}, "generated"),
        ({"kind": "generated", "rate_per_cm2_s": -1}, "greater than or equal to 0"),
        ({"kind": "generated", "thickness_um": 0}, "0.5"),
        ({"kind": "library"}, "path"),
        ({"kind": "library", "path": "a", "arrival": "none"}, "poisson"),
    ):
        with pytest.raises(BadInput, match=says):
            parse_scene(SCENE | {"cosmic_rays": changed})
