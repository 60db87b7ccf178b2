"""SatNet, COCO, masks and movies: read back by others' readers; and what is refused."""

from __future__ import annotations

import io
import json
import sys
import warnings
from dataclasses import fields, replace
from types import SimpleNamespace

import erfa
import numpy as np
import pytest
import zarr
from astropy.io import fits
from astropy.wcs import WCS, FITSFixedWarning
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from PIL import Image

from pipeline.errors import BadInput, Incomplete
from pipeline.export import formats, movie, satnet
from pipeline.export.coco import annotation, image_entry, packed, run_lengths
from pipeline.export.formats import ExportRequest, _Job, export_product
from pipeline.export.labels import Labels
from pipeline.export.masks import Mask, _as_disc, _cut, classes_from_light, mask_fits, paint
from pipeline.export.movie import gif_bytes, write_mp4
from pipeline.export.times import ExposureTimes
from pipeline.route.run import render
from pipeline.spec.load import parse_scene
from pipeline.store.cube import read_layer

STARS = ExportRequest(stars_snr=10.0)


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
            labelled, "masks", tmp_path / light, ExportRequest(0, stars_snr=0.0, light=light)
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
    new = tmp_path / "in" / "new"  # folders that are not there yet are made
    (gif,) = export_product(labelled, "gif", new / "a.gif", ExportRequest(fps=4.0))
    picture = Image.open(gif)
    assert (picture.n_frames, picture.size, picture.info["duration"]) == (2, (512, 512), 250)
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    (mp4,) = export_product(labelled, "mp4", new / "a.mp4", ExportRequest(fps=4.0))
    reader = ffmpeg.read_frames(str(mp4))
    about = next(reader)
    assert (about["size"], about["fps"]) == ((512, 512), 4.0)
    assert len(list(reader)) == 2
    assert sorted(p.name for p in new.iterdir()) == ["a.gif", "a.mp4"]


@pytest.mark.parametrize(
    ("fps", "lasts_ms"), [(100.0, 20), (60.0, 20), (30.0, 30), (0.5, 2000), (15.0, 70), (3.5, 290)]
)
def test_frames_of_a_gif_last_whole_hundredths_and_two_at_least(fps, lasts_ms):
    """However many a second are asked for: browsers slow shorter ones down."""
    pictures = (np.full((4, 4), grey, np.uint8) for grey in (0, 255))
    gif = Image.open(io.BytesIO(gif_bytes(pictures, 2, fps)))
    assert (gif.n_frames, gif.info["duration"]) == (2, lasts_ms)


def test_a_gif_whose_frames_fill_the_memory_is_refused(monkeypatch):
    """All of them are held until it is written; a film's are not."""
    monkeypatch.setattr(movie, "MOST_GIF_BYTES", 40)
    pictures = [np.zeros((4, 4), np.uint8)] * 3
    assert gif_bytes(iter(pictures[:2]), 2, 4.0)
    with pytest.raises(BadInput, match=r"gif of 3 frames.*at most 2 frames of this size; or mp4"):
        gif_bytes(iter(pictures), 3, 4.0)


def test_a_movie_of_odd_sides_that_differ(tmp_path):
    """27 rows and 41 columns lose their last ones; bright on the left, dark on the right."""
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    picture = np.repeat(np.linspace(250, 5, 41).astype(np.uint8)[None], 27, axis=0)
    write_mp4(iter([picture, picture]), tmp_path / "a.mp4", 2.0)
    about, first, _ = ffmpeg.read_frames(str(tmp_path / "a.mp4"), pix_fmt="gray", bits_per_pixel=8)
    assert (about["size"], about["fps"]) == ((40, 26), 2.0)
    seen = np.frombuffer(first, np.uint8).reshape(26, 40).astype(float)
    assert np.corrcoef(seen.ravel(), picture[:26, :40].ravel())[0, 1] > 0.99
    with pytest.raises(BadInput, match="2 x 2"):
        write_mp4(iter([picture[:1]]), tmp_path / "b.mp4", 2.0)
    assert not (tmp_path / "b.mp4").exists()


@pytest.mark.parametrize("fps", [0.01, 1 / 3, 29.97, 100.0])
def test_a_film_has_all_its_frames_at_any_speed(tmp_path, fps):
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    pictures = np.random.default_rng(1).integers(0, 255, (7, 32, 32)).astype(np.uint8)
    write_mp4(iter(pictures), tmp_path / "a.mp4", fps)
    assert ffmpeg.count_frames_and_secs(str(tmp_path / "a.mp4"))[0] == 7


def test_a_film_leaves_others_alone(labelled, tmp_path):
    """What lies beside it stays; what is in its folder's place is no folder."""
    pytest.importorskip("imageio_ffmpeg")
    kept = tmp_path / "film.part.mp4"
    kept.write_text("keep me")
    list(export_product(labelled, "mp4", tmp_path / "film.mp4", ExportRequest()))
    assert kept.read_text() == "keep me"
    assert {path.name for path in tmp_path.iterdir()} == {"film.mp4", "film.part.mp4"}
    with pytest.raises(BadInput, match=r"film\.part\.mp4 is a file"):
        list(export_product(labelled, "mp4", kept / "film.mp4", ExportRequest()))


@pytest.mark.parametrize("ends", ["exit 1;", "head -c 300000 |"])
def test_a_film_that_ffmpeg_did_not_end_is_no_film(labelled, tmp_path, monkeypatch, ends):
    """It ends at once, or after the first frame of two, and tells nothing: nothing is left."""
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    broken, output = tmp_path / "ffmpeg", tmp_path / "out" / "film.mp4"
    broken.write_text(f'#!/bin/bash\n{ends} {ffmpeg.get_ffmpeg_exe()} "$@"\n')
    broken.chmod(0o755)
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(broken))
    output.parent.mkdir()
    with pytest.raises(Incomplete, match="ffmpeg ended before the film was whole"):
        list(export_product(labelled, "mp4", output, ExportRequest()))
    assert not list(output.parent.iterdir())


def test_without_an_encoder(labelled, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(BadInput, match=r"nightglass\[movie\]"):
        list(export_product(labelled, "mp4", tmp_path / "a.mp4", ExportRequest()))
    assert not list(tmp_path.iterdir())


def test_header_tells_site_and_sensor(labelled, tmp_path):
    """astropy reads both WCS and the site; it says that SIP is not for the alternate one."""
    (path,) = export_product(labelled, "fits", tmp_path / "a.fits", ExportRequest(0))
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
    told = {
        "OBJECT": "labelled", "SEED": 7, "FRAME": 0, "BUNIT": "adu", "FILTER": "400-900 nm",
        "APTDIA": 400.0, "FOCALLEN": 1000.0, "XPIXSZ": 9.0, "YPIXSZ": 9.0, "TRKMODE": "target",
        "RDNOISE": 6.0, "BIASLVL": 500, "DARKCUR": 0.5, "OBSKIND": "ground", "SITELAT": 20.7,
        "SITELONG": -156.3, "SITEELEV": 3055.0, "TELAPSE": 1.0,
    }  # fmt: skip
    assert {k: header[k] for k in told} == pytest.approx(told)
    place = (np.radians(header["OBSGEO-L"]), np.radians(header["OBSGEO-B"]), header["OBSGEO-H"])
    on_fits = erfa.gd2gce(6_378_140.0, 1 / 298.257, *place)  # FITS 4.0, table 33: IAU 1976
    assert np.allclose(on_fits, [header[f"OBSGEO-{axis}"] for axis in "XYZ"], atol=0.1)
    (path,) = export_product(labelled, "fits", tmp_path / "b.fits", ExportRequest(0, "mean_e"))
    light = fits.getheader(path)
    assert (light["BUNIT"], "SATURATE" in light) == ("electron", False)
    assert header["GAIN"] == 1.5
    assert header["SATURATE"] == min(65535, int(90000 / 1.5 + 500))
    assert header["SECPIX"] == pytest.approx(np.degrees(9e-6) * 3600)


@pytest.mark.parametrize(
    ("kind", "name", "wish", "field"),
    [
        ("tiff", "x", ExportRequest(), "--to"),
        ("gif", "x.png", ExportRequest(), "-o"),
        ("coco", "x", ExportRequest(frame=9), "--frame"),
        ("gif", "x.gif", ExportRequest(layer="stars"), "--layer"),
        ("gif", "x.gif", ExportRequest(fps=0.0), "--fps"),
        ("masks", "x", ExportRequest(threshold_sigma=-1.0), "--threshold"),
        ("masks", "x", ExportRequest(threshold_sigma=0.0), "--threshold"),
        ("masks", "x", ExportRequest(threshold_sigma=float("nan")), "--threshold"),
        ("masks", "x", ExportRequest(light="lamp"), "--light"),
        ("satnet", "x", ExportRequest(stars_snr=float("nan")), "--stars-snr"),
        ("coco", ".", ExportRequest(), "-o"),
        ("gif", "x.gif", ExportRequest(fps=0.001), "--fps"),
        ("mp4", "x.mp4", ExportRequest(fps=1e-9), "--fps"),
    ],
)
def test_limits_refused(labelled, tmp_path, kind, name, wish, field):
    with pytest.raises(BadInput) as caught:
        list(export_product(labelled, kind, tmp_path / name, wish))
    assert caught.value.field == field


@pytest.mark.parametrize("kind", ["fits", "coco"])
def test_outputs_below_a_file_are_refused_by_its_name(labelled, tmp_path, kind):
    (tmp_path / "file").write_text("keep me")
    with pytest.raises(BadInput, match=f"in a folder; {tmp_path}/file is a file"):
        list(export_product(labelled, kind, tmp_path / "file" / "a" / "b", ExportRequest()))
    assert (tmp_path / "file").read_text() == "keep me"


@pytest.mark.parametrize("kind", ["fits", "png"])
def test_frames_that_are_there_are_kept(labelled, tmp_path, kind):
    """In a folder, and as one file: refused by name, not a byte of them changed."""
    first, *_ = export_product(labelled, kind, tmp_path / "all", ExportRequest())
    one = tmp_path / f"one.{kind}"
    assert list(export_product(labelled, kind, one, ExportRequest(frame=0))) == [one]
    before = [path.read_bytes() for path in (first, one)]
    for output, taken in ((tmp_path / "all", first), (one, one)):
        with pytest.raises(BadInput, match="does not exist yet") as caught:
            list(export_product(labelled, kind, output, ExportRequest(layer="mean_e", frame=0)))
        assert caught.value.value == str(taken)
    assert [path.read_bytes() for path in (first, one)] == before


def test_annotations_are_plain_json(coco):
    text = coco.read_text()
    assert "NaN" not in text
    told = json.loads(text)
    assert "electrons" in told["info"]["masks"]
    assert {"start", "middle", "end", "light", "length_px", "angle_deg"} <= set(
        told["annotations"][0]["streak"]
    )


def three_labels():
    """A satellite and two stars whose values all differ, in a frame of 100 rows, 300 columns."""
    values = {f.name: np.array([1.0, 2.0, 3.0]) * k for k, f in enumerate(fields(Labels), 10)}
    path = {"x_start": 10, "x": 70, "x_end": 60, "y_start": 40, "y": 20, "y_end": 5,
            "x_light": 31, "y_light": 22}  # fmt: skip
    values |= {f"{k}_px": np.array([v, v + 1, v + 2], float) for k, v in path.items()}
    none = np.nan
    values |= {
        "kind": np.array([1, 2, 2]), "name": np.array(["sat", "7", "8"]),
        "object_name": np.array(["ISS", "seven", "eight"]), "radius_px": np.array([2.5, 0.0, 0.0]),
        "g_mag": np.array([none, 9.5, 10.5]), "v_mag": np.array([4.5, none, none]),
        "mag_ab": np.array([4.25, none, none]),
    }  # fmt: skip
    return Labels(**values)


TIMES = ExposureTimes(
    *(np.datetime64(f"2020-01-01T00:00:0{s}.000000", "us") for s in (0, 2, 4)), 4.0
)


def test_satnet_tells_each_number_of_its_own():
    """Shares of rows and columns by hand: (pixel + 0.5) / side; 2 px and a radius on every side."""
    labels = three_labels()
    told = satnet.annotation(labels, TIMES, (100, 300), 0.01, {}, 2.0)["data"]
    assert told["sensor"] == {"height": 100, "width": 300, "iFOVy": 0.01, "iFOVx": 0.01}
    assert told["stats"] == {"num_obs": 1}
    first, second, _ = told["objects"]
    places = {
        "x_start": 10.5 / 300, "x_mid": 70.5 / 300, "x_end": 60.5 / 300, "x_light": 31.5 / 300,
        "y_start": 0.405, "y_mid": 0.205, "y_end": 0.055, "y_light": 0.225,
        "x_min": 10.5 / 300, "x_max": 70.5 / 300, "x_center": 40.5 / 300, "bbox_width": 69 / 300,
        "y_min": 0.055, "y_max": 0.405, "y_center": 0.23, "bbox_height": 0.44,
    }  # fmt: skip
    assert {k: first[k] for k in places} == pytest.approx(places, abs=1e-12)
    kinds = ("class_name", "class_id", "object_name", "object_id", "magnitude", "seg_id")
    assert [first[k] for k in kinds] == ["Satellite", 1, "ISS", "sat", 4.5, 1]
    assert [second[k] for k in kinds] == ["Star", 2, "", "7", 9.5, 2]
    numbers = [second[k] for k in ("pe_per_sec", "snr", "ra", "dec")]
    wanted = [labels.electrons[1] / 4.0, labels.snr[1], labels.ra_deg[1], labels.dec_deg[1]]
    assert numbers == wanted


def test_coco_tells_each_number_of_its_own():
    labels = three_labels()
    entry = image_entry(5, "a.png", (100, 300), TIMES)
    assert (entry["id"], entry["height"], entry["width"], entry["exposure_s"]) == (5, 100, 300, 4.0)
    mask = Mask(5, 20, np.ones((3, 4)), np.array([[0, 1, 0, 0], [0, 1, 1, 0], [0, 0, 0, 0]], bool))
    first, star = (annotation(9, 5, labels, i, mask, (100, 300)) for i in (0, 1))
    assert (first["id"], first["image_id"]) == (9, 5)
    assert (first["category_id"], star["category_id"]) == (1, 2)
    assert (first["bbox"], first["area"], first["num_keypoints"]) == ([21, 5, 2, 2], 3, 3)
    assert first["segmentation"]["size"] == [100, 300]  # height, width
    assert first["keypoints"] == [10, 40, 2, 70, 20, 2, 60, 5, 2]  # 2: labelled and visible
    cut = annotation(9, 5, labels, 0, mask, (30, 60))
    assert cut["keypoints"] == [10, 40, 1, 70, 20, 1, 60, 5, 1]  # 1: labelled, off the frame
    assert annotation(9, 5, labels, 0, mask, (30, 61))["keypoints"][-1] == 2  # -0.5 to 60.5
    streak = first["streak"]
    assert (streak["start"], streak["light"], streak["end"]) == ([10, 40], [31, 22], [60, 5])
    long = streak["length_px"], streak["angle_deg"]
    assert long == pytest.approx((61.0328, -34.9920), abs=1e-4)
    assert (first["name"], first["object_name"], star["object_name"]) == ("sat", "ISS", "seven")
    for i, one in enumerate((first, star)):
        for name in ("electrons", "snr", "ra_deg", "dec_deg"):
            assert one[name] == getattr(labels, name)[i]
    mags = [{k: a[k] for k in ("g_mag", "v_mag", "mag_ab") if k in a} for a in (first, star)]
    assert mags == [{"v_mag": 4.5, "mag_ab": 4.25}, {"g_mag": 9.5}]


def test_the_table_of_masks_holds_the_labels():
    """Each column what its name says, by astropy; the brightest owns a pixel that two light."""
    labels = three_labels()
    ones = np.ones((2, 3), bool)
    lights = np.full((2, 3), 5.0), np.array([[9.0, 2, 9], [9, 9, 9]]), np.full((2, 3), 4.0)
    masks = [Mask(*at, e, ones) for at, e in zip(((0, 0), (1, 1), (1, 2)), lights, strict=True)]
    owner = paint(labels, iter(masks), (4, 6))
    assert owner.tolist() == [[1, 1, 1, 0, 0, 0], [1, 2, 1, 2, 3, 0], [0, 2, 2, 2, 3, 0], [0] * 6]
    made = mask_fits(labels, owner, owner.astype(np.uint8), [])
    table = fits.open(io.BytesIO(made))["SOURCES"].data
    columns = {"class": labels.kind, "name": labels.name, "object_name": labels.object_name,
               "x": labels.x_px, "y": labels.y_px, "magnitude": [4.5, 9.5, 10.5],
               "electrons": labels.electrons, "snr": labels.snr}  # fmt: skip
    for name, wanted in columns.items():
        assert list(table[name]) == list(wanted), name


def test_a_name_beyond_ascii_is_escaped_in_the_table_of_masks():
    """FITS has no other letters; two names of 80 letters that differ in the last one differ."""
    labels = replace(three_labels(), object_name=np.array(["Ü", "天" * 79 + "a", "天" * 79 + "b"]))
    empty = np.zeros((2, 2), np.int32)
    made = mask_fits(labels, empty, empty.astype(np.uint8), [])
    table = fits.open(io.BytesIO(made))["SOURCES"]
    assert table.data["object_name"].tolist() == ["\\xdc", *("\\u5929" * 79 + c for c in "ab")]


def test_masks_of_faint_sources_discs_and_overlaps(tmp_path):
    """Half of its own brightest pixel; a full disc about its place; targets before stars."""
    faint = _cut(-1, 2, np.array([[9.0, 9, 9], [8, 4, 3.9], [0, 5, 6]]), (4, 6), 100.0)
    assert faint.pixels.tolist() == [[True, False, False], [False, True, True]]  # of 9: from 4.5
    assert (faint.y0, faint.x0) == (0, 2)
    fainter = _cut(-1, 2, np.array([[9.0, 9, 9], [8, 4, 3.9], [0, 5, 6]]) / 1e3, (4, 6), 100.0)
    assert (fainter.pixels == faint.pixels).all()  # also where that is far below an electron
    assert not _cut(-1, 2, np.zeros((3, 3)), (4, 6), 100.0).pixels.any()
    y0, x0, light = _as_disc(10, 20, np.array([[7.0]]), 3.2)
    y, x = np.mgrid[y0 : y0 + light.shape[0], x0 : x0 + light.shape[1]]
    inside = np.hypot(y - 10, x - 20) <= 3.2
    assert light == pytest.approx(np.where(inside, 7.0 / inside.sum(), 0.0), abs=1e-9)
    for name, values in (("targets_e", [[5.0, 5, 0]]), ("stars_e", [[5.0, 4.9, 7]])):
        zarr.create_array(store=tmp_path / "cube.zarr" / name, data=np.array([values]))
    found = classes_from_light(tmp_path, 0, ["targets_e", "stars_e"], 5.0)
    assert found.tolist() == [[1, 1, 2]]


def test_a_source_whose_pixels_all_lie_beyond_the_frame_has_no_annotation():
    """Its light within is less than half of its brightest pixel's; no other label's number moves"""
    labels = three_labels()
    light = np.array([[9.0, 4.0, 1.0]])
    beyond, away = (_cut(1, x, light, (4, 6), 100.0) for x in (-1, 6))
    assert annotation(1, 1, labels, 0, beyond, (4, 6)) is None
    assert not away.pixels.size
    inside = Mask(1, 1, np.full((1, 2), 3.0), np.ones((1, 2), bool))
    owner = paint(labels, iter([beyond, away, inside]), (4, 6))
    assert owner.tolist() == [[0] * 6, [0, 3, 3, 0, 0, 0], [0] * 6, [0] * 6]


def test_satnet_names_its_image_and_holds_nine_tenths_of_a_point(labelled, tmp_path):
    """90% of a Gaussian's light lie within sigma sqrt(2 ln 10), wider by the pixel's own 1/12."""
    *_, path = export_product(labelled, "satnet", tmp_path / "set", ExportRequest(1))
    told = json.loads(path.read_text())["data"]
    assert told["file"] == {"dirname": "set", "sequence": 0, "filename": "labelled.0001.fits",
                            "sequence_id": 1}  # fmt: skip
    assert told["sensor"]["iFOVx"] == pytest.approx(np.degrees(9e-6))
    one = told["objects"][0]
    margin = 0.5 * (one["bbox_width"] - (one["x_max"] - one["x_min"])) * 512
    assert margin == pytest.approx(np.sqrt((0.9**2 + 1 / 12) * 2 * np.log(10)), abs=0.15)
    floor = json.loads((labelled / "report.json").read_text())["errors"]["noise_floor_e"]
    assert _Job(labelled, ExportRequest(threshold_sigma=3.0)).threshold_e(1) == 3.0 * floor


@pytest.mark.parametrize(
    ("values", "suffix"),
    [
        (np.array([[0, 65_535]], np.uint32), ".png"),
        (np.array([[0, 65_536]], np.uint32), ".fits"),
        (np.array([[0, 7]], np.uint16), ".png"),
        (np.array([[0.0, 7.0]], np.float32), ".fits"),
    ],
)
def test_an_image_is_a_png_only_where_16_bits_hold_it(values, suffix, tmp_path, monkeypatch):
    monkeypatch.setattr(formats, "read_layer", lambda *_: values)
    monkeypatch.setattr(formats, "fits_bytes", lambda *_: b"fits")
    job = SimpleNamespace(product=None, cube=None, request=ExportRequest())
    path = formats._write_image(job, 0, tmp_path / "one")
    assert path.suffix == suffix
    if suffix == ".png":
        assert np.array_equal(np.asarray(Image.open(path)), values)


SKIES = {
    "exposures": {
        "dwells": [{"integration_s": t, "frames": 1} for t in (1.0, 100.0, 0.0)],
        "background": {"uniform_e_per_s": 100.0},
    },
    "twilight": {
        "exposure": {"integration_s": 2.0, "frames": 4, "cadence_s": 1200.0},
        "background": {"twilight": True, "airglow": True},
    },
    "no photon noise": {
        "exposure": {"integration_s": 2.0, "frames": 2, "cadence_s": 1200.0},
        "background": {"twilight": True},
    },
}


@pytest.mark.parametrize("name", SKIES)
def test_thresholds_are_of_the_frame_s_own_exposure_and_sky(name, tmp_path):
    """By hand from the layer of the sky and the detector's numbers, in masks and COCO alike."""
    photons = name != "no photon noise"
    scene = {
        "schema": "nightglass/scene/1", "name": "skies", "epoch": "2015-07-02T02:30:00Z", "seed": 1,
        "observer": {
            "kind": "ground", "latitude_deg": 40.0, "longitude_deg": 0.0,
            "atmosphere": {"extinction": True},
        },
        "sensor": {
            "shape": [48, 65], "pixel_pitch_um": 9.0, "focal_length_m": 0.01, "aperture_m": 0.01,
            "bandpass": {"kind": "named", "name": "bessell-V"}, "read_noise_e": 3.0, "adc_bits": 24,
            "psf": {"kind": "gaussian", "sigma_px": 1.0}, "dark_e_per_s": 2.0, "flat": 0.9,
            "photon_noise": photons,
        },
        "pointing": {"mode": "sidereal", "boresight_ra_deg": 300.0, "boresight_dec_deg": 30.0},
        "exposure": {"integration_s": 1.0}, "accept": ["moon", "sun", "daylight", "error"],
        "output": {"layers": ["dn", "background_e"]},
    } | SKIES[name]  # fmt: skip
    run = tmp_path / "run"
    render(parse_scene(scene), run)
    made = list(export_product(run, "masks", tmp_path / "masks", ExportRequest(None, "dn", 0.0, 2)))
    *_, coco = export_product(run, "coco", tmp_path / "coco", ExportRequest(threshold_sigma=2.0))
    images = json.loads(coco.read_text())["images"]
    assert len(images) == len(made) > 1
    for k, (path, image) in enumerate(zip(made, images, strict=True)):
        header = fits.getheader(path)
        sky_e = read_layer(run, "background_e", k)[23:25, 32].mean(dtype=float)
        charge_e = sky_e + 2.0 * header["EXPTIME"] if photons else 0.0
        wanted = 2.0 * np.sqrt(charge_e + 9.0 + 1 / 12)
        assert header["THRESH"] == pytest.approx(wanted, rel=2e-3), k
        assert image["threshold_e"] == header["THRESH"]
