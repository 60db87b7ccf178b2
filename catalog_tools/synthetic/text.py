"""Columns of numbers to CSV text with the digits of the Gaia archive, by pyarrow's writer.

Doubles get 16 significant digits, singles 8; their size must stay below 9e15. A number that is
printed is an integer below 2^53 over a power of ten up to 10^22, so that every correct parser
gives the same double (Clinger 1990, PLDI, "fast path").
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray
from pyarrow import csv

DOUBLE, SINGLE, WHOLE, TEXT, NAME = range(5)
DOUBLE_TOP, SINGLE_TOP = 9e15, 9e7  # the integers that are printed stay below
NO_WHOLE = np.iinfo(np.int64).min  # an absent integer
POWERS = np.array([float(10**i) for i in range(23)])
PLAIN = csv.WriteOptions(include_header=False, quoting_style="none")


def as_printed(values: NDArray[np.float64], kind: int) -> NDArray[np.float64]:
    """What a reader gets for values (n,) printed as DOUBLE or SINGLE; NaN for an empty field."""
    top = DOUBLE_TOP if kind == DOUBLE else SINGLE_TOP
    decimals = np.zeros(values.shape, np.int64)
    for power in POWERS[1:]:
        decimals += np.abs(values) * power < top
    scale = POWERS[decimals]
    return np.asarray(np.rint(values * scale) / scale)


def rows_of_text(
    kinds: Sequence[int], columns: Sequence[NDArray[np.generic]], texts: Sequence[str]
) -> memoryview:
    """CSV lines of columns (n,) each, without a header.

    kinds : of each column: DOUBLE or SINGLE (floats, NaN for empty), WHOLE (integers from 0,
    NO_WHOLE for empty), TEXT (numbers in `texts`), NAME (text 0, then the integer).
    """
    arrays = [_column(c, kind, texts) for c, kind in zip(columns, kinds, strict=True)]
    out = pa.BufferOutputStream()
    csv.write_csv(pa.table(arrays, [str(i) for i in range(len(arrays))]), out, PLAIN)
    return memoryview(out.getvalue())


def _column(values: NDArray[np.generic], kind: int, texts: Sequence[str]) -> pa.Array:
    """One column as pyarrow prints it; null where its field is empty."""
    if kind == TEXT:
        return pa.array(texts).take(pa.array(values))
    if kind in (DOUBLE, SINGLE):
        return pa.array(as_printed(values.astype(np.float64), kind), from_pandas=True)
    whole = pa.array(values, mask=values == NO_WHOLE)
    if kind == NAME:
        return pc.binary_join_element_wise(texts[0], whole.cast(pa.string()), "")
    return whole
