"""Which place a product has: a folder of this machine, or an object store."""

from __future__ import annotations

import re
from pathlib import Path

from pipeline.store.folder import Folder
from pipeline.store.place import Place


def place_for(product: Path | str) -> Place:
    """The place of a product: a folder, or an s3 URL, which alone imports an object store."""
    if re.match(r"[A-Za-z][A-Za-z0-9+.-]+:/", str(product)):
        from pipeline.store.bucket import Bucket

        return Bucket(str(product))
    return Folder(Path(product))
