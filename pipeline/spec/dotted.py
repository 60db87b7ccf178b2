"""Fields of plain data by dotted names: `sensor.read_noise_e`, `targets.0.body.albedo`."""

from __future__ import annotations

import copy

from catalog_tools.documents import JsonObject, JsonValue


class NoFieldError(LookupError):
    """There is no place for a field; `args[0]` is the dotted name up to which there is none."""


def set_dotted(data: object, name: str, value: object) -> None:
    """Set one field in place; mappings that are missing on the way are made.

    Raises NoFieldError where the way leads through a plain value or beyond a list's end.
    """
    holder, key = _holder(data, name)
    holder[key] = value


def add_dotted(data: object, name: str, value: object) -> None:
    """Add a value to a list in place, unless it is there; a missing list is made.

    Raises NoFieldError where there is no list of that name, and none can be made.
    """
    holder, key = _holder(data, name)
    held = holder.get(key) if isinstance(holder, dict) else holder[key]
    if held is not None and not isinstance(held, list):
        raise NoFieldError(name)
    held = held or []
    holder[key] = held if value in held else [*held, value]


def changed(data: object, changes: JsonObject) -> JsonValue:
    """A copy of plain data with dotted changes; None removes one. Raises as `set_dotted`."""
    out = copy.deepcopy(data)
    for name, value in changes.items():
        holder, key = _holder(out, name)
        if value is not None:
            holder[key] = copy.deepcopy(value)
        elif isinstance(holder, list):
            del holder[key]
        else:
            holder.pop(key, None)
    return out


def _holder(data: JsonValue, name: str) -> tuple[JsonValue, JsonValue]:
    """What holds a field, and its key there."""
    *parents, last = name.split(".")
    holder = data
    for i, part in enumerate(parents):
        if (place := _place(holder, part)) is not None:
            holder = holder[place]
        elif isinstance(holder, dict):
            if holder.get(part) is None:
                holder[part] = {}
            holder = holder[part]
        else:
            raise NoFieldError(".".join(parents[: i + 1]))
    if (place := _place(holder, last)) is not None:
        return holder, place
    if isinstance(holder, dict):
        return holder, last
    raise NoFieldError(name)


def _place(holder: object, name: str) -> int | None:
    """The place in a list that a number names; None where there is none."""
    there = isinstance(holder, list) and name.isdigit() and int(name) < len(holder)
    return int(name) if there else None
