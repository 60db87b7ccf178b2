"""From a YAML or JSON file to a Sweep; every mistake named by field, value and remedy."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from pydantic import ValidationError

from catalog_tools.documents import JsonObject
from pipeline.errors import BadInput
from pipeline.spec.load import (
    InvalidScene,
    apply_override,
    mistakes_of,
    parse_text,
    place_paths,
    plain_mapping,
    read_format_file,
)
from pipeline.spec.sweep import Sweep, check_overrides

FORMAT = "sweep", "scene, axes"
OF_SCENE = "scene."


def read_sweep(path: Path, overrides: Iterable[str] = (), placed: bool = True) -> JsonObject:
    """The plain data of a sweep file with `a.b=value` overrides; not yet checked.

    With overrides its scene's file is read, too: `scene.sensor.read_noise_e=3` sets a key there.
    placed : relative paths in that file are made absolute
    """
    data = plain_mapping(read_format_file(path, "SWEEP", "sweep"), *FORMAT)
    overrides = list(overrides)
    for override in overrides:
        if not override.startswith(OF_SCENE):
            apply_override(data, override)
    if overrides and isinstance(name := data.get("scene"), str):
        data["scene"], home = read_base(name, path.parent)
        if placed:
            place_paths(data["scene"], home)
    for override in overrides:
        if override.startswith(OF_SCENE):
            apply_override(data, override)
    return data


def read_base(name: str, folder: Path) -> tuple[JsonObject, Path]:
    """The plain data of the scene file that a sweep in a folder names, and that file's folder."""
    file = folder / name
    if not file.is_file():
        raise BadInput("scene", name, "an existing scene file, from the sweep's folder")
    data = parse_text(file.read_bytes(), str(file))
    if not isinstance(data, dict):
        raise BadInput("scene", data, "a scene: a mapping of sections")
    return data, file.parent


def load_sweep(path: Path, overrides: Iterable[str] = ()) -> Sweep:
    """Read a sweep file, with overrides as `read_sweep` takes them, and check it."""
    overrides = list(overrides)
    return parse_sweep(read_sweep(path, overrides), overrides)


def parse_sweep(data: object, overrides: Iterable[str] = ()) -> Sweep:
    """Check plain data against the sweep format. Raises InvalidScene with every mistake.

    overrides : that were set in it; BadInput for one of a field that an axis changes, where it
    would have no effect
    """
    data = plain_mapping(data, *FORMAT)
    try:
        sweep = Sweep.model_validate(data)
    except ValidationError as error:
        raise InvalidScene(mistakes_of(error, data)) from None
    check_overrides(overrides, sweep.axes, "sweep", OF_SCENE)
    return sweep
