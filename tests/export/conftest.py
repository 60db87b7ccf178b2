"""A small rate-tracked product with isolated stars and targets, and its noise-free light."""

from __future__ import annotations

import copy

import numpy as np
import pytest

from catalog_tools.ingest import ingest
from pipeline.run import render
from pipeline.spec.load import load_scene, parse_scene

RA_DEG, DEC_DEG, SIDE, STEP_PX = 275.94299663, -3.60041723, 512, 80
IFOV_DEG = float(np.degrees(9e-6))


def _catalogue(folder):
    """36 stars on a grid, 80 px apart and each a little off it, G 9 to 12."""
    rng = np.random.default_rng(3)
    rows = ["source_id,ref_epoch,ra,dec,parallax,pmra,pmdec,radial_velocity,phot_g_mean_mag,"
            "phot_bp_mean_mag,phot_rp_mean_mag"]  # fmt: skip
    for i in range(36):
        x, y = ((np.array(divmod(i, 6)) - 2.5) * STEP_PX + rng.uniform(-3, 3, 2)) * IFOV_DEG
        dec, g = DEC_DEG + y, 9.0 + i / 12.0
        ra = RA_DEG - x / np.cos(np.radians(dec))
        rows.append(f"{(i + 1) << 35},2015.5,{ra:.12f},{dec:.12f},1,0,0,,{g},{g + 0.4},{g - 0.6}")
    (folder / "stars.csv").write_text("\n".join(rows) + "\n")
    return str(ingest([folder / "stars.csv"], folder / "catalogue").catalogue.path)


@pytest.fixture(scope="session")
def labelled(tmp_path_factory):
    """The demo's GEO scene before 36 stars, at 512 x 512 px: two frames, layers of light alone."""
    from importlib.resources import files

    folder = tmp_path_factory.mktemp("labelled")
    demo = files("pipeline").joinpath("scenes/demo.yaml")
    (folder / "demo.yaml").write_text(demo.read_text())
    data = copy.deepcopy(load_scene(folder / "demo.yaml").as_dict())
    data["name"] = "labelled"
    data["sensor"] |= {
        "shape": [SIDE, SIDE], "focal_length_m": 1.0, "distortion": None,
        "psf": {"kind": "gaussian", "sigma_px": 0.9},
    }  # fmt: skip
    data["exposure"] = {"integration_s": 1.0, "frames": 2, "cadence_s": 4.0}
    data["stars"] = {"catalogue": _catalogue(folder)}
    near = copy.deepcopy(data["targets"][0])  # 38 px off the tracked one, drifting
    near["name"] = "drifter"
    near["orbit"]["position_m"][2] += 12_300.0
    near["orbit"]["velocity_m_s"][2] += 900.0
    data["targets"] = [data["targets"][0], near]
    data["output"] = {"layers": ["dn", "stars_e", "targets_e", "mean_e"]}
    render(parse_scene(data), folder / "run")
    return folder / "run"
