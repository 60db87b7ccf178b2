"""First pass: a batch of sources becomes sorted pieces, counts and rejects, with one marker.

A batch is the unit of work and of going on: its marker is written last, after all that it names
is on disk, so a killed ingest reads again only the batches without one.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import pyarrow as pa

from .columns import HEALPIX_COLUMN
from .judging import PLACE_COLUMN, REJECTS, Columns, judge
from .partition import Pixels, coarser_counts
from .pieces import Piece, is_whole, write_piece
from .publish import sync_file, write_durably


class Source(Protocol):
    """Anything that yields rows: an input file, or a part of a synthetic sky."""

    @property
    def label(self) -> str:
        """The name by which the manifest and the rejects table call it."""

    def identity(self) -> list[Any]:
        """What tells whether it is still the same source (JSON values)."""

    def tables(self, record: dict[str, Any]) -> Iterator[pa.Table]:
        """Its rows in order, in tables of schema INCOMING; fills in `bytes` and `md5`, if any."""


@dataclass(frozen=True)
class Batch:
    """Sources that are read by one task."""

    number: int
    sources: tuple[Source, ...]

    def identity(self) -> list[Any]:
        return [source.identity() for source in self.sources]


@dataclass(frozen=True)
class Split:
    """What came of a batch: its sources' records, pieces, rows by pixel, and rejects.

    starts : (sources + 1,) place of each source's first row in the batch.
    """

    number: int
    records: tuple[dict[str, Any], ...]
    pieces: tuple[Piece, ...]
    reasons: dict[str, int]

    @property
    def starts(self) -> np.ndarray:
        return np.concatenate([[0], np.cumsum([r["rows"] for r in self.records], dtype=np.int64)])


def split(batch: Batch, folder: Path, piece_rows: int) -> None:
    """Read the sources of a batch once: keep or reject each row, and write what came of it.

    Nothing is done where all that is there already, and whole.
    """
    if finished(batch, folder, verify=True):
        return
    name = f"{batch.number:06d}"
    held = _Held(folder, batch.number, piece_rows)
    records: list[dict[str, Any]] = []
    reasons: Counter[str] = Counter()
    rejects = pa.ipc.new_file(str(folder / f"{name}-rejects.arrow"), REJECTS)
    for source in batch.sources:
        record: dict[str, Any] = {"name": source.label, "bytes": None, "md5": None, "rows": 0}
        for table in source.tables(record):
            kept, columns, bad = judge(table, source.label, record["rows"])
            if bad.num_rows:
                rejects.write_table(bad)
                reasons.update(bad["reason"].to_pylist())
            held.add({**columns, PLACE_COLUMN: held.rows_in + kept}, table.num_rows)
            record["rows"] += table.num_rows
        records.append(record)
    held.write()
    pixels, counts = held.counts()
    np.save(folder / f"{name}-counts.npy", np.stack([pixels, counts]))
    rejects.close()
    for path in folder.glob(f"{name}-*"):
        sync_file(path)
    marker = {
        "identity": batch.identity(), "records": records, "pieces": held.pieces, "reasons": reasons
    }  # fmt: skip
    write_durably(folder / f"{name}.json", json.dumps(marker))


class _Held:
    """Kept rows in memory, written as pieces of a set size."""

    def __init__(self, folder: Path, batch: int, piece_rows: int) -> None:
        self.folder, self.batch, self.piece_rows = folder, batch, piece_rows
        self.parts: list[Columns] = []
        self.rows = self.rows_in = 0
        self.pieces: list[Piece] = []
        self._counts: list[tuple[Pixels, Pixels]] = []

    def add(self, columns: Columns, rows_in: int) -> None:
        """Hold some rows; `rows_in` is how many were read for them."""
        self.rows_in += rows_in
        count = columns[PLACE_COLUMN].size
        if not count:
            return
        self.parts.append(columns)
        self.rows += count
        if self.rows >= self.piece_rows:
            self.write()

    def write(self) -> None:
        """Write what is held."""
        if not self.rows:
            return
        names = list(self.parts[0])
        rows = {name: np.concatenate([part.pop(name) for part in self.parts]) for name in names}
        self.parts, self.rows = [], 0
        self._counts.append(coarser_counts(rows[HEALPIX_COLUMN]))
        self.pieces.append(write_piece(self.folder, self.batch, len(self.pieces), rows))

    def counts(self) -> tuple[Pixels, Pixels]:
        """Pixels of the counting order that occur, ascending, and their rows."""
        if not self._counts:
            return np.empty(0, np.int64), np.empty(0, np.int64)
        pixels, where = np.unique(
            np.concatenate([pixels for pixels, _ in self._counts]), return_inverse=True
        )
        counts = np.zeros(pixels.size, np.int64)
        np.add.at(counts, where, np.concatenate([counts for _, counts in self._counts]))
        return pixels, counts


def finished(batch: Batch, folder: Path, *, verify: bool = False) -> Split | None:
    """What came of a batch, if its marker is there and the batch's sources are still the same.

    verify : also read every piece again and compare its checksum.
    """
    try:
        marker = json.loads((folder / f"{batch.number:06d}.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    pieces = tuple(Piece(*piece) for piece in marker["pieces"])
    if marker["identity"] != json.loads(json.dumps(batch.identity())):
        return None
    if verify and not all(is_whole(folder, piece) for piece in pieces):
        return None
    return Split(batch.number, tuple(marker["records"]), pieces, marker["reasons"])


def counts_of(split: Split, folder: Path) -> tuple[Pixels, Pixels]:
    """The pixels of the counting order that a batch's rows fall into, and how many in each."""
    pixels, counts = np.load(folder / f"{split.number:06d}-counts.npy")
    return pixels, counts


def rejects_of(split: Split, folder: Path) -> Iterator[pa.Table]:
    """The rows of a batch that were rejected while reading, in tables of bounded size."""
    if not split.reasons:
        return
    with pa.OSFile(str(folder / f"{split.number:06d}-rejects.arrow")) as file:
        reader = pa.ipc.open_file(file)
        for i in range(reader.num_record_batches):
            yield pa.Table.from_batches([reader.get_batch(i)])


def in_batches(
    sources: Sequence[Source], sizes: Sequence[int], most_bytes: int, most_sources: int
) -> Iterator[Batch]:
    """Consecutive sources together, up to a size, so that tasks and files stay few."""
    held: list[Source] = []
    number = size = 0
    for source, own in zip(sources, sizes, strict=True):
        if held and (size + own > most_bytes or len(held) >= most_sources):
            yield Batch(number, tuple(held))
            number, held, size = number + 1, [], 0
        held.append(source)
        size += own
    if held:
        yield Batch(number, tuple(held))
