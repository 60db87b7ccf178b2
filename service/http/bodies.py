"""Request bodies: counted while they stream in, then strict JSON or YAML, or nothing."""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import json
import math
from collections.abc import Sequence
from itertools import chain
from typing import NoReturn

from starlette.requests import ClientDisconnect, Request

from catalog_tools.documents import JsonObject, JsonValue
from pipeline.errors import BadInput
from pipeline.spec import load
from service.problems import Malformed, TooLarge, TooSlow, WrongMediaType, cut

JSON, YAML = "application/json", "application/yaml"
TEXTS = (JSON, YAML)  # what a scene or a sweep may come as
YAML_BYTES = 1 << 17  # reading it takes a second: larger scenes come as JSON
MAX_DEPTH = 32
DISCARD_BYTES, DISCARD_S = 1 << 24, 1.0


async def read_body(
    request: Request, limit_bytes: int, limit_s: float, kinds: tuple[str, ...] = (JSON,)
) -> bytes:
    """The body of a request that says it is one of `kinds`, of at most `limit_bytes`, chunked or
    not."""
    _check_media_type(request, kinds)
    declared = request.headers.get("content-length", "")
    too_large = declared.isdigit() and (len(declared) > 18 or int(declared) > limit_bytes)
    body, more = bytearray(), True
    try:
        async with asyncio.timeout(limit_s):
            while more and not too_large:
                message = await request.receive()
                if message["type"] == "http.disconnect":
                    raise Malformed("the body ended before it was whole")
                body += message.get("body", b"")
                more = message.get("more_body", False)
                too_large = len(body) > limit_bytes
    except TimeoutError:
        raise TooSlow(f"a body must arrive within {limit_s:g} s") from None
    if too_large:
        body.clear()
        await discard_rest(request)
        raise TooLarge(f"a body of at most {limit_bytes} bytes is taken")
    return bytes(body)


async def discard_rest(request: Request) -> None:
    """Read on for a moment, keeping nothing: a connection that is closed on a client which still
    sends is reset, and the refusal is lost with it."""
    discarded = 0
    with contextlib.suppress(TimeoutError, ClientDisconnect):
        async with asyncio.timeout(DISCARD_S):
            while discarded < DISCARD_BYTES:
                message = await request.receive()
                discarded += len(message.get("body", b""))
                if not message.get("more_body", False):
                    return


def media_type(request: Request) -> str:
    """What a request says that its body is."""
    return request.headers.get("content-type", "").partition(";")[0].strip().lower()


def _check_media_type(request: Request, wanted: tuple[str, ...]) -> None:
    given = request.headers.get("content-type", "")
    charset = given.partition(";")[2].strip().lower().removeprefix("charset=").strip('"')
    if media_type(request) not in wanted or charset not in ("", "utf-8"):
        allowed = f"{' or '.join(wanted)} in UTF-8"
        raise WrongMediaType(f"a body of {allowed} is taken", (("?Content-Type", given, allowed),))
    encoding = request.headers.get("content-encoding", "identity")
    if encoding.strip().lower() != "identity":
        raise WrongMediaType(
            "compressed bodies are not taken", (("?Content-Encoding", encoding, "identity"),)
        )


def parse_text(body: bytes, kind: str) -> JsonValue:
    """Plain data from the text of a scene or sweep, JSON or YAML. Malformed, TooLarge."""
    return parse_yaml(body) if kind == YAML else parse_json(body)


def parse_yaml(body: bytes) -> JsonValue:
    """Plain data from YAML 1.2, as strict as JSON: one document of mappings with text as keys,
    lists, text, finite numbers, true, false and null; no key twice, no alias, no tag for more.

    Malformed for everything else, TooLarge beyond YAML_BYTES.
    """
    if len(body) > YAML_BYTES:
        raise TooLarge(f"YAML of at most {YAML_BYTES} bytes is taken; send larger scenes as JSON")
    try:
        data = load.parse_text(body, "the body")
    except BadInput as error:
        raise Malformed(cut(f"the body: {error.value}: {error.allowed}")) from None
    _check_nodes(data)
    return data


def parse_json(body: bytes) -> JsonValue:
    """Plain data from JSON text. Malformed for everything that RFC 8259 or sense refuses:

    NaN, Infinity and numbers beyond float64, lone surrogates, keys given twice, nesting deeper
    than 32 levels, integers of thousands of digits, bytes that are not UTF-8.
    """
    try:
        data = json.loads(
            body.decode("utf-8"),
            parse_constant=_no_constant,
            parse_float=_finite,
            object_pairs_hook=_once,
        )
    except UnicodeDecodeError as error:
        raise Malformed(f"the body is not UTF-8 (byte {error.start})") from None
    except RecursionError:
        raise Malformed(f"the body is nested deeper than {MAX_DEPTH} levels") from None
    except json.JSONDecodeError as error:
        where = f"line {error.lineno}, column {error.colno}"
        raise Malformed(f"the body is not JSON: {cut(error.msg, 80)} at {where}") from None
    except ValueError:
        raise Malformed("the body holds a number with too many digits") from None
    _check_nodes(data)
    return data


def _no_constant(name: str) -> NoReturn:
    raise Malformed(f"{name} is not JSON")


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise Malformed(f"the number {cut(text, 40)} is beyond the range of float64")
    return value


def _once(pairs: list[tuple[str, object]]) -> JsonObject:
    found = dict(pairs)
    if len(found) != len(pairs):
        seen: set[str] = set()
        twice = next(key for key, _ in pairs if key in seen or seen.add(key))  # type: ignore[func-returns-value]
        raise Malformed(f"the key {cut(ascii(twice), 80)} is given twice")
    return found


def _check_nodes(data: object) -> None:
    """Depth, kind and text of every node, without recursion."""
    level = [data]
    for depth in range(MAX_DEPTH + 1):
        if depth == MAX_DEPTH and any(isinstance(node, dict | list) for node in level):
            break
        level = list(chain.from_iterable(map(_checked, level)))
        if not level:
            return
    raise Malformed(f"the body is nested deeper than {MAX_DEPTH} levels")


def _checked(node: object) -> Sequence[object]:
    """What a node holds: the keys and values of a mapping, the items of a list."""
    if isinstance(node, str):
        _check_text(node)
    elif isinstance(node, dict):
        if not all(isinstance(key, str) for key in node):
            raise Malformed("a key of a mapping is no text: put it in quotes")
        return [*node, *node.values()]
    elif isinstance(node, list):
        return node
    elif isinstance(node, float) and not math.isfinite(node):
        raise Malformed(f"{node} is no number of a scene")
    elif not (node is None or isinstance(node, bool | int | float)):
        raise Malformed(f"a value of kind {type(node).__name__} is no plain data")
    return ()


def _check_text(text: str) -> None:
    if not text.isascii():
        try:
            text.encode("utf-8")
        except UnicodeEncodeError as error:
            raise Malformed(
                f"text with a lone surrogate (U+{ord(text[error.start]):04X}) is not Unicode"
            ) from None


def digest_of(data: object) -> str:
    """SHA-256 of plain data that was sent: the same for every order of keys and every notation."""
    return hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()
