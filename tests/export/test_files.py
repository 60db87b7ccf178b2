"""Exports: FITS headers, PNG pictures, tables, and what is refused."""

from __future__ import annotations

import copy

import numpy as np
import pytest
from astropy.io import fits
from astropy.time import Time
from astropy.wcs import WCS
from PIL import Image

from pipeline.errors import BadInput
from pipeline.export.files import export_frames
from pipeline.export.header import fits_header
from pipeline.export.picture import shrink, stretch
from pipeline.route.run import render
from pipeline.spec.load import parse_scene
from pipeline.store.cube import open_cube, read_layer

SCENE = {
    "schema": "nightglass/scene/1",
    "name": "export",
    "epoch": "2016-12-31T23:59:59.5Z",
    "observer": {"kind": "fixed", "position_au": [0.9, 0.3, 0.1], "velocity_m_s": [0, 29e3, 0]},
    "sensor": {
        "shape": [64, 96],
        "pixel_pitch_um": 20.0,
        "focal_length_m": 0.05,
        "aperture_m": 0.02,
        "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
        "psf": {"kind": "gaussian", "sigma_px": 1.0},
        "bias_dn": 100,
        "read_noise_e": 5,
    },
    "pointing": {
        "mode": "rate",
        "boresight_ra_deg": 359.99,
        "boresight_dec_deg": 89.5,
        "rate_ra_arcsec_s": 10,
        "rate_dec_arcsec_s": -5,
        "roll_deg": 33,
    },
    "exposure": {"integration_s": 1.0, "frames": 2, "cadence_s": 2.0},
    "background": {"uniform_e_per_s": 50},
    "output": {"layers": ["dn", "mean_e"]},
}


@pytest.fixture(scope="module")
def product(tmp_path_factory):
    path = tmp_path_factory.mktemp("export") / "run"
    render(parse_scene(copy.deepcopy(SCENE)), path)
    return path


HALVES = [{"rows": [0, 40], "columns": [0, 96]}, {"rows": [40, 64], "columns": [0, 96]}]


@pytest.mark.parametrize(
    ("sensor", "told"),
    [
        ({"detector": {"nonlinearity": {"kind": "polynomial", "coefficients": [-0.1]}}},
         {"SATURATE": 36_100, "GAIN": 1.0, "BIASLVL": 100.0}),
        ({"detector": {"nonlinearity": {"kind": "table", "true_e": [0, 3e4, 6e4],
                                        "read_e": [0, 2.4e4, 3.6e4]}}}, {"SATURATE": 28_100}),
        ({"detector": {"amplifiers": [HALVES[0] | {"gain_e_per_dn": 4.0, "read_noise_e": 0.0}]}},
         {"SATURATE": 10_100, "GAIN": "amplifiers", "RDNOISE": 0.0, "BIASLVL": 100.0}),
        ({"detector": {"amplifiers": [one | {"gain_e_per_dn": 2.0, "offset_dn": dn}
                                      for one, dn in zip(HALVES, (7, 3), strict=True)]}},
         {"SATURATE": 20_103, "GAIN": 2.0, "BIASLVL": "amplifiers"}),
        ({"gain_e_per_dn": "gain.npy"}, {"GAIN": "image", "SATURATE": None}),
        ({"adc_bits": 12}, {"SATURATE": 4095}),
    ],
    ids=("polynomial", "table", "one amplifier", "amplifiers alone", "an image", "converter"),
)  # fmt: skip
def test_cards_of_the_sensor_hold_for_every_pixel(sensor, told, tmp_path, monkeypatch):
    """SATURATE is the least that a saturated pixel reads; what differs is no number."""
    monkeypatch.chdir(tmp_path)
    np.save("gain.npy", np.full((64, 96), 2.0))
    scene = copy.deepcopy(SCENE)
    scene["sensor"] |= {"read_noise_e": 0.0, "full_well_e": 40_000.0, **sensor}
    scene["background"]["uniform_e_per_s"] = 1e9
    scene["exposure"]["frames"] = 1
    render(parse_scene(scene), tmp_path / "run")
    (path,) = export_frames(tmp_path / "run", "fits", tmp_path / "out")
    with fits.open(path) as hdus:
        header, least = hdus[0].header, int(hdus[0].data.min())
    assert {key: header.get(key) for key in told} == told
    assert header.get("SATURATE", least) == least


def test_a_catalogue_may_have_any_name(product):
    """A FITS header holds printable ASCII alone (FITS 4.0, 4.2.1): the rest are question marks."""
    cube = open_cube(product).assign_attrs(catalogue="Müllers Sterne\n", catalogue_digest="0123")
    cards = fits_header(cube, 0, "dn")
    assert fits.Header(cards)["CATALOG"] == "M?llers Sterne?"


@pytest.mark.parametrize("amplifiers", [(), HALVES], ids=("one", "amplifiers"))
def test_gain_is_of_the_layer_that_the_file_holds(amplifiers, tmp_path):
    """The photon noise of electrons is that of a gain of 1, and no bias is left in them, whatever
    the outputs' gains. SExtractor with the raw gain of 1.5 told 12% too small errors."""
    scene = copy.deepcopy(SCENE)
    scene["sensor"] |= {"gain_e_per_dn": 1.5, "read_noise_e": 3.0}
    if amplifiers:
        own = [one | {"gain_e_per_dn": g} for one, g in zip(amplifiers, (1.4, 1.6), strict=True)]
        scene["sensor"]["detector"] = {"amplifiers": own}
    scene["output"]["layers"] = ["dn", "mean_e", "calibrated_e"]
    render(parse_scene(scene), tmp_path / "run")
    for layer in ("mean_e", "calibrated_e"):
        (path,) = export_frames(tmp_path / "run", "fits", tmp_path / f"{layer}.fits", 0, layer)
        header = fits.getheader(path)
        keys = ("BUNIT", "GAIN", "RDNOISE", "BIASLVL", "SATURATE")
        assert [header.get(key) for key in keys] == ["electron", 1.0, 3.0, None, None]


def test_each_frame_tells_what_its_own_dwell_follows(tmp_path):
    scene = copy.deepcopy(SCENE)
    own = {"mode": "sidereal", "boresight_ra_deg": 10, "boresight_dec_deg": 0}
    scene["dwells"] = [{"frames": 2}, {"frames": 1, "pointing": own}]
    render(parse_scene(scene), tmp_path / "run")
    paths = export_frames(tmp_path / "run", "fits", tmp_path / "out")
    assert [fits.getheader(path)["TRKMODE"] for path in paths] == ["rate", "rate", "sidereal"]


def test_fits(product, tmp_path):
    """Both frames, with times across the leap second of 2016, pixels and two WCS near the pole."""
    first, second = export_frames(product, "fits", tmp_path / "out")
    with fits.open(first, checksum=True) as hdus:
        header = hdus[0].header
        assert np.array_equal(hdus[0].data, read_layer(product, "dn", 0))
        assert header["DATE-OBS"].startswith("2016-12-31T23:59:59.5")
        assert header["DATE-AVG"] == "2016-12-31T23:59:60.000000"
        assert header["DATE-END"] == "2016-12-31T23:59:60.500000"
        times = [Time(header[f"DATE-{key}"], scale="utc") for key in ("BEG", "AVG", "END")]
        assert [(t - times[0]).sec for t in times] == pytest.approx([0.0, 0.5, 1.0], abs=1e-6)
        assert header["EXPTIME"] == 1.0
        assert header["TIMESYS"] == "UTC"
        assert header["SYNTHSTR"] is False
    with fits.open(second) as hdus:
        assert hdus[0].header["DATE-OBS"].startswith("2017-01-01T00:00:00.5")
        assert hdus[0].header["FRAME"] == 1
    apparent, astrometric = WCS(header, key="A"), WCS(header)
    x, y = np.array([0.0, 95.0, 47.5, 3.0]), np.array([0.0, 63.0, 31.5, 60.0])
    ra, dec = astrometric.all_pix2world(x, y, 0)
    back = astrometric.all_world2pix(ra, dec, 0)
    assert np.abs(np.array(back) - [x, y]).max() < 1e-6
    u, v = (_vectors(*w.all_pix2world(x, y, 0)) for w in (astrometric, apparent))
    shift = np.degrees(np.linalg.norm(u - v, axis=1)) * 3600
    assert 5.0 < shift.min() <= shift.max() < 25.0  # aberration of 29 km/s, up to 20.5 arcsec


def _vectors(ra_deg, dec_deg):
    ra, dec = np.radians(ra_deg), np.radians(dec_deg)
    return np.stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)], -1)


def test_png(product, tmp_path):
    (path,) = export_frames(product, "png", tmp_path / "one.png", frame=1, layer="mean_e")
    assert Image.open(path).size == (96, 64)


def test_limits_refused(product, tmp_path):
    (tmp_path / "there.fits").write_text("mine")
    cases = [
        (("gif", tmp_path / "x"), "--to"),
        (("fits", tmp_path / "x", 2), "--frame"),
        (("fits", tmp_path / "x", 0, "stars_e"), "--layer"),
        (("fits", tmp_path / "x.fits"), "-o"),
        (("fits", tmp_path / "there.fits", 0), "-o"),
    ]
    for arguments, field in cases:
        with pytest.raises(BadInput) as caught:
            list(export_frames(product, *arguments))
        assert caught.value.field == field
    assert (tmp_path / "there.fits").read_text() == "mine"


def test_pictures_of_flat_and_tiny_images():
    assert stretch(np.full((5, 5), 7)).shape == (5, 5)
    assert stretch(np.full((5, 5), 2.0**63)).max() == 0  # no level lies 12 above it
    assert stretch(np.zeros((1, 1))).dtype == np.uint8
    small, factor = shrink(np.ones((1, 5000)))
    assert small.shape[1] <= 5000
    assert factor >= 1
    assert shrink(np.ones((3000, 3000)))[0].shape == (1000, 1000)


def test_texts_of_a_header_fit_their_cards(product):
    """Also where a scene's name and the path of its catalogue do not."""
    with open_cube(product) as cube:
        texts = {"title": "night " * 40, "catalogue": "/sky" * 40, "catalogue_digest": "e" * 64}
        cards = fits_header(cube.assign_attrs(texts), 0, "dn")
    given = {key: value for key, value, _ in cards}
    assert given["CATALOG"].startswith("/sky/sky")
    assert {len(fits.Card(key, value).image) for key, value in given.items()} == {80}


def test_a_header_says_why_it_has_no_apparent_wcs(tmp_path):
    """Of a distortion that no terms of TPV hold; the primary WCS is there all the same."""
    data = copy.deepcopy(SCENE) | {"exposure": {"integration_s": 1.0, "frames": 1}}
    data["sensor"]["focal_length_m"] = 0.00264  # 40 degrees
    data["sensor"]["distortion"] = {"kind": "radial", "k1": -0.8, "k2": 0.6, "k3": -0.1}
    render(parse_scene(data), tmp_path / "run")
    (path,) = export_frames(tmp_path / "run", "fits", tmp_path / "out")
    header = fits.getheader(path)
    assert list(header["COMMENT"]) == [
        "No WCS A: TPV terms leave over 0.001 px of the distortion."
    ]
    assert header["CTYPE1"] == "RA---TAN-SIP"
    assert not [key for key in header if key.startswith(("CTYPE", "PV")) and key.endswith("A")]
