"""Temporary pieces between reading and writing: sorted runs of rows on disk, read by range."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import pyarrow as pa

from .columns import HEALPIX_COLUMN
from .judging import REJECTS, judge
from .partition import Pixels, count

PIECE_ROWS = 500_000  # a run in memory: about 40 MB, four times that while it is sorted


class Source(Protocol):
    """Anything that yields rows: an input file, or a part of a synthetic sky."""

    @property
    def label(self) -> str:
        """The name by which the manifest and the rejects table call it."""

    def tables(self) -> Iterator[pa.Table]:
        """Its rows in order, in tables of schema INCOMING."""

    def record(self) -> dict[str, Any]:
        """What the manifest says about it (JSON values)."""


@dataclass(frozen=True)
class Piece:
    """One sorted run: the ranges of order-29 pixels and source_ids that it holds."""

    path: Path
    source: int
    rows: int
    first_29: int
    last_29: int
    first_id: int
    last_id: int


@dataclass
class Split:
    """What came of one source: its pieces, its rows by pixel, and what was rejected."""

    source: int
    rows_in: int = 0
    record: dict[str, Any] = field(default_factory=dict)
    pieces: list[Piece] = field(default_factory=list)
    counts: list[tuple[Pixels, Pixels]] = field(default_factory=list)
    rejects: Path | None = None


def split(source: Source, index: int, folder: Path) -> Split:
    """Read a source once: judge its rows, and write the kept ones as sorted pieces."""
    result = Split(index)
    rejected: list[pa.Table] = []
    for table in _in_runs(source.tables()):
        kept, bad = judge(table, source.label, result.rows_in)
        result.rows_in += table.num_rows
        if bad.num_rows:
            rejected.append(bad)
        if kept.num_rows:
            path = folder / f"{index:06d}-{len(result.pieces):05d}.arrow"
            result.pieces.append(_write(path, index, kept))
            result.counts.append(count(kept[HEALPIX_COLUMN].to_numpy()))
    if rejected:
        result.rejects = folder / f"{index:06d}-rejects.arrow"
        _write_arrow(result.rejects, pa.concat_tables(rejected))
    result.record = {**source.record(), "rows": result.rows_in}
    return result


def rows_between(piece: Piece, first_29: int, end_29: int) -> pa.Table:
    """Rows of a piece in a half-open range of order-29 pixels (memory-mapped, not copied)."""
    table = read_arrow(piece.path)
    low, high = np.searchsorted(table[HEALPIX_COLUMN].to_numpy(), [first_29, end_29])
    return table.slice(low, high - low)


def ids_of(piece: Piece) -> np.ndarray:
    """A piece's source_ids, ascending, memory-mapped."""
    return np.load(piece.path.with_suffix(".npy"), mmap_mode="r")


def read_arrow(path: Path) -> pa.Table:
    """An Arrow file, memory-mapped."""
    return pa.ipc.open_file(pa.memory_map(str(path))).read_all()


def read_rejects(splits: Iterable[Split]) -> pa.Table:
    """All rows that were rejected while reading, in the order of the sources."""
    tables = [read_arrow(s.rejects) for s in splits if s.rejects is not None]
    return pa.concat_tables([REJECTS.empty_table(), *tables])


def _in_runs(tables: Iterable[pa.Table]) -> Iterator[pa.Table]:
    """The same rows in tables of PIECE_ROWS, the last one smaller."""
    held: list[pa.Table] = []
    rows = 0
    for table in tables:
        held.append(table)
        rows += table.num_rows
        while rows >= PIECE_ROWS:
            whole = pa.concat_tables(held)
            yield whole.slice(0, PIECE_ROWS)
            held, rows = [whole.slice(PIECE_ROWS)], rows - PIECE_ROWS
    if rows:
        yield pa.concat_tables(held)


def _write(path: Path, source: int, table: pa.Table) -> Piece:
    _write_arrow(path, table.combine_chunks())
    ids = np.sort(table["source_id"].to_numpy())
    np.save(path.with_suffix(".npy"), ids)
    pixels = table[HEALPIX_COLUMN].to_numpy()
    ends = (int(pixels[0]), int(pixels[-1]), int(ids[0]), int(ids[-1]))
    return Piece(path, source, table.num_rows, *ends)


def _write_arrow(path: Path, table: pa.Table) -> None:
    with pa.ipc.new_file(str(path), table.schema) as writer:
        writer.write_table(table)
