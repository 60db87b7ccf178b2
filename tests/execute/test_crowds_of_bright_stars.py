"""Crowds of bright stars: what they err by together is within what the product states."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from scipy.special import erf

from catalog_tools.ingest.ingest import ingest
from pipeline.commands.options import as_stated
from pipeline.execute import check
from pipeline.physics.drawing.quadrature import draw_quadrature
from pipeline.physics.motion.streak import POINT
from pipeline.physics.psf.pupil import Blur, Gaussian
from pipeline.plan.accuracy import crowd_error_e
from pipeline.route.prepare import prepare
from pipeline.route.run import render
from pipeline.route.truths import _bounds
from pipeline.spec.load import parse_scene
from tests.slow import slow

PIXEL_DEG = np.degrees(1e-5)


def scene(folder: Path, apart_px: float, g_mag: float, psf: dict[str, Any]) -> dict[str, Any]:
    """A frame of 64 pixels with 400 equal stars around its middle."""
    rng = np.random.default_rng(5)
    dx, dy = apart_px * PIXEL_DEG * rng.uniform(-1.0, 1.0, (2, 400))
    rows = [f"{i + 1},{60.0 + a},{b},{g_mag}" for i, (a, b) in enumerate(zip(dx, dy, strict=True))]
    csv = folder / "stars.csv"
    csv.write_text("\n".join(["source_id,ra,dec,phot_g_mean_mag", *rows]) + "\n")
    ingest([csv], folder / "catalogue", form="gaia_dr2", workers=1)
    return {
        "schema": "nightglass/scene/1", "name": "crowd", "epoch": "2019-04-20T11:00:00Z", "seed": 1,
        "observer": {"kind": "fixed", "position_au": [0.9, 0.3, 0.1]},
        "sensor": {
            "shape": [64, 64], "pixel_pitch_um": 10.0, "focal_length_m": 1.0, "aperture_m": 0.4,
            "bandpass": {"kind": "named", "name": "bessell-V"}, "psf": psf, "read_noise_e": 5.0,
            "adc_bits": 32,
        },
        "exposure": {"integration_s": 1.0},
        "pointing": {"mode": "sidereal", "boresight_ra_deg": 60.0, "boresight_dec_deg": 0.0},
        "stars": {"catalogue": str(folder / "catalogue")}, "accept": ["coverage"],
    }  # fmt: skip


def test_wings_of_a_crowd_are_in_the_bound(tmp_path: Path) -> None:
    """400 stars of 3e3 e- within 2 px, each of which the grid serves, are as bright as one that
    it does not: the product says so."""
    data = scene(tmp_path, 1.0, 16.0, {"kind": "airy", "wavelengths": 1})
    report = render(parse_scene(data), tmp_path / "product")
    errors = report["errors"]
    assert errors["windows"] >= 1
    assert errors["achieved_error_sigma"] <= errors["bound_of_all_approximations_sigma"]
    assert errors["wing_error_of_brightest_e"] > prepare(parse_scene(data)).plan.facts.budget_e
    alone = data | {"stars": data["stars"] | {"faintest_g_mag": 1.0}}
    nothing = render(parse_scene(alone), tmp_path / "alone")["errors"]
    assert nothing["wing_error_of_brightest_e"] == 0.0


@pytest.mark.parametrize("photon_noise", [True, False])
def test_bright_stars_in_one_pixel_are_as_stated(tmp_path: Path, photon_noise: bool) -> None:
    """400 stars within a tenth of a pixel, each at the limit of a way of drawing: their noise
    hides what they err by together, or it is stated, and within what was asked or refused."""
    psf = {"kind": "gaussian", "sigma_px": 0.7}
    data = scene(tmp_path, 0.05, 16.0, psf) | {"accept": ["coverage", "error"]}
    data["sensor"] |= {"photon_noise": photon_noise}
    errors = render(parse_scene(data), tmp_path / "product")["errors"]
    assert errors["windows"] >= 1
    assert errors["achieved_error_sigma"] <= errors["bound_of_all_approximations_sigma"]


def test_sharp_light_does_not_end_at_the_centre_of_a_pixel(tmp_path: Path) -> None:
    """Stars beside corners of pixels, whose light ends before the centres of their neighbours."""
    data = scene(tmp_path, 12.0, 6.0, {"kind": "gaussian", "sigma_px": 0.1})
    errors = render(parse_scene(data), tmp_path / "product")["errors"]
    assert errors["windows"] >= 1
    assert errors["achieved_error_sigma"] <= errors["bound_of_all_approximations_sigma"]
    plan = prepare(parse_scene(data)).plan
    x, y = 0.47, 0.49
    drawn = draw_quadrature(
        Blur(Gaussian(0.1)), POINT, (3, 3), (-1, -1), y, x, plan.responses.fades_px
    )
    edges = (np.arange(4) - 1.5) / (0.1 * np.sqrt(2.0))
    along, down = (0.5 * np.diff(erf(edges - c / (0.1 * np.sqrt(2.0)))) for c in (x, y))
    assert drawn == pytest.approx(down[:, None] * along[None, :], abs=1e-12)


def test_of_an_error_that_could_not_be_looked_for_nothing_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither that it is as stated nor exit code 5, where all windows take too long."""
    monkeypatch.setattr(check, "reference", lambda *_: (None, 400))
    data = scene(tmp_path, 1.0, 16.0, {"kind": "gaussian", "sigma_px": 0.8})
    report = render(parse_scene(data), tmp_path / "product")
    assert report["errors"]["windows"] == 0 < report["errors"]["windows_skipped"]
    assert report["errors"]["as_stated"] is None
    as_stated(report)


def test_errors_of_a_crowd() -> None:
    """Those of one cell add up; of 16 cells in a box their squares do; frames stay apart."""
    none, place = np.zeros(100), np.full(100, 3.2)
    assert crowd_error_e(none, place, place, np.full(100, 0.01), 1.0, 40.0) == pytest.approx(1.0)
    x, y = (v.ravel() for v in np.meshgrid(np.arange(4) * 10.0, np.arange(4) * 10.0))
    sides = np.ones(16), 1.0, 40.0
    assert crowd_error_e(np.zeros(16), x, y, *sides) == pytest.approx(4.0)
    assert crowd_error_e(np.arange(16), x, y, *sides) == pytest.approx(1.0)
    assert crowd_error_e(none[:0], none[:0], none[:0], none[:0], 1.0, 40.0) == 0.0


@pytest.mark.parametrize(("g_mag", "least_e"), [(5.0, 5e6), slow(2.5, 5e7)])
def test_one_bright_star_of_a_streaked_frame_is_as_stated(
    tmp_path: Path, g_mag: float, least_e: float
) -> None:
    """A star of magnitude 5 or 2.5 trails through a frame too large to sweep it along its own
    path, while faint stars get the smallest cores: what its wings err by is within what was
    asked."""
    data = scene(tmp_path, 200.0, 16.0, {"kind": "airy", "jitter_px": 0.5})
    csv = tmp_path / "bright.csv"
    csv.write_text(f"source_id,ra,dec,phot_g_mean_mag\n1,60.0,0.0,{g_mag}\n2,60.001,0.001,16\n")
    ingest([csv], tmp_path / "both", form="gaia_dr2", workers=1)
    sensor = data["sensor"] | {
        "shape": [2048, 2048], "focal_length_m": 0.4, "aperture_m": 0.2, "obscuration": 0.3,
        "bandpass": {"kind": "box", "short_nm": 450, "long_nm": 850}, "read_noise_e": 12.0,
    }  # fmt: skip
    pointing = {
        "mode": "rate", "boresight_ra_deg": 60.0, "boresight_dec_deg": 0.0,
        "rate_ra_arcsec_s": 15.0, "rate_dec_arcsec_s": 0.0,
    }  # fmt: skip
    data |= {
        "sensor": sensor, "pointing": pointing, "exposure": {"integration_s": 3.0},
        "stars": {"catalogue": str(tmp_path / "both")}, "accuracy": {"noise_fraction": 0.1},
    }  # fmt: skip
    errors = render(parse_scene(data), tmp_path / "product")["errors"]
    assert errors["brightest_source_e"] > least_e
    assert errors["achieved_error_sigma"] <= errors["bound_of_all_approximations_sigma"]
    assert errors["bound_of_all_approximations_sigma"] <= 0.1


def test_a_crowd_errs_by_the_light_that_falls(tmp_path: Path) -> None:
    """Truth holds what a sensor collects; at a fill factor of a half twice as much falls on it."""
    rng = np.random.default_rng(8)
    x_px, y_px = rng.uniform(30.0, 34.0, (2, 50))
    light_e = np.full(50, 300.0)
    columns = {"frame": np.zeros(50, int), "x_px": x_px, "y_px": y_px, "electrons": light_e}
    table = pa.table(columns)
    plan = prepare(parse_scene(scene(tmp_path, 200.0, 16.0, {"kind": "airy"}))).plan
    r = plan.responses

    def errs_e(fill: float, limit_e: float) -> float:
        one = replace(r.classes[0], brightest_e=limit_e, wing_error=1e-3)
        blur = replace(r.blur, fill_factor=fill)
        changed = replace(plan, responses=replace(r, classes=(one,), blur=blur))
        return _bounds(changed, "stars", table).errors_e["wings_on_a_coarse_grid"]

    assert errs_e(1.0, 1e9) == pytest.approx(crowd_error_e(
        np.zeros(50), x_px, y_px, np.full(50, 0.3), *r.crowd_sides_px
    ))  # fmt: skip
    assert errs_e(0.5, 1e9) == pytest.approx(2.0 * errs_e(1.0, 1e9))
    assert errs_e(0.5, 500.0) == 0.0  # brighter than the class whose wings err
