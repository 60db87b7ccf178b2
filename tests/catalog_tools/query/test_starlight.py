"""The map of summed starlight: every star in it once, at its place, magnitude and colour."""

from __future__ import annotations

import errno
import shutil
import sys
from unittest.mock import Mock

import numpy as np
import pytest

from catalog_tools.catalogue import open_catalogue
from catalog_tools.engine.schedulers import LocalScheduler
from catalog_tools.errors import BadInput, Damaged, DiskFull
from catalog_tools.geometry.healpix_interpolation import neighbours
from catalog_tools.query import starlight as sl
from catalog_tools.query.query import cone
from catalog_tools.star_counts import GALACTIC
from catalog_tools.synthetic.synthetic import make_demo


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A small synthetic sky with a deep field, and its map."""
    path = tmp_path_factory.mktemp("starlight") / "catalogue"
    make_demo(path, faintest_g_mag=5.5, deep_fields=[(200.0, 60.0, 2.2, 16.0)], seed=4)
    catalogue = open_catalogue(path)
    return catalogue, sl.make_starlight(catalogue)


@pytest.fixture(scope="module")
def stars(made):
    rows, _ = cone(made[0], 0.0, 0.0, 180.0)
    names = ("phot_g_mean_mag", "phot_bp_mean_mag", "phot_rp_mean_mag", "_healpix_29")
    rows = rows if "_healpix_29" in rows.column_names else cone(
        made[0], 0.0, 0.0, 180.0, columns=names)[0]  # fmt: skip
    return [rows[n].to_numpy(zero_copy_only=False).astype(np.float64) for n in names[:3]] + [
        rows["_healpix_29"].to_numpy()
    ]


def centre(order, pixel):
    import healpy

    return np.array([healpy.pix2vec(1 << order, pixel, nest=True)])


@pytest.mark.parametrize("order", [0, 1, 2, 6, 7])
def test_against_healpy_weights(order):
    import healpy

    rng = np.random.default_rng(order)
    v = rng.normal(size=(4000, 3))
    v[:200, :2] *= 10.0 ** rng.uniform(-12, 0, (200, 1))  # around the poles
    v[200:202] = [[0, 0, 1], [0, 0, -1]]
    v /= np.sqrt(np.sum(v**2, axis=1))[:, None]
    values = rng.random(12 * 4**order)
    pixels, weights = neighbours(order, v)
    theta, phi = np.arctan2(np.hypot(v[:, 0], v[:, 1]), v[:, 2]), np.arctan2(v[:, 1], v[:, 0])
    expected = healpy.get_interp_val(values, theta, phi, nest=True)
    np.testing.assert_allclose((values[pixels] * weights).sum(axis=0), expected, atol=1e-12)


def test_every_star_is_in_the_map_once(made, stars):
    light, (g, bp, rp, healpix) = made[1].light.astype(float), stars
    own, colour = 10.0 ** (-0.4 * g), bp - rp
    has = np.isfinite(colour)
    bins = np.searchsorted(sl.BIN_EDGES_G_MAG, g, side="left")
    for kind, factor in enumerate((np.ones_like(g), colour, colour**2)):
        expected = np.bincount(bins[has], (own * factor)[has], sl.BINS)
        np.testing.assert_allclose(light[:, kind].sum(axis=-1), expected, rtol=1e-5, atol=1e-12)
    np.testing.assert_allclose(light[:, 3].sum(), own[~has].sum(), rtol=1e-5)
    pixel = healpix >> (2 * (29 - made[1].order))
    expected = np.bincount(pixel, own, light.shape[-1])
    np.testing.assert_allclose(light[:, [0, 3]].sum(axis=(0, 1)), expected, rtol=1e-5, atol=1e-12)


def test_stars_on_an_edge_are_not_beyond_it(tmp_path):
    """A star of G = 15.5 is drawn where the limit is 15.5: its light is not in the glow too."""
    from catalog_tools.ingest.ingest import ingest

    edges = [3.0, 9.0, 15.5, 21.0]
    rows = [f"{i + 1},2015.5,{10.0 + 0.01 * i},20.0,,,,,{g}" for i, g in enumerate(edges)]
    head = "source_id,ref_epoch,ra,dec,parallax,pmra,pmdec,radial_velocity,phot_g_mean_mag"
    (tmp_path / "stars.csv").write_text("\n".join([head, *rows]) + "\n")
    ingest([tmp_path / "stars.csv"], tmp_path / "catalogue", workers=1)
    light = sl.make_starlight(open_catalogue(tmp_path / "catalogue"), order=2)
    bright = light.light[:, [0, 3]].sum(axis=1).max(axis=1)
    for limit in edges:
        first = int(np.searchsorted(sl.BIN_EDGES_G_MAG, limit)) + 1  # the bin beyond
        fainter = sum(10.0 ** (-0.4 * g) for g in edges if g > limit)
        assert bright[first:].sum() == pytest.approx(fainter, rel=1e-6)


@pytest.mark.parametrize("limit", [-1.0, 3.0, 3.1, 9.0, 12.5, 12.77, 15.49, 15.5, 22.0, 30.0])
def test_light_beyond_a_limit(made, stars, limit):
    """At a pixel's centre: exact on edges, within its own error inside a bin."""
    g, _, _, healpix = stars
    pixel = healpix >> (2 * (29 - made[1].order))
    own = 10.0 ** (-0.4 * g)
    for at in np.unique(pixel[g > 14.0])[::5]:
        found = made[1].fainter(limit, centre(made[1].order, int(at)))
        got = (found.g + found.g_without_colour)[0] * 4 * np.pi / made[1].light.shape[-1]
        error = found.g_error[0] * 4 * np.pi / made[1].light.shape[-1]
        expected = own[(pixel == at) & (g > limit)].sum()
        if limit < 3.0:
            expected = own[pixel == at].sum()
        assert abs(got - expected) <= 1e-5 * expected + error + 1e-15
        if limit in (3.0, 9.0, 12.5, 15.5, 22.0, 30.0, -1.0):
            assert error == 0.0


def test_squares_are_those_of_the_stars(made, stars):
    g, _, _, healpix = stars
    pixel = healpix >> (2 * (29 - made[1].order))
    at = np.bincount(pixel[g > 14]).argmax()
    found = made[1].fainter(12.0, centre(made[1].order, int(at)))
    expected = (10.0 ** (-0.8 * g[(pixel == at) & (g > 12.0)])).sum()
    got = found.g_squared[0] * 4 * np.pi / made[1].light.shape[-1]
    assert got == pytest.approx(expected, rel=0.2)


def test_same_bits_whatever_the_scheduler_and_read_back(made):
    again = sl.make_starlight(made[0], scheduler=LocalScheduler("synchronous", 1))
    np.testing.assert_array_equal(again.light, made[1].light)
    read = sl.read_starlight(made[0])
    np.testing.assert_array_equal(read.light, made[1].light)
    assert read.order == made[1].order == 6
    assert (made[0].path and sl.make_starlight(made[0]).catalogue_digest) == made[0].digest


def test_damage_is_found_and_named(made, tmp_path):
    path = tmp_path / "copy"
    shutil.copytree(made[0].path, path)
    catalogue, file = open_catalogue(path), path / sl.STARLIGHT_NAME
    whole = file.read_bytes()
    for at in (200, len(whole) // 2, len(whole) - 300):
        file.write_bytes(whole[:at] + bytes([whole[at] ^ 16]) + whole[at + 1 :])
        with pytest.raises(Damaged, match=r"starlight\.npz"):
            sl.read_starlight(catalogue)
    file.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(Damaged, match="catalog starlight"):
        sl.read_starlight(catalogue)
    other = tmp_path / "other"
    make_demo(other, faintest_g_mag=4.0, seed=9)
    (other / sl.STARLIGHT_NAME).write_bytes(whole)
    with pytest.raises(Damaged, match="other stars"):
        sl.read_starlight(open_catalogue(other))
    (other / sl.STARLIGHT_NAME).unlink()
    assert sl.read_starlight(open_catalogue(other)) is None


def test_a_folder_in_the_place_of_a_map(made, tmp_path):
    shutil.copytree(made[0].path, tmp_path / "copy")
    catalogue, place = open_catalogue(tmp_path / "copy"), tmp_path / "copy" / sl.STARLIGHT_NAME
    place.unlink()
    place.mkdir()
    with pytest.raises(Damaged, match=r"starlight\.npz: .*: cannot be read \(.*Is a directory"):
        sl.read_starlight(catalogue)
    with pytest.raises(BadInput, match=r"a folder to write to \(.*Is a directory") as caught:
        sl.make_starlight(catalogue)
    assert caught.value.value == str(place.parent)


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EDQUOT, errno.EFBIG])
def test_a_full_disk_is_said_as_one(made, monkeypatch, code):
    """A disk, a quota or the largest file there may be; the map that was there stays."""
    monkeypatch.setattr(np, "savez_compressed", Mock(side_effect=OSError(code, "no room")))
    with pytest.raises(DiskFull, match="make room"):
        sl.make_starlight(made[0])
    np.testing.assert_array_equal(sl.read_starlight(made[0]).light, made[1].light)


def test_refusals(made):
    from dataclasses import replace

    with pytest.raises(BadInput, match="local folder"):
        sl.make_starlight(replace(made[0], path="memory://somewhere"))
    with pytest.raises(BadInput, match="order"):
        sl.make_starlight(made[0], order=12)


def from_galactic(lon_deg, lat_deg):
    lon, lat = np.radians(lon_deg), np.radians(lat_deg)
    v = np.stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat) + 0 * lon], -1)
    return v @ GALACTIC


def test_against_published_starlight():
    """Integrated starlight in S10: about 20 to 30 at the poles, 160 to 640 in the plane, a mean of
    about 100 over the sky beyond G = 6 (the stars that the eye sees make up some more)."""
    counted, lon = sl.CountedLight(), np.arange(0.0, 360.0, 20.0)
    s10 = 10.0**4 * (np.pi / 180.0) ** 2  # stars of tenth magnitude per square degree
    pole = counted.fainter(6.0, from_galactic(lon, np.full(18, 90.0))).g * s10
    plane = counted.fainter(6.0, from_galactic(lon, np.zeros(18))).g * s10
    assert 15.0 < pole.mean() < 35.0
    assert 160.0 < plane.mean() < 640.0
    v = np.random.default_rng(1).normal(size=(5000, 3))
    v /= np.sqrt(np.sum(v**2, axis=1))[:, None]
    assert (counted.fainter(6.0, v).g * s10).mean() == pytest.approx(105.0, rel=0.15)


def test_stars_of_no_catalogue_stay_whatever_the_limit():
    """No limit has any of them drawn, so none is held to account for their graininess."""
    v = from_galactic(np.array([0.0]), np.array([40.0]))
    beyond = sl.CountedLight(18.0, in_no_catalogue=True)
    for limit in (10.0, 18.0, 20.0, 30.0):
        assert beyond.fainter(limit, v).g[0] == sl.CountedLight().fainter(18.0, v).g[0] > 0.0
        assert beyond.fainter(limit, v).g_squared[0] == 0.0


def test_counts_between_two_magnitudes_add_up():
    v = from_galactic(np.array([0.0, 120.0]), np.array([15.0, -70.0]))
    whole = sl.CountedLight().fainter(11.3, v)
    parts = sl.AddedLight((sl.CountedLight(3.0, 17.2), sl.CountedLight(17.2, 21.0)))
    for name in ("g", "g_colour", "g_colour_squared", "g_squared"):
        np.testing.assert_allclose(getattr(parts.fainter(11.3, v), name), getattr(whole, name),
                                   rtol=2e-4)  # fmt: skip


def test_against_a_real_complete_field(shared_data, tmp_path):
    """The counts against all real stars of 2.5 square degrees: within their stated error, and the
    colours that they take are those of the field."""
    sys.path.insert(0, str(__import__("pathlib").Path(__file__).parents[1]))
    from lsst_refcat import vega_mag

    sys.path.pop(0)
    from astropy.io import fits

    data = [fits.getdata(p, 1) for p in sorted(
        (shared_data / "gaia_dr2" / "lsst_refcat_htm7").glob("*_refcats.fits"))]  # fmt: skip
    g, bp, rp = (
        np.concatenate([vega_mag(d[f"phot_{b}_mean_flux"], b) for d in data])
        for b in ("g", "bp", "rp")
    )
    at = np.radians([0.7, -1.0])
    v = np.array([[np.cos(at[1]) * np.cos(at[0]), np.cos(at[1]) * np.sin(at[0]), np.sin(at[1])]])
    area = 4 * np.pi / (8 * 4**7)  # eight trixels of level 7
    for limit in (14.0, 16.0, 18.0):
        real = (10.0 ** (-0.4 * g[(g > limit) & (g < 21.0)])).sum() / (8 * area)
        counted = sl.CountedLight().fainter(limit, v)
        assert counted.g[0] == pytest.approx(real, rel=0.4)
        kept = (g > limit) & (g < 21.0) & np.isfinite(bp - rp)
        own = 10.0 ** (-0.4 * g[kept])
        mean = (own * (bp - rp)[kept]).sum() / own.sum()
        assert counted.g_colour[0] / counted.g[0] == pytest.approx(mean, abs=0.1)


@pytest.mark.parametrize(("before", "after"), [(3.0, 1.0), (1.0, 3.0)])
def test_error_inside_a_bin_holds_a_slope_either_way(before, after):
    """A line through the neighbouring bins moves (b - a) / 4 h (1 - h) past a limit."""
    light = np.zeros((sl.BINS, len(sl.KINDS), 12), np.float32)
    light[19, 0], light[21, 0] = before, after
    low, high = sl.BIN_EDGES_G_MAG[19:21]
    for share in (0.5, 0.1):
        found = sl.StarlightMap(0, light, "").fainter(high - share * (high - low), centre(0, 4))
        per_pixel = found.g_error[0] * 4.0 * np.pi / 12.0
        assert per_pixel == pytest.approx(2.0 / 4.0 * share * (1.0 - share))


def test_leaves_smaller_than_pixels_and_stars_with_one_colour_alone(tmp_path):
    """Leaves of a higher order than the map's fall into their pixels; half a colour is none."""
    from catalog_tools.ingest.ingest import ingest

    rng = np.random.default_rng(8)
    ra, dec = rng.uniform(100.0, 130.0, 1500), rng.uniform(-20.0, 20.0, 1500)
    kind = np.arange(1500) % 3
    rows = [
        f"{i + 1},2015.5,{ra[i]},{dec[i]},,,,,9.0,{'' if kind[i] == 1 else 9.5},"
        f"{'' if kind[i] == 2 else 8.7}"
        for i in range(1500)
    ]
    head = "source_id,ref_epoch,ra,dec,parallax,pmra,pmdec,radial_velocity,phot_g_mean_mag,"
    head += "phot_bp_mean_mag,phot_rp_mean_mag"
    (tmp_path / "stars.csv").write_text("\n".join([head, *rows]) + "\n")
    ingest([tmp_path / "stars.csv"], tmp_path / "catalogue", workers=1, rows_per_leaf=200)
    catalogue = open_catalogue(tmp_path / "catalogue")
    assert catalogue.leaf_table["order"].max() > 1
    light = sl.make_starlight(catalogue, order=1).light.sum(axis=0)
    healpix = cone(catalogue, 0.0, 0.0, 180.0, columns=["_healpix_29", "phot_bp_mean_mag",
                                                       "phot_rp_mean_mag"])[0]  # fmt: skip
    pixel = healpix["_healpix_29"].to_numpy() >> 56
    whole = np.isfinite(
        sum(healpix[n].to_numpy() for n in ("phot_bp_mean_mag", "phot_rp_mean_mag"))
    )
    one = 10.0 ** (-0.4 * 9.0)
    for row, which in ((0, whole), (3, ~whole)):
        expected = np.bincount(pixel[which], minlength=48) * one
        np.testing.assert_allclose(light[row], expected, rtol=1e-5)
