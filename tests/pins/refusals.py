"""Pinned refusals: each error that a test expects is held against its stored words, in full.

A test asks of an error by `pytest.raises` what it is about, often a field and a word; the rest of
the message, with its figures, is held against told/refusals/ (a file for each file of tests).
`NIGHTGLASS_PINS=anew` in the environment stores what is said by the tests that are run.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from catalog_tools.errors import shorten
from pipeline.errors import BadInput, Damaged
from tests.pins.told import ANEW, TOLD, alike

ROOT = Path(__file__).resolve().parents[2]
# What another library says of a path, cut off where that is long, and places with ports.
_VARIES = re.compile(r"…|://|Could not open|No such file|Errno")
_UNIQUE = re.compile(r"[0-9a-f]{32}")  # names that are given at random
LONGEST_PATH = 300
_raises = pytest.raises
_said: list[str] = []


@contextmanager
def _heard(expected: AbstractContextManager[Any]) -> Iterator[Any]:
    """A `pytest.raises` that notes what the error says."""
    with expected as info:
        try:
            yield info
        except (BadInput, Damaged) as error:
            _said.append(_whole(error))
            raise


def _whole(error: BadInput | Damaged) -> str:
    """The message, a path in it whole where it is cut."""
    value, text = getattr(error, "value", None), str(error)
    is_path = isinstance(value, str | Path) and len(str(value)) < LONGEST_PATH
    return text.replace(shorten(value), repr(value)) if is_path else text


def listen() -> None:
    """From now on, errors that tests expect are noted."""

    def raises(expected: Any, *args: Any, **options: Any) -> Any:
        context = _raises(expected, *args, **options)
        return context if args else _heard(context)

    pytest.raises = raises  # type: ignore[assignment]


def hold(node: pytest.Item, base: Path) -> Iterator[None]:
    """Around a test: AssertionError where it was refused something in other words than stored.

    base : the folder of temporary folders
    """
    _said.clear()
    yield
    if getattr(getattr(node, "obj", None), "is_hypothesis_test", False):
        return  # it is refused as many things as it tries
    said = [re.sub(rf"{re.escape(str(base))}/[\w.-]*?\d+(?=/|\b)", "<folder>", s) for s in _said]
    said = [s.replace(str(ROOT), "<root>").replace(str(ROOT.parent), "<beside>") for s in said]
    said = [_UNIQUE.sub("<unique>", s) for s in said if not _VARIES.search(s)]
    name, path = node.nodeid.partition("::")[2], _file_of(node)
    stored = _stored(path)
    if os.environ.get(ANEW) == "anew":
        if said and not _same(stored.get(name), said):
            stored[name] = said
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(json.dumps(stored, indent=0, sort_keys=True, ensure_ascii=False) + "\n")
    elif name in stored:
        assert _same(stored[name], said), f"pinned: {stored[name]}\nsaid: {said}"


def _file_of(node: pytest.Item) -> Path:
    parts = node.path.relative_to(ROOT / "tests").with_suffix("").parts
    return TOLD / "refusals" / f"{'.'.join(parts)}.json"


@cache
def _stored(path: Path) -> dict[str, list[str]]:
    return json.loads(path.read_text()) if path.is_file() else {}


def _same(stored: list[str] | None, said: list[str]) -> bool:
    if stored is None or len(stored) != len(said):
        return False
    return all(a == b or alike(a, b) for a, b in zip(stored, said, strict=True))
