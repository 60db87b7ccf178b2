"""What a server's answer means to its client: nothing wrong, or which error."""

from __future__ import annotations

import httpx

from pipeline.errors import BadInput, NightglassError


class ServiceError(NightglassError):
    """The server refused or failed; `status` is its HTTP status, 0 where it did not answer."""

    def __init__(self, message: str, status: int = 0) -> None:
        self.status = status
        super().__init__(message)


class Refused(BadInput):
    """The server does not accept what was sent; `mistakes` are its (field, value, allowed)."""

    def __init__(self, mistakes: list[tuple[str, str, str]], status: int) -> None:
        self.mistakes, self.status = mistakes, status
        super().__init__(*mistakes[0])

    def __reduce__(self) -> tuple[object, ...]:
        return type(self), (self.mistakes, self.status)

    def __str__(self) -> str:
        """Each mistake on a line; the values are as the server shows them."""
        return "\n".join(f"{f}: {v} is not accepted; {_allowed(a)}" for f, v, a in self.mistakes)


def problem_of(answer: httpx.Response, *, was_asked: bool = False) -> NightglassError | None:
    """The error that an answer means, or None.

    was_asked : to delete it, by a request whose answer was lost: it need not be there any more
    """
    if answer.status_code < 400 or (was_asked and answer.status_code == 404):
        return None
    detail, found = _told(answer)
    if found and answer.status_code < 500:
        return Refused(found, answer.status_code)
    return ServiceError(f"{answer.url.netloc.decode()}: {detail}", answer.status_code)


def _told(answer: httpx.Response) -> tuple[str, list[tuple[str, str, str]]]:
    """What an answer says in words, and of each field; its status where it does not."""
    status = f"status {answer.status_code} {answer.reason_phrase}"
    try:
        answer.read()
        body = answer.json()
        detail = str(body.get("detail") or body.get("title") or status)
        listed = body.get("errors") or []
        return detail, [(_field(e["pointer"]), str(e["value"]), str(e["allowed"])) for e in listed]
    except (ValueError, KeyError, TypeError, AttributeError):
        return status, []


def _field(pointer: str) -> str:
    """`/sensor/shape` as `sensor.shape`."""
    parts = pointer.removeprefix("/").split("/")
    return ".".join(p.replace("~1", "/").replace("~0", "~") for p in parts) or "scene"


def _allowed(text: str) -> str:
    return text if text.startswith("allowed: ") else f"allowed: {text}"
