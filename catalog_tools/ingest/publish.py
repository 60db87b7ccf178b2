"""One writer at a time, work that outlives its process, and one atomic rename at the end."""

from __future__ import annotations

import ctypes
import fcntl
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, NamedTuple

from ..catalogue import MANIFEST_NAME
from ..errors import NO_ROOM, BadInput, DiskFull, Incomplete, NightglassError
from ..storage.durable import MAKE_ROOM, sync, sync_all

# renameat2(2) of Linux: both paths are relative to the current folder; swap the two.
_AT_FDCWD, _RENAME_EXCHANGE = -100, 2


class Workspace(NamedTuple):
    """Where a catalogue is made: the folder that will be published, and what lets a run go on."""

    catalogue: Path
    progress: Path


@contextmanager
def publishing(
    destination: Path, *, overwrite: bool, restart: bool = False, field: str = "output"
) -> Iterator[Workspace]:
    """Yield hidden folders beside `destination`; the catalogue takes its name when all ends well.

    If the block fails or the process dies, what the folder `progress` holds stays for a later run
    (unless `restart`); if it is empty, nothing is left but what was there before. Raises BadInput
    where the destination exists (unless `overwrite` and it is a catalogue) or where another writer
    is at work on it. The lock is the kernel's: it ends with the process.
    """
    destination = destination.absolute()
    _clean_up(destination)
    _check(destination, overwrite, field)
    try:
        destination.parent.mkdir(parents=True, exist_ok=True)
        lock = (destination.parent / f".{destination.name}.lock").open("a")
    except OSError as error:
        if error.errno in NO_ROOM:
            raise DiskFull(str(destination), error.errno, MAKE_ROOM) from error
        raise BadInput(field, str(destination), f"a place that can be written ({error})") from None
    part = destination.parent / f".{destination.name}.part"
    work = Workspace(part / "catalogue", part / "progress")
    with lock:
        if not _alone(lock):
            allowed = "a place into which no other process is writing a catalogue"
            raise BadInput(field, str(destination), allowed)
        try:
            _check(destination, overwrite, field)
            if restart:
                shutil.rmtree(part, ignore_errors=True)
            for folder in work:
                folder.mkdir(parents=True, exist_ok=True)
            yield work
            _swap_in(work.catalogue, destination)
            shutil.rmtree(work.progress, ignore_errors=True)
        except OSError as error:
            raise _cut_off(error, destination, holds_any(work.progress)) from error
        finally:
            if not holds_any(work.progress):
                shutil.rmtree(part, ignore_errors=True)
            Path(lock.name).unlink(missing_ok=True)


def _cut_off(error: OSError, destination: Path, kept: bool) -> NightglassError:
    """A write that failed, with how to go on where what is finished is kept."""
    if error.errno in NO_ROOM:
        told = f"what is finished is kept: {MAKE_ROOM} to go on" if kept else MAKE_ROOM
        return DiskFull(str(destination), error.errno, told)
    told = "; what is finished is kept: run the same command again to go on" if kept else ""
    return Incomplete(f"{destination}: could not be written ({error}){told}")


def _clean_up(destination: Path) -> None:
    """Remove what a run left that was killed after the catalogue had taken its name."""
    part = destination.parent / f".{destination.name}.part"
    if (
        (destination / MANIFEST_NAME).is_file()
        and part.is_dir()
        and not (part / "catalogue").exists()
    ):
        with (destination.parent / f".{destination.name}.lock").open("a") as lock:
            if _alone(lock):
                shutil.rmtree(part, ignore_errors=True)
                Path(lock.name).unlink(missing_ok=True)


def holds_any(folder: Path) -> bool:
    """Whether a folder is there and not empty."""
    return folder.is_dir() and any(folder.iterdir())


def _alone(lock: IO[str]) -> bool:
    """Take the lock; not so where another holds it, or has just finished and removed its file."""
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return Path(lock.name).stat().st_ino == os.fstat(lock.fileno()).st_ino
    except OSError:
        return False


def _check(destination: Path, overwrite: bool, field: str) -> None:
    if not os.path.lexists(destination):
        return
    if not overwrite:
        raise BadInput(field, str(destination), "a path where nothing is yet (or --overwrite)")
    if not (destination / MANIFEST_NAME).is_file():
        raise BadInput(field, str(destination), "a catalogue, to be overwritten")


def _swap_in(work: Path, destination: Path) -> None:
    sync_all(work)
    if os.path.lexists(destination):
        _exchange(work, destination)
        shutil.rmtree(work, ignore_errors=True)
    else:
        work.rename(destination)
    sync(destination.parent)


def _exchange(one: Path, other: Path) -> None:
    """Swap the names of two folders in one step, so that a reader finds the old or the new."""
    libc = ctypes.CDLL(None, use_errno=True)
    names = os.fsencode(one), os.fsencode(other)
    if not hasattr(libc, "renameat2"):
        raise OSError(f"{other}: this system can't swap folders; remove the old one first")
    if libc.renameat2(_AT_FDCWD, names[0], _AT_FDCWD, names[1], _RENAME_EXCHANGE):
        code = ctypes.get_errno()
        raise OSError(code, os.strerror(code), str(other))
