"""A label, the drawn light and the WCS agree to 0.001 px, for stars and targets alike."""

from __future__ import annotations

import json

import numpy as np
import pytest
from astropy.io import fits
from astropy.wcs import WCS

from pipeline.export.formats import PAD_FRACTION, ExportRequest, export_product
from pipeline.export.response import STEP_PX, SourceLight, path_between
from pipeline.physics.motion.streak import POINT
from pipeline.physics.psf.pupil import Airy, Blur, Gaussian
from pipeline.physics.psf.seeing import Moffat
from pipeline.plan.optics.psf_field import PsfField
from pipeline.store.cube import read_layer

TOLERANCE_PX = 1e-3
HALF = 24  # of the window around a source that its centroid is taken in


@pytest.fixture(scope="module", params=["labelled", "distorted"])
def product(request):
    """A rate-tracked product; the same through optics that distort, with a response that varies."""
    return request.getfixturevalue(request.param)


@pytest.fixture(scope="module")
def satnet(product, tmp_path_factory):
    folder = tmp_path_factory.mktemp("satnet") / "out"
    return list(export_product(product, "satnet", folder, ExportRequest(stars_snr=10.0)))


@pytest.mark.parametrize("frame", [0, 1])
@pytest.mark.parametrize("kind", ["Satellite", "Star"])
def test_label_light_and_wcs_agree(product, satnet, frame, kind):
    """Centroids of the noise-free layers, labels of the file, astropy's reading of its WCS."""
    image, label = satnet[2 * frame], satnet[2 * frame + 1]
    light = read_layer(product, {"Satellite": "targets_e", "Star": "stars_e"}[kind], frame)
    told = [o for o in json.loads(label.read_text())["data"]["objects"] if o["class_name"] == kind]
    inside = [o for o in told if all(0.08 < o[f"{a}_mid"] < 0.92 for a in "xy")]
    assert len(inside) >= {"Satellite": 2, "Star": 20}[kind]
    streaks = [np.hypot(o["x_end"] - o["x_start"], o["y_end"] - o["y_start"]) for o in inside]
    assert max(streaks) * 512 > 2.5  # of stars, and of the drifting target
    world = WCS(fits.getheader(image))
    if world.sip is not None:  # of no higher order than its terms
        assert np.fliplr(world.sip.a).diagonal().any()
    for o in inside:
        middle = np.array([o[f"{a}_mid"] * 512 - 0.5 for a in "xy"])
        drawn = np.array([o[f"{a}_light"] * 512 - 0.5 for a in "xy"])
        seen = _centroid(light.astype(float), middle)
        assert np.abs(seen - drawn).max() < TOLERANCE_PX, o["object_id"]
        assert np.abs(middle - drawn).max() < 2 * TOLERANCE_PX  # a lit side, a bend
        at = world.all_world2pix([[o["ra"], o["dec"]]], 0)[0]
        assert np.abs(at - middle).max() < TOLERANCE_PX, o["object_id"]


@pytest.mark.parametrize("frame", [0, 1])
def test_boxes_are_where_the_light_is(product, satnet, frame, tmp_path):
    """SatNet's boxes hold the path to 0.001 px; COCO's hold path and light, and no more rows or
    columns than they need."""
    objects = json.loads(satnet[2 * frame + 1].read_text())["data"]["objects"]
    for o in objects:
        for axis in "xy":
            ends = [o[f"{axis}_{w}"] for w in ("start", "mid", "end")]
            assert abs(o[f"{axis}_min"] - min(ends)) * 512 < TOLERANCE_PX
            assert abs(o[f"{axis}_max"] - max(ends)) * 512 < TOLERANCE_PX
            assert o[f"{axis}_min"] - 1e-9 <= o[f"{axis}_light"] <= o[f"{axis}_max"] + 1e-5
    (*_, coco) = export_product(product, "coco", tmp_path / "coco", ExportRequest(stars_snr=10.0))
    whole = json.loads(coco.read_text())
    mine = [a for a in whole["annotations"] if a["image_id"] == whole["images"][frame]["id"]]
    layers = [read_layer(product, name, frame).astype(float) for name in ("targets_e", "stars_e")]
    named = {o["object_id"]: o for o in objects}
    assert {a["name"] for a in mine} <= set(named)
    assert len(mine) > 20
    for a in mine:
        o, (x0, y0, width, height) = named[a["name"]], map(int, a["bbox"])
        light = np.array([o["x_light"], o["y_light"]]) * 512 - 0.5
        assert np.abs(np.array(a["streak"]["light"]) - light).max() < TOLERANCE_PX
        if not all(0.08 < o[f"{axis}_mid"] < 0.92 for axis in "xy"):
            continue
        for place in (a["streak"]["start"], a["streak"]["middle"], a["streak"]["end"]):
            assert x0 - 0.5 <= place[0] <= x0 + width - 0.5
            assert y0 - 0.5 <= place[1] <= y0 + height - 0.5
        drawn = layers[0 if o["class_name"] == "Satellite" else 1]
        assert drawn[y0 : y0 + height, x0 : x0 + width].sum() > 0.8 * a["electrons"]


def _centroid(image, at):
    x0, y0 = np.round(at).astype(int) - HALF
    cut = image[y0 : y0 + 2 * HALF + 1, x0 : x0 + 2 * HALF + 1]
    y, x = np.mgrid[: cut.shape[0], : cut.shape[1]]
    return np.array([(x * cut).sum(), (y * cut).sum()]) / cut.sum() + [x0, y0]


def test_times_are_told_alike(labelled, satnet, tmp_path):
    """FITS, SatNet and COCO give one start, middle and end."""
    (*_, coco) = export_product(labelled, "coco", tmp_path / "coco", ExportRequest())
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
    (*_, coco) = export_product(labelled, "coco", tmp_path / "last", ExportRequest(1))
    (alone,) = json.loads(coco.read_text())["images"]
    assert {k for k in alone if alone[k] != entries[1][k]} == {"id"}


def test_a_path_through_three_places_bends_their_way() -> None:
    """At its ends it is at the ends, halfway in the middle; straight where they are in line."""
    start, middle, end = np.array([-10.0, 3.0]), np.array([2.0, 9.0]), np.array([12.0, 1.0])
    path = path_between(start, middle, end)
    x, y = middle[0] + path.x_px, middle[1] + path.y_px
    half = len(x) // 2
    for k, place in ((0, start), (half, middle), (-1, end)):
        assert (x[k], y[k]) == pytest.approx(tuple(place), abs=2 * STEP_PX)
    assert path_between(start, 0.5 * (start + end), end).segments == 1


def test_many_unlike_streaks_are_each_drawn_as_alone() -> None:
    """Of six hundred, more than are remembered, the first is drawn again as it was."""
    drawn, bits = SourceLight(Blur(Gaussian(0.7))), []
    for n in (*range(600), 0, 599):
        end = np.array([n % 30, n // 30]) * STEP_PX
        row, column, light = drawn.image(path_between(-end, 0 * end, end), 9.0, 9.0, 100.0, 1.0)
        bits.append((row, column, light.shape, light.tobytes()))
        assert light.sum() == pytest.approx(100.0, rel=1e-3)
    assert bits[-2:] == [bits[0], bits[599]]
    assert len(set(bits)) == 600


def test_light_of_a_field_is_that_of_its_place() -> None:
    """Its second moments: shares of the four responses around a place, by rows and by columns, each
    of its sigma and a pixel's 1/12."""
    sigmas = (0.8, 1.2, 1.6, 2.0)  # left and right of the first row, then of the last
    blurs = tuple(Blur(Gaussian(s)) for s in sigmas)
    drawn = SourceLight(blurs[0], PsfField((0.0, 100.0), (0.0, 200.0), blurs, (0, 1, 2, 3)))
    for x, y in ((40.0, 70.0), (160.0, 10.0), (200.0, 0.0)):
        row, column, light = drawn.image(POINT, x, y, 1000.0, 1e-9)
        v, u = y / 100.0, x / 200.0
        shares = ((1 - v) * (1 - u), (1 - v) * u, v * (1 - u), v * u)
        expected = sum(w * (s * s + 1.0 / 12.0) for w, s in zip(shares, sigmas, strict=True))
        rows, columns = np.mgrid[: light.shape[0], : light.shape[1]] + 0.0
        assert light.sum() == pytest.approx(1000.0, rel=1e-5)
        for at, place in ((rows + row, y), (columns + column, x)):
            assert (at * light).sum() / light.sum() == pytest.approx(place, abs=1e-4)
            assert ((at - place) ** 2 * light).sum() / light.sum() == pytest.approx(
                expected, rel=1e-3
            )


@pytest.mark.parametrize(
    ("optics", "radius_px"),
    [
        (Gaussian(2.0), np.sqrt(2.0 * np.log(10.0) * (4.0 + 1.0 / 12.0))),  # with the pixel's
        (Moffat(2.1, 2.0), 1.05 / np.sqrt(2.0 ** (1 / 2.0) - 1.0) * 3.0),  # 1 - 1 / (1 + r^2/a^2)
        (Moffat(4.0, 1.5), 2.0 / np.sqrt(2.0 ** (1 / 1.5) - 1.0) * np.sqrt(99.0)),
        (Airy(3.0), 5.70),  # 1 - J0^2 - J1^2 of pi r / Q
    ],
)
def test_the_margin_of_a_box_holds_nine_tenths_of_all_light(optics, radius_px):
    """Far wings count: encircled light in closed form. A sensor's gaps take the same from all."""
    for fill in (1.0, 0.3):
        made = SourceLight(Blur(optics, fill_factor=fill)).enclosing_px(PAD_FRACTION)
        assert made == pytest.approx(radius_px, rel=0.03)
