"""Kinds of point-spread functions in a scene: what is taken, and what is refused and how."""

from __future__ import annotations

from typing import Any

import pytest

from pipeline.errors import BadInput
from pipeline.spec.load import parse_scene

Data = dict[str, Any]

GOOD: list[Data] = [
    {"kind": "gaussian", "sigma_px": 2.0, "sigma_minor_px": 0.5, "angle_deg": 30.0},
    {"kind": "airy", "wavelengths": 3, "defocus_um": -20.0,
     "vanes": {"count": 4, "width_m": 0.01, "angle_deg": 45.0},
     "aberrations": [{"noll": 8, "rms_nm": 30.0}, {"noll": 11, "rms_waves": -0.1}]},
    {"kind": "airy", "wavelength_nm": 650.0, "wavelengths": 1},
    {"kind": "moffat", "fwhm_px": 2.5},
    {"kind": "moffat", "fwhm_arcsec": 1.2, "beta": 2.5},
    {"kind": "kolmogorov", "fwhm_arcsec": 1.0, "reference_nm": 550.0},
    {"kind": "kolmogorov", "r0_m": 0.1, "diffraction": False},
    {"kind": "kolmogorov", "fwhm_arcsec": 0.8, "outer_scale_m": 25.0},
    {"kind": "table", "path": "psf.npy", "samples_per_px": 32, "centre": [15.5, 16.0]},
    {"kind": "table", "path": "psf.txt", "centre": "file", "includes_pixel": True},
    {"kind": "gaussian", "sigma_px": 1.0, "charge_diffusion_um": 4.0},
]  # fmt: skip


def with_psf(full: Data, psf: Data) -> Data:
    return {**full, "sensor": {**full["sensor"], "psf": psf}}


@pytest.mark.parametrize("psf", GOOD)
def test_kinds_are_taken_and_kept(full: Data, psf: Data) -> None:
    scene = parse_scene(with_psf(full, psf))
    again = parse_scene(scene.as_dict())
    assert again == scene
    for key, value in psf.items():
        kept = scene.as_dict()["sensor"]["psf"][key]
        if key not in ("aberrations", "vanes"):
            assert kept == value or list(kept) == value


@pytest.mark.parametrize(
    ("psf", "field", "allowed"),
    [
        ({"kind": "gaussian", "sigma_px": 1.0, "sigma_minor_px": 1.5}, "sigma_minor_px", "1.0"),
        ({"kind": "airy", "wavelength_nm": 650.0, "wavelengths": 3}, "wavelengths", "1"),
        ({"kind": "airy", "wavelengths": 641}, "wavelengths", "640"),
        ({"kind": "airy", "aberrations": [{"noll": 2, "rms_nm": 5.0}]}, "noll", "4"),
        ({"kind": "airy", "aberrations": [{"noll": 67, "rms_nm": 5.0}]}, "noll", "66"),
        ({"kind": "airy", "aberrations": [{"noll": 4}]}, "rms_nm", "exactly one"),
        ({"kind": "airy", "aberrations": [{"noll": 4, "rms_nm": 1.0}] * 2}, "aberrations", "once"),
        ({"kind": "airy", "vanes": {"count": 0, "width_m": 0.01}}, "count", "1"),
        ({"kind": "airy", "vanes": {"count": 4, "width_m": 0.0}}, "width_m", "greater than"),
        ({"kind": "airy", "vanes": {"count": 4, "width": 0.1}}, "width", "width_m"),
        ({"kind": "moffat"}, "fwhm_px", "exactly one"),
        ({"kind": "moffat", "fwhm_px": 1.0, "fwhm_arcsec": 1.0}, "fwhm_px", "exactly one"),
        ({"kind": "moffat", "fwhm_px": 1.0, "beta": 1.2}, "beta", "1.5"),
        ({"kind": "kolmogorov"}, "fwhm_arcsec", "exactly one"),
        ({"kind": "kolmogorov", "fwhm_arcsec": 1.0, "r0_m": 0.1}, "fwhm_arcsec", "exactly one"),
        ({"kind": "kolmogorov", "r0_m": 0.1, "outer_scale_m": 0.0}, "outer_scale_m", "0.1"),
        ({"kind": "table"}, "path", "must be given"),
        ({"kind": "table", "path": "a", "sample_um": 1.0, "samples_per_px": 2}, "sample_um", "one"),
        ({"kind": "table", "path": "a", "light_fraction": 0.0}, "light_fraction", "greater than"),
        ({"kind": "table", "path": "a", "centre": "corner"}, "centre", "middle"),
        ({"kind": "gaussian", "sigma_px": 1.0, "charge_diffusion_px": 0.1,
          "charge_diffusion_um": 1.0}, "charge_diffusion_um", "instead"),
    ],
)  # fmt: skip
def test_bad_values_name_field_and_remedy(full: Data, psf: Data, field: str, allowed: str) -> None:
    with pytest.raises(BadInput) as error:
        parse_scene(with_psf(full, psf))
    text = str(error.value)
    assert "sensor.psf" in text
    assert field in text
    assert allowed in text


def test_diffusion_in_pixels_or_micrometres(full: Data) -> None:
    um = parse_scene(with_psf(full, {"kind": "airy", "charge_diffusion_um": 6.75})).sensor.psf
    px = parse_scene(with_psf(full, {"kind": "airy", "charge_diffusion_px": 0.5})).sensor.psf
    assert um.diffusion_px(13.5) == px.diffusion_px(13.5) == 0.5
