"""The few errors that reach a user: bad input, damaged data, unfinished work."""

from __future__ import annotations

import errno
import os
from importlib.util import find_spec

NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


class NightglassError(Exception):
    """Base of every error that is shown as one message, never as a traceback."""


class BadInput(NightglassError):
    """Something the user gave is wrong: exit code 2, or HTTP 4xx.

    Parameters
    ----------
    field : the name of the field as the user wrote it (dotted for nested keys), or the path.
    value : what was given; shortened in the message.
    allowed : what would be accepted, in words.
    """

    def __init__(self, field: str, value: object, allowed: str) -> None:
        self.field, self.value, self.allowed = field, value, allowed
        super().__init__(field, value, allowed)

    def __str__(self) -> str:
        return f"{self.field}: {shorten(self.value)} is not accepted; allowed: {self.allowed}"


class Missing(BadInput):
    """A package is not installed, or broken, that one of this product's extras brings.

    Parameters
    ----------
    what : what needs it, in the plural: "movies".
    package : its name in the package index.
    extra : of pyproject.toml.
    instead : what can be done without it, in words, if anything.
    field : the name of the field that asks for it, as the user wrote it, if any does.
    broken : why it cannot be imported although it is there (`why_broken`).
    """

    def __init__(
        self,
        what: str,
        package: str,
        extra: str,
        instead: str = "",
        field: str = "",
        broken: str = "",
    ) -> None:
        remedy = f"pip install 'nightglass[{extra}]'" + (f", or {instead}" if instead else "")
        state = f"cannot be imported ({broken})" if broken else "is not installed"
        self._given = what, package, extra, instead, field, broken
        self._text = f"{field}: " if field else ""
        self._text += f"{what} need {package}, which {state}: {remedy}"
        super().__init__(field or package, what, f"an installation with {package}: {remedy}")

    def __reduce__(self) -> tuple[object, ...]:
        return type(self), self._given

    def __str__(self) -> str:
        return self._text


def why_broken(error: ImportError, module: str) -> str:
    """Why a module that is there cannot be imported, for `Missing`; "" for an absent one."""
    return "" if find_spec(module) is None else str(error)


class Damaged(NightglassError):
    """Stored data does not match its checksum, length or manifest: never rendered silently."""

    def __init__(self, path: str, reason: str) -> None:
        self.path, self.reason = path, reason
        super().__init__(path, reason)

    def __str__(self) -> str:
        return f"{self.path}: damaged: {self.reason}"


class Incomplete(NightglassError):
    """Work ended before everything was done; `--resume` goes on from what is stored."""


class TryLater(NightglassError):
    """What the work needs is not there now (a scheduler, a database, a lease): exit code 4."""


class DiskFull(Incomplete):
    """A store has no room: what is whole is kept, and the same work goes on when there is room."""

    def __init__(self, store: str, code: int, remedy: str) -> None:
        self.store, self.code, self.remedy = store, code, remedy
        super().__init__(store, code, remedy)

    def __str__(self) -> str:
        return f"{self.store}: the disk is full ({os.strerror(self.code)}); {self.remedy}"


def shorten(value: object, limit: int = 80) -> str:
    """`repr` of a value, cut to `limit` characters: values are never echoed whole."""
    try:
        text = repr(value)
    except (ValueError, RecursionError):  # an integer of thousands of digits, endless nesting
        text = f"a {type(value).__name__} too large to show"
    if "\n" in text:  # an array's rows
        text = " ".join(text.split())
    if len(text) <= limit:
        return text
    tail = limit // 2  # the end of a path says most
    return f"{text[: limit - 1 - tail]}…{text[len(text) - tail :]}"
