"""The destination folder: one fetch at a time, and a record of the files that were verified.

Everything that is not a finished file lives in the hidden folder `.fetch`, which ingest does not
look into: files under way (`parts/NAME.part` with `NAME.part.json` beside), the lock, and the
ledger. The ledger only saves time: a file that is not in it is hashed again.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from ..documents import JsonObject
from ..errors import BadInput
from ..storage.durable import sync
from .layout import Release

HIDDEN = ".fetch"
LEDGER_NAME = "verified.jsonl"
RELEASE_NAME = "release"


class FileLedger:
    """Which files of a folder were verified, by size, time of change and MD5; safe for threads."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.parts = folder / HIDDEN / "parts"
        self._path = folder / HIDDEN / LEDGER_NAME
        self._lock = threading.Lock()
        self._known = dict(_read(self._path))

    def part(self, name: str) -> Path:
        """Where a file stays until it is verified."""
        return self.parts / f"{name}.part"

    def md5_of(self, name: str) -> str | None:
        """The digest that the file had when it was verified; None if it changed since, or never."""
        record = self._known.get(name)
        if record is None or record[:2] != _state(self.folder / name):
            return None
        return record[2]

    def add(self, name: str, md5: str) -> None:
        """Note a file as verified, for later runs too."""
        state = _state(self.folder / name)
        if state is None:
            return
        line = json.dumps({"name": name, "size": state[0], "mtime_ns": state[1], "md5": md5})
        with self._lock:
            self._known[name] = (*state, md5)
            with self._path.open("a+b") as file:
                torn = file.tell() > 0 and _last_byte(file) != b"\n"  # killed as it wrote
                file.write(b"\n" * torn + line.encode() + b"\n")

    def publish(self, name: str, md5: str) -> None:
        """Give a verified part its name: on disk first, then visible, then noted."""
        part, target = self.part(name), self.folder / name
        sync(part)
        part.replace(target)
        sync(self.folder)
        self.add(name, md5)


def _last_byte(file: BinaryIO) -> bytes:
    file.seek(-1, os.SEEK_END)
    return file.read(1)


@contextmanager
def folder_for(destination: Path, release: Release) -> Iterator[FileLedger]:
    """The ledger of a folder that this process alone fetches into.

    Raises BadInput where the folder can't be made or written, where another fetch is at work, and
    where it holds another release. The lock is the kernel's: it ends with the process.
    """
    field, hidden = "destination", destination / HIDDEN
    try:
        (hidden / "parts").mkdir(parents=True, exist_ok=True)
        lock = (hidden / "lock").open("a")
    except OSError as error:
        raise BadInput(
            field, str(destination), f"a folder that can be written ({error.strerror})"
        ) from None
    with lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            allowed = "a folder into which no other fetch is writing"
            raise BadInput(field, str(destination), allowed) from None
        held = _held_release(hidden, release.name)
        if held != release.name:
            raise BadInput(field, str(destination), f"an empty folder, or one of {held} files")
        yield FileLedger(destination)


def write_whole(folder: Path, name: str, content: bytes) -> None:
    """Write a small file of the folder so that it is whole or not there."""
    new = folder / HIDDEN / f"{name}.new"
    new.write_bytes(content)
    sync(new)
    new.replace(folder / name)


def file_md5(path: Path) -> str:
    """MD5 digest of a file, hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, lambda: hashlib.md5(usedforsecurity=False)).hexdigest()


def _held_release(hidden: Path, name: str) -> str:
    """The release of the folder; `name` from now on where it had none."""
    path = hidden / RELEASE_NAME
    if path.exists():
        return path.read_text(encoding="utf-8").strip() or name
    path.write_text(name + "\n", encoding="utf-8")
    return name


def _state(path: Path) -> tuple[int, int] | None:
    try:
        stat = path.stat()
    except OSError:
        return None
    return stat.st_size, stat.st_mtime_ns


def _read(path: Path) -> Iterator[tuple[str, tuple[int, int, str]]]:
    """Records in order; a line that a kill cut off counts for nothing."""
    try:
        text = path.read_text(encoding="utf-8", errors="replace")
    except FileNotFoundError:
        return
    for line in text.splitlines():
        try:
            record: JsonObject = json.loads(line)
            yield record["name"], (int(record["size"]), int(record["mtime_ns"]), record["md5"])
        except (ValueError, KeyError, TypeError):
            continue
