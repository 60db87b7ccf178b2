"""From sources to a published catalogue: split, count, find duplicates, write leaves, publish."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from . import duplicates, hats
from .catalogue import Catalogue, Leaf, open_catalogue, write_manifest
from .columns import STORED
from .errors import BadInput
from .judging import DUPLICATE, REJECTS, ROW_COLUMN, rejects
from .partition import COUNT_ORDER, Cell, Pixels, choose_leaves, coarser, healpix_29
from .pieces import Piece, Source, Split, read_rejects, rows_between, split
from .publish import publishing
from .shards import write_shard

REJECTS_NAME = "rejects.parquet"
PIECES_NAME = "pieces"
Progress = Callable[[str, int, int], None]  # stage, done, total
Item = TypeVar("Item")
Result = TypeVar("Result")


def silent(stage: str, done: int, total: int) -> None:
    """Tell nobody about progress."""


@dataclass(frozen=True)
class About:
    """What a new catalogue says of itself."""

    name: str
    description: str
    synthetic: bool
    ref_epoch_jyear: float
    facts: dict[str, Any]


@dataclass(frozen=True)
class IngestReport:
    """Every row accounted for: rows_in == catalogue.rows + sum(rejected.values())."""

    catalogue: Catalogue
    rows_in: int
    rejected: dict[str, int]


def build(
    sources: Sequence[Source],
    destination: Path,
    about: About,
    *,
    rows_per_leaf: int,
    workers: int,
    progress: Progress = silent,
    overwrite: bool = False,
) -> IngestReport:
    """Write a catalogue from sources; it appears at `destination` whole, or not at all.

    The shards' bits depend on the rows alone: not on the order of the sources nor on `workers`.
    Memory: for each worker one piece while splitting, one leaf while writing.
    """
    if rows_per_leaf < 1:
        raise BadInput("rows_per_leaf", rows_per_leaf, "at least 1")
    with publishing(destination, overwrite=overwrite) as work:
        splits = _split_all(sources, work / PIECES_NAME, workers, progress)
        counts = _total_counts(splits)
        cells = choose_leaves(counts, rows_per_leaf)
        labels = [source.label for source in sources]
        leaves, surplus = _write_leaves(work, cells, splits, labels, workers, progress)
        reasons = _write_rejects(work, pa.concat_tables([read_rejects(splits), surplus]))
        catalogue = _describe(about, leaves, [s.record for s in splits], reasons)
        catalogue = replace(catalogue, digest=write_manifest(work, catalogue))
        hats.write_hats_files(work, catalogue, _less(counts, surplus), rows_per_leaf)
        shutil.rmtree(work / PIECES_NAME)
    return IngestReport(open_catalogue(destination), sum(s.rows_in for s in splits), reasons)


def in_parallel(
    function: Callable[[Item], Result],
    items: Iterable[Item],
    workers: int,
    tell: Progress,
    stage: str,
) -> Iterator[Result]:
    """Results in the items' order, on Dask's threads, a bounded window of tasks at a time."""
    import dask

    if workers < 1:
        raise BadInput("workers", workers, "at least 1")
    items = list(items)
    waiting, done = iter(items), 0
    task = dask.delayed(function, pure=False)
    scheduler = "threads" if workers > 1 else "synchronous"
    while window := list(islice(waiting, 4 * workers)):
        tell(stage, done, len(items))
        tasks = [task(item) for item in window]
        yield from dask.compute(*tasks, scheduler=scheduler, num_workers=workers)
        done += len(window)
    tell(stage, done, len(items))


def _split_all(
    sources: Sequence[Source], folder: Path, workers: int, progress: Progress
) -> list[Split]:
    """Read every source once, into sorted pieces in a new folder."""
    folder.mkdir()
    numbered = list(enumerate(sources))
    results = in_parallel(
        lambda item: split(item[1], item[0], folder), numbered, workers, progress, "read"
    )
    return list(results)


def _total_counts(splits: Iterable[Split]) -> Pixels:
    counts = np.zeros(12 * 4**COUNT_ORDER, np.int64)
    for s in splits:
        for pixels, rows in s.counts:
            counts[pixels] += rows
    return counts


def _write_leaves(
    root: Path,
    cells: Sequence[Cell],
    splits: Sequence[Split],
    labels: Sequence[str],
    workers: int,
    progress: Progress,
) -> tuple[list[Leaf], pa.Table]:
    """Write all shards; also the rows left out of them, because their source_id is repeated."""
    pieces = [piece for s in splits for piece in s.pieces]
    repeated = duplicates.find(pieces)
    leaves: list[Leaf] = []
    surplus = [REJECTS.empty_table()]
    for leaf, bad in in_parallel(
        lambda cell: _write_leaf(root, cell, pieces, repeated, labels),
        cells, workers, progress, "write",
    ):  # fmt: skip
        leaves += [leaf] if leaf else []
        surplus.append(bad)
    return leaves, pa.concat_tables(surplus)


def _write_leaf(
    root: Path,
    cell: Cell,
    pieces: Sequence[Piece],
    repeated: duplicates.Duplicated,
    labels: Sequence[str],
) -> tuple[Leaf | None, pa.Table]:
    """Gather a leaf's rows from the pieces and write its shard; also the surplus duplicates."""
    parts = []
    for piece in pieces:
        if piece.first_29 < cell.end_29 and piece.last_29 >= cell.first_29:
            part = rows_between(piece, cell.first_29, cell.end_29)
            source = pa.array(np.full(part.num_rows, piece.source, np.int32))
            parts.append(part.append_column("_source", source))
    kept, surplus = repeated.part(pa.concat_tables(parts))
    bad = [REJECTS.empty_table()]
    for i in np.unique(surplus["_source"].to_numpy()).tolist():
        rows = surplus.filter(pa.compute.equal(surplus["_source"], i))
        reasons = pa.array([DUPLICATE] * rows.num_rows, pa.string())
        bad.append(rejects(rows, labels[i], rows[ROW_COLUMN], reasons))
    leaf = None
    if kept.num_rows:
        leaf = write_shard(root, cell.order, cell.pixel, kept.select(STORED.names).cast(STORED))
    return leaf, pa.concat_tables(bad)


def _write_rejects(root: Path, rejected: pa.Table) -> dict[str, int]:
    """Write the rejects table, if there is a row for it; returns the number for each reason."""
    if not rejected.num_rows:
        return {}
    keys = [("source", "ascending"), ("row", "ascending")]
    pq.write_table(rejected.sort_by(keys), root / REJECTS_NAME, write_page_checksum=True)
    counts = rejected["reason"].value_counts().to_pylist()
    return {entry["values"]: entry["counts"] for entry in sorted(counts, key=lambda e: e["values"])}


def _less(counts: Pixels, surplus: pa.Table) -> Pixels:
    """Rows by pixel without the surplus duplicates, so that the HATS maps add up to the rows."""
    left = counts.copy()
    if surplus.num_rows:
        pixels = healpix_29(surplus["ra"].to_numpy(), surplus["dec"].to_numpy())
        np.subtract.at(left, coarser(pixels, COUNT_ORDER), 1)
    return left


def _describe(
    about: About, leaves: Sequence[Leaf], records: Sequence[dict[str, Any]], reasons: dict[str, int]
) -> Catalogue:
    bands = [band for leaf in leaves for band in leaf.bands]
    return Catalogue(
        path="",
        name=about.name,
        description=about.description,
        ref_epoch_jyear=about.ref_epoch_jyear,
        synthetic=about.synthetic,
        rows=sum(leaf.rows for leaf in leaves),
        brightest_g_mag=min((band.brightest_g_mag for band in bands), default=None),
        faintest_g_mag=max((band.faintest_g_mag for band in bands), default=None),
        leaves=tuple(leaves),
        sources=tuple(records),
        rejected=reasons,
        facts=about.facts,
        digest="",
    )
