"""From sources to a published catalogue in passes that can be cut off anywhere and continued.

Pass 1 reads batches of sources into sorted pieces (`batches`). From their counts leaves are
chosen, and repeated source_ids are found (`duplicates`). Pass 2 writes the leaves, one marker
each. Last come the rejects, the HATS files, the manifest, and one rename (`publish`).
"""

from __future__ import annotations

import json
import shutil
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import chain
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from ..catalogue import (
    LEAVES_DTYPE,
    REJECTS_NAME,
    ROW_GROUPS_DTYPE,
    SOURCES_NAME,
    Catalogue,
    open_catalogue,
    shard_name,
    write_manifest,
)
from ..columns import LIMITS, UNITS
from ..coverage import of_rows
from ..documents import JsonObject
from ..engine.schedulers import LocalScheduler, Scheduler
from ..errors import BadInput, Damaged, Incomplete
from ..partition import COUNT_ORDER, Cell, Pixels, choose_leaves, coarser, healpix_29
from ..storage.durable import write_atomically
from . import duplicates, hats
from .batches import (
    Batch,
    BatchResult,
    RowSource,
    counts_of,
    finished,
    in_batches,
    rejects_of,
    split,
    sweep,
)
from .judging import DUPLICATE, ELSEWHERE, REJECTS
from .leaves import LeafDone, Written, leaf_done, surplus_of, write_leaf, written
from .memory import Budget
from .pieces import Pieces
from .publish import Workspace, publishing

REQUEST_NAME = "request.json"
PROGRESS_VERSION = 5  # of everything that is kept of an unfinished build
BATCH_BYTES = 96 << 20  # of files as they come: some 300,000 gzipped rows of Gaia
BATCH_SOURCES = 64
REJECTS_ROWS = 100_000
MOST_NAMED = 20  # files without a row
Progress = Callable[[str, int, int], None]  # stage, done, total
Reasons = dict[str, int]
Record = JsonObject  # of a source, as its batch keeps it


def silent(stage: str, done: int, total: int) -> None:
    """Tell nobody about progress."""


@dataclass(frozen=True)
class About:
    """What a new catalogue says of itself.

    coverage : as `coverage.Coverage.to_json` gives it; None where the rows are to tell.
    """

    name: str
    description: str
    synthetic: bool
    ref_epoch_jyear: float
    facts: JsonObject
    coverage: JsonObject | None = None

    def __post_init__(self) -> None:
        for name in ("name", "description"):  # one line each, as the files of HATS hold them
            object.__setattr__(self, name, " ".join(getattr(self, name).split()))


@dataclass(frozen=True)
class IngestReport:
    """Every row accounted for: rows_in == catalogue.rows + sum(rejected.values()).

    continued : batches that an earlier, unfinished run had read already; notes : what a person
    should know.
    """

    catalogue: Catalogue
    rows_in: int
    rejected: dict[str, int]
    continued: int
    notes: tuple[str, ...] = ()


def build(
    sources: Sequence[RowSource],
    destination: Path,
    about: About,
    *,
    rows_per_leaf: int,
    sizes: Sequence[int] | None = None,
    budget: Budget | None = None,
    scheduler: Scheduler | None = None,
    progress: Progress = silent,
    overwrite: bool = False,
    restart: bool = False,
) -> IngestReport:
    """Write a catalogue from sources; it appears at `destination` whole, or not at all.

    sizes : bytes of the sources, by which they are put into batches. The shards' bits depend on
    the rows alone: not on the order of the sources, the budget, or the scheduler. An unfinished
    build of the same request goes on where it stopped, unless `restart`; one of another request is
    refused. Raises BadInput, Damaged, and Incomplete (what is finished is kept).
    """
    budget = budget or Budget()
    budget.check(rows_per_leaf)
    scheduler = scheduler or LocalScheduler("synchronous", 1)
    sizes = [BATCH_BYTES] * len(sources) if sizes is None else sizes
    batches = list(in_batches(sources, sizes, BATCH_BYTES, BATCH_SOURCES))
    with publishing(destination, overwrite=overwrite, restart=restart) as work:
        _begin(work, about, rows_per_leaf, sources)
        splits, continued = _read_all(batches, work.progress, budget, scheduler, progress)
        records = list(chain.from_iterable(s.records for s in splits))
        notes = _notes_on(records, about, work.progress)
        _refuse_none(splits, records, notes, work.progress)
        pieces = Pieces(work.progress, list(chain.from_iterable(s.pieces for s in splits)))
        counts = _total_counts(splits, work.progress)
        cells = choose_leaves(counts, rows_per_leaf, pieces.rows_between)
        budget.check_leaves(cells)
        duplicates.find(pieces, work.progress, budget.bucket_rows)
        context = written(work, pieces, splits)
        done = _write_all(context, cells, scheduler, progress)
        _sweep(work.catalogue, done)
        reasons = _write_rejects(context, splits, done)
        _write_sources(work, records)
        leaves = np.concatenate([np.empty(0, LEAVES_DTYPE), *(leaf.leaf for leaf in done)])
        groups = np.concatenate([np.empty(0, ROW_GROUPS_DTYPE), *(d.row_groups for d in done)])
        final = _final_counts(counts, context, done)
        content = _content(about, leaves, records, done, reasons)
        content["coverage"] = about.coverage or of_rows(final).to_json()
        if content["rows_in"] != content["rows"] + sum(reasons.values()):
            raise Damaged(str(work.progress), "rows kept and rejected don't add up to those read")
        shape = hats.write_hats_files(work.catalogue, leaves, final)
        digest = write_manifest(work.catalogue, content, leaves, groups)
        hats.write_properties(work.catalogue, content, digest, rows_per_leaf, shape)
    catalogue = open_catalogue(destination)
    return IngestReport(catalogue, content["rows_in"], reasons, continued, notes)


def _begin(work: Workspace, about: About, rows_per_leaf: int, sources: Sequence[RowSource]) -> None:
    """Go on with an unfinished build of the same request, or begin a new one."""
    request = {
        "version": PROGRESS_VERSION,
        "about": asdict(about),
        "rows_per_leaf": rows_per_leaf,
        "sources": [source.identity()[0] for source in sources],
    }
    request = json.loads(json.dumps(request))
    path = work.progress / REQUEST_NAME
    try:
        earlier = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        for folder in work:
            shutil.rmtree(folder)
            folder.mkdir()
        write_atomically(path, json.dumps(request))
        return
    differs = [key for key in request if request[key] != earlier.get(key)]
    if differs:
        allowed = (
            "the arguments of the unfinished ingest that is kept there, to go on with it, or "
            f"--restart to discard it ({' and '.join(differs)} differ)"
        )
        raise BadInput("output", str(work.progress.parent), allowed)


def _notes_on(records: Sequence[Record], about: About, folder: Path) -> tuple[str, ...]:
    """What a person should know of the sources; BadInput where none of them has a row.

    Sources that say what they cover, such as a cone without a star, need none.
    """
    empty = [record["name"] for record in records if not record["rows"]]
    if 0 < len(empty) == len(records) and about.coverage is None:
        shutil.rmtree(folder, ignore_errors=True)  # there is nothing to go on with
        raise BadInput("source", "no row", f"at least one star ({_first(empty)}: no row in it)")
    notes = [f"{name} holds no row" for name in empty[:MOST_NAMED]]
    if len(empty) > MOST_NAMED:
        notes.append(f"{len(empty) - MOST_NAMED} more files hold no row")
    unlike = sum(record["unlike_gaia"] for record in records)
    if 1000 * unlike > sum(record["rows"] for record in records):
        text = f"{unlike} rows have source_ids below 2**45, which are hardly Gaia's"
        notes.append(f"{text}: their places were not compared with them")
    return (*notes, *_notes_on_limits(records), *_doubts(records))


def _doubts(records: Sequence[Record]) -> Iterator[str]:
    """What is likely to be wrong with the places of some sources; each doubt once."""
    of_sources: dict[str, list[str]] = {}
    for record in records:
        for doubt in record["doubts"]:
            of_sources.setdefault(doubt, []).append(record["name"])
    for doubt, names in of_sources.items():
        yield f"{_first(names)}: {doubt}"


def _first(names: Sequence[str]) -> str:
    """The first of some names, and how many there are beside it."""
    return f"{names[0]} and {len(names) - 1} more" if len(names) > 1 else names[0]


def _notes_on_limits(records: Sequence[Record]) -> Iterator[str]:
    """Of each column how many values no star has, which count as absent."""
    beyond: Counter[str] = Counter()
    for record in records:
        beyond.update(record["beyond"])
    for name, count in beyond.items():
        text = f"{count} value(s) of {name} beyond {LIMITS[name]:g} {UNITS[name]}"
        yield f"{text}, which no star has, count as absent: is its unit right?"


def _refuse_none(
    splits: Sequence[BatchResult], records: Sequence[Record], notes: Sequence[str], folder: Path
) -> None:
    """BadInput where there are rows, and each of them was rejected while it was read."""
    reasons: Counter[str] = Counter()
    for s in splits:
        reasons.update(s.reasons)
    rows = sum(record["rows"] for record in records)
    if not rows or sum(reasons.values()) < rows:
        return
    shutil.rmtree(folder, ignore_errors=True)  # there is nothing to go on with
    why = "; ".join([*(f"{reason}: {count}" for reason, count in reasons.most_common()), *notes])
    raise BadInput("source", f"{rows} rows, all rejected", f"at least one star ({why})")


def _run(scheduler: Scheduler, stage: str, tasks: Sequence[object], tell: Progress) -> None:
    """Run tasks (function, arguments...), telling how many are done."""
    done = 0
    tell(stage, done, len(tasks))

    def finished_one(_: str) -> None:
        nonlocal done
        done += 1
        tell(stage, done, len(tasks))

    graph = {(stage, i): task for i, task in enumerate(tasks)}
    if graph:
        scheduler.run(graph, list(graph), finished_one)


def _read_all(
    batches: Sequence[Batch], folder: Path, budget: Budget, scheduler: Scheduler, tell: Progress
) -> tuple[list[BatchResult], int]:
    """What came of all batches, in order; and how many of them were there already."""
    before = [done for batch in batches if (done := finished(batch, folder))]
    sweep(folder, before)
    tasks = [(split, batch, folder, budget.piece_rows) for batch in batches]
    try:
        _run(scheduler, "read", tasks, tell)
    except BaseException:
        if not any(finished(batch, folder) for batch in batches):
            shutil.rmtree(folder, ignore_errors=True)  # nothing was done: nothing stays
        raise
    splits = [done for batch in batches if (done := finished(batch, folder))]
    if len(splits) != len(batches):
        raise Incomplete(f"{len(batches) - len(splits)} batches are not there; run it again")
    return splits, len(before)


def _total_counts(splits: Iterable[BatchResult], folder: Path) -> Pixels:
    counts = np.zeros(12 * 4**COUNT_ORDER, np.int64)
    for s in splits:
        pixels, rows = counts_of(s, folder)
        counts[pixels] += rows
    return counts


def _write_all(
    context: Written, cells: Sequence[Cell], scheduler: Scheduler, tell: Progress
) -> list[LeafDone]:
    """Write all shards that are not there yet."""
    shared = scheduler.share(context)
    _run(scheduler, "write", [(write_leaf, shared, cell) for cell in cells], tell)
    done = [leaf for cell in cells if (leaf := leaf_done(context, cell))]
    if len(done) != len(cells):
        raise Incomplete(f"{len(cells) - len(done)} leaves are not there; run it again")
    return done


def _sweep(root: Path, done: Sequence[LeafDone]) -> None:
    """Remove what an earlier run left that is no part of this catalogue."""
    shards = {root / shard_name(d.cell.order, d.cell.pixel) for d in done if d.leaf.size}
    for path in root.rglob("*"):
        if path.is_file() and path not in shards:
            path.unlink()


def _write_rejects(
    context: Written, splits: Sequence[BatchResult], done: Sequence[LeafDone]
) -> Reasons:
    """Write the rejects table, if there is a row for it; returns the number for each reason.

    First the rows rejected while reading, in the order of the sources; then the surplus ones.
    """
    reasons: Counter[str] = Counter()
    for s in splits:
        reasons.update(s.reasons)
    elsewhere = sum(leaf.elsewhere for leaf in done)
    surplus = sum(leaf.surplus for leaf in done) - elsewhere
    reasons.update({DUPLICATE: surplus} if surplus else {})
    reasons.update({ELSEWHERE: elsewhere} if elsewhere else {})
    if reasons:
        path = context.work.catalogue / REJECTS_NAME
        path.parent.mkdir(exist_ok=True)
        read = chain.from_iterable(rejects_of(s, context.work.progress) for s in splits)
        left_out = chain.from_iterable(surplus_of(context, leaf) for leaf in done)
        with pq.ParquetWriter(path, REJECTS, compression="zstd", write_page_checksum=True) as file:
            for table in even(chain(read, left_out), REJECTS_ROWS):
                file.write_table(table)
    return dict(sorted(reasons.items()))


def _write_sources(work: Workspace, records: Sequence[Record]) -> None:
    """Write the table of the sources: name, bytes, MD5, rows."""
    kinds = {"name": pa.string(), "bytes": pa.int64(), "md5": pa.string(), "rows": pa.int64()}
    path = work.catalogue / SOURCES_NAME
    path.parent.mkdir(exist_ok=True)
    table = pa.Table.from_pylist(records, pa.schema(kinds))
    pq.write_table(table, path, compression="zstd", write_page_checksum=True)


def _final_counts(counts: Pixels, context: Written, done: Sequence[LeafDone]) -> Pixels:
    """Rows by pixel without the surplus ones, so that the HATS maps add up to the rows."""
    left = counts.copy()
    for leaf in done:
        for rows in surplus_of(context, leaf):
            pixels = healpix_29(rows["ra"].to_numpy(), rows["dec"].to_numpy())
            np.subtract.at(left, coarser(pixels, COUNT_ORDER), 1)
    return left


def _content(
    about: About,
    leaves: np.ndarray,
    records: Sequence[Record],
    done: Sequence[LeafDone],
    rejected: Reasons,
) -> JsonObject:
    """The manifest's content but for the digests; the coverage is as `about` says."""
    some = leaves.size > 0
    return {
        **asdict(about),
        "rows": int(leaves["rows"].sum()),
        "brightest_g_mag": float(leaves["brightest_g_mag"].min()) if some else None,
        "faintest_g_mag": float(leaves["faintest_g_mag"].max()) if some else None,
        "sources": len(records),
        "rows_in": sum(record["rows"] for record in records),
        "rejected": rejected,
        "without_colour": sum(leaf.without_colour for leaf in done),
    }


def even(tables: Iterable[pa.Table], rows: int) -> Iterator[pa.Table]:
    """The same rows in tables of `rows`, the last one smaller."""
    held: list[pa.Table] = []
    count = 0
    for table in tables:
        held.append(table)
        count += table.num_rows
        while count >= rows:
            whole = pa.concat_tables(held)
            yield whole.slice(0, rows)
            held, count = [whole.slice(rows)], count - rows
    if count:
        yield pa.concat_tables(held)
