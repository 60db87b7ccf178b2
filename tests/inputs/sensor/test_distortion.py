"""Distortions from FITS headers: what astropy.wcs sees of them, less the pointing."""

from __future__ import annotations

import copy
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits
from astropy.wcs import WCS

from pipeline.errors import BadInput
from pipeline.inputs.sensor.distortion import gather_distortion, read_distortion
from pipeline.plan.pointing.geometry import camera_of
from pipeline.spec.load import parse_scene

SCENE = {
    "schema": "nightglass/scene/1", "name": "lens", "epoch": "2019-10-20T05:42:30Z",
    "observer": {"kind": "fixed", "position_au": [1, 0, 0]},
    "sensor": {
        "shape": [1000, 1200], "pixel_pitch_um": 9.0, "focal_length_m": 1.0, "aperture_m": 0.2,
        "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
        "psf": {"kind": "gaussian", "sigma_px": 1.0},
    },
    "pointing": {"mode": "sidereal", "boresight_ra_deg": 10, "boresight_dec_deg": 20},
    "exposure": {"integration_s": 1.0},
}  # fmt: skip
BASE = {
    "CTYPE1": "RA---TAN", "CTYPE2": "DEC--TAN", "CRVAL1": 210.0, "CRVAL2": -33.0, "CRPIX1": 1500.5,
    "CRPIX2": -200.25, "CD1_1": -2e-4, "CD1_2": 1e-4, "CD2_1": 1e-4, "CD2_2": 2e-4,
    "CUNIT1": "deg", "CUNIT2": "deg",
}  # fmt: skip
SIP = BASE | {"CTYPE1": "RA---TAN-SIP", "CTYPE2": "DEC--TAN-SIP", "A_ORDER": 3, "B_ORDER": 2,
              "A_2_0": 2e-6, "A_0_3": 1e-9, "B_1_1": -3e-6, "AP_ORDER": 2,
              "BP_ORDER": 2}  # fmt: skip
TPV = BASE | {"CTYPE1": "RA---TPV", "CTYPE2": "DEC--TPV", "PV1_0": 1e-3, "PV1_1": 1.002,
              "PV1_4": 4e-3, "PV2_1": 0.999, "PV2_7": 5e-3, "PV2_11": 2e-3}  # fmt: skip


def named(path: Path):
    data = copy.deepcopy(SCENE)
    data["sensor"]["distortion"] = {"kind": "file", "path": str(path)}
    return parse_scene(data)


def write(path: Path, cards: dict, extension: bool = False) -> Path:
    header = fits.Header(cards)
    if extension:
        hdus = [fits.PrimaryHDU(), fits.ImageHDU(np.zeros((2, 2)), header)]
    else:
        hdus = [fits.PrimaryHDU(np.zeros((2, 2)), header)]
    fits.HDUList(hdus).writeto(path)
    return path


@pytest.mark.parametrize("cards", [SIP, TPV], ids=["sip", "tpv"])
@pytest.mark.parametrize("where", ["primary", "extension", "text", "packed"])
def test_against_astropy(cards, where, tmp_path):
    """The displacement is the file's own, but for the constant that keeps the boresight."""
    if where == "text":
        path = tmp_path / "lens.head"
        path.write_text(fits.Header(cards).tostring(sep="\n") + "\nEND     \n")
    else:
        name = "lens.fits.gz" if where == "packed" else "lens.fits"
        path = write(tmp_path / name, cards, where == "extension")
    scene = gather_distortion(named(path))
    camera = camera_of(scene)
    assert scene.sensor.distortion.kind == ("sip" if cards is SIP else "tpv")
    wcs = WCS(fits.Header(cards))
    rng = np.random.default_rng(1)
    x, y = rng.uniform(0, 1200, 300), rng.uniform(0, 1000, 300)
    straight = WCS(fits.Header(BASE))
    there = np.array(straight.all_world2pix(*wcs.all_pix2world(x, y, 0), 0))
    middle = straight.all_world2pix(*wcs.all_pix2world(599.5, 499.5, 0), 0)
    shift = there - [x, y] - (np.array(middle) - [599.5, 499.5])[:, None]
    plane = camera.distortion.to_plane(x - 599.5, y - 499.5)
    assert np.abs(plane - np.array([x - 599.5, y - 499.5]) - shift).max() < 1e-6
    assert np.abs(shift).max() > 0.5
    assert gather_distortion(scene) is scene


def test_cdelt_and_scamp(tmp_path):
    cards = {k: v for k, v in TPV.items() if not k.startswith("CD")}
    cards |= {"CDELT1": -2e-4, "CDELT2": 2e-4, "PC1_2": 0.5, "CTYPE1": "RA---TAN"}
    found = read_distortion(write(tmp_path / "lens.fits", cards | {"CTYPE2": "DEC--TAN"}))
    assert found["cd_deg"] == [[-2e-4, -1e-4], [0.0, 2e-4]]
    assert found["pv2"] == {1: 0.999, 7: 5e-3, 11: 2e-3}
    assert found["reference_px"] == [1499.5, -201.25]


@pytest.mark.parametrize("more", [{"CROTA2": 30.0}, {"CROTA2": 30.0, "PC1_2": 0.5}])
def test_an_older_header_turns_by_crota(more, tmp_path):
    """As astropy has it: where there is no PC."""
    cards = {k: v for k, v in TPV.items() if not k.startswith("CD")}
    cards |= {"CDELT1": -2e-4, "CDELT2": 3e-4} | more
    found = read_distortion(write(tmp_path / "lens.fits", cards))
    if "PC1_2" in more:
        true = np.diag([-2e-4, 3e-4]) @ [[1.0, 0.5], [0.0, 1.0]]
    else:
        true = WCS(fits.Header(cards)).pixel_scale_matrix
    np.testing.assert_allclose(found["cd_deg"], true, rtol=1e-12, atol=1e-18)


def test_a_packed_file_that_is_damaged_is_refused(tmp_path):
    path = write(tmp_path / "lens.fits.gz", SIP)
    whole = bytearray(path.read_bytes())
    whole[12:40] = bytes(28)
    path.write_bytes(whole)
    with pytest.raises(BadInput, match="a readable FITS file or header"):
        read_distortion(path)


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (None, "existing"),
        (b"", "SIP"),
        (b"\x00\xff" * 5000, "SIP"),
        (b"SIMPLE  =                    T" + b" " * 2850, "END card"),
        (BASE, "SIP"),
        (SIP | {"A_ORDER": 10}, "order 9"),
        (SIP | {"B_ORDER": 10}, "order 9"),
        (SIP | {"A_2_0": "much"}, "numbers"),
        (SIP | {"CPDIS1": "LOOKUP"}, "lookup"),
        (TPV | {"PV1_4": 1e200}, "less than or equal"),
        (lambda content: content.replace(b"A_ORDER =  ", b"A_ORDER =x "), "numbers"),
    ],
)
def test_limits_refused(content, told, tmp_path):
    path = tmp_path / "lens.fits"
    if isinstance(content, bytes):
        path.write_bytes(content)
    elif callable(content):
        write(path, SIP)
        path.write_bytes(content(path.read_bytes()))
    elif content:
        write(path, content)
    with pytest.raises(BadInput, match=r"sensor\.distortion") as caught:
        camera_of(gather_distortion(named(path)))
    assert told in str(caught.value)
