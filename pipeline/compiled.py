"""Compiled kernels that are kept on disk: none outlives a change of what it calls."""

from __future__ import annotations

import atexit
import hashlib
import os
import shutil
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path

from catalog_tools.engine.code import sources

FOLDER = "NUMBA_CACHE_DIR"  # of kept kernels, where they do not lie beside their sources


def forget_stale(package: Path) -> None:
    """Remove kept kernels that are older than the newest source of a package.

    numba takes a kept kernel while the kernel's own file has its date and size. What the kernel
    calls in other files is compiled into it, and may have changed: by an update in place, or an
    edit. A source of a future date tells nothing and does not count.
    """
    folders = [package, *(folder for folder in package.iterdir() if folder.is_dir())]
    now = time.time()
    dates = [source.stat().st_mtime for folder in folders for source in folder.glob("*.py")]
    newest = max((date for date in dates if date <= now), default=0.0)
    for folder in folders:
        for kept in folder.glob("__pycache__/*.nbi"):
            with suppress(OSError):  # another process was first, or it may not be removed
                if kept.stat().st_mtime < newest:
                    kept.unlink()


def keep_apart(package: Path) -> None:
    """Let kernels kept in a folder of their own lie there by what they are compiled from.

    Such a folder outlives an installation (a container's volume); files of two installations may
    have the same dates and sizes: one version of the sources must not find another's kernels.
    """
    asked = os.environ.get(FOLDER)
    if not asked:
        return
    version = hashlib.sha256(b"".join(sources(package))).hexdigest()[:16]
    if Path(asked).name != version:  # a process that this one starts has it already
        os.environ[FOLDER] = str(Path(asked, version))
    _tell_numba()


def keep_somewhere(package: Path) -> None:
    """Where none of numba's places can be written, let kernels lie in a folder of this process.

    As where another user installed the program and HOME is not to be written: numba refuses to
    import what it cannot keep. The processes that this one starts share the folder.
    """
    users = os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser()
    asked = os.environ.get(FOLDER)
    places = [package / "__pycache__", Path(users, "numba"), *([Path(asked)] if asked else [])]
    if any(_can_be_written(place) for place in places):
        return
    own = tempfile.mkdtemp(prefix="nightglass-kernels-")
    atexit.register(_remove, own, os.getpid())
    os.environ[FOLDER] = own
    _tell_numba()


def _can_be_written(folder: Path) -> bool:
    """Whether a folder is there, or can be made, and takes files."""
    there = next(f for f in (folder, *folder.absolute().parents) if f.exists())
    return there.is_dir() and os.access(there, os.W_OK | os.X_OK)


def _remove(folder: str, owner: int) -> None:
    if os.getpid() == owner:
        shutil.rmtree(folder, ignore_errors=True)


def _tell_numba() -> None:
    if "numba" in sys.modules:
        sys.modules["numba"].config.CACHE_DIR = os.environ[FOLDER]
