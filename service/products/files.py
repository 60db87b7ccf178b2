"""Files of a product over HTTP: no path leaves the product, no link is followed, Range works."""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from starlette.requests import Request
from starlette.responses import Response, StreamingResponse

from service.problems import NotThere

PIECE_BYTES = 1 << 18
TYPES = {".json": "application/json", ".png": "image/png", ".yaml": "text/plain; charset=utf-8"}
RANGE = re.compile(r"bytes=(?!-$)(\d{0,18})-(\d{0,18})")


def open_inside(folder: Path, relative: str) -> BinaryIO:
    """Open a regular file below a folder, part by part, without following any link.

    NotThere for what is absent, hidden (a leading dot), a link, or outside.
    """
    *folders, name = relative.split("/")
    if any(not part or part.startswith(".") or "\0" in part for part in (*folders, name)):
        raise NotThere("there is no such file in the product")
    handles = []
    try:
        handles.append(os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW))
        for part in folders:
            flags = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW
            handles.append(os.open(part, flags, dir_fd=handles[-1]))
        flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK
        file = os.open(name, flags, dir_fd=handles[-1])
    except (OSError, ValueError):
        raise NotThere("there is no such file in the product") from None
    finally:
        for handle in handles:
            os.close(handle)
    if not stat.S_ISREG(os.fstat(file).st_mode):
        os.close(file)
        raise NotThere("there is no such file in the product")
    return os.fdopen(file, "rb")


def list_files(folder: Path) -> list[tuple[str, int]]:
    """(path, bytes) of every file that can be fetched, in order."""
    found = []
    for root, folders, names in os.walk(folder):
        folders[:] = [name for name in folders if not name.startswith(".")]
        for name in names:
            path = Path(root, name)
            about = None if name.startswith(".") else _lstat(path)
            if about is not None and stat.S_ISREG(about.st_mode):
                found.append((path.relative_to(folder).as_posix(), about.st_size))
    return sorted(found)


def _lstat(path: Path) -> os.stat_result | None:
    try:
        return path.lstat()
    except FileNotFoundError:  # the job is being deleted
        return None


def is_known(asked: str | None, tag: str) -> bool:
    """Whether If-None-Match names this ETag or, as `*`, any. A proxy that packs answers makes it
    weak: `W/"3"`."""
    named = [one.strip().removeprefix("W/") for one in (asked or "").split(",")]
    return tag in named or named == ["*"]


def serve_file(request: Request, folder: Path, relative: str) -> Response:
    """A file as 200, one Range of it (of GET alone) as 206, 304 for a known ETag, 416 for an
    empty range."""
    file = open_inside(folder, relative)
    about = os.fstat(file.fileno())
    size, etag = about.st_size, f'"{about.st_mtime_ns:x}-{about.st_size:x}"'
    headers = {"ETag": etag, "Accept-Ranges": "bytes", "X-Content-Type-Options": "nosniff"}
    if is_known(request.headers.get("if-none-match"), etag):
        file.close()
        return Response(status_code=304, headers=headers)
    asked = RANGE.fullmatch(request.headers.get("range", "").strip())
    if request.method != "GET" or request.headers.get("if-range") not in (None, etag):
        asked = None
    part = _part(asked, size)
    if part is None:
        file.close()
        return Response(status_code=416, headers=headers | {"Content-Range": f"bytes */{size}"})
    start, stop = part
    status = 200
    if asked is not None:
        status = 206
        headers["Content-Range"] = f"bytes {start}-{stop - 1}/{size}"
    headers["Content-Length"] = str(stop - start)
    kind = TYPES.get(Path(relative).suffix, "application/octet-stream")
    body = _pieces(file, start, stop)
    return StreamingResponse(body, status_code=status, headers=headers, media_type=kind)


def _part(asked: re.Match[str] | None, size: int) -> tuple[int, int] | None:
    """[start, stop) of one byte range; the whole for none or several; None for an empty one."""
    if asked is None:
        return 0, size
    first, last = asked.group(1, 2)
    if not first:
        start, stop = max(0, size - int(last)), size
    else:
        start, stop = int(first), min(size, int(last) + 1) if last else size
    return (start, stop) if start < stop else None


def _pieces(file: BinaryIO, start: int, stop: int) -> Iterator[bytes]:
    with file:
        file.seek(start)
        while start < stop and (piece := file.read(min(PIECE_BYTES, stop - start))):
            start += len(piece)
            yield piece
