"""Every kind of file gives the same rows, whole, in order, and its digest."""

from __future__ import annotations

import csv
import gzip
import hashlib
import io
import sqlite3
import zlib
from dataclasses import replace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from astropy.table import Table
from hypothesis import given, settings
from hypothesis import strategies as st
from star_rows import random_stars, write_csv

from catalog_tools.columns import INCOMING, NAMES
from catalog_tools.forms import IdRule, Layout, load_form
from catalog_tools.ingest.ingest import ingest
from catalog_tools.readers import detect_form, kind_of, read_tables, text
from catalog_tools.readers.fields import FieldTaker

DR2 = load_form("gaia_dr2")
IN_SQL = replace(DR2, layout=Layout(query="select * from stars"))


def read(path, form=DR2, **options):
    return pa.concat_tables([INCOMING.empty_table(), *read_tables(path, form, **options)])


def as_astropy(stars, *, masked):
    """An astropy table; absent values masked, or NaN as FITS has them."""
    table = Table(masked=masked)
    for name in NAMES:
        column = stars[name].combine_chunks()
        table[name] = column.to_numpy(zero_copy_only=False)
        if masked:
            table[name].mask = column.is_null().to_numpy(zero_copy_only=False)
    return table


VOTYPES = {pa.int64(): "long", pa.float64(): "double", pa.float32(): "float"}
VOTABLE = (
    '<?xml version="1.0"?>\n<VOTABLE version="1.3" xmlns="http://www.ivoa.net/xml/VOTable/v1.3">'
    "<RESOURCE><TABLE>{fields}<DATA><TABLEDATA>{rows}</TABLEDATA></DATA></TABLE></RESOURCE></VOTABLE>"
)


def write_votable(path, stars):
    """TABLEDATA; astropy 8's own writer of it is not used here: it corrupts the heap."""
    fields = "".join(f'<FIELD name="{f.name}" datatype="{VOTYPES[f.type]}"/>' for f in stars.schema)
    rows = (
        "".join(f"<TD>{'' if x is None else x!r}</TD>" for x in r)
        for r in zip(*stars.to_pydict().values(), strict=True)
    )
    path.write_text(VOTABLE.format(fields=fields, rows="".join(f"<TR>{r}</TR>\n" for r in rows)))


def write_sqlite(path, stars):
    with sqlite3.connect(path) as base:
        base.execute(f"create table stars ({', '.join(NAMES)})")
        rows = zip(*(stars[name].to_pylist() for name in NAMES), strict=True)
        base.executemany(f"insert into stars values ({','.join('?' * len(NAMES))})", rows)
    base.close()


def write_all(folder, stars):
    """The same rows as every kind of file: by kind, the path."""
    paths = {"csv": folder / "a.csv", "csv.gz": folder / "a.csv.gz"}
    for path in paths.values():
        write_csv(path, stars)
    as_astropy(stars, masked=False).write(folder / "a.fits", overwrite=True)
    write_votable(folder / "a.vot", stars)
    binary = {"format": "votable", "tabledata_format": "binary2", "overwrite": True}
    as_astropy(stars, masked=True).write(folder / "b.vot", **binary)
    pq.write_table(stars, folder / "a.parquet", row_group_size=7)
    (folder / "a.sqlite").unlink(missing_ok=True)
    write_sqlite(folder / "a.sqlite", stars)
    paths |= {"fits": folder / "a.fits", "votable": folder / "a.vot"}
    paths |= {"parquet": folder / "a.parquet", "sqlite": folder / "a.sqlite"}
    for kind in ("fits", "votable"):
        paths[f"{kind}.gz"] = folder / f"{kind}.packed"
        paths[f"{kind}.gz"].write_bytes(gzip.compress(paths[kind].read_bytes()))
    return paths | {"votable binary2": folder / "b.vot"}


def test_same_rows_from_every_kind_and_every_byte_digested(tmp_path):
    stars, folder = random_stars(300, 5), tmp_path / "a #b?c=%41&d"
    folder.mkdir()
    for kind, path in write_all(folder, stars).items():
        assert kind_of(path) == kind.split()[0]
        md5 = hashlib.md5()
        assert read(path, IN_SQL, md5=md5).equals(stars), kind
        assert md5.hexdigest() == hashlib.md5(path.read_bytes()).hexdigest(), kind


FLOATS = {"allow_nan": False, "allow_infinity": False}


@st.composite
def tables(draw):
    """Rows of any finite values, any of them absent but the ids."""
    count = draw(st.integers(0, 5))
    columns = []
    for field in INCOMING:
        if field.name == "source_id":
            values = st.integers(-(2**63), 2**63 - 1)
        elif field.type == pa.float64():
            values = st.none() | st.floats(**FLOATS)
        else:
            values = st.none() | st.floats(width=32, **FLOATS)
        columns.append(draw(st.lists(values, min_size=count, max_size=count)))
    arrays = [pa.array(c, f.type) for c, f in zip(columns, INCOMING, strict=True)]
    return pa.table(arrays, schema=INCOMING)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("any")


@settings(max_examples=12)
@given(stars=tables())
def test_any_table_reads_back_equal(folder, stars):
    for kind, path in write_all(folder, stars).items():
        assert read(path, IN_SQL).equals(stars), kind


TRAPS = st.text('a1 ,"', max_size=4)


@given(rows=st.lists(st.lists(TRAPS, min_size=3, max_size=5), max_size=8), data=st.data())
def test_fields_taken_at_once_are_those_of_the_csv_module(rows, data):
    """Whatever stands in quotes: the fast way gives the same fields, or passes."""
    quoting = data.draw(st.sampled_from((csv.QUOTE_MINIMAL, csv.QUOTE_ALL, csv.QUOTE_NONE)))
    if quoting == csv.QUOTE_NONE:
        text = "".join(",".join(row) + "\n" for row in rows)
    else:
        file = io.StringIO()
        csv.writer(file, quoting=quoting, lineterminator="\n").writerows(rows)
        text = file.getvalue()
    taken = FieldTaker([True, False, True, False], ord(",")).take(text.encode())
    if taken is not None:
        fields, count = taken
        expected = list(csv.reader(io.StringIO(text)))
        assert [len(row) for row in expected] == [4] * count
        got = list(csv.reader(io.StringIO(fields.tobytes().decode())))
        assert got == [[row[0], row[2]] for row in expected]
    elif quoting == csv.QUOTE_ALL:
        inside = any("," in field for row in rows for field in row)
        assert inside or any(len(row) != 4 for row in rows)


@pytest.mark.parametrize("piece_bytes", [1, 7, 1000])
def test_rows_do_not_depend_on_how_the_bytes_come(tmp_path, monkeypatch, piece_bytes):
    stars = random_stars(200, 6)
    path = write_csv(tmp_path / "a.csv.gz", stars)
    whole = read(path)
    monkeypatch.setattr("catalog_tools.readers.bytes_in.PACKED_BYTES", piece_bytes)
    monkeypatch.setattr("catalog_tools.readers.bytes_in.MOST_BYTES", 50)
    monkeypatch.setattr(text, "TABLE_BYTES", 500)
    parts = list(read_tables(path, DR2))
    assert len(parts) > 10
    assert pa.concat_tables(parts).equals(whole)
    assert whole.equals(stars)


def test_tables_are_of_bounded_size(tmp_path):
    stars = random_stars(60_000, 7)
    path = tmp_path / "a.csv"
    import pyarrow.csv as pacsv

    pacsv.write_csv(stars, path)
    parts = list(read_tables(path, DR2))
    assert len(parts) > 1
    assert max(part.num_rows for part in parts) < 50_000
    assert pa.concat_tables(parts).equals(stars)


# Many columns that nobody asked for, texts with every trap among them.
HEAD = "name,source_id,note,ra,dec,phot_g_mean_mag,pmra,flag"


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_quotes_blanks_and_nulls_among_unwanted_columns(tmp_path, end):
    lines = [
        HEAD,
        'a,1,plain,10.0,-3.5,12.5,null,"x"',
        '"b, c",2,"a ""quoted"" word",11.0,4.0,13.0,"",y',
        "",
        '"d",3,,1,2,3,nan,"a,b"',
        ' e , 4 ,\u00e9,"12.5", 6 ,7,  ,z',
    ]
    path = tmp_path / "odd.csv"
    path.write_bytes(end.join(lines).encode())  # no line end after the last row
    table = read(path)
    assert table["source_id"].to_pylist() == [1, 2, 3, 4]
    assert table["ra"].to_pylist() == [10.0, 11.0, 1.0, 12.5]
    assert table["pmra"].to_pylist() == [None] * 4 == table["phot_bp_mean_mag"].to_pylist()


@pytest.mark.parametrize("wanted", ["name", "flag"])
def test_last_and_first_column_may_be_wanted(tmp_path, wanted):
    path = tmp_path / "a.csv"
    names = HEAD.replace("source_id", "id").replace(wanted, "source_id")
    path.write_text(f"{names}\r\n7,1,,2,3,4,5,8\r\n9,1,,2,3,4,5,6\r\n", newline="")
    assert read(path)["source_id"].to_pylist() == ([7, 9] if wanted == "name" else [8, 6])


@pytest.mark.parametrize(
    "layout",
    [
        Layout(text="whitespace", columns=("name", "id")),
        Layout(text="fixed", columns=("name", "id"), ranges=((1, 6), (7, 8))),
    ],
)
def test_letters_whose_bytes_are_blanks_elsewhere_stay(tmp_path, layout):
    """In Latin-1, in which bytes stay themselves, the last byte of these is a blank."""
    names = ["\u00c5ke", "\u00e0", "b\u00e0", "\u0445x"]
    lines = (name.encode() + b" " * (6 - len(name.encode())) + b" 7" for name in names)
    (tmp_path / "a.txt").write_bytes(b"\n".join(lines) + b"\n")
    (table,) = text.read_text(
        tmp_path / "a.txt",
        "source",
        layout,
        lambda names, _: {"name": "text", "id": "integer"},
        zipped=False,
    )
    assert table.to_pydict() == {"name": names, "id": [7] * 4}


def test_mixed_line_ends_byte_order_mark_comments_and_case(tmp_path):
    path = tmp_path / "odd.csv"
    path.write_bytes(
        b'\xef\xbb\xbf# a comment\r\n\n"SOURCE_ID",RA,Dec,phot_g_mean_mag\r\n1,2,3,4\n5,6,7,8\r\n'
    )
    assert read(path)["source_id"].to_pylist() == [1, 5]


@pytest.mark.parametrize(("delimiter", "stated"), [(",", "# delimiter: ','\n"), (" ", "")])
def test_ecsv_states_its_delimiter(tmp_path, delimiter, stated):
    path = tmp_path / "a.ecsv"
    head = delimiter.join(("source_id", "ra", "dec", "phot_g_mean_mag", "pmra"))
    row = delimiter.join(("1", "2.5", "3.5", "4.5", '""'))
    path.write_text(f"# %ECSV 1.0\n# ---\n{stated}# datatype:\n{head}\n{row}\n")
    assert read(path).to_pylist()[0]["ra"] == 2.5


def test_header_alone_is_no_row(tmp_path):
    for name in ("a.csv", "b.csv.gz"):
        path = write_csv(tmp_path / name, INCOMING.empty_table())
        assert read(path).num_rows == 0
        assert detect_form(path).name == "gaia_dr2"
    (tmp_path / "c.csv").write_text(",".join(NAMES))
    assert read(tmp_path / "c.csv").num_rows == 0


def test_blank_lines_alone_are_no_rows(tmp_path):
    (tmp_path / "a.csv").write_text(",".join(NAMES) + "\n\n\n")
    assert read(tmp_path / "a.csv").equals(INCOMING.empty_table())


def test_gzip_members_and_zeros_follow_each_other(tmp_path):
    stars = random_stars(50, 8)
    data = write_csv(tmp_path / "a.csv", stars).read_bytes()
    path = tmp_path / "a.csv.gz"
    members = [gzip.compress(data[:999]), gzip.compress(b""), gzip.compress(data[999:])]
    path.write_bytes(members[0] + b"\0" * 7 + b"".join(members[1:]) + b"\0" * 700)
    md5 = hashlib.md5()
    assert read(path, md5=md5).equals(stars)
    assert md5.hexdigest() == hashlib.md5(path.read_bytes()).hexdigest()


def test_memory_is_bounded_however_well_a_file_is_packed(tmp_path, monkeypatch):
    """A thousandfold packed file comes in pieces of at most MOST_BYTES."""
    from catalog_tools.readers import bytes_in

    path = tmp_path / "bomb.gz"
    path.write_bytes(gzip.compress(b"," * 30_000_000))
    pieces = [len(piece) for piece in bytes_in.bytes_of(path, zipped=True)]
    assert sum(pieces) == 30_000_000
    assert max(pieces) <= bytes_in.MOST_BYTES


def test_unpacking_against_zlib(tmp_path):
    from catalog_tools.readers.bytes_in import bytes_of

    rng = np.random.default_rng(9)
    data = rng.integers(0, 40, 3_000_000, np.uint8).tobytes()
    for level in (1, 6, 9):
        packed = gzip.compress(data, level)
        (tmp_path / "a.gz").write_bytes(packed)
        got = b"".join(bytes_of(tmp_path / "a.gz", zipped=True))
        assert got == zlib.decompress(packed, wbits=31)


# FITS: what the standard allows, against astropy


def test_fits_scaled_unsigned_null_and_other_columns(tmp_path):
    from astropy.io import fits

    n = 5
    columns = [
        fits.Column("flags", "11X", array=np.zeros((n, 11), bool)),
        fits.Column("source_id", "K", bzero=2**63, array=np.arange(n, dtype=np.uint64) + 2**60),
        fits.Column("ra", "I", array=np.arange(n, dtype=np.int16) * 50),
        fits.Column("image", "6E", dim="(2,3)", array=np.ones((n, 3, 2))),
        fits.Column("dec", "E", array=np.float32([1.1, 2.2, np.nan, 4.4, 5.5])),
        fits.Column("phot_g_mean_mag", "J", null=-99, array=np.array([9, -99, 11, 12, 13])),
        fits.Column("list", "PJ()", array=np.array([np.arange(i) for i in range(n)], object)),
        fits.Column("text", "3A", array=["abc"] * n),
    ]
    hdus = [fits.PrimaryHDU(np.ones((40, 50))), fits.ImageHDU(np.ones(3))]
    hdus.append(fits.BinTableHDU.from_columns(columns))
    fits.HDUList(hdus).writeto(tmp_path / "a.fits")
    for keyword, value in (("TSCAL3", 0.01), ("TZERO3", 100.0), ("TZERO6", 3)):
        fits.setval(tmp_path / "a.fits", keyword, value=value, ext=2)
    table = read(tmp_path / "a.fits").to_pydict()
    assert table["source_id"] == [2**60 + i for i in range(n)]
    np.testing.assert_allclose(table["ra"], 100 + np.arange(n) * 0.5, rtol=1e-15)
    assert table["dec"] == [np.float32(1.1), np.float32(2.2), None, *np.float32([4.4, 5.5])]
    assert table["phot_g_mean_mag"] == [12, None, 14, 15, 16]  # the null is the stored number


def test_fits_extension_by_number_and_rows_in_pieces(tmp_path, monkeypatch):
    from astropy.io import fits

    few, many = random_stars(3, 1), random_stars(500, 2)
    tables = [fits.table_to_hdu(as_astropy(stars, masked=False)) for stars in (few, many)]
    fits.HDUList([fits.PrimaryHDU(), *tables]).writeto(tmp_path / "a.fits")
    monkeypatch.setattr("catalog_tools.readers.fits.PIECE_BYTES", 1000)
    assert read(tmp_path / "a.fits").equals(few)
    second = replace(DR2, layout=Layout(hdu=2))
    assert read(tmp_path / "a.fits", second).equals(many)


def test_votable_tabledata_with_null_values(tmp_path):
    kinds = ["source_id long", "ra double", "dec double", "phot_g_mean_mag float"]
    kinds += ["pmra double", "pmra double"]
    pairs = (kind.split() for kind in kinds)
    fields = "".join(f'<FIELD name="{name}" datatype="{kind}"/>' for name, kind in pairs)
    row = "<TR><TD>6714230465835878784</TD><TD>2.5</TD><TD>-3</TD><TD/><TD/><TD>8</TD></TR>"
    (tmp_path / "a.xml").write_text(VOTABLE.format(fields=fields, rows=row))
    star = read(tmp_path / "a.xml").to_pylist()[0]
    assert (star["source_id"], star["ra"], star["dec"]) == (6714230465835878784, 2.5, -3.0)
    assert star["phot_g_mean_mag"] is star["pmra"] is None


# DR2 or DR3


def gaia(tmp_path, columns, values):
    path = tmp_path / "a.csv"
    head = "source_id,ra,dec,phot_g_mean_mag"
    path.write_text(f"{head},{columns}\n1,2,3,4,{values}\n5,6,7,8,{values}\n")
    return path


@pytest.mark.parametrize(
    ("columns", "values", "form"),
    [
        ("pmra", "1", "gaia_dr2"),
        ("ref_epoch", "2015.5", "gaia_dr2"),
        ("ref_epoch", "2016.0", "gaia_dr3"),
        ("pm", "1", "gaia_dr3"),
        ("PM,ref_epoch", "1,2016.0", "gaia_dr3"),
        ("teff_val", "", "gaia_dr2"),
        ("designation", "Gaia DR3 4", "gaia_dr3"),
        ("designation", "Gaia DR2 4", "gaia_dr2"),
        ("designation", "Gaia EDR3 4", "gaia_dr3"),
    ],
)
def test_release_is_told_by_columns_epoch_and_designation(tmp_path, columns, values, form):
    path = gaia(tmp_path, columns, values)
    found = detect_form(path)
    assert found == load_form(form)
    assert found.ref_epoch_jyear == {"gaia_dr2": 2015.5, "gaia_dr3": 2016.0}[form]
    assert pa.concat_tables(read_tables(path)).num_rows == 2


def test_a_byte_order_mark_hides_no_votable(tmp_path):
    """Whose element may come late, after a long comment."""
    head = b"\xef\xbb\xbf<?xml version='1.0'?>\n<!-- " + b"long " * 200_000 + b"-->\n<VOTABLE/>"
    (tmp_path / "late.xml").write_bytes(head)
    assert kind_of(tmp_path / "late.xml") == "votable"


def test_detection_looks_into_every_kind(tmp_path):
    stars = random_stars(30, 3)
    later = stars.append_column("ref_epoch", pa.array(np.full(30, 2016.0)))
    pq.write_table(later, tmp_path / "a.parquet")
    table = as_astropy(stars, masked=False)
    table["ref_epoch"] = 2016.0
    table.write(tmp_path / "a.fits")
    write_votable(tmp_path / "a.vot", later)
    for name in ("a.parquet", "a.fits", "a.vot"):
        assert detect_form(tmp_path / name).name == "gaia_dr3"
        assert pa.concat_tables(read_tables(tmp_path / name)).equals(stars)


def test_fits_tables_behind_lists_of_any_length_are_found(tmp_path):
    """The heap that such columns keep behind their rows is passed over with them."""
    from astropy.io import fits

    stars = random_stars(20, 4)
    lists = np.empty(3, object)
    lists[:] = [np.arange(n, dtype=np.float64) for n in (700, 0, 1500)]
    heap = fits.BinTableHDU.from_columns([fits.Column("v", "PD()", array=lists)])
    table = fits.table_to_hdu(as_astropy(stars, masked=False))
    fits.HDUList([fits.PrimaryHDU(), heap, table]).writeto(tmp_path / "a.fits")
    found = read(tmp_path / "a.fits", replace(DR2, layout=Layout(hdu=2)))
    assert found["source_id"].to_pylist() == stars["source_id"].to_pylist()


def test_votable_integers_that_stand_for_none(tmp_path):
    """The number that a field says is null, of an id and of a magnitude in whole numbers."""
    null = '<FIELD name="{}" datatype="{}"><VALUES null="-99"/></FIELD>'
    fields = null.format("source_id", "long") + null.format("phot_g_mean_mag", "int")
    fields += "".join(f'<FIELD name="{n}" datatype="double"/>' for n in ("ra", "dec"))
    rows = "".join(
        f"<TR><TD>{i}</TD><TD>{g}</TD><TD>1</TD><TD>2</TD></TR>"
        for i, g in ((7, 9), (-99, 8), (6, -99))
    )
    (tmp_path / "a.xml").write_text(VOTABLE.format(fields=fields, rows=rows))
    found = read(tmp_path / "a.xml").to_pydict()
    assert found["source_id"] == [7, None, 6]
    assert found["phot_g_mean_mag"] == [9.0, 8.0, None]


BY_NAME = replace(DR2, source_id=IdRule("text", ("name",)))


def test_ids_from_names_are_the_same_in_every_kind_of_file(tmp_path):
    """A star without a name has no id, whether its name is absent or blank."""
    values = {"name": ["HD 7", "", "x & y"], "ra": [1.0, 2.0, 3.0], "dec": [1.0, 2.0, 3.0]}
    table = pa.table({**values, "phot_g_mean_mag": [9.0, 9.0, 9.0]})
    rows = list(zip(*table.to_pydict().values(), strict=True))
    lines = [",".join(table.column_names), *(",".join(map(str, row)) for row in rows)]
    (tmp_path / "a.csv").write_text("\n".join(lines))
    Table(table.to_pydict()).write(tmp_path / "a.fits")
    kinds = dict.fromkeys(table.column_names, "double") | {"name": 'char" arraysize="*'}
    fields = "".join(f'<FIELD name="{name}" datatype="{kind}"/>' for name, kind in kinds.items())
    cells = "".join("".join(f"<TD>{x}</TD>" for x in row).join(("<TR>", "</TR>")) for row in rows)
    xml = VOTABLE.format(fields=fields, rows=cells.replace("&", "&amp;"))
    (tmp_path / "a.vot").write_text(xml)
    pq.write_table(table, tmp_path / "a.parquet")
    with sqlite3.connect(tmp_path / "a.sqlite") as base:
        base.execute("create table stars (name, ra, dec, phot_g_mean_mag)")
        base.executemany("insert into stars values (?, ?, ?, ?)", rows)
    base.close()
    form = replace(BY_NAME, layout=Layout(query="select * from stars"))
    ends = ("csv", "fits", "vot", "parquet", "sqlite")
    found = [read(tmp_path / f"a.{end}", form) for end in ends]
    assert found[0]["source_id"].is_valid().to_pylist() == [True, False, True]
    assert all(other.equals(found[0]) for other in found)


def test_stars_without_a_designation_in_votables_have_no_id(tmp_path):
    kinds = dict.fromkeys(("ra", "dec", "phot_g_mean_mag"), "double")
    kinds["designation"] = 'char" arraysize="*'
    fields = "".join(f'<FIELD name="{name}" datatype="{kind}"/>' for name, kind in kinds.items())
    rows = (f"<TR><TD>1</TD><TD>2</TD><TD>9</TD><TD>{x}</TD></TR>" for x in ("Gaia DR2 7", ""))
    (tmp_path / "a.vot").write_text(VOTABLE.format(fields=fields, rows="".join(rows)))
    form = replace(DR2, source_id=IdRule("trailing_integer", ("designation",)))
    assert read(tmp_path / "a.vot", form)["source_id"].to_pylist() == [7, None]


def test_whole_numbers_of_sqlite_in_columns_of_numbers(tmp_path):
    """Also those that a double does not hold exactly."""
    with sqlite3.connect(tmp_path / "a.sqlite") as base:
        base.execute("create table stars (source_id, ra, dec, phot_g_mean_mag, parallax)")
        base.execute("insert into stars values (1, 2, 3, 9, ?)", [2**60 + 1])
    base.close()
    assert read(tmp_path / "a.sqlite", IN_SQL)["parallax"].to_pylist() == [float(2**60)]


def test_a_votable_that_the_service_cut_off_is_told(tmp_path):
    """As a TAP service ends an answer that reached its limit of rows (DALI 1.1, section 4.4.1)."""
    stars, told = random_stars(5), {}
    write_votable(tmp_path / "whole.vot", stars)
    text = (tmp_path / "whole.vot").read_text()
    for status in ("OVERFLOW", "OK"):
        info = f'<INFO name="QUERY_STATUS" value="{status}"/></RESOURCE>'
        (tmp_path / f"{status}.vot").write_text(text.replace("</RESOURCE>", f"<INFO/>{info}"))
    for name in ("whole", "OK", "OVERFLOW"):
        made = ingest([tmp_path / f"{name}.vot"], tmp_path / name, form="gaia_dr2")
        told[name] = [note for note in made.notes if "cut it off" in note]
        assert made.rows_in == 5
    assert told["whole"] == told["OK"] == []
    (said,) = told["OVERFLOW"]
    assert said.startswith("OVERFLOW.vot: the service")
    assert "stars are missing" in said
