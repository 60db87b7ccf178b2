"""The service's own refusals; service/app.py holds the one table that gives each its status."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from catalog_tools.documents import JsonObject
from pipeline.errors import BadInput, NightglassError, shorten

MAX_TEXT = 400
MAX_LISTED = 50
Mistake = tuple[str, object, str]  # field as the user wrote it (dotted), value, what is allowed


class Refusal(NightglassError):
    """A request that is not served; `errors` say what to change, as problem+json shows it."""

    def __init__(self, message: str, mistakes: tuple[Mistake, ...] = ()) -> None:
        self.errors = [mistake_dict(mistake) for mistake in mistakes[:MAX_LISTED]]
        super().__init__(message)


class Malformed(Refusal):
    """The body or a header is not what the protocol allows."""


class UnknownHost(Refusal):
    """The Host header names another machine."""


class NotThere(Refusal):
    """There is no such thing here."""


class Unauthenticated(Refusal):
    """No key or token came with the request, or none that is valid."""


class NoProvider(Refusal):
    """The identity provider's keys cannot be read: whether a token is valid is not known."""


class Forbidden(Refusal):
    """Who asks is known, but may not do this."""


class NotReady(Refusal):
    """It is there, but not in a state that allows this."""


class KeyReused(Refusal):
    """An Idempotency-Key came again with another body."""


class TooLarge(Refusal):
    """The body is larger than the service takes."""


class TooSlow(Refusal):
    """The body did not arrive in time."""


class WrongMediaType(Refusal):
    """The body is not plain JSON."""


class NotAllowed(Refusal):
    """A well-formed scene that this service does not take: its paths or its size."""


class PlanRefused(Refusal):
    """The engine refused a scene when it planned it; `error` is the worker's description."""

    def __init__(self, error: JsonObject) -> None:
        super().__init__(error["message"])
        self.errors = error["errors"]


class QueueFull(Refusal):
    """A quota of the team is used up: jobs that wait, pixels x frames a day, bytes kept."""


class TooMany(Refusal):
    """More at once than the service takes: watchers, keys to be verified."""


class Overloaded(Refusal):
    """The answer could not be made in time."""


class TableFault(Refusal):
    """The job table cannot be read or written now: its disk is full, or it is locked."""


class StoreFull(Refusal):
    """The disk of the uploaded files is full: nothing of the file is kept."""


class PlanTooSlow(Refusal):
    """A dry run that took longer than the service allows."""


class EngineFault(Refusal):
    """The engine stopped without an answer: an internal fault."""


@contextmanager
def within(place: str) -> Iterator[None]:
    """Name mistakes of what stands at a place of a body by where they are in the body."""
    try:
        yield
    except Refusal as error:
        error.errors = [e | {"pointer": f"/{place}{e['pointer']}"} for e in error.errors]
        raise
    except BadInput as error:
        kind: Callable[..., BadInput] = type(error)
        there = [(f"{place}.{name}", value, allowed) for name, value, allowed in mistakes_of(error)]
        if hasattr(error, "mistakes"):
            raise kind(there) from None
        raise BadInput(*there[0]) from None


def mistakes_of(error: Exception) -> list[Mistake]:
    """The mistakes of a scene or of another input; none where an error is of something else."""
    if not isinstance(error, BadInput):
        return []
    return getattr(error, "mistakes", [(error.field, error.value, error.allowed)])


def mistake_dict(mistake: Mistake) -> JsonObject:
    """One mistake as problem+json: pointer (RFC 6901), value and remedy, all cut in length."""
    field, value, allowed = mistake
    told = str(allowed).removeprefix("allowed: ")
    return {"pointer": pointer(field), "value": shorten(value), "allowed": cut(told)}


def pointer(field: str) -> str:
    """`sensor.shape` as `/sensor/shape`, `stars.catalogue[1]` as `/stars/catalogue/1`.

    Query parameters (`?limit`) and headers stay; `axes.0 (sensor.gain), value 2` is `/axes/0`.
    """
    if field.startswith("?") or field in ("scene", ""):
        return field if field.startswith("?") else ""
    field = re.sub(r"\[(\d+)\]", r".\1", field.partition(" (")[0])
    parts = field.replace("~", "~0").replace("/", "~1").split(".")
    return cut("/" + "/".join(parts), 200)


def cut(text: str, limit: int = MAX_TEXT) -> str:
    return text if len(text) <= limit else f"{text[: limit - 1]}…"
