"""Second pass: gather a leaf's rows from the pieces, leave repeated ones out, write its shard."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NamedTuple
from uuid import uuid4

import numpy as np
import pyarrow as pa

from ..catalogue import LEAVES_DTYPE, ROW_GROUPS_DTYPE, shard_name
from ..columns import STORED
from ..documents import JsonObject
from ..errors import Damaged
from ..partition import Cell
from ..storage.durable import sync, whole_file, write_atomically
from .batches import BatchResult, crc32c_of, stored_tables
from .duplicates import Repeated
from .judging import (
    COLOURS,
    DUPLICATE,
    ELSEWHERE,
    PLACE_COLUMN,
    REJECTS,
    Columns,
    without_colour,
)
from .memory import give_back
from .pieces import CHANGED, Pieces, Run
from .publish import Workspace
from .shards import write_shard

SURPLUS_ROWS = 50_000


@dataclass(frozen=True)
class Written:
    """All that came of the first pass, for the tasks of the second.

    labels, starts : for each batch, the names of its sources, and the place of each one's first
    row in the batch.
    """

    work: Workspace
    pieces: Pieces
    labels: tuple[tuple[str, ...], ...]
    starts: tuple[np.ndarray, ...]

    @cached_property
    def basis(self) -> str:
        """What tells whether a leaf was written from these pieces."""
        content = [piece._replace(name="") for piece in self.pieces.pieces]
        return hashlib.sha256(json.dumps(content).encode()).hexdigest()


class LeafDone(NamedTuple):
    """A finished leaf: its records for the manifest's tables (none if all its rows are surplus).

    surplus : rows omitted as their source_id occurs before, `elsewhere` of them at another place;
    surplus_crc32c : of the file that holds them, None where there is none; without_colour : rows in
    it without a BP or RP magnitude.
    """

    cell: Cell
    leaf: np.ndarray
    row_groups: np.ndarray
    surplus: int
    surplus_crc32c: int | None
    elsewhere: int
    without_colour: int


def written(work: Workspace, pieces: Pieces, splits: Sequence[BatchResult]) -> Written:
    """The context of the second pass."""
    labels = tuple(tuple(record["name"] for record in s.records) for s in splits)
    return Written(work, pieces, labels, tuple(s.starts for s in splits))


def write_leaf(context: Written, cell: Cell) -> None:
    """Write a leaf's shard, its surplus rows, and at last its marker; unless all that is there."""
    if leaf_done(context, cell, verify=True):
        return
    give_back()
    work, pieces = context.work, context.pieces
    runs = pieces.runs(cell.first_29, cell.end_29)
    repeated = Repeated(work.progress)
    names = [*STORED.names, PLACE_COLUMN] if repeated.ids.size else STORED.names
    rows = {name: pieces.gather(runs, name) for name in names}
    surplus = repeated.surplus(rows)
    elsewhere = repeated.stand_elsewhere(rows, surplus)
    if surplus.size:
        with whole_file(_surplus_path(work, cell)) as path:
            _write_surplus(path, context, runs, rows, surplus, elsewhere)
        rows = {name: np.delete(values, surplus) for name, values in rows.items()}
    rows.pop(PLACE_COLUMN, None)
    marker: JsonObject = {
        "basis": context.basis,
        "leaf": None,
        "surplus": int(surplus.size),
        "surplus_crc32c": crc32c_of(_surplus_path(work, cell)) if surplus.size else None,
        "elsewhere": int(np.count_nonzero(elsewhere)),
        "without_colour": without_colour(rows[name] for name in COLOURS),
    }
    if rows["source_id"].size:
        leaf, groups = _write_shard(work, cell, rows)
        marker |= {"leaf": leaf.tolist(), "row_groups": groups.tolist()}
    write_atomically(_marker_path(work, cell), json.dumps(marker, default=np.ndarray.tolist))


def _write_shard(work: Workspace, cell: Cell, rows: Columns) -> tuple[np.ndarray, np.ndarray]:
    """Write a shard apart from the catalogue, where nobody else writes, then put it into place."""
    name, own = shard_name(cell.order, cell.pixel), work.progress / f"leaf-{uuid4().hex}"
    own.mkdir()
    try:
        records = write_shard(own, cell.order, cell.pixel, rows)
        sync(own / name)
        path = work.catalogue / name
        path.parent.mkdir(parents=True, exist_ok=True)
        (own / name).replace(path)
        sync(path.parent)
    finally:
        shutil.rmtree(own, ignore_errors=True)
    return records


def leaf_done(context: Written, cell: Cell, *, verify: bool = False) -> LeafDone | None:
    """A leaf that was written from the same pieces; `verify` compares its files' checksums."""
    work = context.work
    try:
        marker = json.loads(_marker_path(work, cell).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    if marker["basis"] != context.basis:
        return None
    surplus = marker["surplus"], marker["surplus_crc32c"]
    if verify and surplus[0] and crc32c_of(_surplus_path(work, cell)) != surplus[1]:
        return None
    if marker["leaf"] is None:
        none = np.empty(0, LEAVES_DTYPE), np.empty(0, ROW_GROUPS_DTYPE)
        return LeafDone(cell, *none, *surplus, marker["elsewhere"], 0)
    leaf = np.array([_record(marker["leaf"])], LEAVES_DTYPE)
    shard = work.catalogue / shard_name(cell.order, cell.pixel)
    if verify and crc32c_of(shard) != leaf["crc32c"][0]:
        return None
    groups = np.array([_record(group) for group in marker["row_groups"]], ROW_GROUPS_DTYPE)
    return LeafDone(cell, leaf, groups, *surplus, marker["elsewhere"], marker["without_colour"])


def surplus_of(context: Written, done: LeafDone) -> Iterator[pa.Table]:
    """The rows of a leaf that were omitted, as the rejects table shows them."""
    if done.surplus:
        path = _surplus_path(context.work, done.cell)
        if crc32c_of(path) != done.surplus_crc32c:
            raise Damaged(str(path), CHANGED)
        yield from stored_tables(path)


def _write_surplus(
    path: Path,
    context: Written,
    runs: Sequence[Run],
    rows: dict[str, np.ndarray],
    surplus: np.ndarray,
    elsewhere: np.ndarray,
) -> None:
    with pa.ipc.new_file(str(path), REJECTS) as writer:
        for start in range(0, surplus.size, SURPLUS_ROWS):
            some = slice(start, start + SURPLUS_ROWS)
            reasons = [ELSEWHERE if e else DUPLICATE for e in elsewhere[some].tolist()]
            writer.write_table(_surplus_table(context, runs, rows, surplus[some], reasons))


def _surplus_table(
    context: Written,
    runs: Sequence[Run],
    rows: dict[str, np.ndarray],
    surplus: np.ndarray,
    reasons: list[str],
) -> pa.Table:
    """The surplus rows with the source and the row that each came from."""
    ends = np.cumsum([stop - start for _, start, stop in runs])
    batch_of_run = np.array([context.pieces.pieces[i].batch for i, _, _ in runs])
    batch = batch_of_run[np.searchsorted(ends, surplus, side="right")]
    place = rows[PLACE_COLUMN][surplus]
    names = np.empty(surplus.size, object)
    row = np.empty(surplus.size, np.int64)
    for b in np.unique(batch).tolist():
        mine, starts = np.flatnonzero(batch == b), context.starts[b]
        source = np.searchsorted(starts, place[mine], side="right") - 1
        names[mine] = np.array(context.labels[b], object)[source]
        row[mine] = place[mine] - starts[source]
    columns = [pa.array(rows[name][surplus]) for name in REJECTS.names[3:]]
    texts = pa.array(names, pa.string()), pa.array(row), pa.array(reasons, pa.string())
    return pa.table([*texts, *columns], REJECTS)


def _record(values: list[object]) -> tuple[object, ...]:
    return tuple(tuple(v) if isinstance(v, list) else v for v in values)


def _marker_path(work: Workspace, cell: Cell) -> Path:
    return work.progress / f"leaf-{cell.order}-{cell.pixel}.json"


def _surplus_path(work: Workspace, cell: Cell) -> Path:
    return work.progress / f"leaf-{cell.order}-{cell.pixel}.arrow"
