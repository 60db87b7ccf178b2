"""VOTables (TABLEDATA, BINARY, BINARY2, also gzipped): read whole, and so of limited size."""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa
from astropy.io.votable import parse
from astropy.io.votable.tree import VOTableFile
from numpy.typing import ArrayLike

from ..errors import BadInput, Damaged
from .bytes_in import bytes_of
from .kinds import Choose

MOST_BYTES = 256 << 20
TEXT_SHARE, BINARY_SHARE = 4, 11  # bytes in memory for each of the file, unpacked (measured)
ROWS = 100_000
CUT_OFF = (
    "the service that wrote it cut it off at its limit of rows (QUERY_STATUS is OVERFLOW):"
    " stars are missing (ask again with a higher MAXREC)"
)


def read_votable(
    path: Path,
    where: str,
    choose: Choose,
    *,
    zipped: bool,
    md5: object = None,
    most_bytes: int | None = None,
    doubts: list[str] | None = None,
) -> Iterator[pa.Table]:
    """Tables of the chosen columns of the file's first table, in pieces of ROWS rows.

    doubts : gets what the file says of rows that it lacks.
    Raises BadInput where the file is larger than MOST_BYTES or would take more than `most_bytes` of
    memory, and Damaged where it can't be parsed.
    """
    text = _whole(path, where, most_bytes, zipped=zipped, md5=md5)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the archive's units are not all VOUnits
            whole = parse(text, table_number=0)
            table = whole.get_first_table()
            data = table.array
    except Exception as error:  # the XML parser has many ways to fail
        raise Damaged(str(path), f"cannot be read as VOTable ({str(error)[:200]})") from None
    if doubts is not None and _is_cut_off(whole):
        doubts.append(CUT_OFF)
    fields = {(field.name or field.ID): field.ID for field in reversed(table.fields)}
    declared = {f.name or f.ID: str(f.unit) for f in reversed(table.fields) if f.unit is not None}
    chosen = choose(list(fields), declared)
    for start in range(0, max(len(data), 1), ROWS):
        rows = data[start : start + ROWS]
        yield pa.table(
            {name: _values(rows[fields[name]], name, chosen[name], where) for name in chosen}
        )


def _is_cut_off(whole: VOTableFile) -> bool:
    """Whether the service that wrote the file left out rows (IVOA DALI 1.1, 4.4.1)."""
    infos = [*whole.infos, *(info for resource in whole.resources for info in resource.infos)]
    told = {((info.name or "").upper(), (info.value or "").upper()) for info in infos}
    return ("QUERY_STATUS", "OVERFLOW") in told


def _whole(
    path: Path, where: str, most_bytes: int | None, *, zipped: bool, md5: object
) -> io.BytesIO:
    text, most = io.BytesIO(), MOST_BYTES
    for piece in bytes_of(path, zipped=zipped, md5=md5):
        if most_bytes is not None and (not text.tell() or b"<BINARY" in piece):
            share = BINARY_SHARE if b"<BINARY" in piece else TEXT_SHARE
            most = min(most, most_bytes // share)
        if text.tell() + len(piece) > most:
            allowed = f"a VOTable of at most {most} bytes, unpacked, with this --memory"
            allowed += " (as CSV, FITS or Parquet the same rows can be read)"
            raise BadInput(where, f"over {most} bytes", allowed)
        text.write(piece)
    text.seek(0)
    return text


def _values(stored: ArrayLike, name: str, want: str, where: str) -> pa.Array:
    column: np.ma.MaskedArray = np.ma.asarray(stored)
    kinds = {"integer": "iuf", "number": "iuf", "text": "OSU"}[want]
    if column.dtype.kind not in kinds or column.ndim != 1:
        allowed = {"integer": "integers", "number": "numbers", "text": "texts"}[want]
        raise BadInput(f"{where} {name}", str(column.dtype), allowed)
    mask = np.ma.getmaskarray(column)
    if want == "text":
        texts = [str(text) or None for text in column.data]  # a blank is an absent one
        return pa.array(texts, pa.string(), mask=mask)
    data = np.ascontiguousarray(column.data, column.dtype.newbyteorder("="))
    return pa.array(data, mask=mask)
