"""Cones, polygons and leaves: no star missed, only what is needed read."""

from __future__ import annotations

import erfa
import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from star_rows import random_stars, same_rows

from catalog_tools.columns import CANONICAL, STEPS
from catalog_tools.errors import BadInput
from catalog_tools.geometry.regions import Cone, cone_of, polygon_of
from catalog_tools.geometry.sphere import MAS_RAD, angles_deg, directions, moved, separation_rad
from catalog_tools.query import query
from catalog_tools.query.query import (
    cone,
    polygon,
    read_leaf,
    record_batches,
)
from catalog_tools.query.selection import motion_pad_rad, select
from catalog_tools.query.star_catalogue import StarCatalogue
from tests.command import nightglass


def seen_from_the_sun(stars, epoch):
    """Directions (n, 3) at an epoch by a plain formula on whole columns, apart from the tested."""
    t = {name: stars[name].to_numpy().astype(float) for name in stars.column_names}
    ra, dec = np.radians(t["ra"]), np.radians(t["dec"])
    pmra, pmdec = np.nan_to_num(t["pmra"]), np.nan_to_num(t["pmdec"])
    east = np.stack([-np.sin(ra), np.cos(ra), 0 * ra], 1)
    north = np.stack([-np.sin(dec) * np.cos(ra), -np.sin(dec) * np.sin(ra), np.cos(dec)], 1)
    plx = np.maximum(np.nan_to_num(t["parallax"]), 0)
    rate = 1 + np.nan_to_num(t["radial_velocity"]) / 4.740470446 * plx * MAS_RAD * (epoch - 2015.5)
    u = rate[:, None] * erfa.s2c(ra, dec) + (epoch - 2015.5) * MAS_RAD * (
        pmra[:, None] * east + pmdec[:, None] * north
    )
    return u / np.sqrt(np.sum(u * u, axis=1))[:, None]


def brute_force(stars, ra_deg, dec_deg, radius_deg, faintest=None, epoch=2015.5):
    """The ids in a cone, over the whole table."""
    centre = erfa.s2c(np.radians(ra_deg), np.radians(dec_deg))
    u = seen_from_the_sun(stars, epoch)
    inside = erfa.sepp(u, np.broadcast_to(centre, u.shape)) <= np.radians(radius_deg)
    if faintest is not None:
        inside &= stars["phot_g_mean_mag"].to_numpy().astype(float) <= faintest
    return np.sort(stars["source_id"].to_numpy()[inside]).tolist()


def ids(table):
    return sorted(table["source_id"].to_pylist())


def with_columns(stars, **columns):
    """Stars with some columns replaced, rounded as they are stored."""
    for name, values in columns.items():
        values = np.rint(np.asarray(values, float) / STEPS[name]) * STEPS[name]
        field = stars.schema.field(name)
        stars = stars.set_column(
            stars.schema.get_field_index(name), field, pa.array(values).cast(field.type)
        )
    return stars


CONES = [
    (10.0, 0.0, 5.0), (123.4, 90.0, 8.0), (0.0, -90.0, 12.0), (0.0, 20.0, 6.0), (359.9, -35.0, 9.0),
    (45.0, 41.8103149, 4.0), (90.0, 0.0, 3.0), (266.0, -29.0, 0.5), (200.0, 10.0, 60.0),
    (33.0, -8.0, 180.0), (90.0, 89.9, 0.3), (7.0, 12.0, 90.0), (180.0, 45.0, 179.9),
]  # fmt: skip


@pytest.mark.parametrize("where", CONES)
@pytest.mark.parametrize(
    ("faintest", "epoch"), [(None, 2015.5), (9.7, 2015.5), (None, 2100.0), (15.0, 1950.0)]
)
def test_against_brute_force(catalogue, stars, where, faintest, epoch):
    found, report = cone(catalogue, *where, faintest, epoch)
    assert ids(found) == brute_force(stars, *where, faintest, epoch)
    assert report.rows == found.num_rows <= report.rows_read


@settings(max_examples=40)
@given(
    ra=st.floats(0, 360), dec=st.floats(-90, 90), radius=st.floats(0.01, 40),
    faintest=st.floats(2, 22), epoch=st.floats(1900, 2150),
)  # fmt: skip
def test_against_brute_force_anywhere(catalogue, stars, ra, dec, radius, faintest, epoch):
    found, _ = cone(catalogue, ra, dec, radius, faintest, epoch)
    assert ids(found) == brute_force(stars, ra, dec, radius, faintest, epoch)


@settings(max_examples=25)
@given(
    seed=st.integers(0, 2**32), ra=st.floats(0, 360), dec=st.floats(-90, 90),
    size=st.floats(0.5, 40), faintest=st.floats(2, 22), epoch=st.floats(1950, 2100),
)  # fmt: skip
def test_against_brute_force_polygons(catalogue, stars, seed, ra, dec, size, faintest, epoch):
    """Convex polygons: a star is within where it is on the inner side of every edge."""
    rng = np.random.default_rng(seed)
    angles = np.sort(rng.uniform(0, 2 * np.pi, 3) / 3 + 2 * np.pi * np.arange(3) / 3)
    centre = directions(ra, dec)
    x = np.cross(centre, [0.6, 0.0, 0.8])
    x /= np.linalg.norm(x)
    side = np.cos(angles)[:, None] * x + np.sin(angles)[:, None] * np.cross(centre, x)
    corners = np.cos(np.radians(size)) * centre + np.sin(np.radians(size)) * side
    found, _ = polygon(catalogue, np.stack(angles_deg(corners), 1), faintest, epoch)
    u = seen_from_the_sun(stars, epoch)
    inside = stars["phot_g_mean_mag"].to_numpy().astype(float) <= faintest
    for a, b in zip(corners, np.roll(corners, -1, 0), strict=True):
        inside &= u @ np.cross(a, b) > 0
    assert ids(found) == np.sort(stars["source_id"].to_numpy()[inside]).tolist()


@pytest.mark.parametrize("where", CONES[:3])
def test_a_star_at_the_limit_belongs_to_it(catalogue, stars, where):
    """Whatever row groups it is in, and the next fainter one does not."""
    inside = brute_force(stars, *where)
    g_mag = stars.filter(pa.compute.is_in(stars["source_id"], pa.array(inside)))["phot_g_mean_mag"]
    for limit in np.unique(g_mag.to_numpy())[:: max(1, len(inside) // 12)].tolist():
        found, _ = cone(catalogue, *where, limit)
        assert ids(found) == brute_force(stars, *where, limit)
        assert found["phot_g_mean_mag"].to_numpy().max() == limit


def test_limits_tiny_cones_hold_their_star(catalogue, stars):
    """0.01 arcsec around a star, the first and last of row groups included, at its own place."""
    rows = stars.slice(0, 0).to_pylist()
    for leaf in catalogue.leaves[::6]:
        for group in (leaf.row_groups[0], leaf.row_groups[-1]):
            table = read_leaf(catalogue, leaf._replace(row_groups=(group,)))
            rows += [
                table.slice(0, 1).to_pylist()[0],
                table.slice(table.num_rows - 1).to_pylist()[0],
            ]
    for row in rows:
        found, report = cone(catalogue, row["ra"], row["dec"], 0.01 / 3600)
        assert row["source_id"] in ids(found)
        assert report.leaves <= 4


def test_limits_fast_movers_cross_leaf_borders(tmp_path, make_catalogue):
    """Stars of 20 to 60 arcsec a year within a degree of HEALPix borders, 200 years on."""
    rng = np.random.default_rng(0)
    near = with_columns(
        random_stars(3000, 3, around=(0.0, 0.0, 0.7)),
        pmra=rng.normal(0, 3e4, 3000), pmdec=rng.normal(0, 3e4, 3000),
    )  # fmt: skip
    made = make_catalogue(tmp_path, near, rows_per_leaf=100)
    assert made.leaf_table.size > 20
    for where in ((0.0, 0.0, 0.2), (1.5, 0.3, 0.3), (359.3, -1.9, 0.5), (0.05, 0.05, 0.01)):
        for epoch in (1815.5, 2015.5, 2215.5):
            found, _ = cone(made, *where, None, epoch)
            assert ids(found) == brute_force(near, *where, None, epoch)


def test_limits_one_fast_star_widens_only_its_own_row_group(tmp_path, make_catalogue):
    """Barnard's star in a field of slow ones: found where it will be, and nothing else is read."""
    slow = with_columns(
        random_stars(4000, 5, around=(269.5, 4.7, 4.0)),
        pmra=np.full(4000, 1.0), pmdec=np.full(4000, -1.0), parallax=np.full(4000, 0.5),
    )  # fmt: skip
    columns = {name: slow[name].to_pylist() for name in slow.column_names}
    barnard = {
        "source_id": 4472832130942575872, "ra": 269.4486, "dec": 4.7394, "pmra": -802.8,
        "pmdec": 10362.5, "parallax": 547.45, "radial_velocity": -110.5, "phot_g_mean_mag": 8.2,
        "phot_bp_mean_mag": 9.8, "phot_rp_mean_mag": 7.0,
    }  # fmt: skip
    for name, value in barnard.items():
        columns[name][0] = value
    field = pa.table(columns, schema=slow.schema)
    made = make_catalogue(tmp_path, field, rows_per_leaf=4000)
    assert (made.row_group_table["max_proper_motion_mas_yr"] > 1e4).sum() == 1
    for epoch in (1950.0, 2100.0):
        at = seen_from_the_sun(field, epoch)[0]
        ra, dec = (float(angle) for angle in angles_deg(at))
        found, report = cone(made, ra, dec, 1.0 / 3600, None, epoch)
        assert ids(found) == brute_force(field, ra, dec, 1.0 / 3600, None, epoch)
        assert barnard["source_id"] in ids(found)
        _, still = cone(made, ra, dec, 1.0 / 3600)
        assert report.row_groups <= still.row_groups + 1


def test_limits_parallax_and_nearing_stars(catalogue, stars):
    """The row group of a star is selected from anywhere the star may be seen, and its time."""
    t = {n: np.nan_to_num(stars[n].to_numpy().astype(float)) for n in stars.column_names}
    years = 60.0
    at = moved(t["ra"], t["dec"], t["pmra"], t["pmdec"], years, t["parallax"], t["radial_velocity"])
    some = np.argsort(-np.hypot(t["pmra"], t["pmdec"]))[:20].tolist()
    some += np.argsort(-t["parallax"])[:20].tolist()
    for i in some:
        for observer in ([0.6, -0.5, 0.6], [0.0, 39.0, -8.0]):
            grown = max(t["parallax"][i], 0) * MAS_RAD  # radial velocities are small here
            seen = at[i] - grown * np.array(observer)
            x, y, z = (seen / np.linalg.norm(seen)).tolist()
            region = Cone((x, y, z), 1e-9, 2015.5 + years, float(np.linalg.norm(observer)))
            leaves = select(catalogue, [region], t["phot_g_mean_mag"][i])
            held = [read_leaf(catalogue, leaf, None, ["source_id"]) for leaf in leaves]
            assert stars["source_id"][i].as_py() in ids(pa.concat_tables(held))


def test_limits_motion_pad():
    """It bounds what erfa's space motion and parallax do, and gives up where nothing bounds."""
    rng = np.random.default_rng(2)
    pm, plx = 10.0 ** rng.uniform(0, 4.2, 400), 10.0 ** rng.uniform(-1, 2.9, 400)
    years, rv, far = rng.uniform(-150, 150, 400), rng.uniform(-700, 700, 400), 1.1
    for i in range(400):
        angle = rng.uniform(0, 2 * np.pi)
        at = moved(
            np.zeros(1), np.zeros(1), pm[i : i + 1] * np.cos(angle), pm[i : i + 1] * np.sin(angle),
            years[i], plx[i : i + 1], rv[i : i + 1],
        )[0]  # fmt: skip
        nearing = 1 + rv[i] / 4.740470446 * plx[i] * MAS_RAD * years[i]
        observer = rng.normal(size=3)
        observer *= far / np.linalg.norm(observer)
        seen = at - plx[i] * MAS_RAD / nearing * observer
        apart = separation_rad(seen / np.linalg.norm(seen), np.array([1.0, 0.0, 0.0]))
        assert apart <= motion_pad_rad(pm[i], plx[i], years[i], far)
        assert (
            motion_pad_rad(pm[i], plx[i], years[i], far)
            < 1.6 * (abs(years[i]) * pm[i] + 1.1 * plx[i]) * MAS_RAD + 2e-9
        )
    assert motion_pad_rad(1.0, 1.0, 1.0, 1e9) == np.pi  # nearer than the observer
    assert motion_pad_rad(1.0, 800.0, 2000.0, 1.0) == np.pi  # may pass by


@settings(max_examples=30)
@given(seed=st.integers(0, 2**32), faintest=st.none() | st.floats(4, 21))
def test_same_union_of_regions(catalogue, seed, faintest):
    """Several regions at once select what each of them does: no more, no less, each once."""
    rng = np.random.default_rng(seed)
    regions = [
        Cone(tuple(directions(rng.uniform(0, 360), rng.uniform(-90, 90)).tolist()),
             float(rng.uniform(0, 0.3)), float(rng.uniform(1950, 2100)), float(rng.uniform(0, 40)))
        for _ in range(4)
    ]  # fmt: skip
    regions.append(polygon_of([(10, 0), (30, 5), (20, 20)]))
    together = select(catalogue, regions, faintest)
    apart = [
        (leaf.order, leaf.pixel, group)
        for region in regions
        for leaf in select(catalogue, [region], faintest)
        for group in leaf.row_groups
    ]
    keys = [(leaf.order, leaf.pixel, group) for leaf in together for group in leaf.row_groups]
    assert sorted(keys) == sorted(set(apart))
    places = [leaf.pixel << 2 * (29 - leaf.order) for leaf in together]
    assert places == sorted(set(places))
    assert select(catalogue, []) == ()


def test_selected_are_only_row_groups_near_and_bright_enough(catalogue):
    whole = select(catalogue, [cone_of(0, 0, 180)], 12.0)
    for leaf in whole:
        every = next(x for x in catalogue.leaves if (x.order, x.pixel) == (leaf.order, leaf.pixel))
        assert leaf.row_groups == tuple(
            group for group in every.row_groups if group.brightest_g_mag <= 12.0
        )
        assert leaf._replace(row_groups=every.row_groups) == every
    narrow = select(catalogue, [cone_of(100, 30, 1)])
    wanted = sum(len(leaf.row_groups) for leaf in narrow)
    assert 0 < wanted < 0.5 * sum(leaf.row_group_count for leaf in narrow)


def test_read_leaf_reads_only_its_row_groups(catalogue):
    leaf = max(catalogue.leaves, key=lambda leaf: leaf.rows)
    first = leaf.row_groups[0]
    assert read_leaf(catalogue, leaf, -5.0).num_rows == 0
    bright = leaf._replace(row_groups=(first,))
    assert read_leaf(catalogue, bright).num_rows == first.rows
    assert read_leaf(catalogue, bright, first.brightest_g_mag, ["ra"]).num_rows == 1
    assert read_leaf(catalogue, leaf._replace(row_groups=())).num_rows == 0
    assert read_leaf(catalogue, leaf).schema.names == CANONICAL.names
    assert read_leaf(catalogue, leaf).num_rows == leaf.rows
    turned = read_leaf(catalogue, leaf._replace(row_groups=leaf.row_groups[::-1]))
    assert ids(turned) == ids(read_leaf(catalogue, leaf))
    table = read_leaf(catalogue, leaf, 15.0)
    assert 0 < table.num_rows < leaf.rows
    assert max(table["phot_g_mean_mag"].to_pylist()) <= 15.0


def test_same_rows_as_came_in(catalogue, stars):
    whole, report = cone(catalogue, 0, 0, 180)
    assert same_rows(whole, stars)
    assert report.rows == report.rows_read == catalogue.rows == stars.num_rows
    chunks = catalogue.row_group_table["column_bytes"][:, 1:]  # all but the HEALPix index
    ends = report.bytes_read - int(chunks.sum())  # 8 bytes, again where a leaf is read in parts
    assert 0 <= ends // 8 - catalogue.leaf_table.size < 4


def test_same_stars_as_a_stream(catalogue, monkeypatch):
    """Batches come while later leaves are not opened yet, and hold what `cone` returns."""
    from catalog_tools.query import reading

    opened = []
    real = reading._fetch
    monkeypatch.setattr(query, "PART_ROWS", 200)
    monkeypatch.setattr(query, "MOST_PART_ROWS", 200)
    monkeypatch.setattr(query, "THREADS", 1)
    monkeypatch.setattr(reading, "_fetch", lambda *a: opened.append(a[1].path) or real(*a))
    region = cone_of(20, 10, 60)
    batches = record_batches(catalogue, region, 18.0, ["source_id", "_healpix_29"], 2050.0)
    assert not opened
    first = next(batches)
    assert 0 < len(set(opened)) < len(select(catalogue, [region])) / 2
    rest = list(batches)
    most = query.PART_ROWS + int(catalogue.row_group_table["rows"].max())
    assert max(batch.num_rows for batch in rest) <= most
    table, _ = cone(catalogue, 20, 10, 60, 18.0, 2050.0, ["source_id", "_healpix_29"])
    assert pa.Table.from_batches([first, *rest]).equals(table)
    assert table.schema.names == ["source_id", "_healpix_29"]
    named, _ = cone(catalogue, 20, 10, 60, 18.0, 2050.0)
    assert named["source_id"].equals(table["source_id"])
    batches = record_batches(catalogue, region)
    next(batches)
    batches.close()


def test_same_stars_whatever_the_threads(catalogue, monkeypatch):
    monkeypatch.setattr(query, "PART_ROWS", 500)
    found = [cone(catalogue, 20, 10, 60, 18.0, 2050.0)[0]]
    for threads in (0, 1, 5):
        monkeypatch.setattr(query, "THREADS", threads)
        monkeypatch.setattr(query, "ARROW_THREADS_ROWS", 0 if threads else 10**9)
        found.append(cone(catalogue, 20, 10, 60, 18.0, 2050.0)[0])
    assert all(table.equals(found[0]) for table in found)


def test_region_carries_its_own_epoch(catalogue):
    region = Cone(tuple(directions(20.0, 10.0).tolist()), 0.1, epoch_jyear=2095.0)
    streamed = pa.Table.from_batches(record_batches(catalogue, region))
    assert streamed.equals(cone(catalogue, 20.0, 10.0, np.degrees(0.1), None, 2095.0)[0])


def test_the_object_of_a_catalogue_asks_as_the_function_does(catalogue):
    """`nightglass.open_catalogue(...).cone`: every argument in its place, the epoch too."""
    asked = (20.0, 10.0, 60.0, 20.0, 4000.0, ["source_id", "ra"])
    found = StarCatalogue(catalogue).cone(*asked)
    assert found.equals(cone(catalogue, *asked)[0])
    assert set(found.column_names) == {"source_id", "ra"}
    still = StarCatalogue(catalogue).cone(20.0, 10.0, 60.0, 20.0)
    assert set(still["source_id"].to_pylist()) != set(found["source_id"].to_pylist())


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
    with pytest.raises(BadInput, match="ruwe"):
        record_batches(catalogue, cone_of(0, 0, 1), columns=["ruwe"])
    with pytest.raises(BadInput, match="columns"):
        cone(catalogue, 0, 0, 1, columns=[])


def test_light_takes_its_time_to_far_observers():
    """A star of 10"/yr, looked at from 1000 au at the catalogue's epoch: 499 s for each au."""
    years = 1000.0 * 499.004784 / (365.25 * 86400.0)
    moved_rad = np.radians(10.0 / 3600.0) * years
    assert motion_pad_rad(1e4, 0.0, 0.0, 1000.0) == pytest.approx(moved_rad, rel=1e-3, abs=2e-9)
    both = motion_pad_rad(1e4, 0.0, -2.0, 1000.0)
    assert both == pytest.approx(np.radians(20.0 / 3600.0) + moved_rad, rel=1e-3)


def test_an_epoch_selects_and_leaves_places_as_they_are(catalogue):
    """Which the help page says, and the text of the function."""
    page = nightglass("catalog", "cone", "--help").stdout
    of_help = " ".join(page.replace("\u2502", " ").split())
    assert "ra and dec written stay those of the catalogue's own epoch" in of_help
    assert "stay those of the catalogue's own epoch" in " ".join((cone.__doc__ or "").split())
    every = cone(catalogue, 0, 0, 180)[0].to_pylist()
    own = {star["source_id"]: (star["ra"], star["dec"]) for star in every}
    found = cone(catalogue, 10.0, 20.0, 30.0, epoch_jyear=2300.0)[0].to_pylist()
    assert found
    assert all((star["ra"], star["dec"]) == own[star["source_id"]] for star in found)
