"""Small scenes of the ledger's study, as plain data, and the stars that they look at."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from catalog_tools.catalogue import open_catalogue
from catalog_tools.documents import JsonObject
from catalog_tools.ingest.ingest import ingest
from catalog_tools.query.starlight import make_starlight
from pipeline.plan.plan import Plan
from pipeline.plan.tiles import Tile
from pipeline.spec.dotted import changed
from pipeline.studies.scenes.stage import Stage, light_by, mean_of, open_stage

RA_DEG, DEC_DEG = 80.0, 20.0
SIDE, STARS = 128, 260
BARNARD = (10.0, 550.0, 0.7)  # proper motion [arcsec a year], parallax [mas], off the middle [deg]
SCENE: JsonObject = {
    "schema": "nightglass/scene/1",
    "name": "ledger",
    "epoch": "2019-12-01T08:00:00Z",
    "seed": 7,
    "observer": {"kind": "fixed", "position_au": [0.6, 0.8, 0.0], "velocity_m_s": [0, 0, 3e4]},
    "sensor": {
        "shape": [SIDE, SIDE],
        "pixel_pitch_um": 9.0,
        "focal_length_m": 0.2,
        "aperture_m": 0.1,
        "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
        "psf": {"kind": "gaussian", "sigma_px": 0.9},
        "read_noise_e": 5.0,
        "gain_e_per_dn": 1.0,
        "adc_bits": 20,
    },
    "pointing": {"mode": "sidereal", "boresight_ra_deg": RA_DEG, "boresight_dec_deg": DEC_DEG},
    "exposure": {"integration_s": 5.0},
    "accuracy": {"check_cells": 0},
    "output": {"layers": ["dn", "mean_e"]},
}
SITE: JsonObject = {
    "kind": "ground",
    "latitude_deg": 20.7,
    "longitude_deg": -156.3,
    "height_m": 3055.0,
}
PLACE_M, SPEED_M_S = [7131858.8, -812572.7, 0.0], [-117.404, -1030.438, 7379.381]
ORBIT = {
    "kind": "orbit",
    "orbit": {"kind": "state", "position_m": PLACE_M, "velocity_m_s": SPEED_M_S},
}
SPHERE = {"kind": "sphere", "diameter_m": 1.0, "albedo": 0.3}


def scene(changes: JsonObject | None = None, base: JsonObject | None = None) -> JsonObject:
    """A small scene with dotted changes, such as {"sensor.shape": [8, 8]}; None removes a key."""
    return changed(base or SCENE, changes or {})


def before(towards: object, range_m: float, name: str = "t", **more: object) -> JsonObject:
    """A target that flies along with the observer in ORBIT, in a direction, so far away."""
    u = np.asarray(towards, float)
    place = np.add(PLACE_M, range_m * u / np.sqrt(u @ u))
    orbit = {"kind": "state", "position_m": [float(v) for v in place], "velocity_m_s": SPEED_M_S}
    return {"name": name, "orbit": orbit, "body": SPHERE} | more


def make_stars(folder: Path) -> str:
    """A catalogue of a few hundred stars around the field, one of them as quick and near as any."""
    rng = np.random.default_rng(3)
    x, y = rng.uniform(-0.35, 0.35, (2, STARS))
    quick, near, off = BARNARD
    x[0], y[0] = 0.1 * off, 0.1 * off
    dec = DEC_DEG + y
    ra = RA_DEG + x / np.cos(np.radians(dec))
    g = np.sort(rng.uniform(8.0, 16.0, STARS))
    motion, parallax = np.zeros(STARS), np.zeros(STARS)
    motion[0], parallax[0] = 1e3 * quick, near
    rows = [
        "source_id,ref_epoch,ra,dec,parallax,pmra,pmdec,radial_velocity,phot_g_mean_mag,"
        "phot_bp_mean_mag,phot_rp_mean_mag"
    ]
    rows += [
        f"{i + 1},2015.5,{ra[i]:.12f},{dec[i]:.12f},{parallax[i]},{motion[i]},0,,"
        f"{g[i]:.4f},{g[i] + 0.4:.4f},{g[i] - 0.6:.4f}"
        for i in range(STARS)
    ]
    path = folder / "stars.csv"
    path.write_text("\n".join(rows) + "\n")
    ingest([path], folder / "stars", workers=1)
    make_starlight(open_catalogue(folder / "stars"))
    return str(folder / "stars")


def whole(stage: Stage) -> Tile:
    """All of a stage's frame."""
    return Tile(0, 0, 0, 0, stage.plan.camera.rows, stage.plan.camera.columns)


def mean_e(data: JsonObject | Stage, plan: Plan | None = None) -> np.ndarray:
    """Mean electrons (rows, columns) of the first frame of a scene, drawn by a plan or its own."""
    stage = data if isinstance(data, Stage) else open_stage(data)
    tile = whole(stage)
    return mean_of(stage, light_by(stage, plan or stage.plan)(tile), tile)
