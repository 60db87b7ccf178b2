"""Read Gaia DR2 `gaia_source` rows from CSV, gzipped CSV, FITS and VOTable.

The kind of a file is told from its first bytes, never from its name. Every reader yields tables
of the canonical columns (schema INCOMING); a column that the file doesn't have is null
throughout, and so is every empty, masked or NaN value.
"""

from __future__ import annotations

import gzip
import re
import warnings
import zlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as pacsv

from .columns import INCOMING, NAMES, REQUIRED
from .errors import BadInput, Damaged

REF_EPOCH_JYEAR = 2015.5
CSV_BLOCK_BYTES = 8 << 20
FITS_ROWS = 200_000
NULL_TEXTS = ["", "null", "NULL", "nan", "NaN"]
COMMENT = b"#"


def read_tables(path: Path, field: str = "source") -> Iterator[pa.Table]:
    """Rows of a DR2 file in order, in tables of bounded size.

    Raises BadInput naming file and column where the file is empty, of an unknown kind, or not of
    the DR2 schema; Damaged where it ends too early or can't be decoded.
    """
    kind = kind_of(path, field)
    if kind in ("csv", "csv.gz"):
        return _csv(path, field, zipped=kind == "csv.gz")
    return _fits(path, field) if kind == "fits" else _votable(path, field)


def kind_of(path: Path, field: str = "source") -> str:
    """`csv`, `csv.gz`, `fits` or `votable`, from the file's first bytes."""
    try:
        with path.open("rb") as file:
            head = file.read(512)
    except OSError as error:
        raise BadInput(field, str(path), f"a file that can be read ({error.strerror})") from None
    if zipped := head[:2] == b"\x1f\x8b":
        with _decompressing(path), gzip.open(path) as file:
            head = file.read(512)
    if not head.strip():
        _refuse(path, field, "is empty")
    if head.startswith(b"SIMPLE  ="):
        kind = "fits"
    elif b"<VOTABLE" in head.upper() or head.lstrip().startswith(b"<?xml"):
        kind = "votable"
    else:
        kind = "csv"
    if kind == "csv" and b"\0" in head:
        _refuse(path, field, "is of no known kind")
    if zipped and kind != "csv":
        _refuse(path, field, f"is a gzipped {kind} file: unpack it first")
    return f"{kind}.gz" if zipped else kind


@contextmanager
def _decompressing(path: Path) -> Iterator[None]:
    try:
        yield
    except (EOFError, gzip.BadGzipFile, zlib.error) as error:
        raise Damaged(str(path), f"cannot be decompressed ({error})") from None


def _refuse(path: Path, field: str, why: str) -> NoReturn:
    raise BadInput(
        field, str(path), f"a Gaia DR2 CSV, CSV.gz, FITS or VOTable file (this one {why})"
    )


def check_columns(path: Path, names: Iterable[str], field: str = "source") -> None:
    """Refuse a schema that is not DR2's: a required column missing, or one that came later."""
    names = set(names)
    if missing := [name for name in REQUIRED if name not in names]:
        allowed = f"a DR2 gaia_source file with column {missing[0]!r}"
        raise BadInput(f"{field} {path}", sorted(names), allowed)
    if "pm" in names:
        raise BadInput(f"{field} {path}", "pm", "DR2's columns (a column 'pm' is EDR3's or DR3's)")


def check_epoch(path: Path, epochs: Any, field: str = "source") -> None:
    """Refuse rows whose `ref_epoch` is not DR2's."""
    epochs = np.asarray(epochs, float)
    wrong = epochs[np.isfinite(epochs) & (epochs != REF_EPOCH_JYEAR)]
    if wrong.size:
        raise BadInput(
            f"{field} {path} ref_epoch", float(wrong[0]), "2015.5, the epoch of Gaia DR2"
        )


def _csv(path: Path, field: str, *, zipped: bool) -> Iterator[pa.Table]:
    header, skip = _csv_header(path, field, zipped)
    check_columns(path, header, field)
    wanted = [name for name in (*NAMES, "ref_epoch") if name in header]
    types = {name: pa.float64() if name == "ref_epoch" else _text_type(name) for name in wanted}
    try:
        # One thread a file: the files themselves are read in parallel.
        reader = pacsv.open_csv(
            pa.input_stream(str(path), compression="gzip" if zipped else None),
            read_options=pacsv.ReadOptions(
                use_threads=False, block_size=CSV_BLOCK_BYTES, skip_rows=skip
            ),
            convert_options=pacsv.ConvertOptions(
                include_columns=wanted,
                column_types=types,
                null_values=NULL_TEXTS,
                strings_can_be_null=True,
                quoted_strings_can_be_null=True,
            ),
        )
        for batch in reader:
            yield _canonical(path, pa.table(batch), field)
    except pa.ArrowInvalid as error:
        raise _csv_error(path, field, header, error) from None
    except OSError as error:
        raise Damaged(str(path), f"cannot be decompressed ({error})") from None


def _text_type(name: str) -> pa.DataType:
    """Numbers are parsed as double and rounded once, as DR2 publishes them; ids as integers."""
    kind = INCOMING.field(name).type
    return kind if pa.types.is_integer(kind) else pa.float64()


def _csv_header(path: Path, field: str, zipped: bool) -> tuple[list[str], int]:
    """Column names, and how many comment lines (ECSV) stand before them."""
    opener: Any = gzip.open if zipped else open
    skip = 0
    with _decompressing(path), opener(path, "rb") as file:
        while (line := file.readline(1 << 20)).startswith(COMMENT):
            skip += 1
    try:
        text = line.decode("utf-8-sig").strip()
    except UnicodeDecodeError:
        _refuse(path, field, "is of no known kind")
    return [name.strip().strip('"') for name in text.split(",")], skip


def _csv_error(path: Path, field: str, header: list[str], error: Exception) -> Exception:
    text = str(error)
    if "ecompress" in text or "zlib" in text:
        return Damaged(str(path), f"cannot be decompressed ({text})")
    if column := re.search(r"In CSV column #(\d+): (.*)", text, re.DOTALL):
        number = int(column.group(1))
        name = header[number] if number < len(header) else f"column {number}"
        return BadInput(
            f"{field} {path} {name}", column.group(2)[:200], "DR2's type of this column"
        )
    return BadInput(f"{field} {path}", text[:200], "a well-formed DR2 CSV file")


def _fits(path: Path, field: str) -> Iterator[pa.Table]:
    from astropy.io import fits

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            warnings.filterwarnings("error", message=".*truncated.*")  # no more than a warning
            with fits.open(path, memmap=False) as hdus:
                tables = [hdu for hdu in hdus if isinstance(hdu, fits.BinTableHDU)]
                if not tables:
                    _refuse(path, field, "holds no binary table")
                data, columns = tables[0].data, tables[0].columns
    except (OSError, ValueError, TypeError, Warning) as error:
        raise Damaged(str(path), f"cannot be read as FITS ({error})") from None
    names = {name.lower(): name for name in columns.names}
    check_columns(path, names, field)
    nulls = {name.lower(): columns[name].null for name in columns.names}
    wanted = [name for name in (*NAMES, "ref_epoch") if name in names]
    for start in range(0, max(len(data), 1), FITS_ROWS):
        arrays = {}
        for name in wanted:
            values = np.asarray(data[names[name]][start : start + FITS_ROWS])
            mask = values == nulls[name] if nulls[name] is not None else None
            arrays[name] = _native(path, field, name, values, mask)
        yield _canonical(path, pa.table(arrays), field)


def _votable(path: Path, field: str) -> Iterator[pa.Table]:
    from astropy.io.votable import parse_single_table

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the archive's units are not all VOUnits
            table = parse_single_table(str(path))
            data = table.array
    except Exception as error:  # the XML parser has many ways to fail
        raise Damaged(str(path), f"cannot be read as VOTable ({str(error)[:200]})") from None
    names = {(f.name or f.ID).lower(): f.ID for f in table.fields}
    check_columns(path, names, field)
    arrays = {}
    for name in (name for name in (*NAMES, "ref_epoch") if name in names):
        column = np.ma.asarray(data[names[name]])
        arrays[name] = _native(path, field, name, column.data, np.ma.getmaskarray(column))
    yield _canonical(path, pa.table(arrays), field)


def _native(
    path: Path, field: str, name: str, values: np.ndarray, mask: np.ndarray | None
) -> pa.Array:
    """A numpy column as Arrow, in this machine's byte order."""
    wanted = "iu" if name == "source_id" else "iuf"
    if values.dtype.kind not in wanted or values.ndim != 1:
        allowed = "integers" if name == "source_id" else "numbers"
        raise BadInput(f"{field} {path} {name}", str(values.dtype), allowed)
    return pa.array(np.ascontiguousarray(values, values.dtype.newbyteorder("=")), mask=mask)


def _canonical(path: Path, table: pa.Table, field: str) -> pa.Table:
    """The canonical columns of a table in which some may be missing; NaN becomes null."""
    if "ref_epoch" in table.column_names:
        check_epoch(path, table["ref_epoch"].fill_null(REF_EPOCH_JYEAR).to_numpy(), field)
    columns = []
    for wanted in INCOMING:
        if wanted.name not in table.column_names:
            columns.append(pa.nulls(table.num_rows, wanted.type))
            continue
        column = table[wanted.name].cast(wanted.type, safe=pa.types.is_integer(wanted.type))
        if pa.types.is_floating(wanted.type):
            column = pc.if_else(pc.is_nan(column), None, column)
        columns.append(column)
    return pa.table(columns, schema=INCOMING)
