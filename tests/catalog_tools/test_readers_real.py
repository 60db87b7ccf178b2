"""Real star tables, each through its form: every row accounted for."""

from __future__ import annotations

import csv
import sqlite3
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from astropy.table import Table
from lsst_refcat import convert
from scipy.spatial import cKDTree

from catalog_tools.columns import INCOMING
from catalog_tools.errors import BadInput
from catalog_tools.forms import load_form
from catalog_tools.ingest.ingest import ingest
from catalog_tools.ingest.judging import judge
from catalog_tools.readers import detect_form, read_tables
from catalog_tools.verify.verify import verify

FORMS = Path(__file__).parent / "forms"
TABLES = {  # form, rows
    "full_schema_random/gdr2_sm.fits": (None, 1000),
    "full_schema_random/gdr2_rv_sm.fits": (None, 100),
    "m67_field/M67_data.csv": (None, 5546),
    "nearby_teff/gaia_dr2_result.csv": (None, 6690),
    "ophiuchus/sample_oph_cone_r3.5-result.vot": (None, 2814),
    "nearby_rv/gaia_data.fits": ("nearby_rv", 4096),
    "clusters_k2/pleiades_gaia.csv": ("clusters_k2", 759),
    "clusters_k2/praesepe_gaia.csv": ("clusters_k2", 652),
    "allsky_random_sqlite/gaia_subset.sqlite3": ("allsky_sqlite", 8862),
}
UNMATCHED = {"clusters_k2/pleiades_gaia.csv": 30}  # rotators for which the source has no DR2 star
NO_GAIA_ID = ("nearby_rv/gaia_data.fits",)


def read(path, form=None):
    meaning = load_form(FORMS / f"{form}.toml") if form else None
    return pa.concat_tables([INCOMING.empty_table(), *read_tables(path, meaning)])


@pytest.fixture(scope="module")
def dr2(shared_data):
    return {name: read(shared_data / "gaia_dr2" / name, form) for name, (form, _) in TABLES.items()}


@pytest.fixture(scope="module")
def refcat(shared_data):
    folder = shared_data / "gaia_dr2" / "lsst_refcat_htm7"
    return pa.concat_tables(read(path, "lsst_refcat") for path in sorted(folder.glob("*.fits")))


def test_every_row_of_dr2_is_accounted_for(dr2):
    for name, (_, rows) in TABLES.items():
        table = dr2[name]
        assert table.num_rows == rows, name
        kept, _, rejected = judge(table, name, 0)
        assert kept.size + rejected.num_rows == rows
        absent = UNMATCHED.get(name, 0)
        assert rejected["reason"].to_pylist() == ["source_id absent"] * absent


@pytest.mark.parametrize("name", [name for name in TABLES if name not in NO_GAIA_ID])
def test_ids_are_the_level_12_pixels(dr2, name):
    """All but 0.2 to 1.3 % of DR2's ids say in which pixel of level 12 the star is."""
    import healpy

    table = dr2[name].filter(dr2[name]["source_id"].is_valid())
    pixels = healpy.ang2pix(
        4096, table["ra"].to_numpy(), table["dec"].to_numpy(), nest=True, lonlat=True
    )
    right = np.mean(table["source_id"].to_numpy() // 34359738368 == pixels)
    assert 0.98 <= right <= 1.0


def test_refcat_is_what_independent_code_makes_of_it(shared_data, tmp_path, refcat):
    assert refcat.num_rows == 5834
    rows = convert(shared_data / "gaia_dr2" / "lsst_refcat_htm7", tmp_path / "refcat.csv.gz")
    other = read(tmp_path / "refcat.csv.gz")
    assert rows == other.num_rows == refcat.num_rows
    for name in INCOMING.names:
        ours, theirs = (t[name].combine_chunks() for t in (refcat, other))
        assert ours.is_null().equals(theirs.is_null()), name
        ours, theirs = (a.drop_null().to_numpy() for a in (ours, theirs))
        np.testing.assert_allclose(ours, theirs, rtol=2e-7, atol=1e-12, err_msg=name)


@pytest.mark.filterwarnings("ignore::astropy.units.UnitsWarning")
@pytest.mark.filterwarnings("ignore::astropy.io.fits.verify.VerifyWarning")
def test_refcat_of_another_epoch_is_refused(shared_data, tmp_path):
    from astropy.table import Table

    path = next((shared_data / "gaia_dr2" / "lsst_refcat_htm7").glob("*131072*"))
    table = Table.read(path, hdu=1)
    table["epoch"][7] += 182.6
    table.write(tmp_path / "later.fits")
    with pytest.raises(BadInput, match=r"2015\.99.*2015\.5") as caught:
        read(tmp_path / "later.fits", "lsst_refcat")
    assert "row 8" in caught.value.field


def test_ids_of_the_clusters_are_whole_again(shared_data, dr2):
    """The float column of these files keeps 15 digits; the designation keeps all 18."""
    for name in ("pleiades", "praesepe"):
        path = shared_data / "gaia_dr2" / f"clusters_k2/{name}_gaia.csv"
        ids = dr2[f"clusters_k2/{name}_gaia.csv"]["source_id"].to_pylist()
        with pytest.raises(BadInput, match="designation"):
            read(path)
        with path.open() as file:
            rows = list(csv.DictReader(file))
        for number, row in zip(ids, rows, strict=True):
            assert row["designation"] == ("" if number is None else f"Gaia DR2 {number}")
            assert number is None or abs(number - float(row["source_id"])) < 1e3


def test_ids_from_positions_differ_and_are_never_gaias(dr2):
    ids = dr2["nearby_rv/gaia_data.fits"]["source_id"].to_numpy()
    assert ids.max() < 0
    assert np.unique(ids).size == ids.size


def test_sqlite_rows_are_those_of_both_files(shared_data, dr2):
    folder = shared_data / "gaia_dr2" / "allsky_random_sqlite"
    table = dr2["allsky_random_sqlite/gaia_subset.sqlite3"]
    with sqlite3.connect(f"file:{folder}/gaia_subset.sqlite3?mode=ro", uri=True) as base:
        defect, g_sum = base.execute(
            "select sum(phot_bp_mean_mag != phot_rp_mean_mag), sum(phot_g_mean_mag) from gaialight"
        ).fetchone()
    assert defect == 0, "the source has been mended: take BP and RP too"
    assert table["phot_bp_mean_mag"].null_count == table.num_rows
    assert abs(np.sum(table["phot_g_mean_mag"].to_numpy(), dtype=float) - g_sum) < 0.01


@pytest.mark.filterwarnings("ignore::astropy.units.UnitsWarning")
def test_full_schema_against_astropy(shared_data, dr2):
    from astropy.table import Table

    name = "full_schema_random/gdr2_sm.fits"
    expected = Table.read(shared_data / "gaia_dr2" / name)
    for column in INCOMING.names:
        ours = dr2[name][column].to_pandas().to_numpy()
        theirs = np.ma.filled(np.ma.asarray(expected[column]).astype(ours.dtype), np.nan)
        np.testing.assert_array_equal(ours, theirs, err_msg=column)


def test_fields_of_an_unstated_release_are_read_with_their_gaps(shared_data):
    folder = shared_data / "gaia_crowded_fields_other_release"
    rows = {"NGC2112": 3040, "NGC225": 3000, "NGC2477": 7100, "NGC6405": 3835}
    for name, count in rows.items():
        table = read(folder / f"{name}.csv")
        assert table.num_rows == count
        assert 0.05 < table["pmra"].null_count / count < 0.3


@pytest.fixture(scope="module")
def hipparcos(shared_data):
    path = shared_data / "bright_stars" / "hip_main_bright.dat.gz"
    return pa.concat_tables(read_tables(path, load_form("hipparcos")))


def test_hipparcos_whole(hipparcos):
    assert hipparcos.num_rows == 9933
    ids = hipparcos["source_id"].to_pylist()
    assert len(set(ids)) == 9933
    assert max(ids) < 2**17
    sirius = hipparcos.slice(ids.index(32349), 1).to_pylist()[0]
    assert sirius["ra"] == 101.28854105  # as printed in the catalogue
    assert sirius["dec"] == -16.71314306
    assert sirius["pmra"] == pytest.approx(-546.01)
    assert sirius["parallax"] == pytest.approx(379.21)
    assert sirius["phot_g_mean_mag"] == pytest.approx(-1.46, abs=0.05)
    kept, _, rejected = judge(hipparcos, "hip", 0)
    assert rejected["reason"].unique().to_pylist() == ["position absent or not finite"]
    assert (kept.size, rejected.num_rows) == (9928, 5)


def directions(ra_deg, dec_deg):
    ra, dec = np.radians(ra_deg), np.radians(dec_deg)
    return np.stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)], axis=-1)


def test_hipparcos_magnitudes_against_dr2(hipparcos, dr2):
    """The published relations on stars that both catalogues have: within their scatter."""
    stars = dr2["nearby_rv/gaia_data.fits"].to_pandas()
    hip = hipparcos.to_pandas().dropna(subset=["ra", "pmra"])
    years = 2015.5 - 1991.25
    hip_ra = hip.ra + hip.pmra / 3.6e6 * years / np.cos(np.radians(hip.dec))
    hip_dec = hip.dec + hip.pmdec / 3.6e6 * years
    tree = cKDTree(directions(hip_ra.to_numpy(), hip_dec.to_numpy()))
    distance, j = tree.query(directions(stars.ra.to_numpy(), stars.dec.to_numpy()))
    i = np.flatnonzero(distance < np.radians(1.0 / 3600.0))
    j = j[i]
    assert i.size > 60
    for band, offset in (("g", 0.05), ("bp", 0.02), ("rp", 0.03)):
        name = f"phot_{band}_mean_mag"
        error = hip[name].to_numpy()[j] - stars[name].to_numpy()[i]
        assert abs(np.median(error)) < offset, band
        assert np.median(np.abs(error - np.median(error))) < 0.03, band


def test_detected_forms(shared_data):
    for name, (form, _) in TABLES.items():
        if form is None:
            assert detect_form(shared_data / "gaia_dr2" / name).name == "gaia_dr2"


BANDS = ("phot_bp_mean_mag", "phot_rp_mean_mag")
COLOUR_TABLES = {  # columns beside G, and whether BP and RP follow exactly
    ("bp_rp", "g_rp"): True, ("bp_g", "g_rp"): True, ("bp_rp", "bp_g"): True,
    ("phot_bp_mean_mag", "bp_rp"): True, ("phot_rp_mean_mag", "bp_rp"): True,
    ("phot_rp_mean_mag", "bp_g"): True, ("bp_rp",): False,
}  # fmt: skip


@pytest.mark.parametrize("columns", COLOUR_TABLES, ids="+".join)
def test_colours_of_the_archive_give_bp_and_rp(shared_data, tmp_path, columns):
    """1,000 random rows of the whole schema, reduced to some of its colours."""
    source = shared_data / "gaia_dr2" / "full_schema_random" / "gdr2_sm.fits"
    whole = Table.read(source)
    kept = ["source_id", "ra", "dec", "phot_g_mean_mag", *columns]
    whole[kept].write(tmp_path / "some.fits")
    made = ingest([tmp_path / "some.fits"], tmp_path / "made", form="gaia_dr2").catalogue
    rows = {row["source_id"]: row for row in read(tmp_path / "some.fits").to_pylist()}
    apart, bright = [], []
    for true in read(source).to_pylist():
        mine = rows[true["source_id"]]
        assert all((mine[band] is None) == (true[band] is None) for band in BANDS)
        if true[BANDS[0]] is not None:
            apart.append([mine[band] - true[band] for band in BANDS])
            bright.append(true["phot_g_mean_mag"] < 17.0)
    assert np.abs(np.diff(apart, axis=1)).max() < 1e-5  # BP - RP; float32 of 20 mag
    if COLOUR_TABLES[columns]:
        assert np.abs(apart).max() < 1e-5
    else:  # the mean of bright stars of that colour
        assert np.median(np.abs(apart)[bright]) < 0.02
        assert np.median(np.abs(apart)) < 0.15
    assert made.without_colour == 1000 - len(apart) == 79
    assert verify(made).whole
