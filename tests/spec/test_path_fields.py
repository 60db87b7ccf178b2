"""Every field that may name a file is found wherever it stands, in lists and mappings too."""

from __future__ import annotations

from typing import Any

from pipeline.spec.load import PATH_FIELDS, path_holders


def put(data: Any, names: tuple[str, ...], many: type) -> None:
    """A text at a place; * stands for the two items of a list, or of a mapping."""
    name, *rest = names
    if name == "*":
        for inner in data.values() if isinstance(data, dict) else data:
            put(inner, tuple(rest), many)
    elif not rest:
        data[name] = "here"
    else:
        put(data.setdefault(name, room(rest, many)), tuple(rest), many)


def room(rest: list[str], many: type) -> Any:
    """What holds the rest of a place."""
    if rest[0] != "*":
        return {}
    two = [room(rest[1:], many) for _ in range(2)]
    return two if many is list else {"0": two[0], "1": two[1]}


def test_all_are_found() -> None:
    for many in (list, dict):
        data: dict[str, Any] = {"other": {"path": "not one"}, "stars": {}}
        for names in PATH_FIELDS:
            put(data, names, many)
        found = [name for name, holder, key in path_holders(data) if holder[key] == "here"]
        wanted = []
        for names in PATH_FIELDS:
            places = [""]
            for name in names:
                both = ("0", "1") if name == "*" else (name,)
                places = [f"{p}.{n}" for p in places for n in both]
            wanted += [p[1:] for p in places]
        assert sorted(found) == sorted(wanted)


def test_limits_what_is_no_scene() -> None:
    for data in (None, 1, "x", [], [{}], {"stars": None}, {"stars": 3}, {"targets": {"a": 1}}):
        assert [name for name, *_ in path_holders(data)] == []
    found = [name for name, *_ in path_holders({"stars": {}})]
    assert found == ["stars.catalogue", "stars.colour_fit"]
