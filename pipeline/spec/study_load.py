"""From a YAML or JSON file to a Study; every mistake named by field, value and remedy."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from pydantic import ValidationError

from catalog_tools.documents import JsonObject, JsonValue
from pipeline.spec.load import (
    InvalidScene,
    apply_override,
    mistakes_of,
    plain_mapping,
    read_format_file,
)
from pipeline.spec.study import Study
from pipeline.spec.sweep import check_overrides

FORMAT = "study", "start, sensors"


def read_study(path: Path, overrides: Iterable[str] = ()) -> JsonObject:
    """The plain data of a study file with `a.b=value` overrides; checked only where there are any:
    BadInput for one of a field that an axis changes, where it would have no effect."""
    data = plain_mapping(read_format_file(path, "STUDY", "study"), *FORMAT)
    overrides = list(overrides)
    for override in overrides:
        apply_override(data, override)
    if overrides:
        check_overrides(overrides, parse_study(data).axes, "study")
    return data


def parse_study(data: JsonValue) -> Study:
    """Check plain data against the study format. Raises InvalidScene with every mistake."""
    data = plain_mapping(data, *FORMAT)
    try:
        return Study.model_validate(data)
    except ValidationError as error:
        raise InvalidScene(mistakes_of(error, data)) from None
