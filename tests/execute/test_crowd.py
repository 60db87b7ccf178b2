"""Crowds drawn together, the check of the achieved error, and what both say of themselves."""

from __future__ import annotations

import json
from functools import partial

import numpy as np
import pytest

import pipeline.execute.blocks
import pipeline.execute.tables
import pipeline.execute.tile
import pipeline.plan.response.responses
from catalog_tools.ingest.ingest import ingest
from pipeline.route.prepare import plan_scene
from pipeline.route.run import Options, render
from pipeline.spec.load import parse_scene
from pipeline.store.cube import open_cube
from tests.slow import slow

IFOV_DEG = 2.0 / 3600.0
RA_DEG, DEC_DEG, SIDE = 80.0, 20.0, 600


def ingested(folder, bright_px=()):
    """3,000 stars over and around the frame, G 9 to 18; the first of G 7.5 at given places."""
    rng = np.random.default_rng(5)
    x, y = rng.uniform(-0.6, 0.6, (2, 3000)) * SIDE * IFOV_DEG
    g = np.log10(10**3.15 + rng.uniform(size=3000) * (10**6.3 - 10**3.15)) / 0.35
    for k, place in enumerate(bright_px):
        (x[k], y[k]), g[k] = np.multiply(place, IFOV_DEG), 7.5
    dec = DEC_DEG + y
    ra = RA_DEG + x / np.cos(np.radians(dec))
    rows = ["source_id,ref_epoch,ra,dec,parallax,pmra,pmdec,radial_velocity,phot_g_mean_mag,"
            "phot_bp_mean_mag,phot_rp_mean_mag"]  # fmt: skip
    rows += [
        f"{i + 1},2015.5,{ra[i]:.12f},{dec[i]:.12f},1,0,0,,{g[i]:.6f},{g[i] + 0.4:.6f},"
        f"{g[i] - 0.6:.6f}"
        for i in range(3000)
    ]
    (folder / "stars.csv").write_text("\n".join(rows) + "\n")
    return str(ingest([folder / "stars.csv"], folder / "catalogue").catalogue.path)


@pytest.fixture(scope="module")
def catalogue(tmp_path_factory):
    return ingested(tmp_path_factory.mktemp("crowd"))


def scene(catalogue, psf, streak_px, **more):
    focal = 9e-6 / np.radians(IFOV_DEG)
    data = {
        "schema": "nightglass/scene/1", "name": "crowd", "epoch": "2019-12-01T08:00:00Z",
        "observer": {"kind": "fixed", "position_au": [1, 0, 0]},
        "sensor": {
            "shape": [SIDE, SIDE], "pixel_pitch_um": 9.0, "focal_length_m": focal,
            "aperture_m": 0.08, "obscuration": 0.3,
            "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900}, "psf": psf,
            "read_noise_e": 5.0, "gain_e_per_dn": 1.0, "adc_bits": 20,
        },
        "pointing": {
            "mode": "rate", "boresight_ra_deg": RA_DEG, "boresight_dec_deg": DEC_DEG,
            "rate_ra_arcsec_s": 0.8 * streak_px, "rate_dec_arcsec_s": 0.6 * streak_px,
        },
        "exposure": {"integration_s": 2.0, "frames": 1}, "stars": {"catalogue": catalogue},
        "output": {"layers": ["dn", "stars_e"]},
    }  # fmt: skip
    for key, value in more.items():
        data[key] = data.get(key, {}) | value
    return parse_scene(data)


def stars_of(made, path, scheduler="synchronous"):
    report = render(made, path, Options(scheduler, 2 if scheduler == "threads" else 1))
    return open_cube(path)["stars_e"].values[0].astype(float), report


@pytest.fixture
def crowded(monkeypatch):
    monkeypatch.setattr(pipeline.plan.response.responses, "_spectral_from", lambda *_: 1)


GAUSS, AIRY = {"kind": "gaussian", "sigma_px": 0.8}, {"kind": "airy", "wavelengths": 1}
MOFFAT = {"kind": "moffat", "fwhm_px": 2.5}


@pytest.mark.parametrize(
    ("psf", "streak"),
    [
        (GAUSS, 0.0), (MOFFAT, 0.0), (AIRY, 60.0),
        *(slow(*v)
          for v in ((AIRY, 0.0), (GAUSS, 60.0), (MOFFAT, 60.0))),
    ],
    ids=str,
)  # fmt: skip
def test_engines_agree_within_their_bounds(psf, streak, catalogue, tmp_path, monkeypatch):
    made = scene(catalogue, psf, streak)
    monkeypatch.setattr(pipeline.plan.response.responses, "_spectral_from", lambda *_: 0)
    stamps, _ = stars_of(made, tmp_path / "stamps")
    monkeypatch.setattr(pipeline.plan.response.responses, "_spectral_from", lambda *_: 1)
    together, report = stars_of(made, tmp_path / "together")
    plan = json.loads((tmp_path / "together" / "plan.json").read_text())
    names = [d["component"] for d in plan["decisions"]]
    assert "crowds_by_transforms" in names
    bound = sum(d["error_bound_e"] or 0.0 for d in plan["decisions"] if d["error_bound_sigma"])
    noise = np.sqrt(25.0 + stamps)
    assert not np.array_equal(stamps, together)
    assert (np.abs(stamps - together) / noise).max() <= 2.0 * bound / 5.0
    assert together.sum() == pytest.approx(stamps.sum(), rel=1e-5)
    assert report["errors"]["achieved_error_sigma"] <= 0.05


def test_stars_are_drawn_one_by_one_where_no_grid_serves(catalogue, tmp_path, monkeypatch):
    """Here as a grid may take no memory."""
    none = partial(pipeline.execute.tables.plan_spectral, most_bytes=1.0)
    monkeypatch.setattr(pipeline.execute.tables, "plan_spectral", none)
    found = []
    for least in (0, 1):
        monkeypatch.setattr(
            pipeline.plan.response.responses, "_spectral_from", lambda *_, n=least: n
        )
        found.append(stars_of(scene(catalogue, GAUSS, 7.0), tmp_path / str(least))[0])
    assert found[0].sum() > 5e5
    assert np.array_equal(*found)


@pytest.mark.slow
def test_same_bits_for_every_tile_where_crowds_are_drawn(crowded, catalogue, tmp_path, monkeypatch):
    """Blocks of 256 px, so that tiles hold parts of several."""
    monkeypatch.setattr(pipeline.execute.blocks, "BLOCK_PX", 256)
    whole, report = stars_of(scene(catalogue, AIRY, 60.0), tmp_path / "whole")
    for k, tile in enumerate(([256, 512], [600, 256], [512, 600])):
        made = scene(catalogue, AIRY, 60.0, output={"tile_shape": tile})
        image, other = stars_of(made, tmp_path / str(k), "threads")
        assert np.array_equal(image, whole)
        assert other["content_digest"] == report["content_digest"]
        assert other["errors"]["checked"] == report["errors"]["checked"]


@pytest.mark.parametrize(("psf", "streak"), [(GAUSS, 30.0), (AIRY, 0.0)], ids=str)
def test_blocks_join_without_a_seam(psf, streak, crowded, catalogue, tmp_path, monkeypatch):
    """Also where bright stars, drawn one by one, reach over from far inside the next block."""
    one, _ = stars_of(scene(catalogue, psf, streak), tmp_path / "one")
    monkeypatch.setattr(pipeline.execute.blocks, "BLOCK_PX", 256)
    many, _ = stars_of(scene(catalogue, psf, streak), tmp_path / "many")
    assert (np.abs(one - many) / np.sqrt(25.0 + one)).max() <= 0.05


def test_a_very_bright_star_reaches_into_the_next_tile_of_a_crowd(crowded, tmp_path):
    """To the end of the largest core: the frame in tiles is the frame drawn as one, to the bit."""
    found = ingested(tmp_path, [(16.0, 130.0), (60.0, 152.0)])
    whole, report = stars_of(scene(found, AIRY, 0.0), tmp_path / "whole")
    made = scene(found, AIRY, 0.0, output={"tile_shape": [256, 256]})
    tiles, other = stars_of(made, tmp_path / "tiles")
    assert np.array_equal(tiles, whole)
    assert other["content_digest"] == report["content_digest"]


def test_few_stars_get_no_block(catalogue, tmp_path):
    made = scene(catalogue, GAUSS, 0.0)
    plan = json.loads(json.dumps(plan_scene(made)))
    assert (
        plan["response"]["spectral_from_stars"] > 3000
        or not plan["response"]["spectral_from_stars"]
    )


def test_the_check_finds_an_error_made_on_purpose(catalogue, tmp_path, monkeypatch):
    made = scene(catalogue, GAUSS, 20.0)
    _, honest = stars_of(made, tmp_path / "honest")
    draw = pipeline.execute.tile.draw_stars
    monkeypatch.setattr(pipeline.execute.tile, "draw_stars", lambda *a: 1.02 * draw(*a))
    drawn, wrong = stars_of(made, tmp_path / "wrong")
    good, bad = honest["errors"], wrong["errors"]
    brightest = max(c["brightest_pixel_e"] for c in bad["checked"])
    assert bad["achieved_error_e"] == pytest.approx(0.02 * brightest, rel=0.05)
    assert good["achieved_error_e"] < 0.05 * bad["achieved_error_e"]
    assert 3 <= good["windows"] <= 6  # one or two of each cell
    for c in bad["checked"]:
        rows, columns = slice(c["y0"], c["y0"] + c["rows"]), slice(c["x0"], c["x0"] + c["columns"])
        rms = 0.02 / 1.02 * np.sqrt(np.mean(drawn[rows, columns] ** 2))
        assert c["error_rms_e"] == pytest.approx(rms, rel=0.05)


def test_no_check_where_none_is_asked_for(catalogue, tmp_path):
    _, report = stars_of(scene(catalogue, GAUSS, 0.0, accuracy={"check_cells": 0}), tmp_path / "r")
    assert report["errors"]["windows"] == 0
    assert report["errors"]["achieved_error_e"] is None
