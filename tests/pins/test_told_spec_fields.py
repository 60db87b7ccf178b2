"""What is told of each field of a scene and a sweep that holds something that it cannot hold."""

from __future__ import annotations

import copy
import inspect
import re
import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel

from pipeline.errors import shorten
from pipeline.spec.load import InvalidScene, parse_scene
from pipeline.spec.sweep_load import parse_sweep
from tests.pins.draw import scene_data, sweep_data
from tests.pins.scenes import SCENES, SWEEPS
from tests.pins.told import check_told

FILES = Path("files")
KINDS = {"text": "?", "true": True, "none": None, "[]": []}
KINDS |= {"long": " " + "x" * 5000, "nan": float("nan"), "[?]": ["?"]}
NUMBERS = {"-1e30": -1e30, "-1": -1, "0": 0, "0.5": 0.5, "3": 3, "1e30": 1e30}
SCREENED = {"digest": "0", "read": 3, "kept": 2, "superseded": 1, "unreadable": 0, "dwell_s": 2.0}
SCREENED |= {"failed": [[1, 2]], "left_out": ["A: none"], "half_angle_deg": 1.0}
ALSO = ", not true or false"
SHORT = (
    (r" in [\w ]+ \(the unit stands in the key\)", " in its unit"),
    ("greater than or equal to", ">="),
    ("less than or equal to", "<="),
    ("greater than", ">"),
)
Data, Way, Parse = dict[str, Any], tuple[Any, ...], Callable[[dict[str, Any]], Any]


def sources() -> Iterator[tuple[Parse, Data]]:
    """Valid scenes and sweeps that between them hold every part of the format, all filled in."""
    for name in SCENES:
        data = scene_data(name, FILES)
        if name == "population":
            data["populations"][0]["screened"] = SCREENED
        yield parse_scene, parse_scene(data).as_dict()
    for name in SWEEPS:
        yield parse_sweep, parse_sweep(sweep_data(name, FILES)).as_dict()


def parts(value: Any, way: Way = ()) -> Iterator[tuple[BaseModel, Way]]:
    """Every model below a value, and the way to it."""
    if isinstance(value, BaseModel):
        yield value, way
        for name, field in type(value).model_fields.items():
            yield from parts(getattr(value, name), (*way, field.alias or name))
    elif isinstance(value, tuple | dict):
        for key, one in value.items() if isinstance(value, dict) else enumerate(value):
            yield from parts(one, (*way, key))


def owner_of(part: BaseModel, name: str) -> str:
    """The model that brings in a field."""
    chain = reversed(type(part).__mro__)
    return next(c.__name__ for c in chain if name in inspect.get_annotations(c))


def places() -> dict[str, tuple[Parse, Data, Way]]:
    """Of each field, and of the first item of one that holds several: data that have it, and where.

    A field is named after the model that brings it in; of its places the best filled one is taken.
    """
    found: dict[str, tuple[Parse, Data, Way, Any]] = {}
    for parse, data in sources():
        for part, way in parts(parse(data)):
            for name, field in type(part).model_fields.items():
                key, held = f"{owner_of(part, name)}.{field.alias or name}", getattr(part, name)
                if key not in found or (held and not found[key][3]):
                    found[key] = parse, data, (*way, field.alias or name), held
    out = {}
    for name, (parse, data, way, held) in sorted(found.items()):
        out[name] = parse, data, way
        while held and isinstance(held, tuple | dict):
            items = {str(k): v for k, v in held.items()} if isinstance(held, dict) else held
            step = next(iter(items)) if isinstance(held, dict) else 0
            name, way, held = f"{name}.{step}", (*way, step), items[step]
            out[name] = parse, data, way
    return out


def at(data: Any, way: Way) -> Any:
    for step in way:
        data = data[step]
    return data


def told(parse: Parse, data: Data, way: Way, value: Any) -> str:
    """What is told where the place holds this value; what it becomes where that is taken."""
    data = copy.deepcopy(data)
    at(data, way[:-1])[way[-1]] = value
    return parsed(parse, data, way, value)


def parsed(parse: Parse, data: Data, way: Way, value: Any) -> str:
    """What is told of data, as far as a value at a place in it is concerned."""
    asked, above, texts = ".".join(map(str, way)), ".".join(map(str, way[:-1])), []
    try:
        found = at(parse(data).as_dict(), way)
    except InvalidScene as error:
        for field, given, allowed in error.mistakes:
            same = given is value or given == str(value) or isinstance(given, dict | list)
            where = {asked: "", above: "up: "}.get(field, f"{field.replace(asked, 'it')}: ")
            shown = "" if same or (given is None and "given" in allowed) else f"{shorten(given)}: "
            text = f"{where}{shown}{allowed.removeprefix('allowed: ')}"
            texts += [text] if "it must be" not in text or not texts else []
        return " / ".join(texts)
    return "taken" if found == value else f"becomes {shorten(found)}"


def answers(place: tuple[Parse, Data, Way], values: Data) -> str:
    """A line for each thing that is told of some values at a place."""
    by: dict[str, list[str]] = {}
    for name, value in values.items():
        text = told(*place, value)
        for long, short in SHORT:
            text = re.sub(long, short, text)
        if text.endswith(ALSO) and text.removesuffix(ALSO) in by:
            text, name = text.removesuffix(ALSO), f"{name}*"
        elif text.endswith(ALSO) and text.startswith("up: "):
            text = f"as of the whole{ALSO}"
        by.setdefault(text, []).append(name)
    return "\n".join(f"    {', '.join(names)}: {text}" for text, names in by.items())


@pytest.mark.parametrize("name", ["kinds", "numbers"])
def test_what_is_told_of_values_in_each_field(name: str) -> None:
    """Fields of which the same is told stand together; * says also that it is not true or false.

    Of numbers only what differs between them, of items nothing but numbers.
    """
    by: dict[str, list[str]] = {}
    for field, place in places().items():
        text = answers(place, KINDS if name == "kinds" else NUMBERS)
        if "\n" in text if name == "numbers" else field.count(".") == 1:
            by.setdefault(text, []).append(field)
    lines = [f"{textwrap.fill(' '.join(fields), 100)}\n{text}" for text, fields in by.items()]
    check_told(f"spec/{name}", "\n".join(lines))


def test_defaults_and_near_misses_of_each_key() -> None:
    """Of each part which keys must be given; what others are; what is meant by one cut short.

    The last only where that is another key, or none.
    """
    lines: dict[str, str] = {}
    for parse, data in sources():
        for part, way in parts(parse(data)):
            name, holder, must, own, near = type(part).__name__, at(data, way), [], [], []
            if name in lines:
                continue
            for key in [field.alias or key for key, field in type(part).model_fields.items()]:
                text = told(parse, data, (*way, key[:-1]), 1)
                meant = text.partition("did you mean ")[2].partition("?")[0]
                near += [f"{key[:-1]}: {meant or text}"] if meant != repr(key) else []
                kept = holder.pop(key)
                text = parsed(parse, data, (*way, key), None)
                must += [key] if text == "it must be given" else []
                default = text.removeprefix("becomes ")
                own += (
                    [f"{key} {default}"] if default != text and name == owner_of(part, key) else []
                )
                holder[key] = kept
            lines[name] = "; ".join([f"{name}: {', '.join(must)}", *own, *near])
    check_told("spec/keys", "\n".join(lines[name] for name in sorted(lines)))


def test_what_is_said_of_each_key() -> None:
    """Of keys that their model's docstring tells of."""
    lines = []
    for model in {type(part) for parse, data in sources() for part, _ in parts(parse(data))}:
        for key, said in model.model_json_schema()["properties"].items():
            text = said["description"]
            field = model.model_fields.get(key)
            if text in " ".join((model.__doc__ or "").split()) and not (
                field and field.description
            ):
                lines.append(f"{model.__name__}.{key}: {text}")
    check_told("spec/said", "\n".join(sorted(lines)))
