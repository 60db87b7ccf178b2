"""JSON documents as plain values: files, requests and reports before a model reads them."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from typing import Any

JsonValue = Any  # text, a number, true, false, None, a list or an object
JsonObject = dict[str, JsonValue]
Arguments = dict[str, Any]  # by name, of a constructor or a function


def levels(value: object) -> Iterator[list[JsonValue]]:
    """The lists and mappings of each level of a document, from the outermost; those of the next
    are looked for when they are asked for."""
    level = [value]
    while inner := [v for v in level if isinstance(v, dict | list)]:
        yield inner
        level = [w for v in inner for w in (v.values() if isinstance(v, dict) else v)]


def is_deeper(value: object, most: int) -> bool:
    """Whether lists and mappings are nested more than so many levels deep."""
    return len(list(islice(levels(value), most + 1))) > most
