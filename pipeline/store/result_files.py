"""Files of results by their ending: which endings there are, and tables without NaN."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc

from pipeline.errors import BadInput, check_new


def check_ending(path: Path, endings: Sequence[str]) -> None:
    """BadInput for a file of no known form, or one that exists, before anything is worked out."""
    if path.suffix.lower() not in endings:
        raise BadInput("-o", path.name, f"a name that ends in {', '.join(endings)}")
    if not path.parent.is_dir():
        raise BadInput("-o", str(path), "a file in a folder that exists")
    check_new(path)


def without_nan(table: pa.Table) -> pa.Table:
    """The table with nulls for NaN."""
    for i, field in enumerate(table.schema):
        if pa.types.is_floating(field.type):
            column = table.column(i)
            held = pc.if_else(pc.is_finite(column), column, pa.scalar(None, field.type))
            table = table.set_column(i, field.name, held)
    return table
