"""From a YAML or JSON file to a Study; every mistake named by field, value and remedy."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from pydantic import ValidationError

from catalog_tools.documents import JsonObject, JsonValue
from pipeline.errors import BadInput
from pipeline.spec.load import (
    InvalidScene,
    apply_override,
    mistakes_of,
    read_format_file,
)
from pipeline.spec.study import Study


def read_study(path: Path, overrides: Iterable[str] = ()) -> JsonObject:
    """The plain data of a study file with `a.b=value` overrides; not yet checked."""
    data = read_format_file(path, "STUDY", "study")
    if not isinstance(data, dict):
        raise BadInput("study", data, "a mapping (schema, name, start, sensors, ...)")
    for override in overrides:
        apply_override(data, override)
    return data


def parse_study(data: JsonValue) -> Study:
    """Check plain data against the study format. Raises InvalidScene with every mistake."""
    if not isinstance(data, dict):
        raise BadInput("study", data, "a mapping (schema, name, start, sensors, ...)")
    try:
        return Study.model_validate(data)
    except ValidationError as error:
        raise InvalidScene(mistakes_of(error, data)) from None
