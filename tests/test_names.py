"""Names: each class of the product has one of its own; its name alone says which one is meant."""

from __future__ import annotations

import ast
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def test_no_class_name_occurs_twice() -> None:
    places = defaultdict(list)
    for package in ("service", "pipeline", "catalog_tools"):
        for path in sorted((ROOT / package).rglob("*.py")):
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, ast.ClassDef):
                    places[node.name].append(f"{path.relative_to(ROOT)}:{node.lineno}")
    assert len(places) > 100
    assert {name: at for name, at in places.items() if len(at) > 1} == {}
