"""The synthetic catalogue: DR2's statistics, one sky for any choice of depth, plainly marked."""

from __future__ import annotations

import sqlite3
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from catalog_tools.errors import BadInput
from catalog_tools.geometry.sphere import directions, separation_rad
from catalog_tools.info import info
from catalog_tools.partition import coarser, healpix_29
from catalog_tools.query.query import cone
from catalog_tools.star_counts import (
    ALL_SKY_DEG2,
    EDGES_G_MAG,
    GALACTIC,
    all_sky_count,
    galactic_rad,
    interval_density,
)
from catalog_tools.synthetic.clusters import CROWDS, interval_shares
from catalog_tools.synthetic.stars import draw_stars, share_absent
from catalog_tools.synthetic.synthetic import (
    DeepField,
    Sky,
    _check,
    cell_order,
    make_demo,
    stars_in_cell,
)

FIELD = (150.0, 2.0, 1.0, 17.5)


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    return make_demo(
        tmp_path_factory.mktemp("demo") / "sky", faintest_g_mag=8.0, deep_fields=[FIELD]
    ).catalogue


@pytest.fixture(scope="module")
def whole(demo):
    return cone(demo, 0, 0, 180)[0]


def test_says_plainly_that_it_is_synthetic(demo):
    assert demo.synthetic
    assert "no row is a real star" in demo.description
    assert info(demo)["synthetic"] is True
    assert "nightglass_synthetic=true" in (Path(demo.path) / "hats.properties").read_text()


def test_complete_to_its_limits_without_duplicates_or_seam(demo, whole):
    g_mag = whole["phot_g_mean_mag"].to_numpy()
    v = directions(whole["ra"].to_numpy(), whole["dec"].to_numpy())
    inside = separation_rad(v, directions(*FIELD[:2])) <= np.radians(FIELD[2])
    assert len(set(whole["source_id"].to_pylist())) == whole.num_rows == demo.rows
    assert g_mag[~inside].max() <= 8.0
    assert 17.4 < g_mag[inside].max() <= 17.5
    expected = all_sky_count(8.0) - all_sky_count(3.0)
    assert abs((g_mag <= 8.0).sum() / expected - 1) < 0.15


def test_source_ids_follow_dr2(whole):
    pixels = coarser(healpix_29(whole["ra"].to_numpy(), whole["dec"].to_numpy()), 12)
    assert (pixels == whole["source_id"].to_numpy() >> 35).all()


def test_same_sky_for_any_choice_of_depth(tmp_path, demo, whole):
    """Another limit and another field: the stars that both want are the same, to the bit."""
    fields = [(151.0, 2.0, 0.6, 16.0), FIELD]
    other = make_demo(tmp_path / "o", faintest_g_mag=6.0, deep_fields=fields, workers=1).catalogue
    rows = cone(other, 0, 0, 180)[0]
    ours = {r["source_id"]: r for r in whole.to_pylist()}
    v = directions(rows["ra"].to_numpy(), rows["dec"].to_numpy())
    in_ours = separation_rad(v, directions(*FIELD[:2])) <= np.radians(FIELD[2])
    shared = rows.filter(pa.array(in_ours | (rows["phot_g_mean_mag"].to_numpy() <= 6.0)))
    assert shared.num_rows > 5000
    assert all(ours[r["source_id"]] == r for r in shared.to_pylist())


def test_same_bits_for_same_arguments(tmp_path, demo):
    again = make_demo(tmp_path / "again", faintest_g_mag=8.0, deep_fields=[FIELD], workers=1)
    assert again.catalogue.digest == demo.digest
    other = make_demo(tmp_path / "other", faintest_g_mag=8.0, seed=3)
    assert other.catalogue.digest != demo.digest


def test_same_bits_in_tables_of_any_size(tmp_path, demo, monkeypatch):
    monkeypatch.setattr("catalog_tools.synthetic.synthetic.TABLE_ROWS", 500)
    again = make_demo(tmp_path / "again", faintest_g_mag=8.0, deep_fields=[FIELD], workers=1)
    assert again.catalogue.digest == demo.digest


def _density(limit, lat_deg):
    """Mean modelled density over longitude, stars per deg2 brighter than `limit`."""
    lon, lat = np.radians(np.arange(0, 360, 5.0)), np.radians(lat_deg)
    v = np.stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), 0 * lon + np.sin(lat)], 1)
    intervals = range(round((limit - 3) / 0.5))
    return sum(interval_density(i, v @ GALACTIC).mean() for i in intervals)


def test_against_published_totals():
    sin_lat = np.arange(-0.995, 1.0, 0.01)
    for limit, low, high in ((12.0, 2e6, 3.3e6), (17.0, 150e6, 175e6), (21.0, 1.6e9, 1.75e9)):
        mean = np.mean([_density(limit, np.degrees(np.arcsin(s))) for s in sin_lat])
        assert low < mean * ALL_SKY_DEG2 < high


def test_against_random_dr2_sample(shared_data):
    """Densities by latitude against real rows, 1 in 65536 of the sky (G is right in that file)."""
    path = shared_data / "gaia_dr2" / "allsky_random_sqlite" / "gaia_subset.sqlite3"
    with sqlite3.connect(f"file:{path}?mode=ro&immutable=1", uri=True) as base:
        rows = base.execute("select ra, dec, phot_g_mean_mag from gaialight").fetchall()
    ra, dec, g_mag = np.array(rows, float).T
    lat = np.abs(np.degrees(galactic_rad(directions(ra, dec))[1]))
    for limit in (16.0, 17.0, 18.0):
        assert (g_mag < limit).sum() * 65536 == pytest.approx(all_sky_count(limit), rel=0.12)
        for low, high in ((0, 5), (5, 10), (10, 20), (20, 40), (40, 90)):
            edges = np.sin(np.radians([low, high]))
            steps = np.linspace(*edges, 21)
            lats = np.degrees(np.arcsin((steps[1:] + steps[:-1]) / 2))
            rows = ((lat >= low) & (lat < high) & (g_mag < limit)).sum()
            mine = np.mean([_density(limit, b) for b in lats]) * ALL_SKY_DEG2 * np.diff(edges)[0]
            assert abs(mine / 65536 - rows) < 0.35 * rows + 3 * np.sqrt(rows), (limit, low)


def test_against_complete_real_field(shared_data):
    """Eight trixels (2.5 deg2) at galactic latitude -61, complete to G 21: counts within 35%."""
    from astropy.io import fits

    folder = shared_data / "gaia_dr2" / "lsst_refcat_htm7"
    flux = np.concatenate([fits.getdata(p, 1)["phot_g_mean_flux"] for p in folder.glob("*.fits")])
    g_mag = -2.5 * np.log10(flux * 1e-9 / 3631) - 0.105
    here, area_deg2 = directions(0.7, -1.0)[None], 8 * ALL_SKY_DEG2 / (8 * 4**7)
    for limit in range(12, 22):
        density = sum(interval_density(i, here)[0] for i in range(2 * (limit - 3)))
        assert density * area_deg2 == pytest.approx((g_mag < limit).sum(), rel=0.35), limit


def test_clusters_stand_in_deep_fields(tmp_path):
    """NGC 6121: half of its stars to the limit lie within its radius, on top of the field's."""
    crowd = next(c for c in CROWDS if "6121" in c.name)
    here, limit = (crowd.ra_deg, crowd.dec_deg), 17.5
    fields = [(*here, crowd.radius_deg, limit)]
    made = make_demo(tmp_path / "m4", faintest_g_mag=4.0, deep_fields=fields).catalogue
    found = cone(made, *here, crowd.radius_deg)[0].num_rows
    steps = EDGES_G_MAG[1:] <= limit
    members = crowd.stars * interval_shares(crowd)[steps].sum() / 2
    v, area_deg2 = directions(*here)[None], np.pi * crowd.radius_deg**2
    field = sum(interval_density(i, v)[0] for i in np.flatnonzero(steps)) * area_deg2
    assert found == pytest.approx(members + field, rel=0.15)
    assert members > field


def test_statistics_of_stars():
    rng = np.random.default_rng(1)
    pixels = np.arange(20_000) << 30

    def stars(interval):
        return draw_stars(rng, interval, pixels)

    bright, middle, faint = stars(12), stars(28), stars(35)
    for t in (bright, middle, faint):
        colour = t["phot_bp_mean_mag"] - t["phot_rp_mean_mag"]
        assert 0.7 < np.nanmedian(colour) < 1.6
        assert 0.3 < np.nanmedian(t["phot_g_mean_mag"] - t["phot_rp_mean_mag"]) < 0.9
        assert (np.isnan(t["pmra"]) == np.isnan(t["parallax"])).all()
        assert 4.0 < np.nanmedian(np.hypot(t["pmra"], t["pmdec"])) < 25.0
    assert np.nanmedian(bright["parallax"]) > np.nanmedian(middle["parallax"])
    assert np.isfinite(bright["radial_velocity"]).mean() > 0.8
    assert not np.isfinite(middle["radial_velocity"]).any()
    assert np.nanmean(faint["parallax"][np.isfinite(faint["parallax"])] < 0) > 0.25
    assert np.isnan(faint["phot_bp_mean_mag"]).mean() > 0.3 > np.isnan(middle["pmra"]).mean()


def test_absent_values_at_dr2_rates():
    edges = np.arange(3.0, 21.001, 0.01)
    rows, middle = np.diff(all_sky_count(edges)), (edges[1:] + edges[:-1]) / 2
    for half, width, published in ((20.772, 0.4, 0.184), (20.668, 0.4, 0.213)):
        assert (rows * share_absent(middle, half, width)).sum() / rows.sum() == pytest.approx(
            published, abs=0.003
        )


def test_a_cell_is_a_pure_function():
    sky = Sky(5, 3.5, (DeepField(10.0, 85.0, 3.0, 20.0),))
    interval = int(np.searchsorted(EDGES_G_MAG, 15.0))
    cell = sky.cells(interval, cell_order(interval))[0]
    assert stars_in_cell(sky, interval, cell).equals(stars_in_cell(sky, interval, cell))


@pytest.mark.parametrize("around", [0, 1])
def test_a_shallow_field_takes_no_star_from_what_lies_around_it(around):
    """Within the sky, and within a deeper field, whichever of the two is named first."""
    deep, shallow = DeepField(10.0, 20.0, 2.0, 14.0), DeepField(10.0, 20.0, 1.0, 6.0)
    both = (deep, shallow) if around == 0 else (shallow, deep)
    v = directions(np.array([10.0, 10.0, 10.0]), np.array([20.0, 21.5, 40.0]))
    for g_mag, by_sky, by_both in (
        (7.0, [True, True, True], [True, True, True]),
        (9.0, [False, False, False], [True, True, False]),
        (14.5, [False, False, False], [False, False, False]),
    ):
        g = np.full(3, g_mag)
        assert Sky(5, 8.0, (shallow,)).wanted(v, g).tolist() == by_sky
        assert Sky(5, 8.0, both).wanted(v, g).tolist() == by_both


def test_limits_are_included():
    """The poles, RA of 0 and 360 degrees, 30 degrees of radius, G of 21; G of 16 for the sky."""
    edges = [DeepField(0.0, -90.0, 30.0, 21.0), DeepField(360.0, 90.0, 1e-9, 21.0)]
    _check(16.0, edges, 0)
    _check(16.0, edges, 2**32 - 1)
    beyond = {"ra_deg": (-1e-9, 360.1), "dec_deg": (-90.1, 90.1), "radius_deg": (0.0, 30.1),
              "faintest_g_mag": (21.1,)}  # fmt: skip
    for name, values in beyond.items():
        for value in values:
            with pytest.raises(BadInput, match=rf"deep_fields\.1\.{name}"):
                _check(16.0, [edges[0], replace(edges[1], **{name: value})], 0)
    for seed in (-1, 2**32):
        with pytest.raises(BadInput, match="seed"):
            _check(16.0, edges, seed)


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        ({"faintest_g_mag": 17.0}, "faintest_g_mag"),
        ({"faintest_g_mag": float("nan")}, "faintest_g_mag"),
        ({"seed": -1}, "seed"), ({"deep_fields": [(0, 91, 1, 15)]}, "deep_fields.0.dec_deg"),
        ({"deep_fields": [(0, 0, 0, 15)]}, "deep_fields.0.radius_deg"),
        ({"deep_fields": [(0, 0, 1, 15), (0, 0, 1, 22)]}, "deep_fields.1.faintest_g_mag"),
    ],
)  # fmt: skip
def test_bad_input_names_its_field(tmp_path, arguments, field):
    with pytest.raises(BadInput) as caught:
        make_demo(tmp_path / "c", **arguments)
    assert caught.value.field == field
    assert not list(tmp_path.iterdir())
