"""What a field of the scene takes, in words, read from the format itself: for messages."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from functools import cache

from catalog_tools.documents import JsonObject
from pipeline.spec.scene import Scene

Node = JsonObject
# The units that stand at the end of keys, as people write them.
UNITS = {
    "um": "um",
    "nm": "nm",
    "mm": "mm",
    "m": "m",
    "km": "km",
    "deg": "degrees",
    "s": "seconds",
    "arcsec": "arcseconds",
    "px": "pixels",
    "e": "electrons",
    "dn": "DN",
    "mag": "magnitudes",
    "mb": "MB",
}


def words_of(field: Sequence[str]) -> str:
    """What the field of these names takes; empty where the format has no such field."""
    nodes = _nodes(field)
    key = next((name for name in reversed(field) if not name.isdigit()), "")
    unit = None if "_per_" in key else UNITS.get(key.rpartition("_")[2])
    found = list(dict.fromkeys(word for node in nodes for word in _words(node, unit)))
    if "text" in found and any(word.startswith("a number") for word in found):
        found[found.index("text")] = "the path of a file"
    return ", or ".join(found)


def range_of(field: Sequence[str]) -> str:
    """Both ends of what the field takes, `-90 to 90`; empty where it has not both, or several."""
    found = set()
    for node in (one for at in _nodes(field) for one in _choices(at)):
        low = node.get("minimum", node.get("exclusiveMinimum"))
        high = node.get("maximum", node.get("exclusiveMaximum"))
        if low is not None and high is not None:
            found.add(f"{low:.15g} to {high:.15g}")
    return found.pop() if len(found) == 1 else ""


@cache
def _schema() -> Node:
    return Scene.model_json_schema(by_alias=True)


def _nodes(field: Sequence[str]) -> list[Node]:
    """The places of the format that a dotted field may be, one for each kind of its holders."""
    nodes = [_schema()]
    for name in field:
        nodes = [inner for node in nodes for inner in _below(node, name)]
    return nodes


def _below(node: Node, name: str) -> Iterator[Node]:
    for one in _choices(node):
        if name in one.get("properties", {}):
            yield one["properties"][name]
        elif name.isdigit() and one.get("type") == "array":
            first = one.get("prefixItems", [])[int(name) : int(name) + 1]
            yield from first or [i for i in [one.get("items")] if isinstance(i, dict)]
        elif isinstance(one.get("additionalProperties"), dict):
            yield one["additionalProperties"]


def _resolved(node: Node) -> Node:
    return _schema()["$defs"][node["$ref"].rpartition("/")[2]] if "$ref" in node else node


def _choices(node: Node) -> Iterator[Node]:
    """What a node stands for: the models and types behind references and unions."""
    node = _resolved(node)
    inner = node.get("anyOf") or node.get("oneOf")
    if not inner:
        yield node
    for one in inner or ():
        yield from _choices(one)


def _words(node: Node, unit: str | None) -> Iterator[str]:
    node = _resolved(node)
    if "discriminator" in node:
        tag = node["discriminator"]
        yield f"a mapping with `{tag['propertyName']}`: {', '.join(sorted(tag['mapping']))}"
        return
    for one in node.get("anyOf") or node.get("oneOf") or ():
        yield from _words(one, unit)
    if "const" in node or "enum" in node:
        yield ", ".join(repr(v) for v in node.get("enum", [node.get("const")]))
    elif "type" in node:
        yield WORDS.get(node["type"], lambda node, _: str(node["type"]))(node, unit)


def _mapping_words(node: Node, _unit: str | None) -> str:
    keys = ", ".join(node.get("required", []))
    return f"a mapping with {keys}" if keys else "a mapping"


def _number_words(node: Node, unit: str | None) -> str:
    word = "a number" if node["type"] == "number" else "a whole number"
    return f"{word} in {unit} (the unit stands in the key)" if unit else word


def _list_words(node: Node, unit: str | None) -> str:
    inner = node.get("prefixItems") or [node.get("items") or {}]
    each = next(_words(inner[0], unit), "").removeprefix("a ")
    several = re.sub(r"^(list|(?:whole )?number|mapping)\b", r"\1s", each)
    count = f" of {len(inner)}" if len(inner) > 1 else " of" if several else ""
    return f"a list{count} {several}".rstrip()


# What is told of a value by its type in the format.
WORDS: dict[str, Callable[[Node, str | None], str]] = {
    "object": _mapping_words,
    "number": _number_words,
    "integer": _number_words,
    "array": _list_words,
    "string": lambda *_: "text",
    "boolean": lambda *_: "true or false",
}
