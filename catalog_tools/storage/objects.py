"""Objects below one URL of an object store (s3): listed, read, put whole or not at all, deleted."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from datetime import datetime
from functools import cache, partial
from typing import TYPE_CHECKING, TypeVar
from urllib.parse import urlsplit

from ..errors import BadInput, Missing, why_broken
from .stores import Unreachable, reason_of, without_secrets

if TYPE_CHECKING:
    from s3fs import S3FileSystem

SCHEME = "s3"
TOGETHER = 256  # objects of one question
Result = TypeVar("Result")


@dataclass(frozen=True)
class Listed:
    """An object as the store lists it; `changed` by the store's own clock."""

    size: int
    changed: datetime


@dataclass(frozen=True)
class Objects:
    """Objects whose names are relative to `url`, with forward slashes.

    A put object is there whole or not at all, and seen by all who ask after it. Credentials come
    from the environment or the cloud's own files. Raises Unreachable where the store gives no
    answer or refuses one; the store's client asks again by itself before that.
    """

    url: str

    def put(self, name: str, content: bytes) -> None:
        """Write an object, whatever was there."""
        self._asked(lambda files: files.pipe_file(self._path(name), content))

    def create(self, name: str, content: bytes) -> bool:
        """Write an object where there is none yet; whether it was this call that did."""
        try:
            self._asked(lambda files: files.pipe_file(self._path(name), content, mode="create"))
        except FileExistsError:
            return self.get(name) == content  # the answer to an earlier try may have been lost
        return True

    def get(self, name: str) -> bytes | None:
        """An object's content; None where there is none."""
        try:
            content: bytes = self._asked(lambda files: files.cat_file(self._path(name)))
        except FileNotFoundError:
            return None
        return content

    def get_many(self, names: Iterable[str]) -> Iterator[tuple[str, bytes]]:
        """Names and contents of small objects, many asked for together. All must be there."""
        left = list(names)
        for start in range(0, len(left), TOGETHER):
            some = left[start : start + TOGETHER]
            paths = [self._path(name) for name in some]
            found = self._asked(partial(_all_of, paths))
            yield from ((name, found[path]) for name, path in zip(some, paths, strict=True))

    def names(self, prefix: str = "") -> dict[str, Listed]:
        """All objects whose names begin with `prefix`."""
        folder, _, start = prefix.rpartition("/")
        path = self._path(folder) if folder else self._path("").rstrip("/")
        skip = len(self._path(""))
        try:
            found = self._asked(lambda files: files.find(path, detail=True, prefix=start))
        except FileNotFoundError:
            return {}
        return {
            full[skip:]: Listed(int(facts["size"]), facts["LastModified"])
            for full, facts in found.items()
            if facts["type"] == "file" and len(full) > skip
        }

    def delete(self, names: Iterable[str]) -> None:
        """Delete objects that are there."""
        left = list(names)
        for start in range(0, len(left), TOGETHER):
            paths = [self._path(name) for name in left[start : start + TOGETHER]]
            self._asked(partial(_without, paths))

    def _path(self, name: str) -> str:
        return f"{self.url.removeprefix(f'{SCHEME}://')}/{name}"

    def _asked(self, ask: Callable[[S3FileSystem], Result]) -> Result:
        try:
            return ask(_files())
        except (FileNotFoundError, FileExistsError):
            raise
        except Exception as error:  # the client's errors are of many kinds
            if getattr(error, "errno", None) == 17 or "PreconditionFailed" in repr(error):
                raise FileExistsError(self.url) from None
            raise Unreachable(f"{self.url}: {reason_of(error)}") from None


def _all_of(paths: list[str], files: S3FileSystem) -> dict[str, bytes]:
    none = [None] * len(paths)  # whole objects; `cat` would ask after each first
    return dict(zip(paths, files.cat_ranges(paths, none, none, on_error="raise"), strict=True))


def _without(paths: list[str], files: S3FileSystem) -> None:
    for path in (p for p in paths if set("*?[]") & set(p)):
        files.rm_file(path)  # `rm` would delete all that the name matches
    plain = [p for p in paths if not set("*?[]") & set(p)]
    if plain:
        files.rm(plain)


@cache
def _files() -> S3FileSystem:
    """The store's client; its lists are always asked for anew."""
    import s3fs

    return s3fs.S3FileSystem(use_listings_cache=False)


def open_objects(url: str, field: str = "-o") -> Objects:
    """The objects below an s3 URL. Raises BadInput naming `field` for one that can't be used."""
    allowed = "a folder, or s3://BUCKET/NAME"
    try:
        parts = urlsplit(url)
        secret = parts.username is not None or parts.query or parts.fragment
    except ValueError:
        raise BadInput(field, without_secrets(url), allowed) from None
    if secret:
        told = f"{allowed} (credentials come from the environment, never from a URL)"
        raise BadInput(field, without_secrets(url), told)
    steps = parts.path.strip("/").split("/")
    odd = {"", ".", ".."} & set(steps) or set("*?[]") & set(parts.path)  # the client takes globs
    if parts.scheme != SCHEME or not parts.netloc or odd:
        raise BadInput(field, without_secrets(url), allowed)
    try:
        _files()
    except ImportError as error:
        broken = why_broken(error, "s3fs")
        raise Missing("s3:// URLs", "s3fs", "remote", "name a folder", field, broken) from None
    return Objects(f"{SCHEME}://{parts.netloc}/{'/'.join(steps)}")
