"""Read an archive's files from any byte on: over http and https, or from a folder (file://).

`requests` rather than urllib: it keeps connections open (61,234 files of 5 to 10 MB), brings its
own certificates, honours proxies, and follows redirects to http and https only; pyvo needs it too.
"""

from __future__ import annotations

import os
import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime
from pathlib import Path
from typing import IO, Protocol
from urllib.parse import quote, unquote, urlsplit

import requests
import urllib3

from ..errors import BadInput
from .patience import FinalFailure, Patience, Unavailable

BLOCK_BYTES = 256 << 10
MOST_REDIRECTS = 5
PASSING = {408, 425, 429, 500, 502, 503, 504}
CONTENT_RANGE = re.compile(r"bytes (\d+)-\d+/(\d+|\*)")


class PastEnd(Exception):
    """The range asked for starts at or behind the file's end (416); total : its length, if told."""

    def __init__(self, total: int | None) -> None:
        super().__init__(total)
        self.total = total


@dataclass(frozen=True)
class Reply:
    """A file's bytes from `start` on. total : the whole file's length; tag : its validator."""

    start: int
    total: int | None
    tag: str | None
    blocks: Iterator[bytes]


class Remote(Protocol):
    """A folder of files, near or far."""

    def address(self, name: str) -> str:
        """The file's URL, for messages (without a password)."""

    @contextmanager
    def open(self, name: str, start: int, tag: str | None) -> Iterator[Reply]:
        """The file from byte `start` on if it still has `tag`, else from its beginning.

        Raises Unavailable (also while reading), FinalFailure, PastEnd.
        """

    def size(self, name: str) -> int | None:
        """The file's length in bytes; None where it isn't told. Raises nothing."""

    def close(self) -> None:
        """End all connections."""


def open_remote(base_url: str, patience: Patience) -> Remote:
    """The folder at a URL; BadInput for a scheme other than http, https and file."""
    try:
        parts = urlsplit(base_url)
    except ValueError:
        parts = urlsplit("")
    if parts.scheme in ("http", "https") and parts.hostname:
        return HttpRemote(base_url, patience)
    if parts.scheme == "file" and parts.netloc in ("", "localhost") and parts.path:
        folder = Path(unquote(parts.path))
        if not folder.is_dir():
            raise BadInput("base_url", base_url, "a folder that exists")
        return FolderRemote(folder)
    raise BadInput("base_url", base_url, "an http://, https:// or file:/// address of a folder")


class HttpRemote:
    """A folder on a web server; every thread has its own connection."""

    def __init__(self, base_url: str, patience: Patience) -> None:
        self._base = base_url.rstrip("/") + "/"
        self._timeout = (patience.connect_s, patience.silence_s)
        self._local = threading.local()
        self._sessions: list[requests.Session] = []

    def address(self, name: str) -> str:
        return without_password(self._base) + name

    @contextmanager
    def open(self, name: str, start: int, tag: str | None) -> Iterator[Reply]:
        headers = {"Range": f"bytes={start}-"} if start else {}
        if start and tag:
            headers["If-Range"] = tag
        with self._request("GET", name, headers) as response:
            if response.status_code == 416:
                raise PastEnd(_total_of_416(response))
            _check_status(response)
            tag = _validator(response)
            begin, total = _extent(response)
            yield Reply(begin, total, tag, _blocks(response))

    def size(self, name: str) -> int | None:
        try:
            with self._request("HEAD", name, {}) as response:
                return _length(response) if response.status_code == 200 else None
        except (Unavailable, FinalFailure):
            return None

    def close(self) -> None:
        for session in self._sessions:
            session.close()

    def _request(self, method: str, name: str, headers: dict[str, str]) -> requests.Response:
        try:
            return self._session().request(
                method,
                self._base + quote(name),
                headers=headers,
                stream=True,
                timeout=self._timeout,
                allow_redirects=True,
            )
        except (requests.exceptions.SSLError, requests.TooManyRedirects) as error:
            raise FinalFailure(plain(error)) from None
        except (requests.ConnectionError, requests.Timeout) as error:
            raise Unavailable(plain(error)) from None
        except (requests.RequestException, ValueError) as error:  # a redirect to another scheme
            raise FinalFailure(plain(error)) from None

    def _session(self) -> requests.Session:
        if not hasattr(self._local, "session"):
            session = requests.Session()
            session.max_redirects = MOST_REDIRECTS
            # Stored bytes, never a decoded form of them: ranges count the former.
            session.headers.update({"Accept-Encoding": "identity", "User-Agent": "nightglass"})
            self._local.session = session
            self._sessions.append(session)
        session = self._local.session
        assert isinstance(session, requests.Session)
        return session


class FolderRemote:
    """A folder on this machine, such as a mounted mirror."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def address(self, name: str) -> str:
        return str(self._folder / name)

    @contextmanager
    def open(self, name: str, start: int, tag: str | None) -> Iterator[Reply]:
        try:
            file = (self._folder / name).open("rb")
        except OSError as error:
            raise FinalFailure(str(error.strerror)) from None
        with file:
            stat = os.fstat(file.fileno())
            now = f"{stat.st_size}-{stat.st_mtime_ns}"
            begin = start if start <= stat.st_size and tag == now else 0
            file.seek(begin)
            yield Reply(begin, stat.st_size, now, _read_blocks(file))

    def size(self, name: str) -> int | None:
        try:
            return (self._folder / name).stat().st_size
        except OSError:
            return None

    def close(self) -> None:
        """Nothing is kept open."""


def read_whole(remote: Remote, name: str, most_bytes: int) -> bytes:
    """A small file's content. Raises Unavailable, FinalFailure (also where it is longer)."""
    with remote.open(name, 0, None) as reply:
        content = bytearray()
        for block in reply.blocks:
            content += block
            if len(content) > most_bytes:
                raise FinalFailure(f"more than {most_bytes} bytes")
        if reply.total is not None and len(content) != reply.total:
            raise Unavailable(f"the connection ended after {len(content)} of {reply.total} bytes")
        return bytes(content)


def without_password(url: str) -> str:
    """A URL as it may be shown."""
    return re.sub(r"//[^/@]*@", "//", url)


def plain(error: BaseException) -> str:
    """The innermost reason of a network failure, short and without object addresses."""
    while True:
        inner = error.args[0] if error.args else None
        inner = getattr(inner, "reason", inner)
        if not isinstance(inner, BaseException):
            break
        error = inner
    text = inner if isinstance(inner, str) else str(error)
    text = without_password(text) or type(error).__name__
    return re.sub(r"<[^>]*>[:,]? ?|\w+\(host=[^)]*\): ", "", text)[:200]


def _read_blocks(file: IO[bytes]) -> Iterator[bytes]:
    try:
        while block := file.read(BLOCK_BYTES):
            yield block
    except OSError as error:
        raise Unavailable(str(error.strerror)) from None


def _blocks(response: requests.Response) -> Iterator[bytes]:
    """The body as it arrives: what came before a cut is not lost in a buffer."""
    try:
        while block := response.raw.read1(BLOCK_BYTES, decode_content=False):
            yield block
    except (urllib3.exceptions.HTTPError, OSError) as error:
        raise Unavailable(plain(error)) from None


def _check_status(response: requests.Response) -> None:
    if response.status_code in (200, 206):
        return
    text = f"{response.status_code} {response.reason}"
    if response.status_code in PASSING:
        raise Unavailable(text, retry_after_s(response.headers.get("Retry-After")))
    raise FinalFailure(text)


def retry_after_s(text: str | None) -> float | None:
    """Seconds to wait, from a number or a date (RFC 9110, 10.2.3)."""
    if not text:
        return None
    if text.strip().isdecimal():
        return float(text)
    try:
        moment = parsedate_to_datetime(text)
    except ValueError:
        return None
    moment = moment if moment.tzinfo else moment.replace(tzinfo=UTC)
    return max(0.0, (moment - datetime.now(UTC)).total_seconds())


def _extent(response: requests.Response) -> tuple[int, int | None]:
    """Where the body begins in the file, and how long the file is."""
    if response.status_code == 200:
        return 0, _length(response)
    match = CONTENT_RANGE.fullmatch(response.headers.get("Content-Range", "").strip())
    if not match:
        raise FinalFailure("206 Partial Content that does not say which part")
    return int(match[1]), None if match[2] == "*" else int(match[2])


def _length(response: requests.Response) -> int | None:
    text = response.headers.get("Content-Length", "")
    return int(text) if text.isdecimal() else None


def _total_of_416(response: requests.Response) -> int | None:
    total = response.headers.get("Content-Range", "").rpartition("*/")[2]
    return int(total) if total.isdecimal() else None


def _validator(response: requests.Response) -> str | None:
    """What If-Range may carry: a strong ETag, else Last-Modified (RFC 9110, 13.1.5)."""
    etag = response.headers.get("ETag")
    if etag and not etag.startswith("W/"):
        return etag
    return response.headers.get("Last-Modified")
