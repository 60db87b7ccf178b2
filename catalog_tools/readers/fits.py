"""FITS binary tables, read as a stream: a few thousand rows at a time, also from gzipped files."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa
from astropy.io.fits import Header

from ..documents import JsonObject
from ..errors import BadInput, Damaged
from ..forms import Layout
from .bytes_in import bytes_of
from .kinds import Choose, choose_once

BLOCK_BYTES = 2880
PIECE_BYTES = 4 << 20
CARD_BYTES = 80
MOST_HEADER_BLOCKS = 1000
MOST_AXES = 999
STANDARD = "FITS headers to the standard"
# FITS standard 4.0, table 18: format and bytes of one element
TYPES = {
    "L": "i1",
    "X": "u1",
    "B": "u1",
    "I": ">i2",
    "J": ">i4",
    "K": ">i8",
    "A": "S1",
    "E": ">f4",
    "D": ">f8",
    "C": ">c8",
    "M": ">c16",
    "P": ">i8",
    "Q": ">c16",
}
# what is asked of a column: kinds of numpy that have it, and the word for it
WANTED = {"integer": ("iuf", "integers"), "number": ("iuf", "numbers"), "text": ("S", "texts")}


class Column(NamedTuple):
    """Where a column lies in a row, how its stored numbers become values, and their unit."""

    name: str
    dtype: str
    repeat: int
    null: int | None
    scale: float
    zero: float
    unit: str


def read_fits(
    path: Path, where: str, layout: Layout, choose: Choose, *, zipped: bool, md5: object = None
) -> Iterator[pa.Table]:
    """Tables of the chosen columns of a binary table: the first, or that of `layout.hdu`.

    Raises BadInput where there is no such table or a column is of another type, and Damaged where
    the file ends too early.
    """
    stream = _Stream(path, bytes_of(path, zipped=zipped, md5=md5))
    header = _find_table(stream, where, layout.hdu)
    columns, width, rows = _described(header, where)
    chosen = choose_once(choose, *_named(columns), where)
    used = sum(np.dtype(c.dtype).itemsize * c.repeat for c in columns)
    if used != width:
        raise Damaged(str(path), f"its columns are {used} bytes, its rows {width}")
    dtype = np.dtype([(f"f{i}", c.dtype, (c.repeat,)) for i, c in enumerate(columns)])
    at_once = max(1, PIECE_BYTES // max(width, 1))
    wanted = [(i, c) for i, c in enumerate(columns) if c.name in chosen]
    for first in range(0, max(rows, 1), at_once):
        count = min(at_once, rows - first)
        data = np.frombuffer(stream.read(count * width), dtype)
        arrays = {c.name: _values(data[f"f{i}"], c, chosen[c.name], where) for i, c in wanted}
        yield pa.table(arrays)
    stream.drain()


def _named(columns: list[Column]) -> tuple[list[str], dict[str, str]]:
    """Names of columns, and the units that they are declared in."""
    return [c.name for c in columns], {c.name: c.unit for c in columns}


class _Stream:
    """Exactly as many bytes as asked for, from pieces of any size."""

    def __init__(self, path: Path, pieces: Iterator[bytes]) -> None:
        self._path, self._pieces, self._rest = path, pieces, b""

    def read(self, size: int, *, or_end: bool = False) -> bytes:
        parts, missing = [self._rest[:size]], size - len(self._rest)
        self._rest = self._rest[size:]
        while missing > 0:
            piece = next(self._pieces, None)
            if piece is None:
                if or_end:
                    return b"".join(parts)
                raise Damaged(str(self._path), f"it ends {missing} bytes too early")
            parts.append(piece[:missing])
            self._rest = piece[missing:]
            missing -= len(piece)
        return b"".join(parts)

    def skip(self, size: int) -> None:
        while size > 0:
            size -= len(self.read(min(size, PIECE_BYTES)))

    def drain(self) -> None:
        self._rest = b""
        for _ in self._pieces:
            pass


def _find_table(stream: _Stream, where: str, hdu: int | None) -> JsonObject:
    number = 0
    while (header := _read_header(stream, where)) is not None:
        is_table = header.get("XTENSION") == "BINTABLE"
        if (hdu is None and is_table) or (hdu == number and number > 0):
            if not is_table or header.get("ZTABLE"):
                kind = "compressed" if is_table else header.get("XTENSION")
                raise BadInput(where, f"extension {number}: {kind}", "a binary table (BINTABLE)")
            return header
        stream.skip(_data_bytes(header))
        number += 1
    allowed = "a FITS file with a binary table" + (f" in extension {hdu}" if hdu else "")
    raise BadInput(where, f"{number} parts", f"{allowed} (this one holds no binary table)")


def _read_header(stream: _Stream, where: str) -> JsonObject | None:
    """Keywords of the next header; None at the end of the file, or where only padding follows."""
    blocks: list[bytes] = []
    while len(blocks) < MOST_HEADER_BLOCKS:
        block = stream.read(BLOCK_BYTES, or_end=not blocks)
        if not blocks and (len(block) < BLOCK_BYTES or not block.strip(b"\0 ")):
            return None
        blocks.append(block)
        cards = (block[i : i + CARD_BYTES] for i in range(0, BLOCK_BYTES, CARD_BYTES))
        if any(card.rstrip() == b"END" for card in cards):
            return _keywords(b"".join(blocks), where)
    raise BadInput(where, f"{len(blocks)} blocks", "a FITS header that has an END")


def _keywords(header: bytes, where: str) -> JsonObject:
    """Values by keyword. BadInput for what is no header, and for an axis of negative length."""
    try:
        cards = Header.fromstring(header.decode("ascii")).cards
        values = {card.keyword: card.value for card in cards if card.keyword}
        count = int(values.get("NAXIS", 0))
        if not 0 <= count <= MOST_AXES:
            raise ValueError(f"NAXIS = {count}")
        axes = [f"NAXIS{i + 1}" for i in range(count)]
        lengths = {name: int(values[name]) for name in axes}
        _data_bytes(values)
    except Exception as error:  # astropy's parser has many ways to fail
        raise BadInput(where, str(error)[:80], STANDARD) from None
    for name, length in lengths.items():
        if length < 0:
            raise BadInput(where, f"{name} = {length}", "axes of no negative length")
    return values


def _data_bytes(header: JsonObject) -> int:
    """Bytes of the data part with its padding (FITS standard 4.0, equations 1 and 2)."""
    naxis = int(header.get("NAXIS", 0))
    if not naxis:
        return 0
    sizes = [int(header[f"NAXIS{i + 1}"]) for i in range(naxis)]
    if sizes[0] == 0 and header.get("GROUPS"):
        sizes = sizes[1:]
    elements = int(header.get("PCOUNT", 0)) + int(np.prod(sizes, dtype=object))
    size = abs(int(header["BITPIX"])) // 8 * int(header.get("GCOUNT", 1)) * elements
    return -(-size // BLOCK_BYTES) * BLOCK_BYTES


def _described(header: JsonObject, where: str) -> tuple[list[Column], int, int]:
    """The columns of a table, the bytes of its rows and how many there are."""
    try:
        return _columns(header, where), int(header["NAXIS1"]), int(header["NAXIS2"])
    except (KeyError, TypeError, ValueError) as error:  # a keyword that is absent, or no number
        raise BadInput(where, str(error)[:80], STANDARD) from None


def _columns(header: JsonObject, where: str) -> list[Column]:
    columns = []
    for i in range(1, int(header["TFIELDS"]) + 1):
        name = str(header.get(f"TTYPE{i}", f"col{i}")).strip()
        form = str(header[f"TFORM{i}"]).strip()
        found = re.match(r"(\d{0,9})([A-Z])", form)
        if found is None or found.group(2) not in TYPES:
            raise BadInput(f"{where} {name}", form, "a TFORM of the FITS standard")
        repeat = int(found.group(1) or 1)
        kind = found.group(2)
        dtype = TYPES[kind]
        if kind == "A":
            dtype, repeat = f"S{repeat}", 1 if repeat else 0
        elif kind == "X":
            repeat = -(-repeat // 8)
        null = header.get(f"TNULL{i}")
        scale, zero = _number(header.get(f"TSCAL{i}", 1)), _number(header.get(f"TZERO{i}", 0))
        unit = str(header.get(f"TUNIT{i}", ""))
        columns.append(Column(name, dtype, repeat, null, scale, zero, unit))
    return columns


def _number(value: object) -> float:
    """A keyword's number, a whole one as it is; ValueError for a text."""
    return value if isinstance(value, int) else float(str(value))


def _values(stored: np.ndarray, column: Column, want: str, where: str) -> pa.Array:
    """A column as Arrow: int64, double or string, null where TNULL stands."""
    kinds, allowed = WANTED[want]
    if column.repeat != 1 or np.dtype(column.dtype).kind not in kinds:
        raise BadInput(f"{where} {column.name}", f"{column.repeat}{column.dtype}", allowed)
    flat = stored[:, 0]
    if want == "text":
        return pa.array([text.rstrip(b" \0").decode("latin-1") or None for text in flat.tolist()])
    is_null = None if column.null is None else flat == column.null
    values = _scaled(np.ascontiguousarray(flat, flat.dtype.newbyteorder("=")), column)
    return pa.array(values, mask=is_null)


def _scaled(values: np.ndarray, column: Column) -> np.ndarray:
    """TSCAL x stored + TZERO, in integers where that is exact (FITS standard 4.0, table 19)."""
    whole = float(column.zero).is_integer() and abs(column.zero) <= 1 << 63 and column.scale == 1
    if values.dtype.kind in "iu" and whole:
        if column.zero == 1 << 63:
            return values.view(np.uint64) ^ np.uint64(1 << 63)
        return values.astype(np.int64) + int(column.zero) if column.zero else values
    if column.scale != 1 or column.zero:
        return values * float(column.scale) + float(column.zero)
    return values
