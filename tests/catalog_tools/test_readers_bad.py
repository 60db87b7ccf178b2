"""Bad input: each refused with one message that names the file, and the row or column."""

from __future__ import annotations

import contextlib
import datetime as dt
import errno
import gzip
import sqlite3
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from astropy.table import Table
from star_rows import random_stars, write_csv
from test_readers import IN_SQL, as_astropy, write_sqlite, write_votable

from catalog_tools.columns import INCOMING
from catalog_tools.errors import BadInput, Damaged
from catalog_tools.forms import IdRule, Layout, load_form
from catalog_tools.readers import detect_form, kind_of, read_tables
from catalog_tools.readers.bytes_in import bytes_of

DR2 = load_form("gaia_dr2")
HEAD = "source_id,ra,dec,phot_g_mean_mag"


def read(path, form=None):
    return pa.concat_tables([INCOMING.empty_table(), *read_tables(path, form)])


@pytest.fixture(scope="module")
def few():
    return random_stars(300, 5)


def check(path, message, form=None):
    with pytest.raises(BadInput) as caught:
        read(path, form)
    error = caught.value
    text = f"{error.field}: {error.value} {error.allowed}"
    assert path.name in text
    assert message in text
    assert len(str(error)) < 700


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is empty"),
        (b"\n \n", "is empty"),
        (b"\xef\xbb\xbf", "is empty"),
        (gzip.compress(b"", mtime=0), "is empty"),
        (b"\x00\x01\x02\x03", "no known kind"),
        (HEAD.encode("utf-16"), "no known kind"),
        (gzip.compress(b"PAR1 and more", mtime=0), "a gzipped parquet file: unpack it"),
        (b"# only\n# comments\n", "no line of one"),
        (b"ra,dec,phot_g_mean_mag\n1,2,3\n", "'source_id'"),
        (b"source_id,ra,dec\n1,2,3\n", "'phot_g_mean_mag'"),
        (f"{HEAD},ra\n1,2,3,4,5\n".encode(), "each of these columns once"),
        ("source_id,ra,dec,é\n".encode("latin-1"), "UTF-8"),
        (f"{HEAD}\n1,2,3,4\n1.5e3,2,3,4\n".encode(), "source_id row 2: 1.5e3 integers"),
        (f"{HEAD}\n1,2,3,4\n1,2,3,4\n1,two,3,4\n".encode(), " ra row 3: two numbers"),
        (f"{HEAD}\n1,2,3,4\n1,2,3\n".encode(), "row 2: 3 fields 4 fields"),
        (f"{HEAD}\n1,2,3,4\n\n1,2,3,4,5\n".encode(), "row 2: 5 fields 4 fields"),
        (f"{HEAD}\n1,2,3,4,5\n1,2,3\n".encode(), "row 1: 5 fields"),
        (f'{HEAD}\n1,"2,3",4\n'.encode(), "row 1: 3 fields"),
        (f'{HEAD},x\n1,2,3,4,"a\nb"\n'.encode(), "row 1"),
        (f'{HEAD},x\n1,2,3,4,a\n1,2,3,4,"b\n'.encode(), "row 2: quotes"),
        (f"{HEAD}\n99999999999999999999,2,3,4\n".encode(), "source_id row 1"),
        (f"{HEAD}\r1,2,3,4\r5,6,7,8\r".encode(), "end with LF or CR LF"),
        (f"{HEAD},x\n1,2,3,4,a\rb\n".encode(), "end with LF or CR LF"),
        (f"{HEAD}\n".encode() + b"1" * 3_000_000, "lines of at most"),
        (f"{HEAD},ref_epoch\n1,2,3,4,2000\n".encode(), "2015.5 (Gaia DR2) or 2016.0"),
        (f"{HEAD},ref_epoch\n1,2,3,4,2015.5\n5,6,7,8,2016.0\n".encode(), "one release"),
        (f"{HEAD},pm,ref_epoch\n1,2,3,4,5,2015.5\n".encode(), "one release"),
        (f"{HEAD},pm,teff_val\n1,2,3,4,5,6\n".encode(), "pm says gaia_dr3"),
        (f"{HEAD},designation,ref_epoch\n1,2,3,4,Gaia DR3 5,2015.5\n".encode(), "one release"),
        (f"{HEAD}\n1,2\n3,4\n".encode(), "row 1: 2 fields 4 fields"),
        (b"x" * 200_000 + b"\n1\n", "a header line of names (field larger than"),
    ],
)
def test_bad_files_are_refused_by_name(tmp_path, content, message):
    path = tmp_path / "bad.csv"
    path.write_bytes(content)
    check(path, message)


def test_rows_are_counted_over_the_whole_file(tmp_path, monkeypatch, few):
    monkeypatch.setattr("catalog_tools.readers.text.TABLE_BYTES", 2000)
    monkeypatch.setattr("catalog_tools.readers.bytes_in.PLAIN_BYTES", 3000)
    good = write_csv(tmp_path / "good.csv", few).read_text().splitlines()
    for row, spoil, message in (
        (250, lambda line: line.replace(",", ",x", 1), "ra row 250"),
        (270, lambda line: line + ",1", "row 270: 11 fields"),
    ):
        lines = [*good]
        lines[row] = spoil(lines[row])
        (tmp_path / "bad.csv").write_text("\n".join(lines))
        check(tmp_path / "bad.csv", message)


def test_a_table_of_another_release_is_refused_by_its_columns(tmp_path):
    for form, column in (("gaia_dr2", "pm"), ("gaia_dr3", "teff_val")):
        (tmp_path / "a.csv").write_text(f"{HEAD},{column}\n1,2,3,4,5\n")
        check(tmp_path / "a.csv", f"the columns of the form {form}", load_form(form))


def test_an_epoch_that_changes_late_in_the_file_is_refused(tmp_path):
    lines = [f"{HEAD},ref_epoch", *("1,2,3,4,2015.5" for _ in range(9)), "1,2,3,4,2016.0"]
    (tmp_path / "a.csv").write_text("\n".join(lines))
    check(tmp_path / "a.csv", "ref_epoch row 10", DR2)


@pytest.mark.parametrize("keep", [1, 5, 60, 2000, -1, -6, -8, -9])
def test_truncated_gzip_is_damage(tmp_path, few, keep):
    whole = write_csv(tmp_path / "whole.csv.gz", few).read_bytes()
    path = tmp_path / "cut.csv.gz"
    path.write_bytes(whole[:keep])
    if keep == 1:
        return check(path, "cut.csv.gz")
    with pytest.raises((Damaged, BadInput), match=r"cut\.csv\.gz"):
        read(path)
    if keep not in (1, 5):
        with pytest.raises(Damaged, match=r"cut\.csv\.gz"):
            read(path, DR2)
    return None


@pytest.mark.parametrize("tail", [b"trailing", b"\x1f", b"\x1f\x8b", b"\0\0x", b"\n"])
def test_what_follows_a_gzip_stream_is_never_ignored(tmp_path, few, tail):
    path = write_csv(tmp_path / "tail.csv.gz", few)
    path.write_bytes(path.read_bytes() + tail)
    with pytest.raises(Damaged, match=r"tail\.csv\.gz.*gzip stream"):
        read(path)


def test_a_tail_long_enough_to_be_a_gzip_stream_is_told_from_one(tmp_path, few):
    path = write_csv(tmp_path / "tail.csv.gz", few)
    path.write_bytes(path.read_bytes() + b"no gzip stream" * 10)
    with pytest.raises(Damaged, match="what follows its gzip stream is not another one"):
        read(path)


def test_all_that_a_cut_gzip_holds_is_read_before_it_is_damage(tmp_path, monkeypatch):
    monkeypatch.setattr("catalog_tools.readers.bytes_in.MOST_BYTES", 50)
    packed = gzip.compress(b"," * 100_000)[:-30]
    (tmp_path / "cut.gz").write_bytes(packed)
    pieces = []
    with pytest.raises(Damaged, match="ends too early"):
        pieces.extend(bytes_of(tmp_path / "cut.gz", zipped=True))
    assert b"".join(pieces) == zlib.decompressobj(wbits=31).decompress(packed)
    assert max(map(len, pieces)) <= 50


@pytest.mark.parametrize("rest", ["nothing", "the file"])
def test_zeros_at_the_beginning_of_a_gzip_are_damage(tmp_path, few, rest):
    """A download whose beginning, or all of it, was never written: no padding stands there."""
    path = write_csv(tmp_path / "hole.csv.gz", few)
    path.write_bytes(b"\0" * 4096 + (path.read_bytes() if rest == "the file" else b""))
    with pytest.raises(Damaged, match=r"hole\.csv\.gz.*gzip stream"):
        list(bytes_of(path, zipped=True))
    with pytest.raises((BadInput, Damaged), match=r"hole\.csv\.gz"):
        read(path, DR2)


def test_damaged_gzip_never_reads_as_whole(tmp_path, few):
    data = bytearray(write_csv(tmp_path / "whole.csv.gz", few).read_bytes())
    for at in (3, *range(20, len(data), 997), len(data) - 6, len(data) - 2):
        data[at] ^= 0xE4 if at == 3 else 4
        (tmp_path / "flip.csv.gz").write_bytes(data)
        with pytest.raises((BadInput, Damaged)):
            read(tmp_path / "flip.csv.gz", DR2)
        data[at] ^= 0xE4 if at == 3 else 4


def test_truncated_files_of_other_kinds_are_damage(tmp_path, few):
    as_astropy(few, masked=False).write(tmp_path / "a.fits")
    write_votable(tmp_path / "a.vot", few)
    pq.write_table(few, tmp_path / "a.parquet")
    write_sqlite(tmp_path / "a.sqlite", few)
    for name in ("a.fits", "a.vot", "a.parquet", "a.sqlite"):
        path = tmp_path / name
        path.write_bytes(path.read_bytes()[: -6000 if name == "a.sqlite" else -4000])
        with pytest.raises(Damaged, match=name):
            read(path, IN_SQL)


def test_a_flipped_byte_of_parquet_is_damage(tmp_path, few):
    path = tmp_path / "a.parquet"
    pq.write_table(few, path, write_page_checksum=True, compression="none")
    data = bytearray(path.read_bytes())
    data[2000] ^= 1
    path.write_bytes(data)
    with pytest.raises(Damaged, match=r"a\.parquet"):
        read(path, DR2)


def test_fits_without_a_table_and_with_other_extensions(tmp_path, few):
    from astropy.io import fits

    fits.PrimaryHDU(np.zeros((3, 3))).writeto(tmp_path / "image.fits")
    check(tmp_path / "image.fits", "no binary table")
    table = fits.table_to_hdu(as_astropy(few, masked=False))
    fits.HDUList([fits.PrimaryHDU(), fits.ImageHDU(np.ones(4)), table]).writeto(tmp_path / "b.fits")
    check(tmp_path / "b.fits", "extension 1: IMAGE", replace(DR2, layout=Layout(hdu=1)))
    check(tmp_path / "b.fits", "in extension 7", replace(DR2, layout=Layout(hdu=7)))
    content, axis = (tmp_path / "b.fits").read_bytes(), b"NAXIS1  =                   "
    (tmp_path / "b.fits").write_bytes(content.replace(axis + b" 4", axis + b"-4"))
    check(tmp_path / "b.fits", "NAXIS1 = -4")


def test_fits_extensions_of_any_size_before_the_table_are_passed_over(tmp_path, few):
    """Images without pixels, and random groups, whose first axis of none counts no pixels."""
    from astropy.io import fits

    table = fits.table_to_hdu(as_astropy(few, masked=False))
    images = fits.ImageHDU(np.ones((0, 900))), fits.ImageHDU(np.ones((3, 0)))
    values = np.arange(9000.0).reshape(10, 900).astype(np.float32)
    more = [np.arange(10.0), np.ones(10)]
    groups = fits.GroupsHDU(fits.GroupData(values, bitpix=-32, parnames=["u", "v"], pardata=more))
    fits.HDUList([fits.PrimaryHDU(), *images, table]).writeto(tmp_path / "images.fits")
    fits.HDUList([groups, table]).writeto(tmp_path / "groups.fits")
    for name in ("images.fits", "groups.fits"):
        assert read(tmp_path / name, DR2)["source_id"].equals(few["source_id"])


@pytest.mark.parametrize(
    ("card", "changed", "message"),
    [
        ("TFORM2  = 'D       '", "TFORM2  = 'Z       '", " ra: Z a TFORM of the FITS standard"),
        ("TFORM2  = 'D       '", "TFORM2  = '9999999999D'", "9999999999D a TFORM of the FITS"),
        ("TFORM2  = 'D       '", "TFORMX  = 'D       '", "'TFORM2' FITS headers to the standard"),
        ("TFIELDS =", "TFIELDX =", "'TFIELDS' FITS headers to the standard"),
        ("BITPIX  =", "BITPIXX =", "'BITPIX' FITS headers to the standard"),
        ("NAXIS2  =", "NAXISX  =", "'NAXIS2' FITS headers to the standard"),
        ("TTYPE4  = 'pmra    '", "TTYPE4  = 'pmdec   '", "each of these columns once"),
        ("TTYPE2  = 'ra      '", "TTYPE2  = '\xe9       '", "FITS headers to the standard"),
        ("COMMENT of 80 bytes", "TSCAL2  = 'x       '", ": 'x' FITS headers to the standard"),
        ("COMMENT of 80 bytes", "TZERO1  = 1E300", "source_id row 1: 1e+300 integers"),
        ("END", "COMMENT", "1000 blocks a FITS header that has an END"),
        ("NAXIS   =                    2", "NAXIS   =            999999999", "NAXIS = 999999999"),
    ],
)
def test_fits_headers_that_break_the_standard(tmp_path, few, card, changed, message):
    from astropy.io import fits

    table = fits.table_to_hdu(as_astropy(few, masked=False))
    table.header["COMMENT"] = "of 80 bytes"
    fits.HDUList([fits.PrimaryHDU(), table]).writeto(tmp_path / "a.fits")
    content, place = (tmp_path / "a.fits").read_bytes(), max(len(card), len(changed))
    old, new = (text.ljust(place).encode("latin-1") for text in (card, changed))
    primary, header, stars = content[:2880], content[2880:5760], content[5760:]
    assert old in header
    blocks = b" " * 2880 * 1000 if card.startswith("END") else b""
    (tmp_path / "a.fits").write_bytes(primary + header.replace(old, new, 1) + blocks + stars)
    check(tmp_path / "a.fits", message, DR2)


def test_fits_rows_that_are_not_as_wide_as_their_columns_are_damage(tmp_path, few):
    as_astropy(few, masked=False).write(tmp_path / "a.fits")
    content, width = (tmp_path / "a.fits").read_bytes(), b"NAXIS1  =                   "
    assert width + b"52" in content
    (tmp_path / "a.fits").write_bytes(content.replace(width + b"52", width + b"53"))
    with pytest.raises(Damaged, match="its columns are 52 bytes, its rows 53"):
        read(tmp_path / "a.fits")


def test_wrong_types_of_columns(tmp_path, few):
    table = as_astropy(few, masked=False)
    table["source_id"] = 6.7e17 + table["source_id"].astype(float)
    table.write(tmp_path / "ids.fits")
    table.write(tmp_path / "ids.vot", format="votable", tabledata_format="binary2")
    for name in ("ids.fits", "ids.vot"):
        check(tmp_path / name, "designation")
    table = as_astropy(few, masked=False)
    table["source_id"] = table["source_id"].astype(float) + 0.5
    table.write(tmp_path / "half.fits")
    check(tmp_path / "half.fits", "source_id row 1")
    table = as_astropy(few, masked=False)
    table["ra"] = [f"{x:.5f}" for x in table["ra"]]
    table.write(tmp_path / "text.fits")
    table.write(tmp_path / "text.vot", format="votable", tabledata_format="binary2")
    pq.write_table(few.set_column(1, "ra", few["ra"].cast(pa.string())), tmp_path / "text.parquet")
    write_sqlite(tmp_path / "text.sqlite", few.set_column(1, "ra", few["ra"].cast(pa.string())))
    for suffix in ("fits", "vot", "parquet", "sqlite"):
        check(tmp_path / f"text.{suffix}", " ra", IN_SQL)


def test_parquet_ids_that_are_no_integers(tmp_path, few):
    date = dt.datetime(2026, 1, 2)
    for values, message in (
        (pa.array([2**63 + n for n in range(300)], pa.uint64()), "below 2**63"),
        (pa.array([[n] for n in range(300)]), "list<element: int64> to int64"),
        (pa.array([True] * 300), "bool integers"),
        (pa.array([date] * 300), "timestamp[us] integers"),
        (pa.array(["HD 7"] * 300), "'HD 7'"),
    ):
        pq.write_table(few.set_column(0, "source_id", values), tmp_path / "a.parquet")
        check(tmp_path / "a.parquet", message, DR2)


def test_a_column_that_a_parquet_file_has_twice(tmp_path, few):
    pq.write_table(few.append_column("pmra", few["pmra"]), tmp_path / "a.parquet")
    check(tmp_path / "a.parquet", "['pmra'] a table that has each of these columns once")


@pytest.mark.parametrize("rule", ["text", "trailing_integer"])
def test_numbers_where_the_form_reads_ids_from_texts(tmp_path, few, rule):
    form = replace(DR2, source_id=IdRule(rule, ("source_id",)))
    pq.write_table(few, tmp_path / "a.parquet")
    as_astropy(few, masked=False).write(tmp_path / "a.fits")
    write_votable(tmp_path / "a.vot", few)
    check(tmp_path / "a.parquet", " source_id: int64 texts", form)
    check(tmp_path / "a.fits", " source_id: 1>i8 texts", form)
    check(tmp_path / "a.vot", " source_id: int64 texts", form)


def test_small_whole_floats_are_ids(tmp_path, few):
    table = as_astropy(few, masked=False)
    table["source_id"] = table["source_id"].astype(float)
    table.write(tmp_path / "ids.fits")
    assert read(tmp_path / "ids.fits")["source_id"].equals(few["source_id"])


def test_sqlite_needs_a_query_that_only_reads(tmp_path, few):
    path = tmp_path / "a.sqlite"
    write_sqlite(path, few)
    before = path.read_bytes()
    check(path, "`query`")
    check(path, "`query`", DR2)
    for query, message in (
        ("select * from moons", "moons"),
        ("delete from stars", "query"),
        ("attach ':memory:' as x", "query"),
        ("select 1; select 2", "query"),
        ("select source_id, ra, dec from stars", "'phot_g_mean_mag'"),
        ("-- of all stars", "a query that gives rows"),
        ("select dec as ra, * from stars", "query: ['ra'] a query that has each of these"),
    ):
        check(path, message, replace(DR2, layout=Layout(query=query)))
    layout = Layout(query="select * from stars", attach=(("other", "none.sqlite"),))
    check(path, "attach.other", replace(DR2, layout=layout))
    assert path.read_bytes() == before
    assert sqlite3.connect(path).execute("select count(*) from stars").fetchone() == (300,)


@pytest.mark.parametrize("mode", ["wal", "persist"])
def test_sqlite_that_a_writer_has_not_finished_is_refused(tmp_path, few, mode):
    """Rows that are committed to a log are in no file yet; a log that is done with is no fault."""
    path, other = tmp_path / "a.sqlite", tmp_path / "b.sqlite"
    for each in (path, other):
        write_sqlite(each, few)
    layout = Layout(query="select * from stars", attach=(("other", "b.sqlite"),))
    for written in (other, path):
        with contextlib.closing(sqlite3.connect(written, isolation_level=None)) as base:
            base.execute(f"pragma journal_mode = {mode}")
            base.execute("pragma cache_size = 1")  # pages go to the file before the end
            base.execute("begin")
            for _ in range(3):
                base.execute("insert into stars select * from stars")
            if mode == "wal":
                base.execute("commit")
            log = written.name + ("-wal" if mode == "wal" else "-journal")
            check(path, log, replace(DR2, layout=layout))
            if mode == "persist":
                base.execute("commit")
        assert sum(map(len, read(path, replace(DR2, layout=layout)))) >= 300


def test_a_votable_too_large_for_memory_is_refused_with_advice(tmp_path, few, monkeypatch):
    write_votable(tmp_path / "a.vot", few)
    monkeypatch.setattr("catalog_tools.readers.votable.MOST_BYTES", 5000)
    check(tmp_path / "a.vot", "as CSV, FITS or Parquet")


def test_no_such_file_and_a_folder(tmp_path):
    for call in (read, kind_of, detect_form):
        for path in (tmp_path / "none.csv", tmp_path):
            with pytest.raises(BadInput, match="can be read"):
                call(path)


def test_a_disk_that_fails_while_a_file_is_read(tmp_path, monkeypatch):
    path = tmp_path / "a.csv"
    path.write_text(f"{HEAD}\n1,2,3,4\n")
    opened, whole = [], Path.open

    def fails_later(self, *args, **options):
        opened.append(self)
        if len(opened) > 1:
            raise OSError(errno.EIO, "Input/output error")
        return whole(self, *args, **options)

    monkeypatch.setattr(Path, "open", fails_later)
    check(path, "a file that can be read (Input/output error)", DR2)


def test_texts_without_digits_are_no_trailing_integers(tmp_path):
    form = replace(DR2, source_id=IdRule("trailing_integer", ("designation",)))
    path = tmp_path / "a.csv"
    path.write_text(f"{HEAD},designation\n1,2,3,4,Gaia DR2 17\n1,2,3,4,none\n")
    check(path, "designation row 2", form)
    for digits in ("9" * 30, f"J1{'0' * 18}7"):  # the last 19 of these are a number
        path.write_text(f"{HEAD},designation\n1,2,3,4,{digits}\n")
        check(path, "designation", form)


def test_nan_and_null_positions_come_through_as_null(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(f"{HEAD}\n1,nan,3,4\n2,,3,4\n3,1,null,4\n4,1,1,NaN\n")
    table = read(path)
    assert table.num_rows == 4
    assert table["ra"].null_count == 2
    assert table["dec"].null_count == table["phot_g_mean_mag"].null_count == 1
    Table({"source_id": [1], "ra": [np.nan], "dec": [1.0], "phot_g_mean_mag": [5.0]}).write(
        tmp_path / "a.fits"
    )
    assert read(tmp_path / "a.fits")["ra"].to_pylist() == [None]
