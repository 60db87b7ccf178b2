"""First pass: a batch of sources becomes sorted pieces, counts and rejects, with one marker.

A batch is the unit of work and of going on: its marker is written last, after all that it names
is on disk, so a killed ingest reads again only the batches without one. Whoever reads a batch does
so into a folder of its own, which its marker names: two at once never mix.
"""

from __future__ import annotations

import io
import json
import shutil
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol
from uuid import uuid4

import google_crc32c
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from ..columns import HEALPIX_COLUMN
from ..documents import JsonObject
from ..errors import Damaged
from ..geometry.gaia_ids import LEAST_CHECKED, MOST_LOOKED_AT, refuse_most
from ..partition import Pixels, coarser_counts
from ..storage.durable import save_array, sync, write_atomically
from .judging import (
    MISPLACED,
    PLACE_COLUMN,
    REJECTS,
    Columns,
    Coordinates,
    beyond_limits,
    judge,
)
from .pieces import CHANGED, SortedRun, is_whole, write_piece

ROWS_THAT_TELL = 10_000  # of a source, of which most must stand where their source_ids say
COUNTS_NAME, REJECTS_NAME = "counts.npy", "rejects.arrow"


class RowSource(Protocol):
    """Anything that yields rows: an input file, or a part of a synthetic sky.

    One whose attribute `ids_hold_place` is true has Gaia's source_ids, which tell their places.
    """

    @property
    def label(self) -> str:
        """The name by which the manifest and the rejects table call it."""

    def identity(self) -> list[object]:
        """What tells whether it is still the same source (JSON values)."""

    def tables(self, record: JsonObject) -> Iterator[pa.Table]:
        """Its rows in order, in tables of schema INCOMING; fills in `bytes`, `md5` and `doubts`,
        where it has any."""


@dataclass(frozen=True)
class Batch:
    """Sources that are read by one task."""

    number: int
    sources: tuple[RowSource, ...]

    def identity(self) -> list[object]:
        return [source.identity() for source in self.sources]


@dataclass(frozen=True)
class BatchResult:
    """What came of a batch: its sources' records, pieces, rows by pixel, and rejects.

    folder : below that of all batches; crcs : crc32c of its files of counts and rejects. starts :
    (sources + 1,) place of each source's first row in the batch.
    """

    number: int
    folder: str
    crcs: dict[str, int]
    records: tuple[JsonObject, ...]
    pieces: tuple[SortedRun, ...]
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
    name = f"{batch.number:06d}-{uuid4().hex}"
    (folder / name).mkdir()
    try:
        marker = {"identity": batch.identity(), **_read(batch, folder, name, piece_rows)}
        for path in (*(folder / name).iterdir(), folder / name):
            sync(path)
        write_atomically(_marker_path(folder, batch), json.dumps(marker))
    except BaseException:
        shutil.rmtree(folder / name, ignore_errors=True)
        raise


def _read(batch: Batch, root: Path, name: str, piece_rows: int) -> JsonObject:
    """Read the sources of a batch into the folder `name` below `root`: what its marker says."""
    folder = root / name
    held = _Held(root, name, batch.number, piece_rows)
    records: list[JsonObject] = []
    reasons: Counter[str] = Counter()
    rejects = pa.ipc.new_file(str(folder / REJECTS_NAME), REJECTS)
    for source in batch.sources:
        record: JsonObject = {
            "name": source.label,
            "bytes": None,
            "md5": None,
            "rows": 0,
            "doubts": [],
        }
        places, beyond, looks = _Places(source), Counter[str](), Coordinates()
        for table in source.tables(record):
            kept, columns, bad = judge(table, source.label, record["rows"], places.compared)
            places.add(columns["source_id"], bad)
            beyond.update(beyond_limits(table))
            looks.add(table["ra"].to_numpy(), table["dec"].to_numpy())
            if bad.num_rows:
                rejects.write_table(bad)
                reasons.update(bad["reason"].to_pylist())
            held.add({**columns, PLACE_COLUMN: held.rows_in + kept}, table.num_rows)
            record["rows"] += table.num_rows
        places.check()
        record["unlike_gaia"] = places.unlike_gaia
        record["beyond"] = dict(beyond)
        record["doubts"] += looks.doubts()
        records.append(record)
    held.write()
    pixels, counts = held.counts()
    save_array(folder / COUNTS_NAME, np.stack([pixels, counts]))
    rejects.close()
    return {
        "folder": name,
        "crcs": {each: crc32c_of(folder / each) for each in (COUNTS_NAME, REJECTS_NAME)},
        "records": records,
        "pieces": held.pieces,
        "reasons": reasons,
    }


class _Places:
    """The rows of a source whose places were compared with its source_ids, where these are Gaia's.

    unlike_gaia : rows that were not, as their numbers are too small.
    """

    def __init__(self, source: RowSource) -> None:
        self.where = f"source {source.label}"
        self.compared: bool = getattr(source, "ids_hold_place", False)
        self.rows = self.wrong = self.unlike_gaia = 0
        self.some_wrong = REJECTS.empty_table()

    def add(self, kept_ids: np.ndarray, bad: pa.Table) -> None:
        """Count rows kept and rows that stand elsewhere; where they are many, `check` at once."""
        if not self.compared:
            return
        own = kept_ids.size - int(np.count_nonzero(kept_ids < LEAST_CHECKED))
        wrong = bad.filter(pc.equal(bad["reason"], MISPLACED))
        self.wrong += wrong.num_rows
        self.rows += own + wrong.num_rows
        if self.some_wrong.num_rows < MOST_LOOKED_AT:
            held = pa.concat_tables([self.some_wrong, wrong])
            self.some_wrong = held.slice(0, MOST_LOOKED_AT)
        self.unlike_gaia += kept_ids.size - own
        if self.rows >= ROWS_THAT_TELL:
            self.check()

    def check(self) -> None:
        """BadInput where most of the rows so far stand elsewhere."""
        ids, ra, dec = (self.some_wrong[name].to_numpy() for name in ("source_id", "ra", "dec"))
        refuse_most(self.where, self.rows, self.wrong, ids, ra, dec)


class _Held:
    """Kept rows in memory, written as pieces of a set size."""

    def __init__(self, root: Path, folder: str, batch: int, piece_rows: int) -> None:
        self.root, self.folder, self.batch, self.piece_rows = root, folder, batch, piece_rows
        self.parts: list[Columns] = []
        self.rows = self.rows_in = 0
        self.pieces: list[SortedRun] = []
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
        name = f"{self.folder}/{len(self.pieces):04d}.rows"
        self.pieces.append(write_piece(self.root, self.batch, name, rows))

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


def finished(batch: Batch, folder: Path, *, verify: bool = False) -> BatchResult | None:
    """What came of a batch, if its marker is there and the batch's sources are still the same.

    verify : also read every file again and compare its checksum.
    """
    try:
        marker = json.loads(_marker_path(folder, batch).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    pieces = tuple(SortedRun(*piece) for piece in marker["pieces"])
    if marker["identity"] != json.loads(json.dumps(batch.identity())):
        return None
    names, crcs = marker["folder"], marker["crcs"]
    if verify and not all(is_whole(folder, piece) for piece in pieces):
        return None
    if verify and any(crc32c_of(folder / names / name) != crc for name, crc in crcs.items()):
        return None
    records, reasons = tuple(marker["records"]), marker["reasons"]
    return BatchResult(batch.number, names, crcs, records, pieces, reasons)


def sweep(folder: Path, splits: Sequence[BatchResult]) -> None:
    """Remove what is of no batch in `splits`: left by a killed run, or read before a change."""
    wanted = {split.folder for split in splits}
    for path in folder.iterdir():
        if path.is_dir() and path.name not in wanted:
            shutil.rmtree(path, ignore_errors=True)


def counts_of(split: BatchResult, folder: Path) -> tuple[Pixels, Pixels]:
    """The pixels of the counting order that a batch's rows fall into, and how many in each."""
    path = folder / split.folder / COUNTS_NAME
    data = path.read_bytes()
    if google_crc32c.value(data) != split.crcs[COUNTS_NAME]:
        raise Damaged(str(path), CHANGED)
    pixels, counts = np.load(io.BytesIO(data))
    return pixels, counts


def rejects_of(split: BatchResult, folder: Path) -> Iterator[pa.Table]:
    """The rows of a batch that were rejected while reading, in tables of bounded size."""
    if not split.reasons:
        return
    path = folder / split.folder / REJECTS_NAME
    if crc32c_of(path) != split.crcs[REJECTS_NAME]:
        raise Damaged(str(path), CHANGED)
    yield from stored_tables(path)


def stored_tables(path: Path) -> Iterator[pa.Table]:
    """The record batches of an Arrow file, one at a time."""
    with pa.OSFile(str(path)) as file:
        reader = pa.ipc.open_file(file)
        for i in range(reader.num_record_batches):
            yield pa.Table.from_batches([reader.get_batch(i)])


def in_batches(
    sources: Sequence[RowSource], sizes: Sequence[int], most_bytes: int, most_sources: int
) -> Iterator[Batch]:
    """Consecutive sources together, up to a size, so that tasks and files stay few."""
    held: list[RowSource] = []
    number = size = 0
    for source, own in zip(sources, sizes, strict=True):
        if held and (size + own > most_bytes or len(held) >= most_sources):
            yield Batch(number, tuple(held))
            number, held, size = number + 1, [], 0
        held.append(source)
        size += own
    if held:
        yield Batch(number, tuple(held))


def _marker_path(folder: Path, batch: Batch) -> Path:
    return folder / f"{batch.number:06d}.json"


def crc32c_of(path: Path) -> int | None:
    """Checksum of a file; None where there is none."""
    crc = 0
    try:
        with path.open("rb") as file:
            while data := file.read(1 << 20):
                crc = google_crc32c.extend(crc, data)
    except FileNotFoundError:
        return None
    return crc
