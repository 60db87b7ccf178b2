"""One writer at a time, and a catalogue that becomes visible by one atomic rename."""

from __future__ import annotations

import fcntl
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from .catalogue import MANIFEST_NAME
from .errors import BadInput, Incomplete


@contextmanager
def publishing(destination: Path, *, overwrite: bool, field: str = "output") -> Iterator[Path]:
    """Yield a hidden folder beside `destination`; it takes that name when the block ends well.

    Raises BadInput where the destination exists (unless `overwrite` and it is a catalogue) or
    where another writer is at work on it. On any failure nothing is left but what was there
    before. The lock is the kernel's: it ends with the process, however that ends.
    """
    destination = destination.absolute()
    _check(destination, overwrite, field)
    try:
        destination.parent.mkdir(parents=True, exist_ok=True)
        lock = (destination.parent / f".{destination.name}.lock").open("a")
    except OSError as error:
        raise BadInput(field, str(destination), f"a place that can be written ({error})") from None
    with lock:
        if not _alone(lock):
            allowed = "a place into which no other process is writing a catalogue"
            raise BadInput(field, str(destination), allowed)
        try:
            _restore(destination)
            _check(destination, overwrite, field)
            shutil.rmtree(work := _part(destination), ignore_errors=True)  # of a killed writer
            work.mkdir()
            yield work
            _swap_in(work, destination)
        except OSError as error:
            raise Incomplete(f"{destination}: could not be written ({error})") from error
        finally:
            shutil.rmtree(_part(destination), ignore_errors=True)
            Path(lock.name).unlink(missing_ok=True)


def _alone(lock: IO[str]) -> bool:
    """Take the lock; not so where another holds it, or has just finished and removed its file."""
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return Path(lock.name).stat().st_ino == os.fstat(lock.fileno()).st_ino
    except OSError:
        return False


def _restore(destination: Path) -> None:
    """Undo an overwriting that was cut off between its two renames."""
    if _old(destination).exists() and not os.path.lexists(destination):
        _old(destination).rename(destination)


def _part(destination: Path) -> Path:
    return destination.parent / f".{destination.name}.part"


def _old(destination: Path) -> Path:
    return destination.parent / f".{destination.name}.old"


def _check(destination: Path, overwrite: bool, field: str) -> None:
    if not os.path.lexists(destination):
        return
    if not overwrite:
        raise BadInput(field, str(destination), "a path where nothing is yet (or --overwrite)")
    if not (destination / MANIFEST_NAME).is_file():
        raise BadInput(field, str(destination), "a catalogue, to be overwritten")


def _swap_in(work: Path, destination: Path) -> None:
    for path in (*sorted(work.rglob("*")), work):
        _sync(path)
    old = _old(destination)
    shutil.rmtree(old, ignore_errors=True)
    if os.path.lexists(destination):
        destination.rename(old)
    work.rename(destination)
    _sync(destination.parent)
    shutil.rmtree(old, ignore_errors=True)


def _sync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
