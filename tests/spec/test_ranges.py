"""What each field of a scene may be, and is where it is absent: kept in `ranges.txt`.

A scene that is valid today is valid tomorrow, and means the same: ranges and defaults change on
purpose alone, with a line in CHANGELOG. `python tests/spec/test_ranges.py` writes them anew.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from pipeline.spec.scene import Scene
from pipeline.spec.sweep import Sweep

KEPT = Path(__file__).with_name("ranges.txt")
SAID = ("title", "description", "discriminator")


def ranges() -> list[str]:
    """A line for each field of each part of a scene: what it may be, and its default."""
    found: dict[str, str] = {}
    for model in (Scene, Sweep):
        schema = model.model_json_schema()
        for name, part in {model.__name__: schema, **schema.get("$defs", {})}.items():
            must = part.get("required", [])
            for field, what in part.get("properties", {}).items():
                asked = "must be given" if field in must else "may be absent"
                found[f"{name}.{field}"] = f"{asked} {json.dumps(_bare(what), sort_keys=True)}"
    return [f"{place}: {what}" for place, what in sorted(found.items())]


def _bare(what: Any) -> Any:
    """A piece of a schema without its words."""
    if isinstance(what, dict):
        return {k: _bare(v) for k, v in what.items() if k not in SAID}
    return [_bare(v) for v in what] if isinstance(what, list) else what


def test_ranges_and_defaults_are_as_they_were() -> None:
    now, kept = ranges(), KEPT.read_text(encoding="utf-8").splitlines()
    assert len(now) > 200
    assert sorted(set(now) - set(kept)) == sorted(set(kept) - set(now)) == []


if __name__ == "__main__":
    KEPT.write_text("\n".join(ranges()) + "\n", encoding="utf-8")
