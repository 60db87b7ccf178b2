"""A small rate-tracked product with isolated stars and targets, and its noise-free light."""

from __future__ import annotations

import numpy as np
import pytest

from catalog_tools.ingest.ingest import ingest
from pipeline.route.run import render
from pipeline.spec.load import parse_scene

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
        rows.append(f"{i + 1},2015.5,{ra:.12f},{dec:.12f},1,0,0,,{g},{g + 0.4},{g - 0.6}")
    (folder / "stars.csv").write_text("\n".join(rows) + "\n")
    return str(ingest([folder / "stars.csv"], folder / "catalogue").catalogue.path)


def _target(name, position_m, velocity_m_s):
    return {
        "name": name,
        "orbit": {"kind": "state", "position_m": position_m, "velocity_m_s": velocity_m_s},
        "body": {"kind": "sphere", "diameter_m": 4.0, "albedo": 0.25},
    }


@pytest.fixture(scope="session")
def labelled(tmp_path_factory):
    """A tracked satellite and a drifting one before 36 stars: two frames, layers of light."""
    folder = tmp_path_factory.mktemp("labelled")
    render(parse_scene(_scene(folder)), folder / "run")
    return folder / "run"


@pytest.fixture(scope="session")
def distorted(tmp_path_factory):
    """The same through optics that distort and whose response varies; the camera turned."""
    folder = tmp_path_factory.mktemp("distorted")
    scene, edge = _scene(folder), float(SIDE - 1)
    a = {"2_0": 2e-5, "1_1": -1e-5, "0_2": 1.5e-5, "3_0": 4e-8, "1_2": -3e-8}
    scene["sensor"]["distortion"] = {"kind": "sip", "a": a, "b": {k: -v for k, v in a.items()}}
    widths = ((0.8, 1.0, 0.9), (1.0, 0.7, 1.2), (0.9, 1.1, 1.3))
    scene["sensor"]["psf"] = {
        "kind": "field", "rows_px": [0.0, 255.0, edge], "columns_px": [0.0, 255.0, edge],
        "psfs": [[{"kind": "gaussian", "sigma_px": s} for s in row] for row in widths],
    }  # fmt: skip
    scene["pointing"]["roll_deg"] = 30.0
    render(parse_scene(scene), folder / "run")
    return folder / "run"


def _scene(folder):
    x, y, z, speed = 4407338.1, -41933005.2, -36593.5, [3057.8229, 321.39, 0.2805]
    return {
        "schema": "nightglass/scene/1", "name": "labelled", "epoch": "2019-07-20T09:00:00Z",
        "seed": 7,
        "observer": {
            "kind": "ground", "latitude_deg": 20.7, "longitude_deg": -156.3, "height_m": 3055
        },
        "sensor": {
            "shape": [SIDE, SIDE], "pixel_pitch_um": 9.0, "focal_length_m": 1.0,
            "aperture_m": 0.4, "obscuration": 0.35,
            "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
            "transmission": 0.8, "quantum_efficiency": 0.85,
            "psf": {"kind": "gaussian", "sigma_px": 0.9}, "full_well_e": 90000,
            "gain_e_per_dn": 1.5, "bias_dn": 500, "dark_e_per_s": 0.5, "read_noise_e": 6.0,
        },
        "pointing": {"mode": "target", "target": "geo-1"},
        "exposure": {"integration_s": 1.0, "frames": 2, "cadence_s": 4.0},
        "stars": {"catalogue": _catalogue(folder)},
        "targets": [
            _target("geo-1", [x, y, z], speed),
            _target("drifter", [x, y, z + 12_300.0], [speed[0], speed[1], speed[2] + 900.0]),
        ],
        "background": {"uniform_mag_arcsec2": 20.8},
        "output": {"layers": ["dn", "stars_e", "targets_e", "mean_e"]},
    }  # fmt: skip
