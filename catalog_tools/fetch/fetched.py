"""What a fetched folder covers: which of its files bring which part of the sky, kept beside them.

Fetch writes it, ingest reads it. A record counts for a catalogue if all files that it names are
among the catalogue's sources.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from pathlib import Path

from ..coverage import Coverage, from_json, united
from ..documents import JsonObject
from ..storage.durable import write_atomically

COVERAGE_NAME = ".fetch/coverage.json"  # beside the ledger, where ingest takes no file for a source
FORMAT = "nightglass/fetched-coverage/1"


def note_coverage(folder: Path, files: Iterable[str], coverage: Coverage) -> None:
    """Keep, with what is kept already, that some files of a folder together cover a region."""
    record = {"files": sorted(files), "coverage": coverage.to_json()}
    records = [r for r in _records(folder) if r != record]
    document = {"format": FORMAT, "records": [*records, record]}
    write_atomically(folder / COVERAGE_NAME, json.dumps(document))


def stated_coverage(paths: Sequence[Path]) -> tuple[Coverage | None, tuple[str, ...]]:
    """What the records beside some files say that these cover together, and notes for a person.

    None where there is no record, or where not every file is in one whose files are all there.
    """
    names: dict[Path, set[str]] = {}
    for path in paths:
        names.setdefault(path.parent, set()).add(path.name)
    parts, recorded, records = [], 0, 0
    for folder, present in names.items():
        mine = _records(folder)
        whole = [r for r in mine if present.issuperset(r["files"])]
        parts += [from_json(r["coverage"]) for r in whole]
        recorded += len(set().union(*(r["files"] for r in whole)))
        records += len(mine)
    if parts and recorded == len(set(paths)):
        return united(parts), ()
    if not records:
        return None, ()
    lacking = "not every source is a fetched file with all that were fetched for the same region"
    return None, (f"{lacking}: what the catalogue covers is derived from its rows",)


def _records(folder: Path) -> list[JsonObject]:
    """The records of a folder; none where the file is absent or can't be understood."""
    try:
        document = json.loads((folder / COVERAGE_NAME).read_text(encoding="utf-8"))
        if document["format"] != FORMAT:
            return []
        for record in document["records"]:
            from_json(record["coverage"])
            set(record["files"])
        return list(document["records"])
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return []
