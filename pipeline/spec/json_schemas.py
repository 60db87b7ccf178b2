"""JSON Schemas of the files that users write: scenes, sweeps, studies."""

from __future__ import annotations

from importlib import import_module

from catalog_tools.documents import JsonObject
from pipeline.errors import BadInput

FORMATS = {"scene": "Scene", "sweep": "Sweep", "study": "Study"}


def json_schema(of: str) -> JsonObject:
    """The JSON Schema (2020-12) of a format. BadInput for a name that is none of FORMATS."""
    if of not in FORMATS:
        raise BadInput("FORMAT", of, f"one of {', '.join(FORMATS)}")
    model = getattr(import_module(f"pipeline.spec.{of}"), FORMATS[of])
    schema: JsonObject = model.model_json_schema(by_alias=True)
    return schema
