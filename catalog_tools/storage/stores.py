"""Where a catalogue's bytes come from: a local folder, or any fsspec URL (s3, http, memory)."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar
from urllib.parse import unquote, urlsplit

import numpy as np
from numpy.typing import NDArray

from ..errors import BadInput, Missing, why_broken

Range = tuple[int, int]  # offset, length
Bytes = NDArray[np.uint8]
Part = tuple[int, Bytes]  # offset, and where to put the bytes: a contiguous view
Result = TypeVar("Result")

REMOTE_GAP_BYTES = 1 << 18  # ranges this close are asked for as one
RETRY_DELAYS_S = (0.2, 0.8, 3.2)  # s3fs retries by itself
CONNECT_S, ANSWER_S = 10.0, 60.0
PACKAGES = {"s3": "s3fs", "s3a": "s3fs", "http": "aiohttp", "https": "aiohttp"}


class Unreachable(OSError):
    """A store that gives no answer, or refuses one: the data itself may be whole."""


class Store(Protocol):
    """Read-only files below one root; names are relative, with forward slashes.

    Every method raises FileNotFoundError where there is no such file, Unreachable where a remote
    store can't be asked, and another OSError where a local file can't be read.
    """

    @property
    def root(self) -> str:
        """The path or URL, without secrets."""

    def read(self, name: str) -> bytes:
        """A whole file."""

    def fill(self, name: str, parts: Sequence[Part]) -> list[int]:
        """Read ranges of a file into buffers, in few requests.

        Returns how many bytes of each there are: fewer than asked where the file ends.
        """

    def size(self, name: str) -> int:
        """Bytes of a file."""

    def names(self) -> frozenset[str] | None:
        """All files below the root; None where the store gives no list (http)."""


@dataclass(frozen=True)
class LocalStore:
    """A folder of this machine."""

    root: str

    def _path(self, name: str) -> str:
        return os.path.join(self.root, name)  # noqa: PTH118

    def read(self, name: str) -> bytes:
        with open(self._path(name), "rb") as file:  # noqa: PTH123
            return file.read()

    def fill(self, name: str, parts: Sequence[Part]) -> list[int]:
        with open(self._path(name), "rb", buffering=0) as file:  # noqa: PTH123
            return [_pread(file.fileno(), offset, part.data) for offset, part in parts]

    def size(self, name: str) -> int:
        return os.stat(self._path(name)).st_size  # noqa: PTH116

    def names(self) -> frozenset[str] | None:
        found: set[str] = set()
        for folder, _, files in os.walk(self.root):
            below = os.path.relpath(folder, self.root).replace(os.sep, "/")
            found.update(file if below == "." else f"{below}/{file}" for file in files)
        return frozenset(found)


@dataclass(frozen=True)
class RemoteStore:
    """What fsspec opens. Transient errors are retried; credentials come from the environment.

    A web server that doesn't know ranges answers with the whole file: that is taken as it comes,
    so such a server costs more but gives the same.
    """

    root: str

    def _path(self, name: str) -> str:
        return f"{_filesystem(self.root)[1].rstrip('/')}/{name}"

    def read(self, name: str) -> bytes:
        files = _filesystem(self.root)[0]
        data: bytes = self._asked(lambda: files.cat_file(self._path(name)))
        return data

    def fill(self, name: str, parts: Sequence[Part]) -> list[int]:
        files, path = _filesystem(self.root)[0], self._path(name)
        spans = joined([(offset, part.size) for offset, part in parts], REMOTE_GAP_BYTES)
        starts, ends = [a for a, _ in spans], [a + n for a, n in spans]

        def ask() -> list[bytes]:
            paths = [path] * len(spans)
            return [_bytes(got) for got in files.cat_ranges(paths, starts, ends, on_error="return")]

        found = [0] * len(parts)
        for (start, length), data in zip(spans, self._asked(ask), strict=True):
            if len(data) > length:  # the whole file
                return [_copy(data, offset, part) for offset, part in parts]
            for i, (offset, part) in enumerate(parts):
                if start <= offset < start + length:
                    found[i] = _copy(data, offset - start, part)
        return found

    def size(self, name: str) -> int:
        files = _filesystem(self.root)[0]
        size = self._asked(lambda: files.info(self._path(name)))["size"]
        return int(size) if size is not None else len(self.read(name))

    def names(self) -> frozenset[str] | None:
        files, root = _filesystem(self.root)
        if self.root.startswith(("http://", "https://")):
            return None
        start = len(files._strip_protocol(root).rstrip("/")) + 1

        def ask() -> list[str]:
            files.invalidate_cache()
            found: list[str] = files.find(root)
            return found

        return frozenset(path[start:] for path in self._asked(ask))

    def _asked(self, ask: Callable[[], Result]) -> Result:
        """The answer, asked for again after transient errors."""
        for delay_s in (*RETRY_DELAYS_S, None):
            try:
                return ask()
            except Exception as error:  # each protocol has errors of its own
                if isinstance(error, FileNotFoundError):
                    raise FileNotFoundError(self.root) from None
                if delay_s is None or not _is_transient(error):
                    raise Unreachable(reason_of(error)) from None
                time.sleep(delay_s)
        raise AssertionError


def open_store(path: str | os.PathLike[str], field: str = "catalogue") -> Store:
    """The store at a path or URL. Raises BadInput naming `field` for a URL that can't be used."""
    text = os.fspath(path)
    if "://" not in text:
        return LocalStore(text)
    try:
        parts = urlsplit(text)
        named = parts.username is not None  # without one there is no password
    except ValueError:
        raise BadInput(field, without_secrets(text), "a well-formed URL") from None
    if parts.scheme in ("file", "local"):
        return LocalStore(unquote(parts.netloc.removeprefix("localhost") + parts.path))
    if named or parts.query or parts.fragment:
        allowed = (
            "a URL without user, password, key or query (credentials come from the environment or "
            "the configuration files of fsspec and of the cloud's own tools)"
        )
        raise BadInput(field, without_secrets(text), allowed)
    root = text.rstrip("/")
    try:
        _filesystem(root)
    except ImportError as error:
        raise _without_package(parts.scheme, root, field, error) from None
    except ValueError as error:
        raise BadInput(field, root, f"a path, or a URL that fsspec knows ({error})") from None
    except Exception as error:  # each protocol checks its configuration in its own way
        raise BadInput(field, root, f"a place that can be read ({reason_of(error)})") from None
    return RemoteStore(root)


def _without_package(scheme: str, root: str, field: str, error: ImportError) -> BadInput:
    """What is said where the package of a protocol cannot be imported."""
    package = PACKAGES.get(scheme)
    if package is None:
        return BadInput(field, root, f"a URL whose packages are installed ({error})")
    broken = why_broken(error, package)
    return Missing(f"{scheme}:// URLs", package, "remote", field=field, broken=broken)


def joined(ranges: Sequence[Range], gap: int) -> list[Range]:
    """The fewest spans, ascending, that hold all ranges and at most `gap` bytes between two."""
    spans: list[list[int]] = []
    for offset, length in sorted(ranges):
        if spans and offset <= spans[-1][1] + gap:
            spans[-1][1] = max(spans[-1][1], offset + length)
        else:
            spans.append([offset, offset + length])
    return [(start, end - start) for start, end in spans]


def without_secrets(text: str) -> str:
    """Text in which what may be a password, a key or a signature in a URL is omitted."""
    text = re.sub(r"://[^/@\s'\"]*@", "://…@", text)
    return re.sub(r"\?[^\s'\"]*", "?…", text)


def _pread(number: int, offset: int, view: memoryview) -> int:
    """Fill a view from an open file, up to the file's end (one call reads at most 2 GiB)."""
    done = 0
    while done < len(view) and (more := os.preadv(number, [view[done:]], offset + done)):
        done += more
    return done


def _copy(data: bytes, start: int, part: Bytes) -> int:
    """Fill a buffer from bytes that may end too early."""
    found = np.frombuffer(data, np.uint8)[start : start + part.size]
    part[: found.size] = found
    return found.size


def _filesystem(root: str) -> tuple[Any, str]:
    """fsspec's filesystem (it keeps one for each process and service), and its path for a URL."""
    from fsspec.core import url_to_fs

    options = {}
    if root.startswith(("http://", "https://")):
        import aiohttp

        timeout = aiohttp.ClientTimeout(None, sock_connect=CONNECT_S, sock_read=ANSWER_S)
        options = {"client_kwargs": {"timeout": timeout}}
    files, path = url_to_fs(root, **options)
    return files, path


def _bytes(got: Any) -> bytes:
    """Bytes of one range; none where it begins beyond the file's end."""
    if not isinstance(got, Exception):
        return bytes(got)
    if getattr(got, "status", None) == 416 or "InvalidRange" in repr(got.__cause__):
        return b""
    raise got


def _is_transient(error: Exception) -> bool:
    """Whether the same question may get an answer later."""
    status = getattr(error, "status", None)
    if isinstance(status, int):
        return status in (408, 425, 429) or status >= 500
    if isinstance(error, PermissionError):
        return False
    network = type(error).__module__.startswith("aiohttp.")
    return network or isinstance(error, (TimeoutError, ConnectionError))


def reason_of(error: Exception) -> str:
    """An error in few words, without secrets."""
    status = getattr(error, "status", None)
    if isinstance(status, int):
        return f"the server answers {status} {getattr(error, 'message', '')}".rstrip()
    if isinstance(error, PermissionError):
        return f"permission denied: {without_secrets(str(error))[:200]}"
    if isinstance(error, TimeoutError):
        return "no answer in time"
    text = without_secrets(str(error))[:200]
    return f"{type(error).__name__}: {text}" if text else type(error).__name__
