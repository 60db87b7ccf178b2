"""A product as one tar stream: made as it is sent, its length known before."""

from __future__ import annotations

import tarfile
from collections.abc import Iterator
from pathlib import Path

from pipeline.store.layout import BEGUN, COMPLETE
from service.products.files import PIECE_BYTES, list_files, open_inside

BLOCK = tarfile.BLOCKSIZE


def archive(folder: Path, name: str) -> tuple[int, Iterator[bytes]]:
    """Length in bytes and pieces of a tar of all files of a product, below the folder `name`."""
    files = list_files(folder)
    heads = [_head(f"{name}/{path}", size) for path, size in files]
    cubes = [path.removesuffix(COMPLETE) for path, _ in files if path.endswith(f"/{COMPLETE}")]
    cubes = [inside for inside in cubes if (folder / inside / BEGUN).is_file()]
    first = b"".join(_record(folder, name, inside) for inside in ("", *cubes))
    length = len(first) + sum(
        len(h) + -(-size // BLOCK) * BLOCK for h, (_, size) in zip(heads, files, strict=True)
    )
    return length + 2 * BLOCK, _pieces(folder, first, files, heads)


def _record(folder: Path, name: str, inside: str) -> bytes:
    """The record of a product, or of a point's that a sweep keeps: hidden, and needed by
    `nightglass check`. inside : its folder below the first, ended by a slash."""
    record = (folder / inside / BEGUN).read_bytes()
    return _head(f"{name}/{inside}{BEGUN}", len(record)) + record + bytes(-len(record) % BLOCK)


def _head(path: str, size: int) -> bytes:
    info = tarfile.TarInfo(path)
    info.size, info.mode = size, 0o644
    return info.tobuf(tarfile.PAX_FORMAT)


def _pieces(
    folder: Path, first: bytes, files: list[tuple[str, int]], heads: list[bytes]
) -> Iterator[bytes]:
    yield first
    for (path, size), head in zip(files, heads, strict=True):
        yield head
        left = size
        with open_inside(folder, path) as file:
            while left and (piece := file.read(min(PIECE_BYTES, left))):
                left -= len(piece)
                yield piece
        if left:
            raise OSError(f"{path} became shorter while it was sent")  # the client sees it cut off
        yield bytes(-size % BLOCK)
    yield bytes(2 * BLOCK)
