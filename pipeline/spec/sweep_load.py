"""From a YAML or JSON file to a Sweep; every mistake named by field, value and remedy."""

from __future__ import annotations

from pathlib import Path

from pydantic import ValidationError

from pipeline.errors import BadInput
from pipeline.spec.load import InvalidScene, mistakes_of, read_format_file
from pipeline.spec.sweep import Sweep


def load_sweep(path: Path) -> Sweep:
    """Read a sweep file and check it."""
    return parse_sweep(read_format_file(path, "SWEEP", "sweep"))


def parse_sweep(data: object) -> Sweep:
    """Check plain data against the sweep format. Raises InvalidScene with every mistake."""
    if not isinstance(data, dict):
        raise BadInput("sweep", data, "a mapping (schema, name, scene, axes, ...)")
    try:
        return Sweep.model_validate(data)
    except ValidationError as error:
        raise InvalidScene(mistakes_of(error, data)) from None
