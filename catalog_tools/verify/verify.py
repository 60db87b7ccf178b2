"""Verify a whole catalogue: every byte, every row, every count; all problems found are listed."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import islice

import numpy as np

from ..catalogue import MANIFEST_NAME, Catalogue
from ..engine.ahead import ahead, cores
from ..errors import BadInput, Damaged
from ..partition import COUNT_ORDER
from ..query.query import read_leaf
from .distinct import temporary_distinct
from .files import check_coverage, check_files, check_hats, check_tables
from .shards import Finding, check_shard

__all__ = ["Finding", "VerifyReport", "verify"]

MOST_REPEATED = 100  # repeated source_ids that are named one by one
Progress = Callable[[str, int, int], None]  # stage, done, total


@dataclass(frozen=True)
class VerifyReport:
    """What was proved, and what is wrong. `notes` tell what could not be looked at."""

    catalogue: str
    shards: int
    row_groups: int
    rows: int
    bytes: int
    findings: tuple[Finding, ...]
    notes: tuple[str, ...]

    @property
    def whole(self) -> bool:
        """Whether nothing is wrong."""
        return not self.findings


def verify(
    catalogue: Catalogue, *, workers: int | None = None, progress: Progress | None = None
) -> VerifyReport:
    """Read all of a catalogue and compare it with its manifest.

    Checked: lengths and crc32c of shards, footers and row groups; page checksums; that each row is
    in its shard's HEALPix pixel and its `_healpix_29` that of its place; magnitudes, places,
    motions and parallaxes within what the manifest says of row group and leaf; all counts; the
    HATS files; the coverage that follows from the rows, and the number without a colour; that no
    source_id occurs twice; files missing and extra. Damage is returned, not raised. `workers`
    threads take one shard each in memory; source_ids (8 bytes a row) go to a temporary folder.
    Raises BadInput, and Incomplete where a remote store gives no answer or that folder has no room.
    """
    workers = cores() if workers is None else workers
    if workers < 1:
        raise BadInput("workers", workers, "at least 1")
    tell = progress or (lambda *_: None)
    total = catalogue.leaf_table.size
    findings = check_tables(catalogue)
    more, notes = check_files(catalogue)
    findings += more
    rows, colourless, counts = 0, 0, np.zeros(12 * 4**COUNT_ORDER, np.int64)
    with temporary_distinct(catalogue.rows) as ids, ThreadPoolExecutor(workers) as pool:
        tell("verify", 0, total)
        checks = ahead(pool, lambda i: check_shard(catalogue, i), range(total), 2 * workers)
        for i, check in enumerate(checks):
            findings += check.findings
            rows += check.rows
            colourless += check.without_colour
            np.add.at(counts, check.pixels, check.counts)
            ids.add(check.source_ids)
            tell("verify", i + 1, total)
        findings += _repeated(catalogue, list(islice(ids.repeated(), MOST_REPEATED + 1)))
    findings += check_hats(catalogue, counts, all_rows=rows == catalogue.rows)
    findings += check_coverage(catalogue, counts, all_rows=rows == catalogue.rows)
    if rows == catalogue.rows and catalogue.without_colour not in (None, colourless):
        what = f"says {catalogue.without_colour} rows have no colour; there are {colourless}"
        findings.append(Finding(MANIFEST_NAME, what))
    return VerifyReport(
        catalogue.path,
        total,
        catalogue.row_group_table.size,
        rows,
        int(catalogue.leaf_table["bytes"].sum()),
        tuple(findings),
        tuple(notes),
    )


def _repeated(catalogue: Catalogue, repeated: list[int]) -> list[Finding]:
    """Repeated source_ids, each with the shards that hold it."""
    if not repeated:
        return []
    places: dict[int, list[str]] = {number: [] for number in repeated[:MOST_REPEATED]}
    wanted = np.array(list(places))
    for leaf in catalogue.leaves:
        try:
            held = read_leaf(catalogue, leaf, None, ["source_id"])["source_id"].to_numpy()
        except Damaged:
            continue  # named already
        for number in held[np.isin(held, wanted)].tolist():
            places[number].append(leaf.path)
    found = [
        Finding(
            where[0] if where else MANIFEST_NAME,
            f"source_id {number} occurs more than once (in {', '.join(where)})",
        )
        for number, where in places.items()
    ]
    if len(repeated) > MOST_REPEATED:
        found.append(Finding(MANIFEST_NAME, "more source_ids occur more than once"))
    return found
