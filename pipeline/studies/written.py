"""What a study found, as JSON: a figure that is no finite number is null."""

from __future__ import annotations

import json
import math
from pathlib import Path

from catalog_tools.documents import JsonObject, JsonValue


def write_study(path: Path, study: JsonObject) -> None:
    """Write a study's JSON file, NaN and infinities as null."""
    path.write_text(json.dumps(with_nulls(study), indent=1, allow_nan=False) + "\n")


def with_nulls(value: JsonValue) -> JsonValue:
    """Plain data as JSON takes it: NaN and infinities as null."""
    if isinstance(value, dict):
        return {key: with_nulls(v) for key, v in value.items()}
    if isinstance(value, list | tuple):
        return [with_nulls(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
