"""One door to all kinds of files: `read_tables`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import pyarrow as pa

from ..errors import BadInput
from ..forms import Form
from ..forms.form import Names
from .detect import detect_form
from .kinds import kind_of
from .meaning import apply
from .raw import raw_tables
from .units import refuse_other_units


def read_tables(
    path: str | Path,
    form: Form | None = None,
    *,
    md5: object = None,
    field: str = "source",
    most_bytes: int | None = None,
    doubts: list[str] | None = None,
) -> Iterator[pa.Table]:
    """The rows of a file in order, as tables of bounded size with the schema INCOMING.

    form : what its columns mean; by default Gaia DR2 or DR3, told from the file. md5 : a hashlib
    object: when the iterator is exhausted it has been fed every byte of the file as it lies on
    disk. field : what the path is called in messages. most_bytes : of memory.
    doubts : gets what the file says of rows that it lacks.
    Raises BadInput naming file, column and row, also where the file declares another unit for a
    column than the form reads it in, and Damaged where the file ends too early or can't
    be decoded.
    """
    path = Path(path)
    kind = kind_of(path, field)
    meaning = form if form is not None else detect_form(path, field, most_bytes)
    return _tables(path, kind, meaning, md5, f"{field} {path}", most_bytes, doubts)


def _tables(
    path: Path,
    kind: str,
    form: Form,
    md5: object,
    where: str,
    most_bytes: int | None,
    doubts: list[str] | None,
) -> Iterator[pa.Table]:
    rows = 0
    try:

        def choose(names: list[str], declared: Mapping[str, str]) -> dict[str, str]:
            chosen = form.choose(names, where)
            refuse_other_units(form, Names(names), declared, where)
            return chosen

        raw = raw_tables(path, kind, form.layout, choose, where, md5, most_bytes, doubts)
        for table in raw:
            yield apply(form, table, where, rows)
            rows += table.num_rows
    except OSError as error:
        allowed = f"a file that can be read ({error.strerror or error})"
        raise BadInput(where, str(path), allowed) from None
