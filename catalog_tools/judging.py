"""Judge each row that comes in: keep it, or reject it with one reason."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from .columns import HEALPIX_COLUMN, INCOMING, NAMES, STORED
from .partition import healpix_29

ROW_COLUMN = "_row"  # the row's place in its source, counted from 0
DUPLICATE = "source_id occurs more than once"

# In this order; the first reason that holds is the one given.
REASONS = (
    "source_id absent",
    "position absent or not finite",
    "ra outside 0 to 360",
    "dec outside -90 to 90",
    "G magnitude absent or not finite",
)

PIECE = STORED.append(pa.field(ROW_COLUMN, pa.int64(), nullable=False))
REJECTS = pa.schema(
    [
        ("source", pa.string()),
        ("row", pa.int64()),
        ("reason", pa.string()),
        ("source_id", pa.int64()),
        ("ra", pa.float64()),
        ("dec", pa.float64()),
        ("phot_g_mean_mag", pa.float32()),
    ]
)


def judge(table: pa.Table, label: str, first_row: int) -> tuple[pa.Table, pa.Table]:
    """Split incoming rows into kept ones (schema PIECE) and rejected ones (schema REJECTS).

    table : schema INCOMING, nulls and NaN anywhere; label : the source's name; first_row : the
    place of the table's first row in its source.
    """
    table = table.select(NAMES).cast(INCOMING)
    rows = pa.array(np.arange(first_row, first_row + table.num_rows))
    reason = _reasons(table)
    kept = reason < 0
    good, bad = table.filter(pa.array(kept)), table.filter(pa.array(~kept))
    text = pa.array([REASONS[i] for i in reason[~kept]], pa.string())
    rejected = rejects(bad, label, rows.filter(pa.array(~kept)), text)
    return _stored(good, rows.filter(pa.array(kept))), rejected


def rejects(rows: pa.Table, label: str, places: pa.Array, reasons: pa.Array) -> pa.Table:
    """Rejected rows as the rejects table shows them."""
    names = REJECTS.names[3:]
    source = pa.array([label] * rows.num_rows, pa.string())
    return pa.table([source, places, reasons, *(rows[n] for n in names)], schema=REJECTS)


def _reasons(table: pa.Table) -> np.ndarray:
    """Index of the first reason against each row; -1 for none."""
    ra, dec, g_mag = (_numbers(table, name) for name in ("ra", "dec", "phot_g_mean_mag"))
    with np.errstate(invalid="ignore"):
        against = (
            table["source_id"].is_null().to_numpy(),
            ~(np.isfinite(ra) & np.isfinite(dec)),
            (ra < 0.0) | (ra > 360.0),
            np.abs(dec) > 90.0,
            ~np.isfinite(g_mag),
        )
    reason = np.full(table.num_rows, -1)
    for i in reversed(range(len(REASONS))):
        reason[against[i]] = i
    return reason


def _numbers(table: pa.Table, name: str) -> np.ndarray:
    return table[name].fill_null(float("nan")).to_numpy()


def _stored(good: pa.Table, rows: pa.Array) -> pa.Table:
    """Kept rows in the piece's schema: ra 360 becomes 0, what is not finite becomes null."""
    ra = good["ra"].to_numpy()
    ra = np.where(ra == 360.0, 0.0, ra)
    pixels = healpix_29(ra, good["dec"].to_numpy())
    columns = [pa.array(pixels)]
    for name in NAMES:
        column = pa.array(ra) if name == "ra" else good[name]
        if INCOMING.field(name).type == pa.float32():
            column = pc.if_else(pc.is_finite(column), column, None)
        columns.append(column)
    return pa.table([*columns, rows], schema=PIECE).sort_by(HEALPIX_COLUMN)
