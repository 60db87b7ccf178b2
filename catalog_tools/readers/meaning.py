"""Apply a form: the table's own columns become the canonical ones, rows in the same order."""

from __future__ import annotations

import hashlib

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from ..columns import INCOMING
from ..errors import BadInput
from ..forms import ColumnSource, Form, IdRule
from ..forms.form import MU_ALPHA, Names
from ..partition import healpix_29

Numbers = NDArray[np.float64]

LARGEST_EXACT = 1 << 53  # above it a double skips integers
EPOCH_TOLERANCE_YEAR = 0.002  # what the difference between time scales can't reach


def apply(form: Form, table: pa.Table, where: str, before: int) -> pa.Table:
    """A table of the schema INCOMING. before : how many rows of the file came before these.

    Raises BadInput naming column and row where an id is no id, or a row is of another epoch.
    """
    names = Names(table.column_names)
    made: dict[str, pa.Array | pa.ChunkedArray] = {}
    for field in INCOMING:
        if field.name != "source_id":
            made[field.name] = _column(form, table, names, field, where, made)
    _check_epoch(form, table, names, made, where, before)
    made["source_id"] = _ids(form.source_id, table, names, made, where, before)
    return pa.table([made[name] for name in INCOMING.names], schema=INCOMING)


def _column(
    form: Form,
    table: pa.Table,
    names: Names,
    field: pa.Field,
    where: str,
    made: dict[str, pa.Array | pa.ChunkedArray],
) -> pa.Array | pa.ChunkedArray:
    ways = form.ways(field.name, names)
    if not ways:
        return pa.nulls(table.num_rows, field.type)
    if len(ways) == 1 and ways[0].is_plain:
        column = _checked(table, names.first(ways[0].names), where)
        column = column.cast(field.type, safe=False)
        return pc.if_else(pc.is_nan(column), None, column)
    values = _numbers_of(ways[0], table, names, where, made)
    for way in ways[1:]:
        values = np.where(np.isnan(values), _numbers_of(way, table, names, where, made), values)
    with np.errstate(over="ignore"):
        return pa.array(values.astype(field.type.to_pandas_dtype()), from_pandas=True)


def _checked(table: pa.Table, name: str | None, where: str) -> pa.ChunkedArray:
    column = table[name]
    if not (pa.types.is_floating(column.type) or pa.types.is_integer(column.type)):
        if not pa.types.is_decimal(column.type) and not pa.types.is_null(column.type):
            raise BadInput(f"{where} {name}", str(column.type), "numbers")
        return column.cast(pa.float64())
    return column


def _numbers(
    table: pa.Table, name: str | None, where: str, nulls: tuple[float, ...] = ()
) -> Numbers:
    """A column as doubles; NaN where it is absent, or holds one of `nulls`."""
    column = _checked(table, name, where)
    values = column.cast(pa.float64(), safe=False).fill_null(float("nan")).to_numpy()
    if not nulls:
        return values
    return np.where(np.isin(values, _as_stored(nulls, column.type)), np.nan, values)


def _as_stored(nulls: tuple[float, ...], kind: pa.DataType) -> Numbers:
    """Numbers in the precision of a column of floating point numbers, as a file would hold them."""
    numbers = np.asarray(nulls, np.float64)
    if not pa.types.is_floating(kind):
        return numbers
    with np.errstate(over="ignore"):
        return numbers.astype(kind.to_pandas_dtype()).astype(np.float64)


def _numbers_of(
    way: ColumnSource,
    table: pa.Table,
    names: Names,
    where: str,
    made: dict[str, pa.Array | pa.ChunkedArray],
) -> Numbers:
    """Values of one way to get a column; NaN where it gives none."""
    values = _numbers(table, names.first(way.names), where, way.nulls)
    with np.errstate(invalid="ignore", divide="ignore"):
        absent = np.isnan(values)
        for name in way.positive:
            absent |= ~(_numbers(table, names.first((name,)), where) > 0.0)
        values = values * way.scale
        if way.is_flux:
            values = way.zero_mag - 2.5 * np.log10(np.where(values > 0.0, values, np.nan))
        values = values + way.add
        if way.is_ == MU_ALPHA:
            dec = made["dec"].to_numpy(zero_copy_only=False)
            values = values * np.cos(np.radians(dec))
        if way.colour:
            values = values + _colour_term(way, table, names, where)
    return np.where(absent, np.nan, values)


def _colour_term(way: ColumnSource, table: pa.Table, names: Names, where: str) -> Numbers:
    """What the colour adds to a magnitude; NaN where a column of it is absent."""
    found = (names.first((name,)) for name in way.colour)
    first, *second = (_numbers(table, name, where, way.nulls) for name in found)
    colour = first - second[0] if second else first
    if way.colour_range is not None:
        low, high = way.colour_range
        if way.clip:
            colour = np.clip(colour, low, high)
        else:
            colour = np.where((colour >= low) & (colour <= high), colour, np.nan)
    return np.asarray(np.polynomial.polynomial.polyval(colour, way.coefficients), np.float64)


def _check_epoch(
    form: Form,
    table: pa.Table,
    names: Names,
    made: dict[str, pa.Array | pa.ChunkedArray],
    where: str,
    before: int,
) -> None:
    """Refuse a row of another epoch, unless it has no G magnitude and is rejected for that."""
    epoch = form.epoch
    name = names.first(epoch.names)
    if name is None:
        return
    years = _numbers(table, name, where)
    if epoch.unit != "jyear":
        zero = 51544.5 if epoch.unit == "mjd" else 2451545.0
        years = 2000.0 + (years - zero) / 365.25
    wrong = np.abs(years - form.ref_epoch_jyear) > EPOCH_TOLERANCE_YEAR
    wrong &= ~made["phot_g_mean_mag"].is_null().to_numpy(zero_copy_only=False)
    if wrong.any():
        row = int(np.argmax(wrong))
        allowed = f"{form.ref_epoch_jyear}, the epoch of the form {form.name}"
        raise BadInput(f"{where} {name} row {before + row + 1}", float(years[row]), allowed)


def _ids(
    rule: IdRule,
    table: pa.Table,
    names: Names,
    made: dict[str, pa.Array | pa.ChunkedArray],
    where: str,
    before: int,
) -> pa.Array | pa.ChunkedArray:
    if rule.rule == "position":
        return _position_ids(made)
    name = names.first(rule.names)
    column = table[name]
    place = f"{where} {name}"
    if rule.rule == "integer":
        if pa.types.is_boolean(column.type) or pa.types.is_temporal(column.type):
            raise BadInput(place, str(column.type), "integers")
        ids = _integers(column, place, before)
    elif not (pa.types.is_string(column.type) or pa.types.is_large_string(column.type)):
        raise BadInput(place, str(column.type), "texts")
    elif rule.rule == "text":
        return pa.array([_hashed(text) for text in column.to_pylist()], pa.int64())
    else:
        ids = _trailing_integers(column, place, before)
    return ids if rule.factor == 1 else pc.negate(ids)


def _integers(column: pa.ChunkedArray, place: str, before: int) -> pa.ChunkedArray:
    if pa.types.is_floating(column.type):
        values = column.cast(pa.float64()).fill_null(float("nan")).to_numpy()
        with np.errstate(invalid="ignore"):
            bad = np.isfinite(values) & (
                (np.abs(values) > LARGEST_EXACT) | (values != np.floor(values))
            )
        if (bad | np.isinf(values)).any():
            row = int(np.argmax(bad | np.isinf(values)))
            allowed = "integers (ids beyond 2**53 in floating point are damaged: another column, "
            allowed += "such as designation, may hold them)"
            raise BadInput(f"{place} row {before + row + 1}", float(values[row]), allowed)
        column = pc.if_else(pc.is_nan(column), None, column)
    try:
        return column.cast(pa.int64())
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError) as error:
        raise BadInput(place, str(error)[:120], "integers below 2**63") from None


def _trailing_integers(column: pa.ChunkedArray, place: str, before: int) -> pa.ChunkedArray:
    digits = pc.struct_field(pc.extract_regex(column, r"(?P<id>\d+)\s*$"), "id")
    wrong = pc.and_(pc.is_null(digits), pc.is_valid(column)).to_numpy()
    if wrong.any():
        row = int(np.argmax(wrong))
        allowed = "texts that end with an integer"
        raise BadInput(f"{place} row {before + row + 1}", column[row].as_py(), allowed)
    try:
        return digits.cast(pa.int64())
    except pa.ArrowInvalid as error:
        raise BadInput(place, str(error)[:120], "integers below 2**63") from None


def _position_ids(made: dict[str, pa.Array | pa.ChunkedArray]) -> pa.Array:
    """-1 - pixel of order 29; 0 where there is no position on the sky: such a row is rejected."""
    ra, dec = (
        np.asarray(made[name].fill_null(float("nan")).to_numpy(zero_copy_only=False))
        for name in ("ra", "dec")
    )
    with np.errstate(invalid="ignore"):
        good = np.isfinite(ra) & (np.abs(dec) <= 90.0)
    ids = np.zeros(ra.size, np.int64)
    if good.any():
        ids[good] = -1 - healpix_29(ra[good], dec[good])
    return pa.array(ids)


def _hashed(text: str | None) -> int | None:
    if text is None or not text.strip():  # a blank names no star
        return None
    digest = hashlib.blake2b(text.strip().encode(), digest_size=8).digest()
    return (int.from_bytes(digest, "big") >> 2) - (1 << 63)
