"""Which place a product has: a folder of this machine, or an object store."""

from __future__ import annotations

from pathlib import Path

from catalog_tools.storage.urls import is_url
from pipeline.store.folder import Folder
from pipeline.store.place import Place


def place_for(product: Path | str, field_name: str) -> Place:
    """The place of a product: a folder, or an s3 URL, which alone imports an object store.

    Raises BadInput naming the field for a URL that can't be used or asked.
    """
    if is_url(product):
        from pipeline.store.bucket import Bucket

        return Bucket(str(product), field_name)
    return Folder(Path(product))
