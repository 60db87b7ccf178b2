"""Ingest: files of Gaia DR2 rows become a catalogue; every file and row accounted for."""

from __future__ import annotations

import hashlib
import os
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa

from .build import About, IngestReport, Progress, build, in_parallel, silent
from .errors import BadInput, Damaged
from .partition import ROWS_PER_LEAF
from .readers import REF_EPOCH_JYEAR, kind_of, read_tables

MD5SUM_NAME = "MD5SUM.txt"


@dataclass(frozen=True)
class FileSource:
    """A source for `build`: one input file, whose content is known by its MD5 digest."""

    path: Path
    label: str
    size: int
    md5: str

    def tables(self) -> Iterator[pa.Table]:
        return read_tables(self.path)

    def record(self) -> dict[str, Any]:
        return {"name": self.label, "bytes": self.size, "md5": self.md5}


def ingest(
    sources: Sequence[str | Path],
    destination: str | Path,
    *,
    name: str = "gaia_dr2",
    rows_per_leaf: int = ROWS_PER_LEAF,
    workers: int | None = None,
    progress: Progress | None = None,
    overwrite: bool = False,
) -> IngestReport:
    """Write a catalogue from Gaia DR2 files (CSV, CSV.gz, FITS, VOTable; a folder stands for its).

    progress : called with (stage, done, total). The catalogue appears at `destination` whole or
    not at all, with the same shard bits for any order of the sources and any number of workers.
    Raises BadInput (sources, destination, schema) and Damaged (an input file).
    """
    workers = (os.cpu_count() or 1) if workers is None else workers
    tell = progress or silent
    paths = list_files(sources)
    files = list(in_parallel(_look_at, paths, workers, tell, "check"))
    files.sort(key=lambda file: (file.label, str(file.path)))
    _refuse_twins(files)
    about = About(
        name=name,
        description=f"Gaia DR2 rows from {len(files)} files. Data: ESA/Gaia/DPAC.",
        synthetic=False,
        ref_epoch_jyear=REF_EPOCH_JYEAR,
        facts={"release": "Gaia DR2", "epoch_scale": "TCB"},
    )
    return build(
        files,
        Path(destination),
        about,
        rows_per_leaf=rows_per_leaf,
        workers=workers,
        progress=tell,
        overwrite=overwrite,
    )


def list_files(sources: Sequence[str | Path]) -> list[Path]:
    """The input files: each path given, and of a folder all files but hidden ones, MD5SUM.txt and
    the archive's `_citation` and `_disclaimer` files."""
    paths: list[Path] = []
    for source in map(Path, sources):
        if not source.exists():
            raise BadInput("source", str(source), "a file or folder that exists")
        if source.is_file():
            paths.append(source)
            continue
        inside = [p for p in sorted(source.iterdir()) if p.is_file() and _holds_rows(p.name)]
        if not inside:
            raise BadInput("source", str(source), "a folder with Gaia DR2 files")
        paths += inside
    if not paths:
        raise BadInput("source", [], "at least one file")
    return paths


def _holds_rows(name: str) -> bool:
    return not name.startswith((".", "_")) and name != MD5SUM_NAME


def _look_at(path: Path) -> FileSource:
    """Kind, size and digest of an input file; its digest is compared with MD5SUM.txt beside it."""
    kind_of(path)
    with path.open("rb") as file:
        md5 = hashlib.file_digest(file, lambda: hashlib.md5(usedforsecurity=False)).hexdigest()
    expected = expected_md5(path)
    if expected is not None and expected != md5:
        raise Damaged(str(path), f"its MD5 is {md5}; {MD5SUM_NAME} says {expected}")
    return FileSource(path, path.name, path.stat().st_size, md5)


def expected_md5(path: Path) -> str | None:
    """What MD5SUM.txt beside a file says of it; None where there is none, or no line for it."""
    try:
        text = (path.parent / MD5SUM_NAME).read_text(encoding="utf-8", errors="replace")
    except OSError:
        return None
    for line in text.splitlines():
        words = line.split()
        if len(words) == 2 and Path(words[1].lstrip("*")).name == path.name:
            return words[0].lower()
    return None


def _refuse_twins(files: Sequence[FileSource]) -> None:
    """A file given twice, under whatever name, would count its rows twice."""
    digest, times = Counter(file.md5 for file in files).most_common(1)[0]
    if times > 1:
        twins = [str(file.path) for file in files if file.md5 == digest]
        raise BadInput("source", twins, "each file once (these have the same content)")
