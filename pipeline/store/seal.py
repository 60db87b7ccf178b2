"""The seal of a finished product, _COMPLETE: digests of all its files that are no chunks."""

from __future__ import annotations

import json
import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from catalog_tools.storage.durable import file_digest, sync
from pipeline.errors import Damaged, Incomplete
from pipeline.store import layout

FORMAT = "nightglass/product/1"
SYNCED_AT_ONCE = 16  # a disk takes these in one go
SMALL_BYTES = 1 << 20  # of files that are looked at whenever a product is opened
FAULTS_TOLD = 3


def check_complete(product: Path) -> None:
    """Raise BadInput where a path holds no product, Incomplete where it holds an unfinished one,
    Damaged where a file is gone, or a small one is not what was sealed.

    Chunks and pages of tables have checksums of their own, which are compared when they are read.
    The record of its beginning is needed by who goes on with it alone.
    """
    if not (product / layout.CUBE).is_dir():
        raise layout.no_product(product)
    if not (product / layout.COMPLETE).is_file():
        raise Incomplete(
            f"{product}: this product is not complete; go on with `nightglass render SCENE -o "
            f"{product} --resume`"
        )
    check_sealed(product, SMALL_BYTES, (layout.PREVIEW, layout.BEGUN))


def check_sealed(
    product: Path, most_bytes: int | None = None, spared: tuple[str, ...] = (layout.PREVIEW,)
) -> None:
    """Raise Damaged, naming the first faults of `finished_faults`, those of files that are spared
    left out: a picture that people look at is not read."""
    found = finished_faults(product, most_bytes)
    faults = [text for text in found if not text.startswith(spared)]
    if faults:
        raise Damaged(str(product), "; ".join(faults[:FAULTS_TOLD]))


def finished_faults(path: Path, most_bytes: int | None = None) -> list[str]:
    """Damage to what `finish` wrote: files named in _COMPLETE with their digest.

    most_bytes : of larger files only whether they are there; None: all are read
    """
    try:
        sealed = json.loads((path / layout.COMPLETE).read_text())
        listed, content = dict(sealed["files"]), sealed["content_digest"]
    except (ValueError, KeyError, TypeError):
        return [f"{layout.COMPLETE}: not what was written"]
    faults = []
    if content != _reported_digest(path):
        faults.append(f"{layout.COMPLETE}: its content_digest is not that of {layout.REPORT}")
    for name, digest in listed.items():
        file = path / name
        if not file.is_file():
            faults.append(f"{name}: missing")
        elif most_bytes is not None and file.stat().st_size > most_bytes:
            continue
        elif file_digest(file) != digest:
            faults.append(f"{name}: the digest differs")
    return faults


def _reported_digest(path: Path) -> str | None:
    """The content digest in a product's report; None where none can be read."""
    try:
        return str(json.loads((path / layout.REPORT).read_text())["content_digest"])
    except (OSError, ValueError, KeyError, TypeError):
        return None


def seal(path: Path, content: str) -> None:
    """Write _COMPLETE, last of all, with the digests of all files that are no chunks.

    content : the digest of what the product holds
    They, and all folders, are brought to the disk first; chunks were, before their markers.
    """
    names, synced = [], []
    unsealed = f"{layout.TRUTH}/{layout.PARTS}/"  # removed when the seal stands
    for folder, _, inside in os.walk(path):
        for own in inside:
            name = f"{folder}/{own}"[len(str(path)) + 1 :]
            if own.startswith(".") and own.endswith(".tmp"):
                (path / name).unlink()  # of a writer that was killed
            elif not (_is_vouched_for(name, own) or name.startswith(unsealed)):
                names.append(name)
        synced.append(folder)
    names.sort(key=lambda name: name.split("/"))
    files = {name: file_digest(path / name) for name in names}
    synced += [f"{path}/{name}" for name in names]
    with ThreadPoolExecutor(SYNCED_AT_ONCE) as pool:
        list(pool.map(_sync_each, (synced[k::SYNCED_AT_ONCE] for k in range(SYNCED_AT_ONCE))))
    sealed = {"format": FORMAT, "content_digest": content, "files": files}
    layout.write_atomically(path / layout.COMPLETE, layout.to_json(sealed))


def _sync_each(paths: list[str]) -> None:
    for path in paths:
        sync(Path(path))


def _is_vouched_for(name: str, own: str) -> bool:
    """Whether the seal leaves a file out: chunks have markers, and these their own checksum."""
    record = own == layout.COMPLETE or own.startswith(layout.LOCK)
    return record or name.startswith(f"{layout.MARKERS}/") or has_marker(name)


def has_marker(name: str) -> bool:
    """Whether a file of a product is a chunk of a layer, which its tile's marker vouches for."""
    parts = name.split("/")  # cube.zarr / layer / c / frame / row / column
    return len(parts) == 6 and parts[0] == layout.CUBE and parts[1] in layout.LONG_NAMES
