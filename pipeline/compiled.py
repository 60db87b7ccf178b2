"""Compiled kernels that are kept on disk: none outlives a change of what it calls."""

from __future__ import annotations

import hashlib
import os
import sys
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
    if "numba" in sys.modules:
        sys.modules["numba"].config.CACHE_DIR = os.environ[FOLDER]
