"""Real DR2 stars, rendered, found again by an independent source extractor and by astropy's WCS."""

from __future__ import annotations

import numpy as np
import pyarrow.parquet as pq
import pytest
import sep
from astropy.io import fits
from astropy.wcs import WCS

from pipeline.export.files import export_frames
from pipeline.route.run import render


@pytest.fixture(scope="module")
def product(sidereal, build, tmp_path_factory):
    path = tmp_path_factory.mktemp("sidereal") / "run"
    render(build(sidereal), path)
    return path


@pytest.fixture(scope="module")
def tracked(rate_track, build, tmp_path_factory):
    path = tmp_path_factory.mktemp("tracked") / "run"
    render(build(rate_track), path)
    return path


def truth_of(product, kind="stars"):
    table = pq.read_table(product / "truth" / f"{kind}.parquet")
    return {name: np.asarray(table[name]) for name in table.column_names}


def exported(product, tmp_path):
    (path,) = export_frames(product, "fits", tmp_path / "frame.fits", 0)
    return fits.open(path)[0]


def isolated(truth, radius_px, share=0.01):
    """Bright stars in the frame with no other star of that share of their light near them."""
    x, y, e = truth["x_px"], truth["y_px"], truth["electrons"]
    inside = truth["in_frame"] & (np.abs(x - 1023.5) < 1000) & (np.abs(y - 1023.5) < 1000)
    chosen = []
    for i in np.flatnonzero(inside & (truth["snr"] > 50)):
        near = np.hypot(x - x[i], y - y[i]) < radius_px
        near[i] = False
        if not (e[near] > share * e[i]).any():
            chosen.append(i)
    return np.array(chosen)


def sky_of(image):
    """Mean of the sky's pixels: finer than their median, which is a whole digital number."""
    off = image - np.median(image)
    near = np.abs(off) < 2.5 * 1.48 * np.median(np.abs(off))
    return float(np.mean(image[near]))


def test_against_source_extractor(product, tmp_path):
    """sep finds the bright stars at the truth positions, with the truth's light."""
    truth, hdu = truth_of(product), exported(product, tmp_path)
    image = (hdu.data.astype(float) - 500.0) * 1.5
    image = np.ascontiguousarray(image - sep.Background(image).back())
    stars = isolated(truth, 25.0)
    assert len(stars) > 60
    x, y = truth["x_px"][stars], truth["y_px"][stars]
    found = sep.extract(image, 8.0, err=float(np.sqrt(np.median(image**2)) * 1.48))
    distance = np.hypot(found["x"][None] - x[:, None], found["y"][None] - y[:, None])
    assert (distance.min(axis=1) < 1.0).mean() > 0.98  # it finds them at all
    x_win, y_win, _ = sep.winpos(image, x, y, 1.3)
    offset = np.hypot(x_win - x, y_win - y)
    assert np.median(offset) < 0.05
    assert abs(np.median(x_win - x)) < 0.01
    assert abs(np.median(y_win - y)) < 0.01
    light, _, _ = sep.sum_circle(image, x, y, 6.0, subpix=0)
    ratio = light / truth["electrons"][stars]
    assert abs(np.median(ratio) - 1.0) < 0.01


def test_against_astropy_wcs(product, tracked, tmp_path):
    """The exported WCS puts every star and target of the truth on its drawn pixel."""
    for i, path in enumerate((product, tracked)):
        header = exported(path, tmp_path / str(i)).header
        for kind in ("stars", "targets"):
            if not (path / "truth" / f"{kind}.parquet").exists():
                continue
            truth = truth_of(path, kind)
            inside = truth["in_frame"]
            world = np.stack([truth["ra_deg"][inside], truth["dec_deg"][inside]], -1)
            assert len(world)
            x, y = WCS(header).all_world2pix(world, 0).T
            worst = np.hypot(x - truth["x_px"][inside], y - truth["y_px"][inside]).max()
            assert worst < 1e-3, kind


def test_against_apparent_wcs(tracked, tmp_path):
    """The alternate WCS gives the target's apparent place at its pixel."""
    truth, header = truth_of(tracked, "targets"), exported(tracked, tmp_path).header
    world = [[truth["apparent_ra_deg"][0], truth["apparent_dec_deg"][0]]]
    x, y = WCS(header, key="A").all_world2pix(world, 0)[0]
    assert np.hypot(x - truth["x_px"][0], y - truth["y_px"][0]) < 1e-3


def test_rate_track_holds_the_target_and_streaks_the_stars(tracked, tmp_path):
    """The GEO target is a point at the centre; stars streak by 15 arcsec/s along the equator."""
    stars, target = truth_of(tracked), truth_of(tracked, "targets")
    assert target["x_px"][0] == pytest.approx(1023.5, abs=1e-6)
    assert target["y_px"][0] == pytest.approx(1023.5, abs=1e-6)
    ifov_arcsec = np.degrees(9e-6 / 2.0) * 3600
    length = np.hypot(
        stars["x_end_px"] - stars["x_start_px"], stars["y_end_px"] - stars["y_start_px"]
    )
    assert np.median(length) * ifov_arcsec / 3.0 == pytest.approx(15.04, rel=0.01)
    image = (exported(tracked, tmp_path).data.astype(float) - 500.0) * 1.5
    image = np.ascontiguousarray(image - np.median(image))
    x, y, _ = sep.winpos(image, [1023.5], [1023.5], 1.3)
    assert np.hypot(x[0] - 1023.5, y[0] - 1023.5) < 0.05
    light, _, _ = sep.sum_circle(image, [1023.5], [1023.5], 6.0, subpix=0)
    assert light[0] == pytest.approx(target["electrons"][0], rel=0.05)


def test_streak_light_and_shape(tracked, tmp_path):
    """Isolated streaks hold the truth's light, between the truth's ends, about their middle."""
    truth, image = truth_of(tracked), exported(tracked, tmp_path).data.astype(float)
    image = (image - 500.0) * 1.5
    image -= sky_of(image)
    stars = isolated(truth, 60.0, share=0.05)
    assert len(stars) >= 8
    along, across, light = [], [], []
    yy, xx = np.mgrid[: image.shape[0], : image.shape[1]]
    for i in stars:
        a = np.array([truth["x_start_px"][i], truth["y_start_px"][i]])
        b = np.array([truth["x_end_px"][i], truth["y_end_px"][i]])
        length = np.hypot(*(b - a))
        u = (b - a) / length
        cut = np.s_[
            max(0, int(min(a[1], b[1])) - 12) : int(max(a[1], b[1])) + 13,
            max(0, int(min(a[0], b[0])) - 12) : int(max(a[0], b[0])) + 13,
        ]
        dx, dy = xx[cut] - truth["x_px"][i], yy[cut] - truth["y_px"][i]
        s, t = dx * u[0] + dy * u[1], dy * u[0] - dx * u[1]
        inside = (np.abs(s) < length / 2 + 7) & (np.abs(t) < 7)
        box = np.where(inside, image[cut], 0.0)
        light.append(box.sum() / truth["electrons"][i])
        along.append((s * box).sum() / box.sum())
        across.append((t * box).sum() / box.sum())
    assert np.median(light) == pytest.approx(1.0, abs=0.015)
    assert abs(np.median(along)) < 0.2
    assert abs(np.median(across)) < 0.03
