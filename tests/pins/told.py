"""Pinned words: what the product tells, compared with stored text, a line at a time.

`NIGHTGLASS_PINS=anew` in the environment stores what is told in place of comparing (`make pins`).
"""

from __future__ import annotations

import difflib
import os
import re
from functools import cache
from pathlib import Path

from tests.pins.compare import KEPT, KINDS, _kinds, kind_here

TOLD = Path(__file__).parent / "told"
ANEW = "NIGHTGLASS_PINS"
MOST_LINES = 40  # of a difference that is shown
RELATIVE = 1e-6  # on another kind of processor: of a number, beside one unit of its last place

_NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w.]\d)")


def check_told(name: str, text: str, **places: str | Path) -> None:
    """Hold a text against tests/pins/told/NAME.txt; AssertionError with what differs.

    places : what to put a word in place of wherever it stands in the text, as `folder=tmp_path`:
        the folder's path becomes `<folder>`; the longest first
    """
    for word, value in sorted(places.items(), key=lambda item: -len(str(item[1]))):
        text = text.replace(str(value), f"<{word}>")
    found = "".join(f"{line.rstrip()}\n" for line in text.splitlines())
    path = TOLD / f"{name}.txt"
    if os.environ.get(ANEW) == "anew":
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(found)
        return
    assert path.is_file(), f"{path.name}: no such pin; `make pins` makes it"
    pinned = path.read_text()
    if found == pinned or (not is_pinned_kind() and alike(pinned, found)):
        return
    lines = [*difflib.unified_diff(pinned.splitlines(), found.splitlines(), "pinned", "told",
                                   lineterm="", n=1)]  # fmt: skip
    more = f"\nand {len(lines) - MOST_LINES} more lines" if lines[MOST_LINES:] else ""
    raise AssertionError(f"{name} tells otherwise:\n" + "\n".join(lines[:MOST_LINES]) + more)


@cache
def is_pinned_kind() -> bool:
    """Whether pins were made on this kind of processor: then each digit counts."""
    return (KEPT / KINDS).is_file() and kind_here() in _kinds(KEPT).values()


def alike(pinned: str, found: str) -> bool:
    """Whether two texts have the same words, and numbers that are the same but for rounding."""
    if _NUMBER.sub("#", pinned) != _NUMBER.sub("#", found):
        return False
    pairs = zip(_NUMBER.findall(pinned), _NUMBER.findall(found), strict=True)
    return all(a == b or _near(a, b) for a, b in pairs)


def _near(a: str, b: str) -> bool:
    """Whether two numbers as written differ by rounding alone; whole numbers must be the same."""
    if not {*"."} & {*a, *b} and not {*"e"} & {*a, *b}:
        return False
    last = max(_last_place(a), _last_place(b))
    return abs(float(a) - float(b)) <= RELATIVE * abs(float(a)) + 1.001 * last


def _last_place(number: str) -> float:
    """What one unit of the last place of a written number is worth."""
    digits, _, power = number.partition("e")
    return 10.0 ** (int(power or 0) - len(digits.partition(".")[2]))
