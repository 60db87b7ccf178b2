"""Take the wanted fields out of a block of CSV lines, all lines at once."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]

NEWLINE, QUOTE = 10, 34


class FieldTaker:
    """Takes the same columns out of block after block; its masks are used again."""

    def __init__(self, keep: list[bool], delimiter: int) -> None:
        self._width = len(keep)
        self._kept = np.flatnonzero(keep).astype(np.int32)
        self._delimiter = delimiter
        self._masks = np.empty((2, 0), np.bool_)

    def take(self, block: bytes) -> tuple[Bytes, int] | None:
        """The kept fields, each with its separator, a line a row; and the number of rows.

        block : whole lines. None where a line has not as many fields as there are columns, or a
        separator stands inside quotes. The block is read as one array of texts, each with the
        separator that ends it.
        """
        ends = self._field_ends(block)
        if ends is None:
            return None
        offsets = np.empty(ends.size + 1, np.int32)
        offsets[0] = 0
        np.add(ends, 1, out=offsets[1:], casting="unsafe")
        buffers = [None, pa.py_buffer(offsets), pa.py_buffer(block)]
        fields = pa.Array.from_buffers(pa.binary(), ends.size, buffers)
        rows = ends.size // self._width
        places = np.arange(rows, dtype=np.int32)[:, None] * self._width + self._kept
        taken = fields.take(pa.array(places.ravel()))
        bounds = np.frombuffer(taken.buffers()[1], np.int32)[: places.size + 1]
        out = np.frombuffer(taken.buffers()[2], np.uint8)[: bounds[-1]].copy()
        out[bounds[self._kept.size :: self._kept.size] - 1] = NEWLINE
        return out, rows

    def _field_ends(self, block: bytes) -> NDArray[np.int64] | None:
        """Where the separators are; None where the lines are not regular."""
        values = np.frombuffer(block, np.uint8)
        if self._masks.shape[1] < values.size:
            self._masks = np.empty((2, values.size * 5 // 4), np.bool_)
        newlines, separators = self._masks[:, : values.size]
        np.equal(values, NEWLINE, out=newlines)
        np.equal(values, self._delimiter, out=separators)
        np.logical_or(newlines, separators, out=separators)
        ends = np.flatnonzero(separators)
        last = ends[self._width - 1 :: self._width]
        if last.size * self._width != ends.size or not newlines[last].all():
            return None
        if np.count_nonzero(newlines) != last.size:
            return None
        if b'"' in block:
            quotes = np.searchsorted(ends, np.flatnonzero(values == QUOTE))
            if quotes.size % 2 or (quotes[::2] != quotes[1::2]).any():
                return None
        return ends
