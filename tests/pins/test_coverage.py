"""The pins between them use all of the scene format, and every component that a plan may name."""

from __future__ import annotations

import inspect
import types
from collections.abc import Iterator
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import pytest
from pydantic import BaseModel

from pipeline.plan.ledger import LEDGER
from pipeline.spec.scene import Scene
from pipeline.spec.sweep import Sweep
from pipeline.spec.sweep_load import parse_sweep
from tests.pins.compare import KEPT, KINDS, load
from tests.pins.draw import scene_of, sweep_data
from tests.pins.scenes import AFTERWARDS, NAMES, SCENES, SWEEPS

MOST_BYTES = 1_000_000
# What no pin uses, and why.
EXCEPTIONS = {
    # The validator turns true and false into a part with its defaults, a word, or none.
    "Atmosphere.*: bool": "becomes a part with its defaults",
    "Background.*: bool": "becomes a part with its defaults, or a word",
    # The program writes these into the scene that a product keeps; a pin's scene is a user's.
    "TablePointing.error_arcsec: *": "written by the program",
    "TablePointing.source: *": "written by the program",
    "TableOrbit.error_m: *": "written by the program",
    "TableOrbit.source: *": "written by the program",
    "MeshBody.digest: *": "written by the program",
    "Population.screened: *": "written by the program",
    "Target.object_name: *": "written by the program",
    # Its own tests draw with one (tests/inputs/band/test_colour_fit_files.py).
    "Stars.colour_fit: *": "a file that `nightglass color-fit` writes",
    "model Screened": "written by the program",
    "Screened.*": "written by the program",
}


def labels(annotation: Any) -> Iterator[str]:
    """What a field of a type may hold: words, numbers, text, switches, lists, models by name."""
    origin = get_origin(annotation)
    if origin is Annotated:
        yield from labels(get_args(annotation)[0])
    elif origin in (Union, types.UnionType):
        for one in get_args(annotation):
            yield from labels(one)
    elif origin is Literal:
        yield from (_word(word, annotation) for word in get_args(annotation))
    elif origin in (tuple, list):
        yield "list"
        for one in get_args(annotation):
            yield from labels(one)
    elif origin is dict:
        yield from labels(get_args(annotation)[1])
    elif isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield f"model {annotation.__name__}"
    elif annotation in (int, float, str, bool):
        yield {str: "text", bool: "bool"}.get(annotation, "number")


def _word(word: Any, choice: Any) -> str:
    """A word of a choice: the same wherever the same choice is offered."""
    return f"word {word!r} of {', '.join(sorted(map(str, get_args(choice))))}"


def choices(annotation: Any) -> Iterator[Any]:
    """Every Literal in a type, but not in the models that it names."""
    if get_origin(annotation) is Literal:
        yield annotation
    else:
        for one in get_args(annotation):
            yield from choices(one)


def models(annotation: Any) -> Iterator[type[BaseModel]]:
    """Every model that a type leads to, by way of others too; some of them twice."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
        for field in annotation.model_fields.values():
            yield from models(field.annotation)
    else:
        for one in get_args(annotation):
            yield from models(one)


def at(model: type[BaseModel], name: str, label: str) -> str:
    """A label of a field; models and words are asked for once, wherever they may stand.

    A field is named after the model that brings it in: of kinds that inherit it one must use it.
    """
    if label.startswith(("model ", "word ")):
        return label
    owner = next(c for c in reversed(model.__mro__) if name in inspect.get_annotations(c))
    return f"{owner.__name__}.{name}: {label}"


def wanted() -> set[str]:
    """Everything that pins must use; of each field too that it is given, of switches both sides."""
    out: set[str] = set()
    for model in {*models(Scene), *models(Sweep)}:
        for name, field in model.model_fields.items():
            found = {*labels(field.annotation), "given"}
            if found == {"bool", "given"}:
                found = {"True", "False", "given"}
            out |= {at(model, name, label) for label in found}
    return out


def used(value: Any) -> Iterator[str]:
    """The same of a scene or sweep that is there."""
    if isinstance(value, BaseModel):
        yield f"model {type(value).__name__}"
        for name, field in type(value).model_fields.items():
            held = getattr(value, name)
            if name in value.model_fields_set:
                yield at(type(value), name, "given")
            for label in _held(held, [*choices(field.annotation)]):
                yield at(type(value), name, label)
            yield from used(held)
    elif isinstance(value, tuple | list | dict):
        for one in value.values() if isinstance(value, dict) else value:
            yield from used(one)


def _held(value: Any, offered: list[Any]) -> Iterator[str]:
    if isinstance(value, tuple | list | dict):
        yield "list"
        for one in value.values() if isinstance(value, dict) else value:
            yield from _held(one, offered)
    elif isinstance(value, bool):
        yield from (repr(value), "bool")
    elif isinstance(value, int | float | str):
        yield "text" if isinstance(value, str) else "number"
        yield from (_word(value, one) for one in offered if value in get_args(one))


@pytest.fixture(scope="module")
def found() -> set[str]:
    files = Path("files")
    out = {label for name in SCENES for label in used(scene_of(name, files))}
    return out | {label for name in SWEEPS for label in used(parse_sweep(sweep_data(name, files)))}


def _excepted(label: str) -> bool:
    return any(fnmatchcase(label, pattern) for pattern in EXCEPTIONS)


def test_every_kind_word_and_field_is_used(found: set[str]) -> None:
    assert not sorted(label for label in wanted() - found if not _excepted(label))


def test_exceptions_are_needed(found: set[str]) -> None:
    """An exception that is used, or that names nothing of the format, goes."""
    open_ = wanted() - found
    assert not [one for one in EXCEPTIONS if not any(fnmatchcase(w, one) for w in open_)]


def test_the_walk_finds_what_is_there() -> None:
    some = {
        "PsfShape.jitter_px: given", "model OrbitObserver", "word 'floor' of floor, half_even",
        "Detector.blooming: False", "model Lag", "Sensor.flat: text", "Sensor.flat: number",
        "model MeshBody", "word 'sobol' of latin_hypercube, sobol", "TablePsf.centre: list",
        "model SpinJoint", "Detector.lag: given", "word 2 of 0, 2, 3, 4, 5, 6",
    }  # fmt: skip
    assert some <= wanted()


def test_every_component_of_the_ledger_is_pinned() -> None:
    components = set()
    for name in SCENES:
        plan = load(name).drawn.plan
        names = {k.split(".")[1] for k in plan if k.startswith("decisions.")}
        components |= {name.partition("#")[0].replace("/", ".") for name in names}
    patterns = [pattern for rule in LEDGER for pattern in rule.components]
    assert not [p for p in patterns if not any(fnmatchcase(c, p) for c in components)]


def test_pins_are_of_these_scenes_and_small() -> None:
    kept = sorted(KEPT.iterdir())
    assert {p.name for p in kept} == {KINDS} | {f"{n}.{e}" for n in NAMES for e in ("json", "xz")}
    assert sum(p.stat().st_size for p in kept) < MOST_BYTES
    assert len(NAMES) >= 40
    assert set(AFTERWARDS) <= set(SCENES)
    assert {"fits", "png", "satnet", "coco", "masks", "calibrated"} <= {
        kind for kinds in AFTERWARDS.values() for kind in kinds
    }
