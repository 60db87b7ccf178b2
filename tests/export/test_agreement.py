"""A label, the drawn light and the WCS agree to 0.001 px, for stars and targets alike."""

from __future__ import annotations

import json

import numpy as np
import pytest
from astropy.io import fits
from astropy.wcs import WCS

from pipeline.export.formats import Wish, export_product
from pipeline.store.cube import read_layer

TOLERANCE_PX = 1e-3
HALF = 24  # of the window around a source that its centroid is taken in


@pytest.fixture(scope="module")
def satnet(labelled, tmp_path_factory):
    folder = tmp_path_factory.mktemp("satnet") / "out"
    return list(export_product(labelled, "satnet", folder, Wish(stars_snr=10.0)))


@pytest.mark.parametrize("frame", [0, 1])
@pytest.mark.parametrize("kind", ["Satellite", "Star"])
def test_label_light_and_wcs_agree(labelled, satnet, frame, kind):
    """Centroids of the noise-free layers, labels of the file, astropy's reading of its WCS."""
    image, label = satnet[2 * frame], satnet[2 * frame + 1]
    light = read_layer(labelled, {"Satellite": "targets_e", "Star": "stars_e"}[kind], frame)
    told = [o for o in json.loads(label.read_text())["data"]["objects"] if o["class_name"] == kind]
    inside = [o for o in told if all(0.08 < o[f"{a}_mid"] < 0.92 for a in "xy")]
    assert len(inside) >= {"Satellite": 2, "Star": 20}[kind]
    world = WCS(fits.getheader(image))
    for o in inside:
        middle = np.array([o[f"{a}_mid"] * 512 - 0.5 for a in "xy"])
        drawn = np.array([o[f"{a}_light"] * 512 - 0.5 for a in "xy"])
        seen = _centroid(light.astype(float), middle)
        assert np.abs(seen - drawn).max() < TOLERANCE_PX, o["object_id"]
        assert np.abs(middle - drawn).max() < 2 * TOLERANCE_PX  # a lit side, a bend
        at = world.all_world2pix([[o["ra"], o["dec"]]], 0)[0]
        assert np.abs(at - middle).max() < TOLERANCE_PX, o["object_id"]


def _centroid(image, at):
    x0, y0 = np.round(at).astype(int) - HALF
    cut = image[y0 : y0 + 2 * HALF + 1, x0 : x0 + 2 * HALF + 1]
    y, x = np.mgrid[: cut.shape[0], : cut.shape[1]]
    return np.array([(x * cut).sum(), (y * cut).sum()]) / cut.sum() + [x0, y0]


def test_times_are_told_alike(labelled, satnet, tmp_path):
    """FITS, SatNet and COCO give one start, middle and end."""
    (*_, coco) = export_product(labelled, "coco", tmp_path / "coco", Wish())
    entries = json.loads(coco.read_text())["images"]
    for frame, entry in enumerate(entries):
        header = fits.getheader(satnet[2 * frame])
        told = json.loads(satnet[2 * frame + 1].read_text())["data"]["metadata"]
        moments = [(header["DATE-BEG"], told["start"], entry["exposure_start"]),
                   (header["DATE-AVG"], told["middle"], entry["date_captured"]),
                   (header["DATE-END"], told["end"], entry["exposure_end"])]  # fmt: skip
        for moment in moments:
            assert len(set(moment)) == 1
        assert header["DATE-OBS"] == header["DATE-BEG"]
        assert header["DATE-BEG"] == f"2019-07-20T09:00:{4 * frame:02d}.000000"
        assert header["DATE-AVG"].endswith(".500000")
        assert header["XPOSURE"] == header["EXPTIME"] == entry["exposure_s"] == 1.0
        days = header["MJD-END"] - header["MJD-BEG"]
        assert days * 86_400 == pytest.approx(1.0, abs=2e-6)
