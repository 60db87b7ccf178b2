"""Judge each row that comes in: keep it, or reject it with one reason."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from ..columns import HEALPIX_COLUMN, INCOMING, LIMITS, STEPS
from ..geometry.gaia_ids import misplaced
from ..partition import healpix_29

Columns = dict[str, np.ndarray]

PLACE_COLUMN = "_place"  # the row's place among all rows of its batch, counted from 0
COLOURS = ("phot_bp_mean_mag", "phot_rp_mean_mag")  # without both a star has no colour
DUPLICATE = "source_id occurs more than once"
ELSEWHERE = "source_id occurs more than once, at another place"
MISPLACED = "place is not that of its source_id"
ROWS_OF_A_DOUBT = 100
SHARE_OF_SINGLE = 0.99  # doubles that end after some bits by chance are far fewer
TURNS = {"hours": 24.0, "radians": 2.0 * np.pi}

# In this order; the first reason that holds is the one given.
REASONS = (
    "source_id absent",
    "position absent or not finite",
    "ra outside 0 to 360",
    "dec outside -90 to 90",
    "G magnitude absent or not finite",
    MISPLACED,
)

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


def judge(
    table: pa.Table, label: str, first_row: int, ids_hold_place: bool = False
) -> tuple[np.ndarray, Columns, pa.Table]:
    """Split incoming rows into kept ones and rejected ones.

    table : schema INCOMING, nulls and NaN anywhere; label : the source's name; first_row : the
    place of the table's first row in its source; ids_hold_place : whether source_ids are Gaia's,
    with which places must agree. Returns the kept rows' places in the table, their columns (those
    of STORED, NaN for an absent value, rounded to STEPS), and the rejects.
    """
    columns = {name: _numbers(table[name], LIMITS[name]) for name in LIMITS}
    reason = _reasons(table, columns)
    if ids_hold_place:
        _find_misplaced(table, columns, reason)
    kept = np.flatnonzero(reason < 0)
    bad = np.flatnonzero(reason >= 0)
    rejected = REJECTS.empty_table()
    if bad.size:
        text = [REASONS[i] for i in reason[bad]]
        rejected = rejects(table.take(pa.array(bad)), label, first_row + bad, text)
        table = table.take(pa.array(kept))
        columns = {name: values[kept] for name, values in columns.items()}
    return kept, _stored(table["source_id"].to_numpy(), columns), rejected


def rejects(rows: pa.Table, label: str, places: np.ndarray, reasons: list[str]) -> pa.Table:
    """Rejected rows as the rejects table shows them."""
    source = pa.array([label] * rows.num_rows, pa.string())
    values = (rows[name] for name in REJECTS.names[3:])
    return pa.table([source, pa.array(places), pa.array(reasons, pa.string()), *values], REJECTS)


def without_colour(magnitudes: Iterable[np.ndarray]) -> int:
    """How many rows lack a magnitude; magnitudes : (n,) each of COLOURS, NaN where it is absent."""
    absent = [np.isnan(each) for each in magnitudes]
    return int(np.count_nonzero(np.logical_or.reduce(absent)))


def beyond_limits(table: pa.Table) -> dict[str, int]:
    """How many values of a column are numbers beyond its limit, which count as absent."""
    with np.errstate(invalid="ignore"):
        sizes = {name: np.abs(table[name].to_numpy()) for name in LIMITS}
        many = {n: int(np.sum((v > LIMITS[n]) & (v < np.inf))) for n, v in sizes.items()}
    return {name: count for name, count in many.items() if count}


@dataclass
class Coordinates:
    """How the positions of a source look as numbers, before any of them is rejected.

    rows : finite ones; single : those of them that single precision holds to the last bit;
    least_ra, largest_ra : as the form reads them [deg]
    """

    rows: int = 0
    single: int = 0
    least_ra: float = np.inf
    largest_ra: float = -np.inf

    def add(self, ra: np.ndarray, dec: np.ndarray) -> None:
        """Look at more rows; (n,) each, NaN where there is none."""
        sound = np.isfinite(ra) & np.isfinite(dec)
        ra, dec = ra[sound], dec[sound]
        self.rows += ra.size
        with np.errstate(over="ignore"):
            single = (ra == ra.astype(np.float32)) & (dec == dec.astype(np.float32))
        self.single += int(np.count_nonzero(single))
        self.least_ra = float(ra.min(initial=self.least_ra))
        self.largest_ra = float(ra.max(initial=self.largest_ra))

    def doubts(self) -> Iterator[str]:
        """What is likely to be wrong with them, in words; so few rows tell nothing."""
        if self.rows < ROWS_OF_A_DOUBT:
            return
        if self.single > SHARE_OF_SINGLE * self.rows:
            step = 3.6e6 * float(np.spacing(np.float32(self.largest_ra)))
            yield (
                f"places have single precision: right ascensions are off by up to {step / 2:.2g}"
                " mas (a column of doubles, or a text with 9 decimals, holds them whole)"
            )
        for unit, turn in TURNS.items():
            if self.least_ra < 0.02 * turn and 0.98 * turn < self.largest_ra <= turn:
                yield (
                    f"right ascensions lie between 0 and {turn:.3g}: are they {unit}? They were"
                    " read as degrees (--form with a column map says another unit)"
                )


def _numbers(column: pa.ChunkedArray, limit: float) -> np.ndarray:
    """A float column, NaN where it is null, not finite or beyond its limit. Always a new array."""
    values = np.array(column.to_numpy())
    values[~(np.abs(values) <= limit)] = np.nan
    return values


def _reasons(table: pa.Table, columns: Columns) -> np.ndarray:
    """Index of the first reason against each row; -1 for none."""
    ra, dec, g_mag = (columns[name] for name in ("ra", "dec", "phot_g_mean_mag"))
    with np.errstate(invalid="ignore"):
        against = (
            table["source_id"].is_null().to_numpy(),
            np.isnan(ra) | np.isnan(dec),
            (ra < 0.0) | (ra > 360.0),
            np.abs(dec) > 90.0,
            np.isnan(g_mag),
        )
    reason = np.full(table.num_rows, -1, np.int8)
    for i in reversed(range(len(against))):
        reason[against[i]] = i
    return reason


def _find_misplaced(table: pa.Table, columns: Columns, reason: np.ndarray) -> None:
    """Give the rows that have no other reason against them MISPLACED where it holds."""
    sound = np.flatnonzero(reason < 0)
    ids = table["source_id"].fill_null(0).to_numpy()[sound]
    wrong = misplaced(ids, columns["ra"][sound], columns["dec"][sound])
    reason[sound[wrong]] = REASONS.index(MISPLACED)


def _stored(source_id: np.ndarray, columns: Columns) -> Columns:
    """Kept rows as they are stored: rounded, and right ascension in [0, 360)."""
    for name, step in STEPS.items():
        kind = INCOMING.field(name).type.to_pandas_dtype()
        # Powers of two: scaling is exact, and rint is the only rounding.
        columns[name] = (np.rint(columns[name] * kind(1.0 / step)) * kind(step)).astype(kind)
    columns["ra"][columns["ra"] >= 360.0] = 0.0
    pixels = healpix_29(columns["ra"], columns["dec"])
    return {HEALPIX_COLUMN: pixels, "source_id": source_id, **columns}
