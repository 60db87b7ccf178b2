"""Places that are not those of their Gaia source_ids, ids at two places, files without a row."""

from __future__ import annotations

import healpy
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from astropy.table import Table

from catalog_tools.catalogue import REJECTS_NAME
from catalog_tools.coverage import Coverage
from catalog_tools.errors import BadInput
from catalog_tools.fetch.fetched import note_coverage
from catalog_tools.forms.load import FOLDER
from catalog_tools.geometry.gaia_ids import CORNER_DEG, MOVED_DEG, misplaced
from catalog_tools.ingest.ingest import ingest
from catalog_tools.ingest.judging import DUPLICATE, ELSEWHERE, MISPLACED
from catalog_tools.readers import read_tables
from catalog_tools.verify.verify import verify

HEAD = "source_id,ra,dec,phot_g_mean_mag"


def gaia_like(n: int, seed: int = 1):
    """n stars over the sky, their places and source_ids as Gaia makes them (healpy's pixels)."""
    rng = np.random.default_rng(seed)
    ra, dec = rng.uniform(0, 360, n), np.degrees(np.arcsin(rng.uniform(-0.999, 0.999, n)))
    pixels = healpy.ang2pix(4096, ra, dec, nest=True, lonlat=True).astype(np.int64)
    return (pixels << 35) + rng.integers(0, 1 << 35, n), ra, dec


def write(path, ids, ra, dec):
    rows = [f"{i},{float(a)!r},{float(d)!r},15.0" for i, a, d in zip(ids, ra, dec, strict=True)]
    path.write_text("\n".join([HEAD, *rows]) + "\n")
    return path


def reasons_of(catalogue):
    return pq.read_table(f"{catalogue.path}/{REJECTS_NAME}").to_pylist()


def test_the_farthest_corner_of_a_pixel():
    assert 0.0 < CORNER_DEG - np.degrees(healpy.max_pixrad(4096)) < 1e-4


def test_rows_elsewhere_are_rejected_with_their_reason(tmp_path):
    """Of 1,000 rows 20 stand a degree off; 20 moved by 150 arcsec, as Barnard's star did."""
    ids, ra, dec = gaia_like(1000)
    off, moved = dec.copy(), slice(20, 40)
    off[:20] -= np.sign(dec[:20]) * 1.0
    off[moved] -= np.sign(dec[moved]) * 150.0 / 3600.0
    report = ingest([write(tmp_path / "s.csv", ids, ra, off)], tmp_path / "made", form="gaia_dr2")
    assert report.rejected == {MISPLACED: 20}
    assert [row["source_id"] for row in reasons_of(report.catalogue)] == ids[:20].tolist()
    assert report.catalogue.rows == 980
    assert report.notes == ()
    assert verify(report.catalogue).whole


def test_ids_of_another_kind_tell_no_places(tmp_path):
    """As large as Gaia's, in a form that does not say that they hold places: every row stays."""
    ids, ra, dec = gaia_like(100)
    dr2 = FOLDER / "gaia_dr2.toml"
    form = tmp_path / "other.toml"
    form.write_text(dr2.read_text().replace("holds_place = true", ""))
    path = write(tmp_path / "s.csv", ids[::-1], ra, dec)
    report = ingest([path], tmp_path / "made", form=form)
    assert (report.rejected, report.catalogue.rows) == ({}, 100)
    assert verify(report.catalogue).whole


def test_the_margin_is_what_stars_may_have_moved():
    """Along a meridian from a pixel's centre: kept to 180 arcsec beyond its corner, not further."""
    ids = np.full(200, 100_000_007 << 35, np.int64)
    ra, dec = healpy.pix2ang(4096, 100_000_007, nest=True, lonlat=True)
    step = np.linspace(0.0, 2.0 * (MOVED_DEG + CORNER_DEG), 200)
    wrong = misplaced(ids, np.full(200, ra), dec + step)
    assert (wrong == (step > MOVED_DEG + CORNER_DEG)).all()


@pytest.mark.parametrize(("change", "words"), [
    (lambda ra, dec: (np.radians(ra), np.radians(dec)), "radians"),
    (lambda ra, dec: (dec % 360.0, ra / 4.0), "may not be those of the file"),
])  # fmt: skip
def test_most_rows_elsewhere_stop_the_ingest(tmp_path, change, words):
    ids, ra, dec = gaia_like(500)
    path = write(tmp_path / "s.csv", ids, *change(ra, dec))
    with pytest.raises(BadInput, match=words) as caught:
        ingest([path], tmp_path / "made", form="gaia_dr2")
    assert "500 of 500 rows" in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "made").exists()


def test_exchanged_columns_are_guessed(tmp_path):
    ids, ra, dec = gaia_like(2000)
    near = (ra < 90.0) & (dec > 0.0)
    path = write(tmp_path / "s.csv", ids[near], dec[near], ra[near])
    with pytest.raises(BadInput, match="ra and dec are exchanged"):
        ingest([path], tmp_path / "made", form="gaia_dr3")


def test_made_up_numbers_are_not_compared_and_that_is_noted(tmp_path):
    _, ra, dec = gaia_like(300)
    report = ingest(
        [write(tmp_path / "s.csv", np.arange(1, 301), ra, dec)], tmp_path / "made", form="gaia_dr2"
    )
    assert report.catalogue.rows == 300
    assert any("300 rows" in note and "not compared" in note for note in report.notes)


def test_an_id_at_two_places_is_no_repetition(tmp_path):
    """Made-up numbers: 3 rows repeated within 0.5 arcsec, 2 again a degree off."""
    _, ra, dec = gaia_like(100)
    ids = np.arange(1, 101)
    again = np.r_[0:3, 10:12]
    shifted = dec[again] - np.sign(dec[again]) * np.r_[np.full(3, 0.5 / 3600.0), 1.0, 1.0]
    path = write(tmp_path / "s.csv", np.r_[ids, ids[again]], np.r_[ra, ra[again]],
                 np.r_[dec, shifted])  # fmt: skip
    report = ingest([path], tmp_path / "made", form="gaia_dr2")
    assert report.rejected == {DUPLICATE: 3, ELSEWHERE: 2}
    told = {(row["source_id"], row["reason"]) for row in reasons_of(report.catalogue)}
    assert told == {
        (1, DUPLICATE),
        (2, DUPLICATE),
        (3, DUPLICATE),
        (11, ELSEWHERE),
        (12, ELSEWHERE),
    }
    assert report.catalogue.rows == 100
    assert verify(report.catalogue).whole


def test_files_without_a_row(tmp_path):
    """Alone refused, beside others noted; an empty cone's file is a catalogue without a star."""
    name = "a-file-with-a-rather-long-name-" * 4 + ".csv"
    (tmp_path / name).write_text(HEAD + "\n")
    with pytest.raises(BadInput, match="no row in it") as caught:
        ingest([tmp_path / name], tmp_path / "made", form="gaia_dr2")
    assert name in str(caught.value)
    write(tmp_path / "s.csv", *gaia_like(10))
    report = ingest([tmp_path / name, tmp_path / "s.csv"], tmp_path / "made", form="gaia_dr2")
    assert f"{name} holds no row" in report.notes
    (tmp_path / ".fetch").mkdir()
    note_coverage(tmp_path, [name], Coverage("a cone", cones=np.array([[1.0, 2, 0.01, 10.0]])))
    assert ingest([tmp_path / name], tmp_path / "cone", form="gaia_dr2").catalogue.rows == 0


def test_values_that_no_star_has_are_counted(tmp_path):
    """Motions in another unit than the form says count as absent: a note; no star left: refused."""
    lines = [HEAD + ",pmra,parallax"]
    for i, (ra, dec) in enumerate(zip(*gaia_like(10)[1:], strict=True)):
        lines.append(f"{i + 1},{ra},{dec},10,{2e6 if i < 7 else 3.0},{-2e4 if i < 2 else 'nan'}")
    (tmp_path / "s.csv").write_text("\n".join(lines) + "\n")
    report = ingest([tmp_path / "s.csv"], tmp_path / "made", form="gaia_dr2")
    assert report.catalogue.rows == 10
    told = [note for note in report.notes if "beyond" in note]
    assert [note.split(",")[0] for note in told] == [
        "7 value(s) of pmra beyond 100000 mas/yr",
        "2 value(s) of parallax beyond 10000 mas",
    ]
    fluxes = "\n".join(line.replace(",10,", ",1500,") for line in lines)
    (tmp_path / "s.csv").write_text(fluxes + "\n")
    with pytest.raises(BadInput, match="at least one star") as caught:
        ingest([tmp_path / "s.csv"], tmp_path / "none", form="gaia_dr2")
    assert "10 rows, all rejected" in str(caught.value)
    assert "10 value(s) of phot_g_mean_mag beyond 60 mag" in str(caught.value)
    assert [path.name for path in tmp_path.iterdir() if path.name.startswith(".none")] == []


def test_the_same_content_twice_is_named_whole(tmp_path):
    names = [f"{'a-rather-long-name-' * 6}{i}.csv" for i in range(2)]
    for each in names:
        write(tmp_path / each, *gaia_like(10))
    with pytest.raises(BadInput, match="the same content") as caught:
        ingest([tmp_path], tmp_path / "made", form="gaia_dr2")
    assert all(str(tmp_path / each) in str(caught.value) for each in names)
    assert "…" not in str(caught.value)


REAL = ("full_schema_random/gdr2_sm.fits", "m67_field/M67_data.csv",
        "nearby_teff/gaia_dr2_result.csv", "ophiuchus/sample_oph_cone_r3.5-result.vot")  # fmt: skip


@pytest.mark.parametrize("name", REAL)
def test_real_rows_stand_where_their_ids_say(shared_data, name):
    rows = pa.concat_tables(read_tables(shared_data / "gaia_dr2" / name))
    ids, ra, dec = (rows[column].to_numpy() for column in ("source_id", "ra", "dec"))
    assert ids.size >= 1000
    assert np.count_nonzero(misplaced(ids, ra, dec)) == 0


def test_real_rows_in_radians_are_refused(shared_data, tmp_path):
    table = Table.read(shared_data / "gaia_dr2" / "m67_field" / "M67_data.csv")
    for column in ("ra", "dec"):
        table[column] = np.radians(table[column])
    table.write(tmp_path / "radians.csv")
    with pytest.raises(BadInput, match=r"5546 of 5546 rows.*in radians"):
        ingest([tmp_path / "radians.csv"], tmp_path / "made")
