"""Pure functions of light, places, bodies and drawing, at edges that no pinned scene reaches.

The stored texts ask, in lines of Python, and hold what came, further in, under each line.
"""

from __future__ import annotations

import pkgutil
from importlib import import_module
from typing import Any

import numpy as np
import pytest

from pipeline import physics
from pipeline.inputs.reference import zodiacal as published
from tests.pins.test_told_inputs import answered, names

__all__ = ["names"]
ROOMS = ("positions", "targets", "psf", "sky", "drawing", "motion")
# How many lines each stored text asks: one that is lost is a fault.
ASKED = {
    "sky": 38,
    "light": 22,
    "positions": 30,
    "orbits": 35,
    "camera": 16,
    "bodies": 27,
    "psf": 32,
    "drawing": 38,
}


@pytest.mark.parametrize("group", ASKED)
def test_as_pinned(group: str, names: dict[str, Any]) -> None:
    for room in pkgutil.walk_packages(physics.__path__, "pipeline.physics."):
        parts = room.name.split(".")
        if len(parts) == 3 or parts[2] in ROOMS:
            names[parts[-1]] = import_module(room.name)
    names["published"] = published
    noise = 1e-9 if group == "camera" else 0.0  # what fits leave of coefficients that are zero
    with np.errstate(all="ignore"):
        answered(f"inputs/of-{group}", ASKED[group], names, noise)
