"""Compiled kernels that are kept on disk: none outlives a change of what it calls."""

from __future__ import annotations

import time
from contextlib import suppress
from pathlib import Path


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
