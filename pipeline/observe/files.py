"""What is seen, as a file: Parquet, CSV, JSON, or CCSDS TDM, by the file's ending."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv
import pyarrow.parquet as pq

from catalog_tools.storage.durable import whole_file
from pipeline.errors import BadInput
from pipeline.observe.observe import Observed
from pipeline.observe.tdm import tdm_text

ENDINGS = (".parquet", ".csv", ".json", ".tdm")


def check_ending(path: Path) -> None:
    """BadInput for a file of no known form, before anything is worked out."""
    if path.suffix.lower() not in ENDINGS:
        raise BadInput("-o", path.name, f"a name that ends in {', '.join(ENDINGS)}")
    if not path.parent.is_dir():
        raise BadInput("-o", str(path), "a file in a folder that exists")


def write(observed: Observed, path: Path) -> None:
    """Write all rows; whole or not at all."""
    check_ending(path)
    try:
        with whole_file(path) as own:
            _write(observed, own, path.suffix.lower())
    except OSError as error:
        raise BadInput("-o", str(path), f"a file that can be written; {error.strerror}") from None


def _write(observed: Observed, path: Path, ending: str) -> None:
    notes = {"scene": observed.scene, "notes": json.dumps(observed.notes)}
    if ending == ".parquet":
        pq.write_table(observed.table.replace_schema_metadata(notes), path)
    elif ending == ".csv":
        pyarrow.csv.write_csv(_without_nan(observed.table), path)
    elif ending == ".json":
        path.write_text(json.dumps(as_data(observed), allow_nan=False), encoding="utf-8")
    else:
        path.write_text(tdm_text(observed), encoding="utf-8")


def as_data(observed: Observed, most_rows: int | None = None) -> dict[str, Any]:
    """Plain data: scene, counts by reason, notes, rows (null where there is no value)."""
    rows = observed.table if most_rows is None else observed.table.slice(0, most_rows)
    return {
        "scene": observed.scene,
        "counts": observed.counts(),
        "notes": list(observed.notes),
        "rows": [{k: _plain(v) for k, v in row.items()} for row in rows.to_pylist()],
    }


def _plain(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _without_nan(table: pa.Table) -> pa.Table:
    """The table with empty cells for NaN."""
    for i, field in enumerate(table.schema):
        if pa.types.is_floating(field.type):
            column = table.column(i)
            empty = pc.if_else(pc.is_finite(column), column, pa.scalar(None, field.type))
            table = table.set_column(i, field.name, empty)
    return table
