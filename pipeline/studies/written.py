"""What a study found, as a JSON file: a figure that is no finite number is null."""

from __future__ import annotations

import json
import math
from pathlib import Path

from catalog_tools.documents import JsonObject, JsonValue


def write_study(path: Path, study: JsonObject) -> None:
    """Write a study's JSON file, NaN and infinities as null."""
    path.write_text(json.dumps(_with_nulls(study), indent=1, allow_nan=False) + "\n")


def _with_nulls(value: JsonValue) -> JsonValue:
    if isinstance(value, dict):
        return {key: _with_nulls(v) for key, v in value.items()}
    if isinstance(value, list | tuple):
        return [_with_nulls(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
