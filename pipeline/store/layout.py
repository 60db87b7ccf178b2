"""Names inside a product directory, and small files written whole or not at all."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pipeline.errors import BadInput

CUBE = "cube.zarr"
MARKERS = "markers"
TRUTH = "truth"
PARTS = ".parts"
SCENE = "scene.yaml"
PLAN = "plan.json"
REPORT = "report.json"
PREVIEW = "preview.png"
BEGUN = ".begun.json"
COMPLETE = "_COMPLETE"
LOCK = ".lock"


def write_atomically(path: Path, content: bytes) -> None:
    """Write a file whole or not at all: temporary sibling, fsync, rename, fsync of the folder."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    with temporary.open("wb") as handle:
        handle.write(content)
        handle.flush()
        os.fsync(handle.fileno())
    temporary.replace(path)
    sync_folder(path.parent)


def sync_folder(folder: Path) -> None:
    """Make the names in a folder durable."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def to_json(value: Any) -> bytes:
    """Readable JSON; NaN and infinity are refused rather than written."""
    return (json.dumps(value, indent=2, allow_nan=False) + "\n").encode()


@contextmanager
def only_writer(product: Path) -> Iterator[None]:
    """Hold the product's lock; another running writer is refused, a dead one is not."""
    import fcntl

    with (product / LOCK).open("w") as handle:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise BadInput(
                "-o", str(product), "a product that no other render is writing now"
            ) from None
        yield
