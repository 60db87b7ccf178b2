"""What comes of files of stars: rows of every kind of file and form, catalogues, and refusals.

Cases are lines of text (indented ones go on): an expression, or `for x in THESE: EXPRESSION`. Its
value is told, or the error that it raises. Modules of catalog_tools stand under their own names.
"""

from __future__ import annotations

import gzip
import hashlib
import re
import sqlite3
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from astropy.io import fits
from astropy.table import Table

import catalog_tools
from catalog_tools.catalogue import REJECTS_NAME, SOURCES_NAME, Catalogue, open_catalogue
from catalog_tools.columns import INCOMING, NAMES, STORED
from catalog_tools.errors import BadInput
from catalog_tools.forms import Layout, load_form
from catalog_tools.geometry.healpix import pixels_of
from catalog_tools.info import info
from catalog_tools.ingest.ingest import ingest
from catalog_tools.query.query import read_leaf
from catalog_tools.readers import read_tables
from tests.pins.told import check_told

MOST = 9  # values of an array that are told one by one
# Bytes and digests of shards hang on the libraries that write them.
NOT_TOLD = {"path", "bytes", "bytes_per_row", "digest", "form_sha256", "footer_bytes", "offset"}
NOT_TOLD |= {"footer_crc32c", "crc32c", "column_bytes", "column_crc32c", "content", "hats_estsize"}
NOT_TOLD |= {"nightglass_digest", "hats_creation_date", "catalogue_digest", "bytes_read"}
ROOT = Path(catalog_tools.__file__).parent
PARTS = [
    ".".join(p.relative_to(ROOT).with_suffix("").parts) for p in sorted(ROOT.rglob("[!_]*.py"))
]
Names = dict[str, Any]


def show(value: Any) -> str:
    """A value as one line: numbers to 9 digits, long arrays by a few values and sums."""
    if isinstance(value, float | np.floating):
        return "0" if abs(value) < 1e-14 else f"{float(value):.9g}"
    if isinstance(value, pa.Table | pa.RecordBatch):
        numpy = value.num_rows > MOST
        arrays = ((name, value.column(name)) for name in value.schema.names)
        told = {n: a.to_numpy(zero_copy_only=False) if numpy else a.to_pylist() for n, a in arrays}
        return show({n: v for n, v in told.items() if any(x is not None and x == x for x in v)})
    if isinstance(value, np.ndarray | np.void) and value.dtype.names:
        return show({name: value[name] for name in value.dtype.names})
    if isinstance(value, np.ndarray):
        few = value.size <= MOST or value.dtype.kind not in "iufb"
        return show(value.tolist()) if few else _sums(value)
    if is_dataclass(value) and not isinstance(value, type):
        held = {f.name: getattr(value, f.name) for f in fields(value) if f.repr}
        plain = {f.name: f.default for f in fields(value)}
        some = {k: v for k, v in held.items() if isinstance(v, np.ndarray) or plain[k] != v}
        return type(value).__name__ + show(some)
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{k}: {show(v)}" for k, v in value.items() if _is_told(k)) + "}"
    if hasattr(value, "_asdict"):
        return type(value).__name__ + show(value._asdict())
    if isinstance(value, list | tuple | set | frozenset):
        return "[" + ", ".join(map(show, sorted(value) if isinstance(value, set) else value)) + "]"
    return str(value)


def _is_told(key: Any) -> bool:
    return not (isinstance(key, str) and key in NOT_TOLD)


def _sums(array: np.ndarray) -> str:
    flat = array.ravel()
    here = np.isfinite(flat)
    good, weights = flat[here].astype(float), (1 + np.arange(flat.size) % 7)[here]
    told = [len(array), *flat[:2], *flat[-1:], good.sum(), good @ weights]
    return f"array{show([*told, *([good.min(), good.max()] if good.size else [])])}"


def tell(name: str, cases: str, names: Names, **places: str | Path) -> None:
    """Hold what each case gives, or the error that it raises, against a stored text."""
    modules: Names = {}  # by name, and by room_name where two rooms have the same
    for part in sorted(PARTS, key=lambda part: (part.count("."), part)):
        room, _, last = part.rpartition(".")
        modules.setdefault(last, import_module(f"catalog_tools.{part}"))
        modules.setdefault(f"{room}_{last}", import_module(f"catalog_tools.{part}"))
    known = modules | {"np": np, "pa": pa, "replace": replace, "Path": Path} | names
    lines: list[str] = []
    for line in cases.strip().replace("\n  ", " ").splitlines():
        for label, text, own in _each(line, known):
            try:
                found = eval(text, known | own)
            except BadInput as error:  # its own words cut long paths
                found = f"BadInput: {error.field} | {error.value!r} | {error.allowed}"
            except Exception as error:
                found = f"{type(error).__name__}: {error}"
            many = isinstance(found, list) and found and all(isinstance(x, str) for x in found)
            lines += [f"{label}: {found[0] if many else show(found)}"]
            lines += [f"  {one}" for one in (found[1:] if many else ())]
    check_told(f"catalog/{name}", "\n".join(lines), **places)


def _each(line: str, known: Names) -> Iterator[tuple[str, str, Names]]:
    loop = re.fullmatch(r"for (\w+) in (.+?): (.+)", line)
    for value in eval(loop[2], known) if loop else [None]:
        own = {loop[1]: value} if loop else {}
        label = (
            f"{loop[3].partition('(')[0]} {' '.join(show(value)[:70].split())}" if loop else line
        )
        yield label, loop[3] if loop else line, own


def stars(n: int, seed: int = 1, spread_deg: float = 360.0) -> pa.Table:
    """Rows of DR2's form, some values absent; their ids are not Gaia's."""
    u = np.random.default_rng(seed).random((10, n))
    blank = np.where(u[9] < 0.1, np.nan, 0.0)
    columns = [1_000_003 * (1 + np.argsort(u[0])), (spread_deg * u[1] + 359.0) % 360.0]
    columns += [spread_deg / 360.0 * (180.0 * u[2] - 90.0), 200.0 * u[3] - 100.0 + blank]
    columns += [60.0 * u[4], 50.0 * u[5] - 1.0 + blank]
    columns += [np.where(u[6] < 0.5, 300.0 * u[6] - 50.0, np.nan), 3.0 + 18.0 * u[7] ** 0.5]
    columns += [np.where(u[8] < 0.8, 4.0 + 17.0 * u[8], np.nan), 2.0 + 18.0 * u[9] + blank]
    arrays = [pa.array(c, from_pandas=True) for c in columns]
    arrays = [a.cast(kind) for a, kind in zip(arrays, INCOMING.types, strict=True)]
    return pa.table(arrays, schema=INCOMING)


def write_csv(path: str | Path, rows: pa.Table) -> str:
    table = rows.to_pydict()
    lines = [
        ",".join("" if x is None else repr(x) for x in row)
        for row in zip(*table.values(), strict=True)
    ]
    data = "\n".join([",".join(table), *lines, ""]).encode()
    Path(path).write_bytes(gzip.compress(data, mtime=0) if str(path).endswith(".gz") else data)
    return str(path)


def write_kinds(rows: pa.Table) -> list[str]:
    """The rows as every kind of file, each also packed and cut short."""
    arrays = {n: rows[n].combine_chunks() for n in rows.schema.names}
    bare = Table({n: a.to_numpy(zero_copy_only=False) for n, a in arrays.items()})
    masked = Table(bare, masked=True)
    for name, array in arrays.items():
        masked[name].mask = array.is_null().to_numpy(zero_copy_only=False)
    bare.write("a.fits")
    for kind in ("binary", "binary2"):
        masked.write(f"a.{kind}", format="votable", tabledata_format=kind)
    pq.write_table(rows, "a.parquet", row_group_size=5)
    with sqlite3.connect("a.sqlite") as base:
        base.execute(f"create table stars ({','.join(arrays)})")
        marks = ",".join("?" * len(arrays))
        values = zip(*rows.to_pydict().values(), strict=True)
        base.executemany(f"insert into stars values ({marks})", values)
    base.close()
    write_csv("a.csv", rows)
    for path in [*Path().glob("a.*")]:
        Path(f"{path}.gz").write_bytes(gzip.compress(path.read_bytes(), mtime=0))
    for path in [*Path().glob("a.[cfp]*")]:
        Path(f"cut{path.name[1:]}").write_bytes(path.read_bytes()[:-90])
    return sorted(map(str, Path().glob("*.*")))


def read(path: str | Path, form: Any = None, **options: Any) -> pa.Table:
    return pa.concat_tables([INCOMING.empty_table(), *read_tables(path, form, **options)])


def with_text(content: str | bytes, form: Any = None) -> pa.Table:
    Path("a.csv").write_bytes(content.encode() if isinstance(content, str) else content)
    return read("a.csv", form)


def laid(**layout: Any) -> Any:
    return replace(load_form("gaia_dr2"), layout=Layout(**layout))


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty working folder: messages then hold short paths."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


KINDS = """
read("a.csv")
for x in files: kinds.kind_of(x, "file")
for x in files: detect.detect_form(x, most_bytes=10**6).name
for x in files: whole_file(x)
for x in files: read(x, SQL, most_bytes=1000).num_rows
for x in [".", "none"]: read(x, DR2)
for x in ["select * from moons", "delete from stars", "select 1; select 2"]: read(S, laid(query=x))
for x in ["ra, dec from stars", "ra, dec, 1.5 phot_g_mean_mag from stars"]: asked("source_id," + x)
for x in ["dec source_id, ra, dec, 5 phot_g_mean_mag from o.stars limit 2"]: asked(x)
for x in ["a.sqlite", "none.sqlite"]: read(S, laid(query=OTHER, attach=(("o", x),)))
for x in ["7", "'a'", "null"]: asked(f"5 source_id, {x} ra, 2 dec, 5 phot_g_mean_mag")
for x in ["string", "float32", "decimal128(22, 2)", "int8"]: typed(x)
in_pieces()
"""


def test_rows_of_every_kind_of_file(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rows, sql = stars(9), laid(query="select * from stars")

    def whole_file(path: str) -> Any:
        md5, data = hashlib.md5(), Path(path).read_bytes()
        found = read(path, sql, md5=md5)
        return "same" if found.equals(rows) else found, md5.digest() == hashlib.md5(data).digest()

    def in_pieces() -> list[int]:
        monkeypatch.setattr("catalog_tools.readers.bytes_in.PACKED_BYTES", 100)
        monkeypatch.setattr("catalog_tools.readers.bytes_in.MOST_BYTES", 150)
        monkeypatch.setattr("catalog_tools.readers.text.TABLE_ROWS", 4)
        monkeypatch.setattr("catalog_tools.readers.bytes_in.PLAIN_BYTES", 700)
        monkeypatch.setattr("catalog_tools.readers.fits.PIECE_BYTES", 200)
        tables = [list(read_tables(f"a.{kind}", sql)) for kind in ("csv.gz", "fits", "fits.gz")]
        assert all(pa.concat_tables(parts).equals(rows) for parts in tables)
        return [len(parts) for parts in tables]

    def typed(kind: str) -> pa.Table:
        made = pa.decimal128(22, 2) if "(" in kind else pa.type_for_alias(kind)
        table = {name: pa.array([1, 2, None]) for name in ("source_id", "dec", "phot_g_mean_mag")}
        pq.write_table(pa.table(table | {"ra": pa.array([3, 4, 5]).cast(made)}), "t.parquet")
        return read("t.parquet")

    def asked(what: str) -> pa.Table:
        return read("a.sqlite", laid(query="select " + what))

    other = "select source_id, ra, dec, phot_g_mean_mag from o.stars limit 2"
    files = [name for name in write_kinds(rows) if "cut.p" not in name and "cut.s" not in name]
    own = {"SQL": sql, "DR2": laid(), "S": "a.sqlite", "OTHER": other}
    tell("kinds", KINDS, globals() | locals() | own, folder=here)


HEAD = "source_id,ra,dec,phot_g_mean_mag"
# Contents of files: ~ ends a line, @ is HEAD.
TEXTS = r"""
|~ ~|@|# a~# b~|ra,dec,phot_g_mean_mag~1,2,3~|source_id,ra,dec~1,2,3~|@,ra~1,2,3,4,5~
Source_ID,RA,Dec,PHOT_G_MEAN_MAG~1,2,3,4~|source_id,RA,Ra,dec,phot_g_mean_mag~1,2,3,4,5~
@~1,2,3,4~1.5,2,3,4~|@~1,2,3,4~1,2,3,4~1,two,3,4~|@~1,2,3,4~1,2,3~|@~1,2,3,4~~1,2,3,4,5~
@,x~1,2,3,4,"b~|@~99999999999999999999,2,3,4~|@~1,nan,3,4~,,NaN,null~|@,x~1,2,3,4,"a,b"~5,6,7,8,~
@,ref_epoch~1,2,3,4,2000~|@,ref_epoch~1,2,3,4,2015.5~5,6,7,8,2016.0~|@,pm,teff_val~1,2,3,4,5,6~
@,pm,ref_epoch~1,2,3,4,5,2016~|@,pm,ref_epoch~1,2,3,4,5,2015.5~|@,designation~1,2,3,4,Gaia EDR3 4~
@,designation,ref_epoch~1,2,3,4,Gaia DR3 5,2015.5~|name,@,f~"b, c",2,11.0,4.0,"13.0","a ""x"" b"~
# %ECSV 1.0~# delimiter: ','~@~1,2,3,4~|@,bp_rp,g_rp~1,2,3,10,1.5,0.6~2,2,3,11,,0.7~
@,bp_g,bp_rp~1,2,3,10,0.9,1.5~|@,bp_g,g_rp~1,2,3,10,0.9,0.6~|@,bp_rp~1,2,3,10,1.5~2,2,3,10,-0.2~
@,phot_bp_mean_mag,bp_rp~1,2,3,10,11.0,1.5~|@,phot_rp_mean_mag,bp_rp~1,2,3,10,9.5,1.5~
@,radial_velocity,pmra~1,2,3,4,7,null~|@,dr2_radial_velocity,ref_epoch~1,2,3,4,7,2016.0~
"""
BYTES = [
    *(b"\0\1\2\3", HEAD.encode("utf-16"), gzip.compress(b""), gzip.compress(b"PAR1")),
    *(b"\x1f\x8b\x09\x00" + b"x" * 40, gzip.compress(f"{HEAD}\n1,2,3,4\n".encode()) + b"trail"),
    gzip.compress(f"{HEAD}\n1,2,".encode()) + bytes(5) + gzip.compress(b"3,4\n") + b"\0",
    *(b"\xef\xbb\xbf# c\r\n\n" + HEAD.encode() + b"\r\n1,2,3,4\n5,6,7,8\r\n", b"ra,\xe9\n"),
    *(HEAD.encode() + b"\r1,2,3,4\r", HEAD.encode() + b",x\n1,2,3,4,a\rb", b"<?xml version=''?>"),
    *(b"# %ECSV 1.0\nsource_id ra dec phot_g_mean_mag\n1 2.5 '' 4\n", b"1" * 1_400_000),
]
ODD_TEXTS = """
for x in TEXTS: with_text(x.replace("@", HEAD).replace("~", chr(10)))
for x in range(len(BYTES)): with_text(BYTES[x])
for x in ["image.fits", "text.fits", "text.vot", "list.fits", "list.vot"]: read(x, laid())
for x in [1.0, 2.0**60, 1.5]: read(ids_of(x), laid())
for x in [None, 1, 2, 7]: read("odd.fits", laid(hdu=x))
read("odd.fits", replace(laid(), source_id=form.IdRule("trailing_integer", ("designation",))))
"""


def test_rows_of_odd_files(here: Path) -> None:
    def ids_of(value: float) -> str:
        named = dict(zip(HEAD.split(","), ([value], [1.0], [2], [5.0]), strict=True))
        Table(named).write("ids.fits", overwrite=True)
        return "ids.fits"

    n = np.arange(4)
    columns = [
        fits.Column("flags", "11X", array=np.zeros((4, 11), bool)),
        fits.Column("source_id", "K", bzero=2**63, array=n.astype(np.uint64) + 2**60),
        fits.Column("ra", "I", array=n.astype(np.int16) * 50),
        fits.Column("image", "6E", dim="(2,3)", array=np.ones((4, 3, 2))),
        fits.Column("dec", "E", array=np.float32([1.1, np.nan, 3.3, 4.4])),
        fits.Column("phot_g_mean_mag", "J", null=-99, array=np.array([9, -99, 11, 12])),
        fits.Column("pmra", "J", bzero=2**31, array=n.astype(np.uint32) + 7),
        fits.Column("designation", "12A", array=[f"Gaia DR2 {i}" for i in n]),
        fits.Column("list", "PJ()", array=np.array([np.arange(i) for i in n], object)),
    ]
    odd = fits.BinTableHDU.from_columns(columns)
    odd.header["TSCAL3"], odd.header["TZERO3"] = 0.01, 100.0
    parts = [fits.PrimaryHDU(np.ones((40, 50))), fits.ImageHDU(np.ones(3)), odd]
    fits.HDUList(parts).writeto("odd.fits")
    fits.HDUList(parts[:2]).writeto("image.fits")
    for name, ra in (("text", ["a", "b"]), ("list", [1, 2])):
        table = Table(dict(zip(HEAD.split(","), ([1, 2], ra, [1, 2], [[1.0], [3.0]]), strict=True)))
        table.write(f"{name}.fits")
        table.write(f"{name}.vot", format="votable", tabledata_format="binary2")
    texts = TEXTS.strip().replace("\n", "|").split("|")
    tell("odd", ODD_TEXTS, globals() | locals() | {"TEXTS": texts}, folder=here)


# A column map; below, what is put in place of one of its keys, or added: cases end with `;`.
MAP = """name = "m"; description = "d."; credit = "c"; ref_epoch_jyear = 2010.0; epoch_scale = "TT"
source_id = {from = "id"}; ra = {from = "ra", unit = "rad"}; dec = {from = "de", unit = "rad"}
phot_g_mean_mag = {from = "g", unit = "mag"}"""
ROWS = "id,ra,de,g,x,y,t,e\n17,1.5,-0.7,10,2,0.5,A12,55197\n18,3.1,0.2,-99,0,3,B7,55197.1\n"
MAPS = """
ra = {from = ["no", "ra"], unit = "hourangle"}; ra = {from = "ra", unit = "arcmin"}; ra = 3
dec = {from = "de", unit = "arcsec", factor = -2.0, add = 1.0}; dec = {from = "de", unit = "mas"}
ra = {from = "ra", unit = "uas"}; pmra = {from = "x", unit = "arcsec/yr", is = "mu_alpha"}
pmra = {from = "x", unit = "mas/yr", is = "mu_alpha_star"}; ra = {from = "ra"}; what = 1
pmdec = {from = "x", unit = "deg/yr", positive = ["y", "x"]}; name = ""; epoch_scale = "UTC"
parallax = {from = "x", unit = "arcsec", null = [2]}; ref_epoch_jyear = 1700; name = "a" "b"
radial_velocity = {from = "x", unit = "m/s", optional = true}; ref_epoch_jyear = "x"; epoch = 3
radial_velocity = {from = "z", unit = "km/s", optional = true}; ra = [1]; phot_g_mean_mag = 7
phot_g_mean_mag = {from = "g", unit = "mag", null = [-99, -1]}; phot_g_mean_mag = []; foreign = "x"
phot_bp_mean_mag = {from = "x", unit = "Jy"}; phot_bp_mean_mag = {from = "x", unit = "nJy"}
phot_rp_mean_mag = {from = "x", unit = "flux", add = 25.0}; epoch = {from = "e", unit = "s"}
phot_rp_mean_mag = {from = "g", unit = "mag", colour = ["x", "y"], coefficients = [1, 2, 3]}
phot_rp_mean_mag = {from="g", unit="mag", colour="y", coefficients=[0, 1], colour_range=[0, 1]}
phot_rp_mean_mag = {from="g",unit="mag",colour="y",coefficients=[0,1],colour_range=[0,1],clip=true}
phot_rp_mean_mag = [{from = "x", unit = "mag", null = [2]}, {from = "g", unit = "mag"}]
phot_rp_mean_mag = [{from="z",unit="mag",optional=true}, {from="g", unit="mag", fallback=true}]
source_id = {rule = "position"}; source_id = {rule = "text", from = "t"}; source_id = {from = "t"}
source_id = {rule = "trailing_integer", from = "t", factor = -1}; source_id = {rule = "integer"}
source_id = {rule = "trailing_integer", from = "id"}; source_id = {from = "y", holds_place = true}
source_id = {from = "id", factor = 2}; source_id = {from = "id", holds_place = 1}
epoch = {from = "e", unit = "mjd"}; epoch = {from = "e", unit = "jd"}; epoch = {from = "no"}
table = {layout = "whitespace"}; table = {delimiter = "|", null = ["-99"], comments = []}
table = {columns = ["id", "ra", "de", "g", "x", "y", "t", "e"], comments = ["id"]}
table = {layout="fixed", comments=["id"], columns={id=[1, 2], ra=[4, 6], de=[8, 11], g=[13, 15]}}
table = {layout = "fixed", columns = {}}; table = {layout = "fixed", columns = {id = [0, 2]}}
table = {layout = "x"}; table = {delimiter = "||"}; table = {hdu = 0}; table = {attach = {a = 1}}
ra = {from = [], unit = "deg"}; ra = {from = "ra", unit = "km"}; ra = {from = 3, unit = "deg"}
ra = {from = "ra", unit = "deg", factor = inf}; dec = {from = "de", unit = "deg", z = 1}
pmra = {from = "x", unit = "mas/yr"}; ra = {from = "ra", unit = "deg", null = "x"}
phot_g_mean_mag = {from = "g", unit = "mag", colour = "x"}; ra = {from = "t", unit = "deg"}
phot_g_mean_mag = {from = "g", unit = "mag", clip = true}; dec = {from = "q", unit = "deg"}
phot_g_mean_mag = {from = "g", unit = "mag", colour_range = [2, 1]}
"""
FORMS = """
for x in ["", *MAPS]: with_map(x)
for x in ["none", ".", Path("big.toml")]: load.load_form(x)
for x in load.known_forms(): [show(replace(of(x), sources=())), *map(show, of(x).sources)]
for x in ["0.62", "3.10", "", None, "cut"]: with_text(hipparcos(x), of("hipparcos"))
for x in ["2015.5,1,2,3,4,5,,7,8,9", "1980,1,2,3,4,5,6,,8,9", "2016,1,2,3,4,5,6,7,8,9"]: gsc(x)
"""


def with_map(line: str) -> Any:
    """The ways to a column by a changed map, and the rows of a table that it gives."""
    key, kept = line.partition(" = ")[0], MAP.replace("; ", "\n").splitlines()
    lines = [old for old in kept if old.partition(" = ")[0] != key]
    Path("map.toml").write_text("\n".join([*lines, line]))
    form = load_form("map.toml")
    delimiter = {"whitespace": " "}.get(form.layout.text, form.layout.delimiter)
    return *form.of(key), with_text(ROWS.replace(",", delimiter), form)


def hipparcos(v_minus_i: str | None) -> str:
    """A row of hip_main.dat; without B-V for None, cut within a column for `cut`."""
    place = f"{'':8}  4711{'':27} 8.20{'':5}123.12345678 -45.87654321"
    colour = " " * 6 if v_minus_i is None else "  0.55"
    line = f"{place}{'':3}  12.50   -30.25    14.75{'':141}{colour}{'':9}{v_minus_i or '':4}"
    return line[: 53 if v_minus_i == "cut" else 270] + "\n"


def test_forms_and_column_maps(here: Path) -> None:
    def gsc(row: str) -> pa.Table:
        names = "objID,epoch,ra,dec,rapm,decpm,parallax,radialVelocity,gaiaGmag,gaiaBpmag,gaiaRpmag"
        return with_text(f"Objects found: 1\n{names}\n7,{row}\n", load_form("gsc"))

    Path("big.toml").write_text("#" * (2 << 20))
    maps = MAPS.strip().replace("\n", "; ").split("; ")
    names = globals() | locals() | {"MAPS": maps, "of": load_form}
    tell("forms", FORMS, names, folder=here)


def whole(made: Catalogue, values: bool = True) -> list[str]:
    """What a catalogue's files say, but for bytes and digests."""
    root = Path(made.path)
    lines = [show({"info": info(made), "coverage": made.coverage})]
    digests = [hashlib.md5(p.read_bytes()).hexdigest() for p in Path().rglob("*.csv*")]
    hats = (line.split("=", 1) for line in (root / "hats.properties").read_text().splitlines()[1:])
    lines.append(show(dict(hats)) + (root / "partition_info.csv").read_text().replace("\n", ";"))
    for name in (SOURCES_NAME, REJECTS_NAME):
        if (root / name).is_file():
            rows = pq.read_table(root / name).to_pylist()
            lines += [show(r | {"md5": r.get("md5") in digests, "bytes": 0}) for r in rows]
    with fits.open(root / "skymap.fits") as hdus:
        rows = np.ravel(hdus[1].data["T"])
        told = {k: v for k, v in hdus[1].header.items() if k != "COMMENT"}
        lines.append(show([told, np.flatnonzero(rows), rows[rows > 0]]))
    lines += [show(made.leaf_table), show(made.row_group_table)]
    lines += [str(p.relative_to(root)) for p in sorted(root.rglob("*.*")) if values]
    for leaf in made.leaves[:1] if values else ():
        lines += [f"{leaf.path} {show(read_leaf(made, leaf, columns=STORED.names))}"]
        group = pq.read_metadata(root / leaf.path).row_group(0)
        for c in (group.column(k) for k in range(group.num_columns)):
            s = c.statistics
            ends = (s.min, s.max, s.null_count) if s and s.has_min_max else ()
            lines.append(show([c.path_in_schema, c.num_values, c.compression, c.encodings, ends]))
    return lines


def gaia(column: str = "", change: Any = None, swap: bool = False) -> pa.Table:
    """Rows whose ids are those of their places, as Gaia's; then with another column or two."""
    rows = stars(40, 3)
    ra, dec = rows["ra"].to_numpy(), rows["dec"].to_numpy()
    rows = rows.set_column(0, INCOMING.field(0), pa.array((pixels_of(12, ra, dec) << 35) + 128))
    table = rows.to_pydict()
    for name in column.split():
        table[name] = change(rows[name].to_numpy())
    return pa.table({n: table[{"ra": "dec", "dec": "ra"}.get(n, n) if swap else n] for n in table})


def awkward() -> pa.Table:
    """Every reason against a row, ids that are repeated, and values at the limits."""
    table = {name: column[:24] for name, column in stars(60, 5).to_pydict().items()}
    nan, inf = float("nan"), float("inf")
    odd = [("source_id", None), ("ra", None), ("ra", inf), ("ra", 360.1), ("ra", -0.1)]
    odd += [("dec", 90.5), ("dec", nan), ("phot_g_mean_mag", nan), ("phot_g_mean_mag", 61.0)]
    odd += [("ra", 360.0), ("dec", 90.0), ("dec", -90.0), ("pmra", 2e5), ("parallax", 1e4)]
    for i, (name, value) in enumerate([*odd, ("phot_bp_mean_mag", -61.0), ("pmdec", inf)]):
        table[name][i] = value
    for i, other, shift in ((17, 16, 0.0), (18, 16, 1.0), (19, 16, 1e-5), (21, 20, 0.0)):
        for name in NAMES:
            table[name][i] = table[name][other]
        table["ra"][i] += shift
        table["parallax"][i] = None if i == 21 else 3.0
    return pa.table(table, schema=INCOMING)


INGESTED = """
for x in ["many", "awkward.csv", "gaia.csv", "moved.csv"]: made(x)
for x in ["radians.csv", "swapped.csv", "none.csv", "empty", "absent", "map.toml"]: made(x)
made("gaia.csv", "none.csv", name="n", form="gaia_dr3", rows_per_leaf=1000)[:3]
made("close.csv", rows_per_leaf=9)[:5]
made("plain.csv")[-2:]
cut_off(7), cut_off(8)
[*map(show, heard)]
made("gaia.csv", "twin.csv")
made("none.csv", "void.csv")
made()
made("gaia.csv", workers=0)
made("gaia.csv", rows_per_leaf=0)
made("gaia.csv", memory_bytes=1)
made("gaia.csv", overwrite=False)
made("gaia.csv", to="many")
made("gaia.csv", to="gaia.csv/made")
for x in ["many", "nowhere", "gaia.csv", "hats"]: catalogue.open_catalogue(x, field="stars")
for x in range(3): changed(x)
sorted(p.name for p in Path().iterdir())
"""


def test_catalogues_of_files(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("catalog_tools.ingest.shards.MIN_BAND_ROWS", 20)
    monkeypatch.setattr("catalog_tools.ingest.shards.MAX_ROW_GROUP_ROWS", 30)
    for folder in ("many/below", "empty", "hats"):
        (here / folder).mkdir(parents=True)
    write_csv("many/a.csv.gz", stars(90, 4))
    write_csv("many/d.csv", stars(3, 6))
    data = Path(write_csv("many/b.csv", stars(150, 2))).read_bytes()
    digest = hashlib.md5(data).hexdigest()
    Path("many/MD5SUM.txt").write_text(f"{digest}  b.csv\n{'0' * 32}  c.csv\n")
    Path("hats/properties").write_text("x")
    tables = {"gaia": gaia(), "twin": gaia(), "radians": gaia("ra dec", np.radians)}
    tables |= {"swapped": gaia(swap=True), "none": gaia().slice(0, 0), "awkward": awkward()}
    tables |= {"moved": gaia("dec", lambda dec: np.where(dec > 60, 0.0, dec))}
    for name, table in (tables | {"close": stars(60, 8, 0.002)}).items():
        write_csv(f"{name}.csv", table)
    Path("map.toml").write_text(MAP)
    Path("void.csv").write_text(HEAD)
    Path("plain.csv").write_text(f"{HEAD}\n1,2,3,4\n2,200,-30,14.5\n")
    heard = list[Any]()

    def made(*names: str, to: str = "made", **options: Any) -> Any:
        told = {"progress": lambda *call: heard.append(call)} if "name" in options else {}
        options = {"rows_per_leaf": 60, "workers": 1, "overwrite": True} | told | options
        report = ingest(names, to, **options)
        told = whole(report.catalogue, names[0] == "gaia.csv")
        return [show([report.notes, report.continued]), *told]

    def cut_off(rows_per_leaf: int) -> Any:
        """An ingest that ends while it writes; then one that goes on, or is of another request."""

        def stop(stage: str, done: int, _: int) -> None:
            if stage == "write" and done > 1 and rows_per_leaf == 7:
                raise OSError(28, "no room")

        try:
            report = ingest(["close.csv"], "later", rows_per_leaf=rows_per_leaf, progress=stop)
        except Exception as error:
            return f"{type(error).__name__}: {error.args}"
        return report.continued

    def changed(which: int) -> Any:
        path = Path("made", ("nightglass/leaves.npy", "nightglass.json", "nightglass.json")[which])
        data = path.read_bytes().replace(b"rows_in", b"rows_on")
        path.write_bytes(data[:-1] if which != 1 else data)
        return open_catalogue("made")

    tell("ingested", INGESTED, globals() | locals(), folder=here)
