"""Stars that two catalogues share are found, all and only those, whatever region is asked for."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import erfa
import numpy as np
import pyarrow as pa
import pytest
from hipparcos_rows import hipparcos_rows
from hypothesis import given, settings
from hypothesis import strategies as st
from pyarrow.csv import read_csv

from catalog_tools.catalogue import open_catalogue
from catalog_tools.columns import INCOMING
from catalog_tools.coverage import all_sky
from catalog_tools.geometry.regions import Cone
from catalog_tools.geometry.sphere import directions, moved, separation_rad
from catalog_tools.ingest.build import About, build
from catalog_tools.query.layers import already_in, tolerance_arcsec

HIP_JYEAR, DR2_JYEAR = 1991.25, 2015.5
ALL_SKY = [Cone((0.0, 0.0, 1.0), np.pi)]
MAS = np.pi / 648e6


def table(**columns) -> pa.Table:
    """Rows from columns; those not given are absent."""
    n = len(columns["ra"])
    columns.setdefault("source_id", np.arange(n) + 1)
    arrays = [
        pa.array(columns.get(f.name, np.full(n, np.nan)), from_pandas=True).cast(f.type)
        for f in INCOMING
    ]
    return pa.table(arrays, schema=INCOMING)


@dataclass(frozen=True)
class Rows:
    """A table as a source of `build`."""

    rows: pa.Table
    label: str = "rows"

    def identity(self) -> list:
        return [self.label, self.rows.num_rows]

    def tables(self, record: dict) -> Iterator[pa.Table]:
        yield self.rows


def catalogue_of(rows: pa.Table, folder: Path, epoch: float, rows_per_leaf: int = 400):
    """Rows as a catalogue of an epoch."""
    about = About(folder.name, "", False, epoch, {})
    return build([Rows(rows)], folder, about, rows_per_leaf=rows_per_leaf).catalogue


def moved_off(ra, dec, pmra, pmdec, years, apart_arcsec, towards_rad):
    """Where stars [deg] stand after some years, and a little off: degrees (n,) each."""
    lon, lat = erfa.c2s(moved(ra, dec, pmra, pmdec, years))
    off = np.radians(apart_arcsec / 3600.0)
    lon = lon + off * np.sin(towards_rad) / np.cos(lat)
    return np.degrees(lon) % 360, np.degrees(lat + off * np.cos(towards_rad))


@pytest.mark.parametrize("motions", ["both", "layer", "main", "none"])
@pytest.mark.parametrize("speed_mas_yr", [0.0, 10_000.0])
def test_limits_of_the_rule(motions, speed_mas_yr, tmp_path):
    """Just inside and just outside, in place and magnitude, whichever row has the motion."""
    edge = 2.0 + 0.04 * (DR2_JYEAR - HIP_JYEAR)
    # Two rows with one motion in components part by 0.1 arcsec: their norths differ.
    slack = 0.2 if speed_mas_yr else 0.01
    cases = [(0.0, 0.0), (edge - slack, 0.0), (edge + slack, 0.0), (0.0, 0.999), (0.0, -0.999),
             (0.0, 1.001), (0.0, -1.001), (edge - slack, 0.99), (60.0, 0.0)]  # fmt: skip
    apart, dg = np.array(cases).T
    n = len(cases)
    ra, dec = np.linspace(0.0, 350.0, n), np.linspace(-45.0, 45.0, n)
    motion = {"pmra": np.full(n, -0.5 * speed_mas_yr), "pmdec": np.full(n, 0.8 * speed_mas_yr)}
    speed = motion.values() if motions != "none" else (np.zeros(n), np.zeros(n))
    later = moved_off(ra, dec, *speed, DR2_JYEAR - HIP_JYEAR, apart, np.arange(n))
    old = {"ra": ra, "dec": dec, "phot_g_mean_mag": np.full(n, 5.0)}
    new = {"ra": later[0], "dec": later[1], "phot_g_mean_mag": 5.0 + dg}
    layer = table(**old, **(motion if motions in ("both", "layer") else {}))
    main = table(**new, **(motion if motions in ("both", "main") else {}))
    found = already_in(
        catalogue_of(main, tmp_path / "m", DR2_JYEAR),
        catalogue_of(layer, tmp_path / "l", HIP_JYEAR),
        ALL_SKY,
    )
    wanted = np.flatnonzero((apart < edge) & (np.abs(dg) <= 1.0)) + 1
    assert found.tolist() == wanted.tolist()


def crowd(n: int, seed: int):
    """A main catalogue and a layer of it 24.25 years earlier, in a field with both limiting cases.

    Around a pole and across right ascension 0; some stars are in one only, some moved off, some
    of another brightness, some without motions.
    """
    rng = np.random.default_rng(seed)
    centre = np.array([(0.0, 89.9), (359.99, -5.0), (120.0, 40.0)])[rng.integers(0, 3, n)]
    dec = np.clip(centre[:, 1] + rng.normal(0, 0.05, n), -90, 90)
    ra = (centre[:, 0] + rng.normal(0, 0.05, n) / np.cos(np.radians(dec))) % 360
    pm = rng.normal(0, 60, (2, n)) * np.where(rng.random(n) < 0.2, 60.0, 1.0)
    g = rng.uniform(4, 9, n)
    main = {"ra": ra, "dec": dec, "pmra": pm[0], "pmdec": pm[1], "phot_g_mean_mag": g}
    common = np.flatnonzero(rng.random(n) < 0.5)
    lon, lat = erfa.c2s(moved(ra, dec, *pm, HIP_JYEAR - DR2_JYEAR))
    off = rng.normal(0, 1.5 / 3600.0, (2, n))
    layer = {
        "ra": (np.degrees(lon) + off[0] / np.cos(lat)) % 360, "dec": np.degrees(lat) + off[1],
        "pmra": pm[0] + rng.normal(0, 5, n), "pmdec": pm[1] + rng.normal(0, 5, n),
        "phot_g_mean_mag": g + rng.normal(0, 0.5, n),
    }  # fmt: skip
    layer["dec"] = np.clip(layer["dec"], -90, 90)
    layer = {k: v[common] for k, v in layer.items()}
    for rows in (main, layer):
        absent = rng.random(len(rows["ra"])) < 0.15
        for name in ("pmra", "pmdec"):
            rows[name] = np.where(absent, np.nan, rows[name])
    return main, layer | {"source_id": common + 10_000}


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    """Crowded catalogues in several leaves; the rows as they are stored."""
    folder = tmp_path_factory.mktemp("crowd")
    main, layer = (table(**rows) for rows in crowd(1000, 3))
    return catalogue_of(main, folder / "m", DR2_JYEAR), catalogue_of(layer, folder / "l", HIP_JYEAR)


def rows_of(catalogue) -> dict[str, np.ndarray]:
    from catalog_tools.query.query import read_leaf

    rows = pa.concat_tables([read_leaf(catalogue, leaf) for leaf in catalogue.leaves])
    return {
        n: rows[n].to_numpy(zero_copy_only=False).astype(np.int64 if n == "source_id" else float)
        for n in ("source_id", "ra", "dec", "pmra", "pmdec", "parallax", "phot_g_mean_mag")
    }


def carried(rows, i, motion, years):
    """Places (n, 3) of rows i after years (n,) by ERFA's space motion."""
    ra, dec = np.radians(rows["ra"][i]), np.radians(rows["dec"][i])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", erfa.ErfaWarning)  # it puts stars far off at 10 Mpc
        out = erfa.pmsafe(
            ra, dec, motion[0] * MAS / np.cos(dec), motion[1] * MAS, 0.0, 0.0,
            2451545.0, 0.0, 2451545.0, years * 365.25,
        )  # fmt: skip
    return erfa.s2c(out[0], out[1])


def by_every_pair(main, layer) -> tuple[set[int], set[int]]:
    """The rule applied to every pair, with ERFA's motion: ids surely in, and those at its edge."""
    m, n = rows_of(main), rows_of(layer)
    edge = np.radians(tolerance_arcsec(main, layer) / 3600.0)
    near = directions(n["ra"], n["dec"]) @ directions(m["ra"], m["dec"]).T > np.cos(0.005)
    near &= np.abs(n["phot_g_mean_mag"][:, None] - m["phot_g_mean_mag"][None]) <= 1.0
    i, k = np.nonzero(near)
    own = [np.array([rows["pmra"][at], rows["pmdec"][at]]) for rows, at in ((n, i), (m, k))]
    still = [np.isnan(motion[0]) for motion in own]
    left = np.nan_to_num(np.where(still[0], own[1], own[0]))
    right = np.nan_to_num(np.where(still[1], own[0], own[1]))
    years = DR2_JYEAR - HIP_JYEAR
    share = np.where(still[1], 1.0, np.where(still[0], 0.0, 0.5))  # carried by the layer's row
    apart = separation_rad(
        carried(n, i, left, share * years), carried(m, k, right, (share - 1.0) * years)
    )
    unsure = np.abs(apart - edge) < np.radians(1e-4 / 3600.0)
    ids = n["source_id"][i]
    return set(ids[(apart < edge) & ~unsure].tolist()), set(ids[unsure].tolist())


def test_against_every_pair(pair):
    found, unsure = by_every_pair(*pair)
    assert 250 < len(found) < 500
    ids = already_in(*pair, ALL_SKY)
    assert (np.diff(ids) > 0).all()
    assert set(ids.tolist()) - unsure == found - unsure


@settings(max_examples=25, deadline=None)
@given(st.data())
def test_same_for_any_region(pair, data):
    """What is found in a region is what is found anywhere, of the stars that it may show."""
    main, layer = pair
    everywhere = set(already_in(main, layer, ALL_SKY).tolist())
    rows = rows_of(layer)
    regions = []
    for _ in range(data.draw(st.integers(1, 3))):
        i = data.draw(st.integers(0, len(rows["ra"]) - 1))
        centre = directions(rows["ra"][i], rows["dec"][i] + data.draw(st.floats(-0.1, 0.1)))
        radius = data.draw(st.floats(1e-6, 0.002))
        epoch = data.draw(st.sampled_from([None, 1900.0, 2015.5, 2100.0]))
        regions.append(Cone(tuple(centre.tolist()), radius, epoch, 0.0))
    faintest = data.draw(st.sampled_from([None, 5.0, 7.0]))
    found = set(already_in(main, layer, regions, faintest).tolist())
    assert found <= everywhere
    motion = np.nan_to_num(rows["pmra"]), np.nan_to_num(rows["pmdec"])
    bright = rows["phot_g_mean_mag"] <= (np.inf if faintest is None else faintest)
    shown = np.zeros(len(bright), bool)
    for r in regions:
        at = moved(rows["ra"], rows["dec"], *motion, (r.epoch_jyear or HIP_JYEAR) - HIP_JYEAR)
        shown |= separation_rad(at, np.array(r.centre)) <= r.radius_rad
    assert everywhere & set(rows["source_id"][shown & bright].tolist()) <= found
    assert found <= set(rows["source_id"][bright].tolist())


def test_nothing_to_compare(pair, tmp_path):
    main, layer = pair
    assert already_in(main, layer, []).dtype == np.int64
    assert already_in(main, layer, ALL_SKY, -5.0).size == 0
    far = [Cone((0.0, 0.0, -1.0), 0.01)]
    assert already_in(main, layer, far).size == 0
    about = About("empty", "", False, DR2_JYEAR, {}, all_sky("nothing", 21.0, []).to_json())
    build([], tmp_path / "e", about, rows_per_leaf=1000)
    empty = open_catalogue(tmp_path / "e")
    assert already_in(empty, layer, ALL_SKY).size == 0
    assert already_in(main, empty, ALL_SKY).size == 0


def test_reads_only_bright_row_groups_near_the_region(tmp_path, monkeypatch):
    """Of a deep main catalogue only what is bright enough and near is opened."""
    from catalog_tools.query import layers

    rng = np.random.default_rng(5)
    n = 40_000
    deep = table(ra=rng.uniform(10, 14, n), dec=rng.uniform(-2, 2, n), pmra=rng.normal(0, 5, n),
                 pmdec=rng.normal(0, 5, n), phot_g_mean_mag=rng.uniform(12, 20, n))  # fmt: skip
    bright = table(ra=[10.1, 13.9, 12.0], dec=[1.9, -1.9, 0.0], pmra=[0.0] * 3, pmdec=[0.0] * 3,
                   phot_g_mean_mag=[11.5, 11.6, 2.0])  # fmt: skip
    main = catalogue_of(deep, tmp_path / "m", DR2_JYEAR, rows_per_leaf=5000)
    layer = catalogue_of(bright, tmp_path / "l", HIP_JYEAR)
    read = []

    def counted(catalogue, leaf, *rest):
        read.append((catalogue.digest, sum(group.rows for group in leaf.row_groups)))
        return layers_read(catalogue, leaf, *rest)

    layers_read = layers.read_leaf
    monkeypatch.setattr(layers, "read_leaf", counted)
    x, y, z = directions(10.1, 1.9).tolist()
    assert already_in(main, layer, [Cone((x, y, z), 0.001)]).size == 0
    assert sum(rows for digest, rows in read if digest == main.digest) < n / 4
    read.clear()
    x, y, z = directions(12.0, 0.0).tolist()
    assert already_in(main, layer, [Cone((x, y, z), 0.001)]).size == 0
    assert not [rows for digest, rows in read if digest == main.digest]  # none is that bright


# Published: SIMBAD's places at J2000 and motions (Gaia DR3) of 61 Cygni A and B; Gaia DR3's own of
# Barnard's star, J2016.0.
FAST = [
    ("61 Cyg A", 104214, 316.72474812, 38.74941619, 2000.0, 4164.209, 3249.614, 4.77),
    ("61 Cyg B", 104217, 316.73026608, 38.74204417, 2000.0, 4105.976, 3155.942, 5.45),
    ("Barnard", 87937, 269.44850252543836, 4.739420051112412, 2016.0, -801.551, 10362.394, 8.19),
]


def gaia_row(ra, dec, pmra, pmdec, years):
    """A row carried from its own epoch to DR2's [deg, mas/yr]."""
    lon, lat = erfa.c2s(moved(*(np.array([v]) for v in (ra, dec, pmra, pmdec)), years)[0])
    return np.degrees(lon) % 360, np.degrees(lat), pmra, pmdec


@pytest.fixture(scope="module")
def hipparcos(shared_data, tmp_path_factory):
    """The stars of Hipparcos brighter than 6.6, read by hand."""
    folder = tmp_path_factory.mktemp("hipparcos") / "made"
    return catalogue_of(hipparcos_rows(shared_data), folder, HIP_JYEAR, 100_000)


@pytest.mark.parametrize("with_motion", [True, False])
def test_fast_stars_over_24_years(with_motion, hipparcos, tmp_path):
    """61 Cygni (5.2 arcsec a year) and Barnard's star (10.4), each the one it is."""
    rows = [gaia_row(ra, dec, pmra, pmdec, DR2_JYEAR - epoch)
            for _, _, ra, dec, epoch, pmra, pmdec, _ in FAST]  # fmt: skip
    columns = dict(zip(("ra", "dec", "pmra", "pmdec"), np.array(rows).T, strict=True))
    if not with_motion:
        del columns["pmra"], columns["pmdec"]
    g = np.array([star[-1] for star in FAST])
    main = catalogue_of(table(**columns, phot_g_mean_mag=g), tmp_path / "m", DR2_JYEAR)
    assert already_in(main, hipparcos, ALL_SKY).tolist() == sorted(star[1] for star in FAST)


def test_real_hipparcos_in_real_dr2(hipparcos, shared_data, tmp_path):
    """Every star that both hold is found, and no other: the parallaxes tell.

    DR2's nearby stars with a temperature (no motions are in that file): Hipparcos's own carry its
    stars over all the 24.25 years.
    """
    file = shared_data / "gaia_dr2" / "nearby_teff" / "gaia_dr2_result.csv"
    dr2 = read_csv(file)
    names = ("source_id", "ra", "dec", "parallax", "phot_g_mean_mag")
    rows = table(**{name: dr2[name].to_numpy(zero_copy_only=False) for name in names})
    main = catalogue_of(rows, tmp_path / "main", DR2_JYEAR, 100_000)
    found = already_in(main, hipparcos, ALL_SKY)
    m, n = rows_of(main), rows_of(hipparcos)
    motion = np.nan_to_num(n["pmra"]), np.nan_to_num(n["pmdec"])
    at = moved(n["ra"], n["dec"], *motion, DR2_JYEAR - HIP_JYEAR)
    places = directions(m["ra"], m["dec"])
    nearest = np.array([int(np.argmax(places @ star)) for star in at])
    apart = np.degrees(separation_rad(at, places[nearest])) * 3600
    dg = m["phot_g_mean_mag"][nearest] - n["phot_g_mean_mag"]
    inside = np.isin(n["source_id"], found)
    assert len(found) == inside.sum() == 142
    assert (apart[inside].max(), np.abs(dg[inside]).max()) < (1.7, 0.75)
    off = np.abs(m["parallax"][nearest] - n["parallax"])[inside]
    assert (np.median(off), off.max()) < (0.6, 12.0)  # HIP 76602, a pair, errs by 11.65 mas
    # The next ones are companions: farther off, or fainter by more than 1 mag.
    outside = ~inside & (apart < 10)
    assert apart[outside].min() > 3.4
    assert (np.abs(dg[outside]) > 0.8).all()
    # A wrong pair by chance: the same list turned by 1 degree matches nothing.
    hip = hipparcos_rows(shared_data)
    turned = hip.set_column(1, "ra", pa.array((hip["ra"].to_numpy() + 1.0) % 360))
    elsewhere = catalogue_of(turned, tmp_path / "t", HIP_JYEAR, 100_000)
    assert already_in(main, elsewhere, ALL_SKY).size == 0


@pytest.mark.parametrize("newer", [True, False])
def test_a_layer_may_be_older_or_newer(newer, tmp_path):
    """2 arcsec and 0.04 for each year between, whichever catalogue is the later one."""
    epochs = (HIP_JYEAR, DR2_JYEAR) if newer else (DR2_JYEAR, HIP_JYEAR)
    edge = 2.0 + 0.04 * (DR2_JYEAR - HIP_JYEAR)
    ra, dec = np.full(3, 9.0), np.array([-20.0, 0.0, 20.0])
    apart = np.array([0.0, edge - 0.01, edge + 0.01]) / 3600.0
    main, layer = (
        catalogue_of(table(ra=ra, dec=dec + off, phot_g_mean_mag=ra), tmp_path / name, epoch)
        for name, off, epoch in zip(("main", "layer"), (0.0, apart), epochs, strict=True)
    )
    assert already_in(main, layer, ALL_SKY).tolist() == [1, 2]
