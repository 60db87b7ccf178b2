"""Cones and leaves: no star missed, only what is needed read."""

from __future__ import annotations

import erfa
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from star_rows import random_stars, same_rows, write_csv

from catalog_tools.columns import CANONICAL
from catalog_tools.errors import BadInput
from catalog_tools.ingest import ingest
from catalog_tools.query import bands_to_read, cone, leaves_in_cone, read_leaf
from catalog_tools.sphere import MAS_RAD, angles_deg, directions, moved, separation_rad


def brute_force(stars, ra_deg, dec_deg, radius_deg, faintest=None, epoch=2015.5):
    """The ids in a cone, by ERFA's space motion for each star and a plain separation."""
    t = {name: stars[name].to_numpy().astype(float) for name in stars.column_names}
    ra, dec = np.radians(t["ra"]), np.radians(t["dec"])
    pmra, pmdec = np.nan_to_num(t["pmra"]), np.nan_to_num(t["pmdec"])
    east = np.stack([-np.sin(ra), np.cos(ra), 0 * ra], 1)
    north = np.stack([-np.sin(dec) * np.cos(ra), -np.sin(dec) * np.sin(ra), np.cos(dec)], 1)
    u = erfa.s2c(ra, dec)
    plx = np.maximum(np.nan_to_num(t["parallax"]), 0)
    rate = 1 + np.nan_to_num(t["radial_velocity"]) / 4.740470446 * plx * MAS_RAD * (epoch - 2015.5)
    u = rate[:, None] * u + (epoch - 2015.5) * MAS_RAD * (
        pmra[:, None] * east + pmdec[:, None] * north
    )
    apart = erfa.sepp(
        u, np.broadcast_to(erfa.s2c(np.radians(ra_deg), np.radians(dec_deg)), u.shape)
    )
    inside = apart <= np.radians(radius_deg)
    if faintest is not None:
        inside &= t["phot_g_mean_mag"] <= faintest
    return np.sort(stars["source_id"].to_numpy()[inside])


CONES = [
    (10.0, 0.0, 5.0), (123.4, 90.0, 8.0), (0.0, -90.0, 12.0), (0.0, 20.0, 6.0), (359.9, -35.0, 9.0),
    (45.0, 41.8103149, 4.0), (90.0, 0.0, 3.0), (266.0, -29.0, 0.5), (200.0, 10.0, 60.0),
    (33.0, -8.0, 180.0), (90.0, 89.9, 0.3),
]  # fmt: skip


@pytest.mark.parametrize("where", CONES)
@pytest.mark.parametrize(
    ("faintest", "epoch"), [(None, 2015.5), (9.7, 2015.5), (None, 2115.5), (15.0, 1815.0)]
)
def test_against_brute_force(catalogue, stars, where, faintest, epoch):
    found, report = cone(catalogue, *where, faintest, epoch)
    assert found["source_id"].to_pylist() == brute_force(stars, *where, faintest, epoch).tolist()
    assert report.rows == found.num_rows <= report.rows_read


@settings(max_examples=60, deadline=None)
@given(
    ra=st.floats(0, 360), dec=st.floats(-90, 90), radius=st.floats(0.01, 40),
    faintest=st.floats(2, 22), epoch=st.floats(1900, 2150),
)  # fmt: skip
def test_against_brute_force_anywhere(catalogue, stars, ra, dec, radius, faintest, epoch):
    found, _ = cone(catalogue, ra, dec, radius, faintest, epoch)
    assert (
        found["source_id"].to_pylist()
        == brute_force(stars, ra, dec, radius, faintest, epoch).tolist()
    )


def test_limits_fast_movers_cross_leaf_borders(tmp_path):
    """Stars of 20 to 60 arcsec a year within a degree of HEALPix borders, 200 years on."""
    near = random_stars(3000, 3, around=(0.0, 0.0, 0.7))
    fast = near.set_column(3, "pmra", near["ra"].cast("float32")).to_pydict()
    rng = np.random.default_rng(0)
    fast["pmra"], fast["pmdec"] = rng.normal(0, 3e4, 3000), rng.normal(0, 3e4, 3000)
    near = type(near).from_pydict(fast, schema=near.schema)
    made = ingest(
        [write_csv(tmp_path / "n.csv", near)], tmp_path / "c", rows_per_leaf=100
    ).catalogue
    assert len(made.leaves) > 20
    for ra, dec, radius in (
        (0.0, 0.0, 0.2),
        (1.5, 0.3, 0.3),
        (359.3, -1.9, 0.5),
        (0.05, 0.05, 0.01),
    ):
        for epoch in (1815.5, 2015.5, 2215.5):
            found, _ = cone(made, ra, dec, radius, None, epoch)
            assert (
                found["source_id"].to_pylist()
                == brute_force(near, ra, dec, radius, None, epoch).tolist()
            )


def test_limits_leaves_hold_parallax_and_nearing_stars(catalogue, stars):
    """A leaf is found for each star from anywhere it may be seen, Barnard-like ones included."""
    t = {n: np.nan_to_num(stars[n].to_numpy().astype(float)) for n in stars.column_names}
    years = 60.0
    at = moved(t["ra"], t["dec"], t["pmra"], t["pmdec"], years, t["parallax"], t["radial_velocity"])
    some = np.argsort(-np.hypot(t["pmra"], t["pmdec"]))[:40]
    shift = np.maximum(t["parallax"], 0)[:, None] * MAS_RAD * np.array([0.6, -0.5, 0.6])
    for i in some:
        seen = at[i] + shift[i]
        leaves = leaves_in_cone(catalogue, seen / np.linalg.norm(seen), 1e-9, 2015.5 + years)
        ids = [
            k
            for leaf in leaves
            for k in read_leaf(catalogue, leaf, None, ["source_id"])["source_id"].to_pylist()
        ]
        assert stars["source_id"][i].as_py() in ids


def test_against_erfa_space_motion():
    """Our straight line against SOFA's starpm (which adds light-time terms): Barnard's star."""
    ra, dec = np.radians([269.452]), np.radians([4.6933])
    pmra, pmdec, plx, rv = -802.8, 10362.5, 547.45, -110.5
    for years in (-100.0, 85.0):
        r2, d2 = erfa.starpm(
            ra, dec, pmra * MAS_RAD / np.cos(dec), pmdec * MAS_RAD, plx / 1e3, rv,
            2451545.0, 0.0, 2451545.0, years * 365.25,
        )[:2]  # fmt: skip
        ours = moved(np.degrees(ra), np.degrees(dec), np.array([pmra]), np.array([pmdec]), years,
                     np.array([plx]), np.array([rv]))  # fmt: skip
        assert separation_rad(ours, erfa.s2c(r2, d2))[0] < 1.5 * MAS_RAD


def test_limits_motion_at_the_pole():
    """A star 0.36 arcsec from the pole that moves 1 arcsec north ends 0.64 arcsec beyond it."""
    at = moved(np.array([0.0]), np.array([89.9999]), np.array([0.0]), np.array([1000.0]), 1.0)
    ra, dec = angles_deg(at)
    assert separation_rad(at, directions(0.0, 89.9999))[0] == pytest.approx(
        1000 * MAS_RAD, rel=1e-9
    )
    assert ra[0] == pytest.approx(180.0, abs=1e-9)
    assert dec[0] == pytest.approx(90.0 - 0.64 / 3600.0, abs=1e-10)


def test_read_leaf_reads_only_bright_bands(catalogue):
    leaf = max(catalogue.leaves, key=lambda leaf: leaf.rows)
    assert bands_to_read(leaf, None) == leaf.bands
    assert bands_to_read(leaf, leaf.bands[0].brightest_g_mag - 0.01) == ()
    assert read_leaf(catalogue, leaf, -5.0).num_rows == 0
    one = leaf.bands[0].brightest_g_mag
    assert read_leaf(catalogue, leaf, one, ["ra"]).num_rows == 1
    assert read_leaf(catalogue, leaf).schema.names == CANONICAL.names


def test_same_rows_as_came_in(catalogue, stars):
    whole, _ = cone(catalogue, 0, 0, 180)
    assert same_rows(whole, stars)
    assert sum(leaf.rows for leaf in catalogue.leaves) == stars.num_rows == catalogue.rows


@pytest.mark.parametrize(
    ("where", "field"),
    [
        ((float("nan"), 0, 1), "ra_deg"), ((0, 91, 1), "dec_deg"),
        ((0, float("nan"), 1), "dec_deg"),
        ((0, 0, 0), "radius_deg"), ((0, 0, -1), "radius_deg"), ((0, 0, 181), "radius_deg"),
        ((0, 0, 1, float("nan")), "faintest_g_mag"), ((0, 0, 1, None, float("inf")), "epoch_jyear"),
    ],
)  # fmt: skip
def test_bad_cone_names_its_field(catalogue, where, field):
    with pytest.raises(BadInput) as caught:
        cone(catalogue, *where)
    assert caught.value.field == field


def test_unknown_column(catalogue):
    with pytest.raises(BadInput, match="ruwe"):
        read_leaf(catalogue, catalogue.leaves[0], None, ["ra", "ruwe"])
