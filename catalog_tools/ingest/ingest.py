"""Ingest: files of stars become a catalogue; every file and every row accounted for."""

from __future__ import annotations

import hashlib
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import pyarrow as pa

from ..coverage import Coverage, all_sky
from ..documents import JsonObject
from ..engine.ahead import cores
from ..engine.schedulers import LocalScheduler, Scheduler
from ..errors import BadInput, Damaged
from ..fetch.fetched import stated_coverage
from ..fetch.layout import RELEASES
from ..forms import Form, load_form
from ..partition import ROWS_PER_LEAF
from ..readers import kind_of, read_tables, told_form
from ..storage.durable import file_digest
from .build import About, IngestReport, Progress, build, silent
from .memory import DEFAULT_BYTES, Budget

SYNTHETIC_MARK = "_made.jsonl"  # beside files that `catalog demo --as-csv` made
MD5SUM_NAMES = ("MD5SUM.txt", "_MD5SUM.txt")


@dataclass(frozen=True)
class FileSource:
    """A source for `build`: one input file, as it was when the ingest began."""

    path: str
    label: str
    size: int
    mtime_ns: int
    form: Form
    expected_md5: str | None
    most_bytes: int

    @property
    def ids_hold_place(self) -> bool:
        """Whether its source_ids are Gaia's, from which places follow."""
        return self.form.source_id.holds_place

    def identity(self) -> list[object]:
        return [self.path, self.size, self.mtime_ns, self.expected_md5]

    def tables(self, record: JsonObject) -> Iterator[pa.Table]:
        """Its rows; at the end its length and MD5 are compared with what was expected."""
        md5 = hashlib.md5(usedforsecurity=False)
        doubts = record.get("doubts")
        yield from read_tables(
            Path(self.path), self.form, md5=md5, most_bytes=self.most_bytes, doubts=doubts
        )
        state = Path(self.path).stat()
        if (state.st_size, state.st_mtime_ns) != (self.size, self.mtime_ns):
            raise Damaged(self.path, "it was changed while it was read")
        record.update(bytes=self.size, md5=md5.hexdigest())
        if self.expected_md5 not in (None, record["md5"]):
            raise Damaged(
                self.path, f"its MD5 is {record['md5']}; MD5SUM.txt says {self.expected_md5}"
            )


def ingest(
    sources: Sequence[str | Path],
    destination: str | Path,
    *,
    form: str | Path | None = None,
    name: str | None = None,
    rows_per_leaf: int = ROWS_PER_LEAF,
    memory_bytes: int = DEFAULT_BYTES,
    workers: int | None = None,
    scheduler: Scheduler | None = None,
    progress: Progress | None = None,
    overwrite: bool = False,
    restart: bool = False,
) -> IngestReport:
    """Write a catalogue from files of stars (a folder stands for its files).

    form : what the files' columns mean: the name of a built-in form or the path of a column map;
    by default Gaia DR2 or DR3, told from the files. memory_bytes : the most that one worker may
    take. scheduler : where the tasks run; threads of this process, `workers` of them, by default.
    progress : called with (stage, done, total). The catalogue appears at `destination` whole or
    not at all, with the same shard bits for any order of the sources and any number of workers. An
    ingest that was cut off goes on where it stopped. Raises BadInput (sources, destination,
    schema), Damaged (an input file) and Incomplete.
    """
    if workers is not None and workers < 1:
        raise BadInput("workers", workers, "at least 1")
    tell = progress or silent
    budget = Budget(memory_bytes)
    paths, left_out = list_files(sources)
    most_bytes = budget.file_bytes
    meaning, assumed = _meaning(form, paths[0], most_bytes)
    files = _look_at(paths, meaning, most_bytes, tell)
    _refuse_twins(files)
    coverage, notes = _coverage(paths, meaning)
    facts = assumed | ({"subfolders_left_out": left_out} if left_out else {})
    report = build(
        files,
        Path(destination),
        _about(name or meaning.name, meaning, paths, coverage, facts),
        rows_per_leaf=rows_per_leaf,
        sizes=[file.size for file in files],
        budget=budget,
        scheduler=scheduler or LocalScheduler("threads", workers or cores()),
        progress=tell,
        overwrite=overwrite,
        restart=restart,
    )
    notes += _md5_notes(files) + tuple(map("the release is {}".format, assumed.values()))
    if left_out:
        notes += (f"{left_out} subfolders were not looked into: name them to take their files",)
    return replace(report, notes=report.notes + notes)


def _meaning(form: str | Path | None, first: Path, most_bytes: int) -> tuple[Form, dict[str, str]]:
    """The form asked for, or that of the first file; and what was assumed of the files."""
    if form is not None:
        return load_form(form), {}
    meaning, is_told = told_form(first, most_bytes=most_bytes)
    if is_told:
        return meaning, {}
    text = f"not named by the files, taken to be Gaia DR2, epoch {meaning.ref_epoch_jyear}"
    remedy = "--form gaia_dr3 if it is DR3; for another epoch a column map"
    return meaning, {"release": f"{text} ({remedy})"}


def _about(
    name: str,
    form: Form,
    paths: Sequence[Path],
    coverage: Coverage | None,
    facts: JsonObject,
) -> About:
    """What the catalogue of these files says of itself. facts : more of them."""
    synthetic = any((path.parent / SYNTHETIC_MARK).is_file() for path in paths)
    return About(
        name=name,
        description=f"{'SYNTHETIC. ' * synthetic}{form.description} {len(paths)} files.",
        synthetic=synthetic,
        ref_epoch_jyear=form.ref_epoch_jyear,
        facts={
            "form": form.name,
            "credit": form.credit,
            "form_sha256": hashlib.sha256(repr(form).encode()).hexdigest(),
            "epoch_scale": form.epoch_scale,
            **facts,
        },
        coverage=None if coverage is None else coverage.to_json(),
    )


def list_files(sources: Sequence[str | Path]) -> tuple[list[Path], int]:
    """The input files: each path given, and of a folder all files but hidden ones, the archive's
    list of MD5 digests, and its `_citation` and `_disclaimer` files.

    Also how many subfolders were not looked into, as they are no sources themselves.
    """
    paths: list[Path] = []
    for source in map(Path, sources):
        if not source.exists():  # nor does a link that leads to itself
            raise BadInput("source", str(source), "a file or folder that exists")
    named, left_out = {Path(source).resolve() for source in sources}, 0
    for source in map(Path, sources):
        inside, below = ([source], []) if source.is_file() else _inside(source)
        paths += inside
        left_out += sum(p.resolve() not in named for p in below)
    if not paths:
        raise BadInput("source", [], "at least one file")
    return paths, left_out


def _inside(folder: Path) -> tuple[list[Path], list[Path]]:
    """Files of stars in a folder, at least one, and its subfolders."""
    entries = [p for p in sorted(folder.iterdir()) if _holds_rows(p.name)]
    inside, below = [p for p in entries if p.is_file()], [p for p in entries if p.is_dir()]
    if not inside:
        hint = f" (name its {len(below)} subfolders: they are not looked into)" if below else ""
        raise BadInput("source", str(folder), f"a folder with files of stars{hint}")
    return inside, below


def _coverage(paths: Sequence[Path], form: Form) -> tuple[Coverage | None, tuple[str, ...]]:
    """What the sources say that they cover: as a whole release, or as they were fetched."""
    release = RELEASES.get(form.name.replace("_", "-"))
    names = {path.name for path in paths}
    if release is not None and len(paths) == len(names) >= release.files:
        listed = {n for folder in {p.parent for p in paths} for n in _md5_sums(folder)}
        wanted = {name for name in listed if release.file_name.fullmatch(name)}
        if len(wanted) == release.files and wanted <= names:
            return all_sky(f"all files of {release.title}"), ()
    return stated_coverage(paths)


def _holds_rows(name: str) -> bool:
    return not name.startswith((".", "_")) and name not in MD5SUM_NAMES


def _look_at(
    paths: Sequence[Path], form: Form, most_bytes: int, tell: Progress
) -> list[FileSource]:
    """The files in the order of their names; each is of a kind that can be read."""
    sums = {folder: _md5_sums(folder) for folder in {path.parent for path in paths}}
    times = Counter(path.name for path in paths)
    files = []
    for i, path in enumerate(paths):
        if i % 256 == 0:
            tell("check", i, len(paths))
        kind_of(path)
        state = path.stat()
        label = path.name if times[path.name] == 1 else str(path)
        expected = sums[path.parent].get(path.name)
        identity = (str(path.absolute()), label, state.st_size, state.st_mtime_ns)
        files.append(FileSource(*identity, form, expected, most_bytes))
    tell("check", len(paths), len(paths))
    return sorted(files, key=lambda file: (file.label, file.path))


def _md5_sums(folder: Path) -> dict[str, str]:
    """What the archive's list of digests in a folder says, by file name."""
    sums = {}
    for name in MD5SUM_NAMES:
        try:
            text = (folder / name).read_text(encoding="utf-8", errors="replace")
        except OSError:
            continue
        for line in text.splitlines():
            words = line.split()
            if len(words) == 2 and len(words[0]) == 32:
                sums[Path(words[1].lstrip("*")).name] = words[0].lower()
    return sums


def _md5_notes(files: Sequence[FileSource]) -> tuple[str, ...]:
    """What lists of digests say of files that are not there, and which files none tells of."""
    names = {Path(file.path).name for file in files}
    listed = {name for folder in {Path(f.path).parent for f in files} for name in _md5_sums(folder)}
    absent = sum(_holds_rows(name) for name in listed - names)
    unlisted = sum(file.expected_md5 is None for file in files)
    notes = []
    if absent:
        notes.append(f"{absent} files that MD5SUM.txt lists are not among the sources")
    if listed and unlisted:
        notes.append(f"{unlisted} sources are not in MD5SUM.txt: their content was not verified")
    return tuple(notes)


def _refuse_twins(files: Sequence[FileSource]) -> None:
    """A file given twice, under whatever name, would count its rows twice.

    Only files of the same size can be the same: no other is read for this.
    """
    by_size: dict[int, list[FileSource]] = defaultdict(list)
    for file in files:
        by_size[file.size].append(file)
    for group in by_size.values():
        seen: dict[str, str] = {}
        for file in group if len(group) > 1 else []:
            digest = file_digest(Path(file.path))
            if digest in seen:
                allowed = f"each file once ({seen[digest]} and {file.path} have the same content)"
                raise BadInput("source", "a file given twice", allowed)
            seen[digest] = file.path
