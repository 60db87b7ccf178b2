"""SatNet, COCO, masks and movies: read back by others' readers; and what is refused."""

from __future__ import annotations

import json
import sys
import warnings

import numpy as np
import pytest
from astropy.io import fits
from astropy.wcs import WCS, FITSFixedWarning
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from PIL import Image

from pipeline.errors import BadInput
from pipeline.export.coco import packed, run_lengths
from pipeline.export.formats import Wish, export_product
from pipeline.export.masks import Mask
from pipeline.store.cube import read_layer

STARS = Wish(stars_snr=10.0)


@pytest.fixture(scope="module")
def coco(labelled, tmp_path_factory):
    folder = tmp_path_factory.mktemp("coco") / "out"
    *_, path = export_product(labelled, "coco", folder, STARS)
    return path


def test_against_pycocotools(labelled, coco):
    """Masks, boxes and areas as COCO's own library reads them; the image is the raw frame."""
    reader = pytest.importorskip("pycocotools.coco").COCO(str(coco))
    assert [reader.cats[k]["name"] for k in (1, 2)] == ["satellite", "star"]
    assert len(reader.imgs) == 2
    for one in reader.anns.values():
        mask = reader.annToMask(one).astype(bool)
        assert mask.shape == (512, 512)
        assert mask.sum() == one["area"] > 0
        y, x = np.nonzero(mask)
        width, height = np.ptp(x) + 1, np.ptp(y) + 1
        assert one["bbox"] == [x.min(), y.min(), width, height]
        near_x, near_y = one["keypoints"][3:5]
        assert x.min() - 1 <= near_x <= x.max() + 1
        assert y.min() - 1 <= near_y <= y.max() + 1
    picture = Image.open(coco.parent / "images" / reader.imgs[1]["file_name"])
    assert np.array_equal(np.asarray(picture), read_layer(labelled, "dn", 0))


def test_masks_hold_the_pixels_that_the_light_says(labelled, tmp_path):
    """Classes from responses and paths against those from the noise-free layers, and their sum."""
    out = {
        light: next(export_product(
            labelled, "masks", tmp_path / light, Wish(0, stars_snr=0.0, light=light)
        ))
        for light in ("response", "layers")
    }  # fmt: skip
    with fits.open(out["response"]) as a, fits.open(out["layers"]) as b:
        drawn, light = a["CLASS"].data, b["CLASS"].data
        threshold = a[0].header["THRESH"]
        names = a["SOURCES"].data["name"]
        owner = a["SOURCE"].data
        assert a[0].header["CLASSBY"] == "response"
        assert b[0].header["CLASSBY"] == "layers"
        assert np.array_equal(owner, b["SOURCE"].data)
        assert_each_pixel_is_its_own_sources(a["SOURCES"].data, owner, drawn)
    assert list(names[:2]) == ["drifter", "geo-1"] or list(names[:2]) == ["geo-1", "drifter"]
    assert set(np.unique(drawn)) == {0, 1, 2}
    for kind in (1, 2):
        one, other = drawn == kind, light == kind
        assert (one ^ other).sum() < 0.06 * other.sum()  # edges: paths and places to 1/16 px
    stars = read_layer(labelled, "stars_e", 0).astype(float)
    differ = (drawn == 2) ^ (stars >= threshold)
    assert np.abs(np.log(stars[differ] / threshold)).max() < 0.6
    assert owner.max() == len(names)


def assert_each_pixel_is_its_own_sources(sources, owner, drawn):
    """Numbers name rows of the table, of the pixel's class; stars stand 80 px apart, so that the
    star of a pixel is the nearest one, and a target's pixels lie about its place."""
    y, x = np.nonzero(owner)
    number = owner[y, x]
    assert number.min() >= 1
    assert number.max() <= len(sources)
    assert np.array_equal(sources["number"], np.arange(1, len(sources) + 1))
    kind = np.zeros(owner.shape, int)
    kind[y, x] = sources["class"][number - 1]
    assert np.array_equal(kind, drawn)
    away = np.hypot(x[:, None] - sources["x"][None], y[:, None] - sources["y"][None])
    own = away[np.arange(len(number)), number - 1]
    star = sources["class"][number - 1] == 2
    assert np.array_equal(own[star], away[:, sources["class"] == 2].min(axis=1)[star])
    assert own.max() < 40.0
    assert len(np.unique(number)) >= 30  # nearly all 38 sources own pixels


@given(arrays(bool, st.tuples(st.integers(1, 12), st.integers(1, 9))), st.integers(0, 3))
def test_run_lengths_against_pycocotools(pixels, border):
    reader = pytest.importorskip("pycocotools.mask")
    whole = np.pad(pixels, border)
    mask = Mask(border, border, np.ones(pixels.shape), pixels)
    counts = run_lengths(mask, whole.shape)
    assert sum(counts) == whole.size
    wanted = reader.encode(np.asfortranarray(whole.astype(np.uint8)))
    assert packed(counts).encode() == wanted["counts"]


@given(st.lists(st.integers(1, 2**31), min_size=1, max_size=30))
def test_packed_counts_come_back(counts):
    """Runs of any length, by the decoder of COCO's library where lengths allow it."""
    text = packed(counts)
    assert _unpacked(text) == counts


def _unpacked(text):
    counts, at = [], 0
    while at < len(text):
        value = shift = 0
        while True:
            letter = ord(text[at]) - 48
            at += 1
            value |= (letter & 31) << shift
            shift += 5
            if not letter & 32:
                if letter & 16:
                    value -= 1 << shift
                break
        counts.append(value + (counts[-2] if len(counts) > 2 else 0))
    return counts


def test_movies(labelled, tmp_path):
    (gif,) = export_product(labelled, "gif", tmp_path / "a.gif", Wish(fps=4.0))
    picture = Image.open(gif)
    assert (picture.n_frames, picture.size, picture.info["duration"]) == (2, (512, 512), 250)
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    (mp4,) = export_product(labelled, "mp4", tmp_path / "a.mp4", Wish())
    reader = ffmpeg.read_frames(str(mp4))
    assert next(reader)["size"] == (512, 512)
    assert len(list(reader)) == 2
    assert [p.name for p in tmp_path.iterdir()] in (["a.gif", "a.mp4"], ["a.mp4", "a.gif"])


def test_without_an_encoder(labelled, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(BadInput, match=r"nightglass\[movie\]"):
        list(export_product(labelled, "mp4", tmp_path / "a.mp4", Wish()))
    assert not list(tmp_path.iterdir())


def test_header_tells_site_and_sensor(labelled, tmp_path):
    """astropy reads both WCS and the site; it says that SIP is not for the alternate one."""
    (path,) = export_product(labelled, "fits", tmp_path / "a.fits", Wish(0))
    header = fits.getheader(path)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        world = WCS(header)
        warnings.filterwarnings("ignore", "Removed redundant SIP", FITSFixedWarning)
        assert WCS(header, key="A").wcs.name == "APPARENT"
    assert world.wcs.dateavg == "2019-07-20T09:00:00.500000"
    from astropy.coordinates import EarthLocation

    site = EarthLocation.from_geodetic(-156.3, 20.7, 3055.0)
    told = [header[f"OBSGEO-{axis}"] for axis in "XYZ"]
    assert np.allclose(told, [v.to_value("m") for v in site.geocentric], atol=1e-3)
    assert header["GAIN"] == 1.5
    assert header["SATURATE"] == min(65535, int(90000 / 1.5 + 500))
    assert header["SECPIX"] == pytest.approx(np.degrees(9e-6) * 3600)


@pytest.mark.parametrize(
    ("kind", "name", "wish", "field"),
    [
        ("tiff", "x", Wish(), "--to"),
        ("gif", "x.png", Wish(), "-o"),
        ("coco", "x", Wish(frame=9), "--frame"),
        ("gif", "x.gif", Wish(layer="stars"), "--layer"),
        ("gif", "x.gif", Wish(fps=0.0), "--fps"),
        ("masks", "x", Wish(threshold_sigma=-1.0), "--threshold"),
        ("masks", "x", Wish(threshold_sigma=float("nan")), "--threshold"),
        ("masks", "x", Wish(light="lamp"), "--light"),
        ("satnet", "x", Wish(stars_snr=float("nan")), "--stars-snr"),
        ("coco", ".", Wish(), "-o"),
    ],
)
def test_limits_refused(labelled, tmp_path, kind, name, wish, field):
    with pytest.raises(BadInput) as caught:
        list(export_product(labelled, kind, tmp_path / name, wish))
    assert caught.value.field == field


def test_annotations_are_plain_json(coco):
    text = coco.read_text()
    assert "NaN" not in text
    told = json.loads(text)
    assert "electrons" in told["info"]["masks"]
    assert {"start", "middle", "end", "light", "length_px", "angle_deg"} <= set(
        told["annotations"][0]["streak"]
    )
