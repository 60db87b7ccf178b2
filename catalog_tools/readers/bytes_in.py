"""The bytes of a file in order, unpacked where they are gzipped, and each counted in a digest."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from isal import isal_zlib

from ..errors import Damaged

PLAIN_BYTES = 1 << 18
PACKED_BYTES = 1 << 17  # about 300 kB of unpacked CSV: what fits into the second-level cache
MOST_BYTES = 1 << 20  # of one unpacked piece, however well it was packed


def bytes_of(path: Path, *, zipped: bool, md5: object = None) -> Iterator[bytes]:
    """Pieces of the file, unpacked if `zipped`.

    md5 : a hashlib object; when the pieces are used up, it has been fed every byte of the file as
    it lies on disk. Raises Damaged where the gzip stream is broken, ends too early, or is followed
    by anything but another one or zeros.
    """
    if zipped:
        return _unpacked(path, _raw(path, md5, PACKED_BYTES))
    return _raw(path, md5, PLAIN_BYTES)


def digest(path: Path, md5: object) -> None:
    """Feed all bytes of a file to `md5`."""
    for _ in _raw(path, md5, PLAIN_BYTES):
        pass


def _raw(path: Path, md5: Any, size: int) -> Iterator[bytes]:
    with path.open("rb", buffering=0) as file:
        while piece := file.read(size):
            if md5 is not None:
                md5.update(piece)
            yield piece


def _unpacked(path: Path, pieces: Iterator[bytes]) -> Iterator[bytes]:
    """Gzip members one after the other; zeros between and after them are padding (RFC 1952)."""
    broken: Any = isal_zlib.error  # no class to a type checker
    engine: Any = None
    first = True
    try:
        for piece in pieces:
            while piece:
                if engine is None:
                    piece = piece if first else piece.lstrip(b"\0")
                    if not piece:
                        break
                    engine = isal_zlib.decompressobj(wbits=31)
                data = engine.decompress(piece, MOST_BYTES)
                if data:
                    yield data
                if engine.eof:
                    piece, engine, first = engine.unused_data, None, False
                else:
                    piece = engine.unconsumed_tail
        if engine is not None:
            yield from _held_back(path, engine)
    except broken as error:
        raise Damaged(str(path), _why(engine, first, error)) from None


def _held_back(path: Path, engine: Any) -> Iterator[bytes]:
    """What a member still holds when the file has ended."""
    while not engine.eof:
        if not (data := engine.decompress(b"", MOST_BYTES)):
            raise Damaged(str(path), "its gzip stream ends too early")
        yield data


def _why(engine: object, first: bool, error: Exception) -> str:
    if not first and engine is not None:
        return f"what follows its gzip stream is not another one ({error})"
    return f"its gzip stream cannot be unpacked ({error})"
