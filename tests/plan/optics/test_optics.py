"""The optics that a scene asks for: kinds, units, bands, vanes' shadow, and their description."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from pipeline.errors import BadInput
from pipeline.physics.psf.aperture import Pupil
from pipeline.physics.psf.band import Mixture
from pipeline.physics.psf.pupil import Airy, EllipticalGaussian
from pipeline.physics.psf.sampled import sampled
from pipeline.physics.psf.seeing import Kolmogorov, Moffat
from pipeline.physics.radiometry import box, collecting_area_m2
from pipeline.plan.facts import Facts, gather_facts
from pipeline.plan.optics.decisions import _changes
from pipeline.plan.optics.optics import describe, optics_remarks, seeing_remarks
from pipeline.plan.pointing.geometry import camera_of, plan_geometry
from pipeline.plan.response.responses import plan_responses
from pipeline.spec.scene import Scene

Make = Callable[..., Scene]
Q = 1.0 / (0.4 * 10e-6)  # px per metre of wavelength, of the scene's telescope
IFOV = 10e-6


def facts_of(s: Scene, **more: Any) -> Facts:
    return gather_facts(s, box(400e-9, 900e-9), 0.0, 5.0, 1.0, **more)


@pytest.mark.parametrize(
    ("aperture_m", "times"), [(0.2, ""), (2.0, ""), (2.02, "1.02 times"), (20.0, "100 times")]
)
def test_apertures_that_no_optics_has_are_told(scene: Make, aperture_m: float, times: str) -> None:
    """Of 1 m of focal length: a pixel sees at most pi of the sky's radiance, that of F/0.5."""
    told = optics_remarks(scene({"sensor.aperture_m": aperture_m}))
    assert len(told) == bool(times)
    assert all(f"{times} what any could collect" in sentence for sentence in told)


@pytest.mark.parametrize(("elevation_deg", "wider"), [(89.0, ""), (30.0, "1.5"), (12.0, "2.6")])
def test_seeing_away_from_the_zenith_is_told(
    scene: Make, elevation_deg: float, wider: str
) -> None:
    """Airmass to 0.6; nothing near the zenith, and nothing of an image without seeing."""
    site = {
        "observer": {"kind": "ground", "latitude_deg": 20, "longitude_deg": 30, "height_m": 3000},
        "pointing": {"mode": "local", "azimuth_deg": 10.0, "elevation_deg": elevation_deg},
    }
    air = scene(site | {"sensor.psf": {"kind": "kolmogorov", "fwhm_arcsec": 1.0}})
    told = seeing_remarks(air, plan_geometry(air, np.array([0]), 0.0))
    assert len(told) == bool(wider)
    assert all(f"is {wider} times as wide at {elevation_deg:.2g}" in said for said in told)
    gaussian = scene(site)
    assert seeing_remarks(gaussian, plan_geometry(gaussian, np.array([0]), 0.0)) == []


def test_airy_over_its_band_as_the_accuracy_asks(scene: Make) -> None:
    f = facts_of(scene({"sensor.psf": {"kind": "airy"}}))
    assert isinstance(f.blur.optics, Mixture)
    assert f.band is not None
    assert f.band.error <= 1e-3 < f.band.error_of_one
    rough = facts_of(scene({"sensor.psf": {"kind": "airy"}, "accuracy": {"flux_fraction": 0.1}}))
    assert isinstance(rough.blur.optics, Airy)
    assert rough.blur.optics.q_px == pytest.approx(rough.mean_wavelength_m * Q, rel=1e-12)
    one = facts_of(scene({"sensor.psf": {"kind": "airy", "wavelengths": 1}}))
    assert one.blur.optics == rough.blur.optics
    four = facts_of(scene({"sensor.psf": {"kind": "airy", "wavelengths": 4}}))
    assert four.band is not None
    assert len(four.band.wavelengths_m) == 4


def test_a_band_is_resolved_where_anything_is_drawn_with_it(scene: Make) -> None:
    """Members of a population too, of which none is known yet."""
    airy = {"kind": "airy", "wavelengths": 2}
    ball = {"kind": "sphere", "diameter_m": 1.0, "albedo": 0.2}
    crowd = {"populations": [{"name": "crowd", "path": "crowd.tle", "body": ball}]}
    for drawn, many in ((crowd, True), ({}, False)):
        band = facts_of(scene({"sensor.psf": airy, "stars": None} | drawn)).band
        assert band is not None
        assert (len(band.wavelengths_m) > 1) == many


def test_vanes_and_wavefronts_in_waves_of_each_wavelength(scene: Make) -> None:
    psf = {
        "kind": "airy", "wavelengths": 2, "defocus_um": 20.0,
        "vanes": {"count": 4, "width_m": 0.02, "angle_deg": 90.0},
        "aberrations": [{"noll": 11, "rms_nm": 65.0}, {"noll": 8, "rms_waves": 0.1}],
    }  # fmt: skip
    f = facts_of(scene({"sensor.psf": psf}))
    assert isinstance(f.blur.optics, Mixture)
    assert f.band is not None
    for part, wavelength in zip(f.blur.optics.parts, f.band.wavelengths_m, strict=True):
        assert isinstance(part, Pupil)
        waves = dict(part.waves)
        assert waves[11] == pytest.approx(65e-9 / wavelength)
        assert waves[8] == pytest.approx(0.1 * f.mean_wavelength_m / wavelength)
        assert waves[4] == pytest.approx(20e-6 / (8 * 2.5**2) / (2 * np.sqrt(3)) / wavelength)
        assert part.vanes is not None
        assert part.vanes.width == pytest.approx(0.05)
    shadow = 4 * 0.02 * 0.2 * 0.7
    assert f.area_m2 == pytest.approx(collecting_area_m2(0.4, 0.3) - shadow, rel=3e-3)


def test_seeing_in_arcsec_and_r0(scene: Make) -> None:
    by_width = facts_of(
        scene({"sensor.psf": {"kind": "kolmogorov", "fwhm_arcsec": 4.0, "wavelength_nm": 500.0}})
    )
    assert isinstance(by_width.blur.optics, Kolmogorov)
    assert by_width.blur.optics.fwhm_px == pytest.approx(np.radians(4.0 / 3600) / IFOV, rel=1e-9)
    assert by_width.blur.optics.telescope is not None
    assert by_width.blur.optics.telescope.q_px == pytest.approx(500e-9 * Q, rel=1e-12)
    air = {"kind": "kolmogorov", "r0_m": 0.03, "wavelength_nm": 800.0, "diffraction": False}
    optics = facts_of(scene({"sensor.psf": air})).blur.optics
    expected = 800e-9 / (0.03 * 1.6**1.2) / IFOV
    assert isinstance(optics, Kolmogorov)
    assert optics.telescope is None
    assert optics.lambda_over_r0_px == pytest.approx(expected, rel=1e-9)
    moffat = facts_of(scene({"sensor.psf": {"kind": "moffat", "fwhm_arcsec": 4.0, "beta": 3.0}}))
    assert isinstance(moffat.blur.optics, Moffat)
    assert moffat.blur.optics.fwhm_px == pytest.approx(by_width.blur.optics.fwhm_px)
    assert moffat.band is None


def test_other_kinds_and_the_pixel(scene: Make) -> None:
    psf = {"kind": "gaussian", "sigma_px": 2.0, "sigma_minor_px": 1.0, "angle_deg": 90.0,
           "charge_diffusion_um": 3.0}  # fmt: skip
    blur = facts_of(scene({"sensor.psf": psf})).blur
    assert blur.optics == EllipticalGaussian(2.0, 1.0, np.pi / 2)
    assert blur.diffusion_px == pytest.approx(0.3)
    falls = np.exp(-0.5 * (np.arange(-20, 21) / 4.0) ** 2)
    table = sampled(np.outer(falls, falls), 0.25, "middle", 0.8)
    psf = {"kind": "table", "path": "x.npy", "includes_pixel": True}
    s = scene({"sensor.psf": psf})
    f = facts_of(s, table=table)
    assert f.blur.optics is table
    assert f.blur.pixel_in_optics
    r = plan_responses(s, f, camera_of(s), plan_geometry(s, np.array([0, 4]), 0.0))
    assert r.lost_light == pytest.approx(0.2)


@pytest.mark.parametrize(
    "psf",
    [
        {"kind": "airy"}, {"kind": "moffat", "fwhm_px": 3.0, "beta": 2.5},
        {"kind": "moffat", "fwhm_px": 3.0}, {"kind": "kolmogorov", "fwhm_arcsec": 4.0},
        {"kind": "airy", "vanes": {"count": 3, "width_m": 0.01}}, {"kind": "table", "path": "x"},
    ],
)  # fmt: skip
def test_every_kind_is_planned_and_told(scene: Make, psf: dict[str, Any]) -> None:
    s = scene({"sensor.psf": psf})
    table = sampled(np.hanning(65)[:, None] * np.hanning(65)[None, :], 1 / 16, "middle")
    f = facts_of(s, table=table if psf["kind"] == "table" else None)
    r = plan_responses(s, f, camera_of(s), plan_geometry(s, np.array([0, 4]), 0.0))
    assert r.lost_light <= 1.1e-3
    assert [c.radius_px for c in r.classes] == sorted(c.radius_px for c in r.classes)
    errors = [c.wing_error for c in r.classes if c.wing_error > 1e-14]
    assert errors == sorted(errors, reverse=True)
    json.dumps(describe(r.blur.optics))


def test_defocus_is_added_to_a_wavefront_that_has_some(scene: Make) -> None:
    """Noll's fourth term in nm, and a detector off best focus: their sum, each with its sign."""
    for defocus_um in (20.0, -20.0):
        psf = {"kind": "airy", "wavelength_nm": 500.0, "defocus_um": defocus_um,
               "aberrations": [{"noll": 4, "rms_nm": 50.0}]}  # fmt: skip
        optics = facts_of(scene({"sensor.psf": psf})).blur.optics
        assert isinstance(optics, Pupil)
        off = defocus_um * 1e-6 / (8 * 2.5**2) / (2 * np.sqrt(3))
        assert dict(optics.waves)[4] == pytest.approx((50e-9 + off) / 500e-9)


def test_light_changes_along_a_streak_by_the_cosine_off_axis(scene: Make) -> None:
    """The boresight turns by h to either side of mid-exposure: of a star in a corner at (x, y)
    tan, the cosine changes by x sin h + 1 - cos h of itself at most."""
    turned = np.radians(1.0)
    s = scene({
        "sensor.focal_length_m": 0.02,
        "pointing": {
            "mode": "rate", "boresight_ra_deg": 40.0, "boresight_dec_deg": 0.0,
            "rate_ra_arcsec_s": 3600.0, "rate_dec_arcsec_s": 0.0,
        },
    })  # fmt: skip
    found = _changes(s, camera_of(s), plan_geometry(s, np.array([0]), 0.0))
    expected = 383.5 * 10e-6 / 0.02 * np.sin(turned) + 1.0 - np.cos(turned)
    assert found == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("beta", [4.765, 50.0])
def test_a_width_in_arcsec_is_held_to_that_in_px(scene: Make, beta: float) -> None:
    """0.1 to 100 px, of pixels of 2.063 or 0.6875 arcsec, however little light its wings hold."""

    def planned(fwhm_arcsec: float, focal_length_m: float) -> Facts:
        moffat = {"kind": "moffat", "fwhm_arcsec": fwhm_arcsec, "beta": beta}
        return facts_of(scene({"sensor.psf": moffat, "sensor.focal_length_m": focal_length_m}))

    for fwhm_arcsec, focal_length_m in ((1e-160, 1.0), (1e-3, 1.0), (0.206, 1.0), (69.0, 3.0)):
        with pytest.raises(BadInput, match=r"arcsec, 0\.1 to 100 px") as told:
            planned(fwhm_arcsec, focal_length_m)
        assert told.value.field == "sensor.psf.fwhm_arcsec"
    assert planned(0.207, 1.0).blur.optics.scale_px > 0.1
    assert planned(68.0, 3.0).blur.optics.scale_px < 100.0
