"""Stars whose light changes while they streak: by the air, and by the pupil that they meet."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest

from catalog_tools.ingest.ingest import ingest
from pipeline.plan.response import responses
from pipeline.route.run import Options, render
from pipeline.spec.load import parse_scene
from pipeline.store.cube import open_cube

PARTS = 16
SINKING: dict[str, Any] = {  # at 12 degrees, and half a degree lower a minute later
    "observer": {
        "kind": "ground", "latitude_deg": 20.7, "longitude_deg": -156.3, "height_m": 0,
        "atmosphere": {"extinction": {"mag_per_airmass": 0.3}},
    },
    "sensor": {"focal_length_m": 0.1, "aperture_m": 0.03, "pupil_projection": False},
    "pointing": {"boresight_ra_deg": 192.0, "boresight_dec_deg": 5.0, "rate_ra_arcsec_s": -15.0},
    "exposure": {"integration_s": 60.0},
}  # fmt: skip
SLEWING: dict[str, Any] = {  # five degrees a second, up to 30 degrees off the axis
    "observer": {"kind": "fixed", "position_au": [0.2, -0.9, 0.4]},
    "sensor": {"focal_length_m": 0.002, "aperture_m": 0.002},
    "pointing": {"boresight_ra_deg": 192.0, "boresight_dec_deg": 5.0, "rate_ra_arcsec_s": 18000.0},
    "exposure": {"integration_s": 2.0},
}
SETTING = copy.deepcopy(SINKING)  # a frame that ends at the horizon, where its stars set
SETTING["pointing"] |= {"boresight_ra_deg": 179.45, "rate_ra_arcsec_s": 15.0}
SETTING["exposure"]["integration_s"] = 120.0


def scene(catalogue: str, changes: dict[str, Any], parts: int) -> Any:
    data: dict[str, Any] = {
        "schema": "nightglass/scene/1", "name": "uneven", "epoch": "2019-04-20T14:36:00Z",
        "sensor": {
            "shape": [96, 128], "pixel_pitch_um": 9.7, "read_noise_e": 5.0, "bias_dn": 100,
            "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
            "psf": {"kind": "gaussian", "sigma_px": 0.8},
        },
        "pointing": {"mode": "rate", "rate_dec_arcsec_s": 0.0}, "stars": {"catalogue": catalogue},
        "output": {"layers": ["dn", "stars_e"]}, "accept": ["moon", "sun", "daylight", "coverage"],
    }  # fmt: skip
    for name, values in changes.items():
        data[name] = data.get(name, {}) | values
    part_s = changes["exposure"]["integration_s"] / parts
    data["exposure"] = {"integration_s": part_s, "frames": parts, "cadence_s": part_s}
    return parse_scene(data)


@pytest.fixture(scope="module")
def catalogue(tmp_path_factory) -> str:
    """Stars of 5th to 13th magnitude all around, and more of them in the middle of the field."""
    folder, dice = tmp_path_factory.mktemp("uneven"), np.random.default_rng(8)
    ra = np.concatenate([dice.uniform(150.0, 240.0, 1500), 192.0 + dice.uniform(-0.7, 0.7, 40)])
    dec = np.concatenate([dice.uniform(-30.0, 40.0, 1500), 5.0 + dice.uniform(-0.4, 0.4, 40)])
    ra = np.concatenate([ra, 179.2 + dice.uniform(-0.9, 0.9, 60)])
    dec = np.concatenate([dec, 5.0 + dice.uniform(-0.4, 0.4, 60)])
    mags = np.concatenate([dice.uniform(1.0, 6.0, 1500), dice.uniform(6.0, 12.0, 100)])
    rows = "".join(
        f"{i + 1},2015.5,{a:.9f},{d:.9f},0,0,{m:.4f}\n"
        for i, (a, d, m) in enumerate(zip(ra, dec, mags, strict=True))
    )
    (folder / "stars.csv").write_text(
        "source_id,ref_epoch,ra,dec,pmra,pmdec,phot_g_mean_mag\n" + rows
    )
    return str(ingest([folder / "stars.csv"], folder / "catalogue").catalogue.path)


def drawn(made: Any, folder: Any) -> np.ndarray:
    """The light of the stars of all frames."""
    render(made, folder, Options("synchronous", 1))
    return open_cube(folder).stars_e.values.sum(axis=0, dtype=float)


@pytest.mark.parametrize("changes", [SINKING, SLEWING], ids=["air", "pupil"])
def test_one_exposure_gathers_what_short_ones_do(catalogue, tmp_path, monkeypatch, changes):
    """In each pixel to what is asked of 0.05 of the noise, and in all; it would be off by many
    times that if the light lay evenly along each streak."""
    parts = drawn(scene(catalogue, changes, PARTS), tmp_path / "parts")
    noise = np.sqrt(25.0 + parts)
    one = drawn(scene(catalogue, changes, 1), tmp_path / "one")
    assert one.sum() == pytest.approx(parts.sum(), rel=1e-5)
    assert (np.abs(one - parts) / noise).max() < 0.01
    monkeypatch.setattr(responses, "star_light", lambda *_: None)
    even = drawn(scene(catalogue, changes, 1), tmp_path / "even")
    assert (np.abs(even - parts) / noise).max() > 0.5


@pytest.mark.parametrize("mag", [0.05, 0.3])
def test_stars_that_set_lose_their_light_once(catalogue, tmp_path, mag):
    """What the air lets through as long as they are seen."""
    setting = copy.deepcopy(SETTING)
    setting["observer"]["atmosphere"]["extinction"]["mag_per_airmass"] = mag
    parts = drawn(scene(catalogue, setting, PARTS), tmp_path / "parts")
    one = drawn(scene(catalogue, setting, 1), tmp_path / "one")
    assert one.sum() == pytest.approx(parts.sum(), rel=3e-4)
    assert (np.abs(one - parts) / np.sqrt(25.0 + parts)).max() < 0.05
