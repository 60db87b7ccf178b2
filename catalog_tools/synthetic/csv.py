"""A synthetic catalogue as files: any number of rows in Gaia DR2's own layout, names and schema.

`GaiaSource_<smallest id>_<largest id>.csv.gz` with all 94 columns, cut on the borders of level-12
pixels, rows in no order; MD5SUM.txt, which also lists the _citation and _disclaimer files. About
1% of the stars have left the pixel of their source_id. Each file depends on (seed, rows, its
number) alone, appears whole, and is noted in `_made.jsonl`; a run that was cut off goes on.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from itertools import islice
from pathlib import Path

import numpy as np
from isal import igzip
from numpy.typing import NDArray

from ..errors import BadInput
from ..geometry.sphere import directions
from ..ingest.build import Progress, silent
from .columns import HEADER, KINDS, TEXTS, all_columns
from .plan import SyntheticPlan, make_plan
from .sample import check_sample, stars_of_file
from .text import rows_of_text

GZIP_LEVEL = 2  # of ISA-L: as large as zlib's 3, at 16 times the speed of its 6
MADE_NAME = "_made.jsonl"
MD5SUM_NAME = "MD5SUM.txt"
TEXT_FILES = {
    "_citation": "SYNTHETIC DATA. There is nothing to cite: no row is a real star.\n",
    "_disclaimer": "SYNTHETIC DATA in the layout of Gaia DR2, drawn from published star counts.\n"
    "No row is a real star. Not made by ESA, Gaia or DPAC.\n",
}


@dataclass(frozen=True)
class CsvReport:
    """What a set holds: files of rows, rows, and bytes of these files."""

    files: int
    rows: int
    bytes: int


@dataclass(frozen=True)
class MadeFile:
    """A finished file as it is noted; an empty name where no star was left for it."""

    number: int
    name: str
    rows: int
    bytes: int
    md5: str


def write_csv_files(
    destination: str | Path,
    rows: int,
    *,
    seed: int = 2,
    workers: int | None = None,
    progress: Progress | None = None,
) -> CsvReport:
    """Write exactly `rows` synthetic stars as Gaia DR2 files into a folder.

    rows : 1 to 2e9, a sample of the whole sky to G = 21; progress : called with (stage, done,
    total). The same arguments give the same files for any number of workers. Files that an earlier
    run with the same arguments finished are kept. Raises BadInput (rows, seed, workers,
    destination).
    """
    workers = (os.cpu_count() or 1) if workers is None else workers
    check_sample(rows, seed, workers)
    folder = Path(destination)
    made = _begin(folder, {"synthetic_rows": rows, "seed": seed})
    plan = make_plan(seed, rows)
    missing = [i for i in range(plan.files) if i not in made]
    tell = progress or silent
    with (folder / MADE_NAME).open("a", encoding="utf-8") as notes:
        tell("write", len(made), plan.files)
        for file in _in_threads(lambda i: _write_file(folder, plan, i), missing, workers):
            made[file.number] = file
            notes.write(json.dumps(asdict(file)) + "\n")
            notes.flush()
            tell("write", len(made), plan.files)
    written = [made[i] for i in sorted(made) if made[i].name]
    _write_texts(folder, written)
    return CsvReport(len(written), sum(f.rows for f in written), sum(f.bytes for f in written))


def _write_file(folder: Path, plan: SyntheticPlan, number: int) -> MadeFile:
    """Make one file: columns, text, gzip, and a rename."""
    stars, rng, first_row = stars_of_file(plan, number)
    ids = stars["source_id"]
    if not ids.size:
        return MadeFile(number, "", 0, 0, "")
    random_index = _random_index(plan.rows, first_row + np.arange(ids.size))
    v = directions(stars["ra"], stars["dec"])
    text = rows_of_text(KINDS, all_columns(rng, stars, v, random_index), TEXTS)
    header = (",".join(HEADER) + "\n").encode()
    data = igzip.compress(header + text, compresslevel=GZIP_LEVEL, mtime=0)
    name = f"GaiaSource_{ids.min()}_{ids.max()}.csv.gz"
    _publish(folder / name, data)
    return MadeFile(number, name, ids.size, len(data), _md5(data))


def _random_index(rows: int, row: NDArray[np.int64]) -> NDArray[np.int64]:
    """A permutation of 0 to rows - 1: multiplication by a number that is coprime to rows."""
    factor = int(rows * 0.6180339887) | 1
    while np.gcd(factor, rows) != 1:
        factor += 2
    return np.asarray(row * (factor % rows) % rows)


def _write_texts(folder: Path, written: Sequence[MadeFile]) -> None:
    """The release's files of text, and the digests of all files."""
    lines = [f"{file.md5}  {file.name}" for file in written]
    for name, text in TEXT_FILES.items():
        _publish(folder / name, text.encode())
        lines.append(f"{_md5(text.encode())}  {name}")
    _publish(folder / MD5SUM_NAME, ("\n".join(lines) + "\n").encode())


def _begin(folder: Path, arguments: dict[str, int]) -> dict[int, MadeFile]:
    """A new folder, or what an earlier run with the same arguments has finished in it."""
    notes = folder / MADE_NAME
    allowed = "a new or empty folder, or a set of the same rows and seed"
    if not notes.is_file():
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise BadInput("output", str(folder), allowed)
        folder.mkdir(parents=True, exist_ok=True)
        _publish(notes, (json.dumps(arguments) + "\n").encode())
        return {}
    text = notes.read_text(encoding="utf-8", errors="replace")
    lines = text[: text.rfind("\n") + 1].splitlines()
    try:
        begun, *done = map(json.loads, lines)
        made = [MadeFile(**note) for note in done]
    except (ValueError, TypeError):
        raise BadInput("output", str(folder), f"{allowed} (cannot read {MADE_NAME})") from None
    if begun != arguments:
        raise BadInput("output", str(folder), f"{allowed} (this one: {lines[0]})")
    if not text.endswith("\n"):
        _publish(notes, ("\n".join(lines) + "\n").encode())
    return {file.number: file for file in made if _is_there(folder, file)}


def _is_there(folder: Path, file: MadeFile) -> bool:
    path = folder / file.name
    return not file.name or (path.is_file() and path.stat().st_size == file.bytes)


def _in_threads(
    function: Callable[[int], MadeFile], items: list[int], workers: int
) -> Iterator[MadeFile]:
    """Results in order, a bounded number of tasks under way."""
    waiting = iter(items)
    with ThreadPoolExecutor(workers) as pool:
        tasks = deque(pool.submit(function, i) for i in islice(waiting, workers + 1))
        try:
            while tasks:
                result = tasks.popleft().result()
                tasks.extend(pool.submit(function, i) for i in islice(waiting, 1))
                yield result
        finally:
            pool.shutdown(cancel_futures=True)


def _publish(path: Path, data: bytes) -> None:
    """Write a file under another name, then rename it."""
    part = path.with_name(f".{path.name}.part")
    part.write_bytes(data)
    part.replace(path)


def _md5(data: bytes) -> str:
    return hashlib.md5(data, usedforsecurity=False).hexdigest()
