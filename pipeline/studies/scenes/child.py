"""A process of its own for one measurement: an order as JSON on stdin, what came out on stdout."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from catalog_tools.documents import JsonObject
from pipeline.errors import BadInput, NightglassError
from pipeline.studies.scenes.exact import find_exact
from pipeline.studies.scenes.level import measure_level, render_once
from pipeline.studies.scenes.stage import open_stage, tiles_of
from pipeline.studies.scenes.switches import measure_switches


def main() -> None:
    """Do what the order says; a fault that a user can mend is told as {"refused": [...]}."""
    order = json.load(sys.stdin)
    try:
        found = WORK[order["work"]](order)
    except BadInput as error:
        found = {"refused": [error.field, str(error.value), error.allowed]}
    except NightglassError as error:
        found = {"failed": str(error)}
    print(json.dumps(found))


def _reference(order: JsonObject) -> JsonObject:
    """Windows and what belongs in them, written for the others; then each approximation alone.

    The scene is rendered once before, so that no other process has to compile what it draws with.
    """
    render_once(order["scene"], order["share"], Path(order["folder"]))
    finest = open_stage(order["finest"])
    tiles = tiles_of(finest, order["share"])
    levels = (open_stage(scene) for scene in order["levels"])
    exact = find_exact(finest, tiles, order["windows"], levels)
    exact.save(Path(order["exact"]))
    usual = open_stage(order["scene"], finest.plan)
    return {
        "sources": exact.sources,
        "windows": len(exact.windows),
        "switches": measure_switches(usual, tiles, exact),
    }


def _level(order: JsonObject) -> JsonObject:
    return measure_level(order)


WORK = {"reference": _reference, "level": _level}

if __name__ == "__main__":
    main()
