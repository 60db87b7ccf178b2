"""One door to all kinds of files: `read_tables`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pyarrow as pa

from ..errors import BadInput
from ..forms import Form
from .detect import detect_form
from .kinds import kind_of
from .meaning import apply
from .raw import raw_tables


def read_tables(
    path: str | Path, form: Form | None = None, *, md5: Any = None, field: str = "source"
) -> Iterator[pa.Table]:
    """The rows of a file in order, as tables of bounded size with the schema INCOMING.

    form : what its columns mean; by default Gaia DR2 or DR3, told from the file. md5 : a hashlib
    object: when the iterator is exhausted it has been fed every byte of the file as it lies on
    disk. field : what the path is called in messages. Raises BadInput naming file, column and row,
    and Damaged where the file ends too early or can't be decoded.
    """
    path = Path(path)
    kind = kind_of(path, field)
    meaning = form if form is not None else detect_form(path, field)
    return _tables(path, kind, meaning, md5, f"{field} {path}")


def _tables(path: Path, kind: str, form: Form, md5: Any, where: str) -> Iterator[pa.Table]:
    rows = 0
    try:
        raw = raw_tables(
            path, kind, form.layout, lambda names: form.choose(names, where), where, md5
        )
        for table in raw:
            yield apply(form, table, where, rows)
            rows += table.num_rows
    except OSError as error:
        allowed = f"a file that can be read ({error.strerror or error})"
        raise BadInput(where, str(path), allowed) from None
