"""Files that are there whole, or not at all, whoever else writes the same one."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from uuid import uuid4


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a sibling of `path` that no other writer has; written, it takes the name `path`.

    It reaches the disk first. If the block fails, `path` is as it was and the sibling is gone.
    """
    own = path.with_name(f".{path.name}.{uuid4().hex}.tmp")
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


def sync(path: Path) -> None:
    """Bring a file or folder to the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
