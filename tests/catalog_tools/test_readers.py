"""Every kind of input file, good and bad."""

from __future__ import annotations

import gzip

import numpy as np
import pyarrow as pa
import pytest
from astropy.table import Table
from star_rows import random_stars, same_rows, write_csv

from catalog_tools.columns import INCOMING, NAMES
from catalog_tools.errors import BadInput, Damaged
from catalog_tools.readers import kind_of, read_tables


def read(path):
    return pa.concat_tables([INCOMING.empty_table(), *read_tables(path)])


@pytest.fixture(scope="module")
def few():
    return random_stars(300, 5)


def as_astropy(stars, *, masked=True):
    """An astropy table; absent values masked, or NaN as FITS has them."""
    table = Table(masked=masked)
    for name in NAMES:
        column = stars[name].combine_chunks()
        table[name] = column.to_numpy(zero_copy_only=False)
        if masked:
            table[name].mask = column.is_null().to_numpy(zero_copy_only=False)
    return table


@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize("suffix", ["csv", "csv.gz", "txt"])
def test_same_rows_from_csv(tmp_path, few, suffix, end):
    path = write_csv(tmp_path / f"stars.{suffix}", few, end=end)
    assert same_rows(read(path), few)


def test_same_rows_from_fits_and_votable(tmp_path, few):
    as_astropy(few, masked=False).write(tmp_path / "stars.fits")
    as_astropy(few).write(tmp_path / "stars.vot", format="votable")
    as_astropy(few).write(tmp_path / "binary.xml", format="votable", tabledata_format="binary2")
    for name, kind in (("stars.fits", "fits"), ("stars.vot", "votable"), ("binary.xml", "votable")):
        assert kind_of(tmp_path / name) == kind
        assert same_rows(read(tmp_path / name), few), name


def test_null_texts_quotes_comments_and_mixed_line_ends(tmp_path):
    path = tmp_path / "odd.csv"
    path.write_bytes(
        b'# a comment\n"source_id",ra,dec,phot_g_mean_mag,pmra,extra\r\n'
        b'1,10.0,-3.5,12.5,null,text\n"2","11.0",4.0,13.0,"",\r\n3,1,2,3,nan,"a,b"\n'
    )
    table = read(path)
    assert table["source_id"].to_pylist() == [1, 2, 3]
    assert table["pmra"].to_pylist() == [None] * 3 == table["phot_bp_mean_mag"].to_pylist()


def test_header_alone_is_no_row(tmp_path):
    path = tmp_path / "none.csv"
    path.write_text(",".join(NAMES) + "\n")
    assert read(path).num_rows == 0


HEAD = "source_id,ra,dec,phot_g_mean_mag"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "empty"),
        (b"\n \n", "empty"),
        (gzip.compress(b""), "empty"),
        (b"\x00\x01\x02PAR1", "no known kind"),
        (b"ra,dec,phot_g_mean_mag\n1,2,3\n", "'source_id'"),
        (b"source_id,ra,dec\n1,2,3\n", "'phot_g_mean_mag'"),
        (f"{HEAD},pm\n1,2,3,4,5\n".encode(), "EDR3"),
        (f"{HEAD},ref_epoch\n1,2,3,4,2016.0\n".encode(), "2015.5"),
        (f"{HEAD}\n1.5e3,2,3,4\n".encode(), "source_id"),
        (f"{HEAD}\n1,two,3,4\n".encode(), " ra"),
        (f"{HEAD}\n1,2,3\n".encode(), "well-formed"),
        (f"{HEAD}\n1,2,3,4\n99999999999999999999,2,3,4\n".encode(), "source_id"),
    ],
)
def test_bad_files_are_refused_by_name(tmp_path, content, message):
    path = tmp_path / "bad.csv"
    path.write_bytes(content)
    with pytest.raises(BadInput) as caught:
        read(path)
    assert "bad.csv" in str(caught.value.field) + str(caught.value.value)
    assert message in str(caught.value.field) + str(caught.value)


@pytest.mark.parametrize("keep", [5, 60, 2000, -1, -6])
def test_truncated_gzip_is_damage(tmp_path, few, keep):
    whole = write_csv(tmp_path / "whole.csv.gz", few).read_bytes()
    path = tmp_path / "cut.csv.gz"
    path.write_bytes(whole[:keep])
    with pytest.raises(Damaged, match=r"cut\.csv\.gz"):
        read(path)


def test_damaged_gzip_never_reads_as_whole(tmp_path, few):
    data = bytearray(write_csv(tmp_path / "whole.csv.gz", few).read_bytes())
    for at in range(20, len(data), 997):
        data[at] ^= 4
        (tmp_path / "flip.csv.gz").write_bytes(data)
        with pytest.raises((BadInput, Damaged)):
            read(tmp_path / "flip.csv.gz")
        data[at] ^= 4


def test_truncated_fits_and_votable_are_damage(tmp_path, few):
    as_astropy(few, masked=False).write(tmp_path / "a.fits")
    as_astropy(few).write(tmp_path / "a.vot", format="votable")
    for name in ("a.fits", "a.vot"):
        path = tmp_path / name
        path.write_bytes(path.read_bytes()[:-4000])
        with pytest.raises(Damaged, match=name):
            read(path)


def test_fits_without_a_table_and_float_ids(tmp_path, few):
    from astropy.io import fits

    fits.PrimaryHDU(np.zeros((3, 3))).writeto(tmp_path / "image.fits")
    with pytest.raises(BadInput, match="no binary table"):
        read(tmp_path / "image.fits")
    table = as_astropy(few, masked=False)
    table["source_id"] = table["source_id"].astype(float)
    table.write(tmp_path / "ids.fits")
    with pytest.raises(BadInput, match="integers"):
        read(tmp_path / "ids.fits")


READABLE = {
    "full_schema_random/gdr2_sm.fits": 1000,
    "full_schema_random/gdr2_rv_sm.fits": 100,
    "m67_field/M67_data.csv": 5546,
    "nearby_teff/gaia_dr2_result.csv": 6690,
    "ophiuchus/sample_oph_cone_r3.5-result.vot": 2814,
}


@pytest.mark.parametrize("name", READABLE)
def test_real_dr2_files(shared_data, name):
    table = read(shared_data / "gaia_dr2" / name)
    assert table.num_rows == READABLE[name]
    assert table["phot_g_mean_mag"].null_count == 0


@pytest.mark.parametrize("name", ["nearby_rv/gaia_data.fits", "clusters_k2/pleiades_gaia.csv"])
def test_real_files_without_usable_ids_are_refused(shared_data, name):
    with pytest.raises(BadInput) as caught:
        read(shared_data / "gaia_dr2" / name)
    assert "source_id" in str(caught.value.field) + str(caught.value)
