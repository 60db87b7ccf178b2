"""Arrays that are dear to make, kept on disk for other processes by all that they follow from.

A file is there whole or not at all, whoever else writes it; one that is damaged is made again; a
folder that cannot be written keeps nothing. The least recently used go.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import platform
import time
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path
from uuid import uuid4

import llvmlite.binding
import numpy as np

from catalog_tools.documents import JsonObject
from catalog_tools.engine.code import LIBRARIES, sources

MOST_BYTES, MOST_FILES = 512e6, 4096
WORTH_S = 0.01  # that making them takes: less is as quick made as read
LOOKED_AFTER = 32  # files written by a process, of which the folder is looked at

Arrays = dict[str, np.ndarray]

_written = 0


def cache_folder() -> Path:
    """NIGHTGLASS_CACHE, else the platform's cache folder (XDG_CACHE_HOME or ~/.cache)."""
    named = os.environ.get("NIGHTGLASS_CACHE")
    if named:
        return Path(named)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "nightglass"


def kept(content: tuple[object, ...], make: Callable[[], JsonObject]) -> Arrays:
    """The named arrays and numbers that `make` gives, from disk where they are known.

    content : all that they follow from beside the physics' own code: numbers, text, arrays,
        dataclasses and tuples of these. TypeError for what has no content of its own.
    """
    path = cache_folder() / "responses" / f"{_digest(content)}.npz"
    with contextlib.suppress(OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        with np.load(path, allow_pickle=False) as stored:
            found = {name: stored[name] for name in stored.files}
        os.utime(path)
        return found
    started = time.perf_counter()
    made = {name: np.asarray(value, order="C") for name, value in make().items()}
    if time.perf_counter() - started >= WORTH_S:
        with contextlib.suppress(OSError):
            _write(path, made)
    return made


def kept_array(content: tuple[object, ...], make: Callable[[], np.ndarray]) -> np.ndarray:
    """The same of one array."""
    return kept(content, lambda: {"values": make()})["values"]


def kept_number(content: tuple[object, ...], make: Callable[[], float]) -> float:
    """The same of one number."""
    return float(kept(content, lambda: {"values": make()})["values"])


def _write(path: Path, made: JsonObject) -> None:
    global _written
    path.parent.mkdir(parents=True, exist_ok=True)
    own = path.with_name(f".{path.stem}.{uuid4().hex}.tmp")
    try:
        with own.open("wb") as handle:
            np.savez(handle, **made)
        own.replace(path)
    finally:
        own.unlink(missing_ok=True)
    if _written % LOOKED_AFTER == 0:
        _shrink(path.parent)
    _written += 1


def _shrink(folder: Path) -> None:
    """Leave three quarters of the most that the folder may hold, where it holds more."""
    files = []
    for path in folder.iterdir():
        with contextlib.suppress(FileNotFoundError):  # another process removed it
            status = path.stat()
            files.append((status.st_mtime, status.st_size, path))
    bytes_, count = sum(size for _, size, _ in files), len(files)
    if bytes_ <= MOST_BYTES and count <= MOST_FILES:
        return
    for _, size, path in sorted(files):
        if bytes_ <= 0.75 * MOST_BYTES and count <= 0.75 * MOST_FILES:
            return
        path.unlink(missing_ok=True)
        bytes_, count = bytes_ - size, count - 1


def _digest(content: tuple[object, ...]) -> str:
    told = hashlib.sha256(_code())
    for part in _parts(content):
        told.update(part)
        told.update(b"\0")
    return told.hexdigest()[:40]


def _parts(value: object) -> Iterator[bytes]:
    """A value's content, piece by piece."""
    if isinstance(value, np.ndarray):
        yield f"{value.dtype.str}{value.shape}".encode()
        yield np.ascontiguousarray(value).tobytes()
    elif isinstance(value, tuple):
        yield f"({len(value)}".encode()
        for one in value:
            yield from _parts(one)
    elif is_dataclass(value):
        yield type(value).__qualname__.encode()
        for field in fields(value):
            yield from _parts(getattr(value, field.name))
    elif value is None or isinstance(value, bool | int | float | str | np.generic):
        yield repr(value).encode()
    else:
        raise TypeError(f"no content of its own: {type(value).__name__}")


@cache
def _code() -> bytes:
    """What else arrays follow from: the code of the physics, its libraries and the processor."""
    told = hashlib.sha256()
    for source in sources(Path(__file__).parent / "physics"):
        told.update(source)
    for name in LIBRARIES:
        told.update(version(name).encode())
    told.update(f"{platform.machine()} {llvmlite.binding.get_host_cpu_name()}".encode())
    return told.digest()
