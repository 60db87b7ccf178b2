"""Files that are there whole, or not at all, whoever else writes the same one."""

from __future__ import annotations

import hashlib
import io
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from uuid import uuid4

import numpy as np

from ..errors import NO_ROOM, DiskFull

MAKE_ROOM = "make room and run the same command again"


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a sibling of `path` that no other writer has; written, it takes the name `path`.

    It reaches the disk first. If the block fails, `path` is as it was and the sibling is gone. Its
    path is absolute: Arrow takes the `run:1` of a relative `run:1/a.parquet` for a kind of URL.
    """
    own = path.absolute().with_name(f".{path.name}.{uuid4().hex}.tmp")
    try:
        yield own
        sync(own)
        own.replace(path)
        sync(path.parent)
    finally:
        own.unlink(missing_ok=True)


def write_atomically(path: Path, content: bytes | str) -> None:
    """Write a small file (text as UTF-8) whole or not at all."""
    with whole_file(path) as own:
        own.write_bytes(content.encode() if isinstance(content, str) else content)


def save_array(path: Path, array: np.ndarray) -> None:
    """`numpy.save` whose error on a full disk says so: numpy's own, on a real file, has no number.

    The array is small: its bytes are held twice.
    """
    held = io.BytesIO()
    np.save(held, array, allow_pickle=False)
    path.write_bytes(held.getbuffer())


@contextmanager
def full_disk_told(store: Path | str, remedy: str) -> Iterator[None]:
    """A full disk as one message: which store, and what to do. Raises DiskFull.

    A file elsewhere (a cache on another disk) is named itself.
    """
    try:
        yield
    except DiskFull as error:  # of a store inside of this one: what to do is said of the whole
        raise DiskFull(str(store), error.code, remedy) from error
    except OSError as error:
        if error.errno not in NO_ROOM:
            raise
        where = str(store)
        written = error.filename2 or error.filename  # where one is copied to another
        if isinstance(written, str):
            there = Path(written).absolute().is_relative_to(Path(store).absolute())
            where = where if there else written
        raise DiskFull(where, error.errno, remedy) from error


def file_digest(path: Path) -> str:
    """SHA-256 of a file, hexadecimal."""
    with path.open("rb") as handle:
        return hashlib.file_digest(handle, "sha256").hexdigest()


def sync(path: Path) -> None:
    """Bring a file or folder to the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def sync_all(folder: Path) -> None:
    """Bring a folder to the disk with all files and folders in it, itself last."""
    for path in (*sorted(folder.rglob("*")), folder):
        sync(path)
