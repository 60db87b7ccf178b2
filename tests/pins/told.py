"""Pinned words: what the product tells, compared with stored text, a line at a time.

`NIGHTGLASS_PINS=anew` in the environment stores what is told in place of comparing (`make pins`).
"""

from __future__ import annotations

import difflib
import os
import re
from pathlib import Path

TOLD = Path(__file__).parent / "told"
ANEW = "NIGHTGLASS_PINS"
MOST_LINES = 40  # of a difference that is shown
RELATIVE = 1e-6  # of a number, beside one unit of its last place: processors round differently

_NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w.]\d)")


def check_told(
    name: str, text: str, *, relative: float = RELATIVE, noise: float = 0.0, **places: str | Path
) -> None:
    """Hold a text against tests/pins/told/NAME.txt; AssertionError with what differs.

    relative : what a number may differ by, as a fraction of itself
    noise : numbers that are both smaller than this are rounding errors and count as the same
    places : what to put a word in place of wherever it stands in the text, as `folder=tmp_path`:
        the folder's path becomes `<folder>`; the longest first
    """
    for word, value in sorted(places.items(), key=lambda item: -len(str(item[1]))):
        text = text.replace(str(value), f"<{word}>")
    found = "".join(f"{line.rstrip()}\n" for line in text.splitlines())
    path = TOLD / f"{name}.txt"
    anew = os.environ.get(ANEW) == "anew"
    assert anew or path.is_file(), f"{path.name}: no such pin; `make pins` makes it"
    pinned = path.read_text() if path.is_file() else ""
    if found == pinned or alike(pinned, found, relative, noise):
        return
    if anew:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(found)
        return
    lines = [*difflib.unified_diff(pinned.splitlines(), found.splitlines(), "pinned", "told",
                                   lineterm="", n=1)]  # fmt: skip
    more = f"\nand {len(lines) - MOST_LINES} more lines" if lines[MOST_LINES:] else ""
    raise AssertionError(f"{name} tells otherwise:\n" + "\n".join(lines[:MOST_LINES]) + more)


def alike(pinned: str, found: str, relative: float = RELATIVE, noise: float = 0.0) -> bool:
    """Whether two texts have the same words, and numbers that are the same but for rounding."""
    if _NUMBER.sub("#", pinned) != _NUMBER.sub("#", found):
        return False
    pairs = zip(_NUMBER.findall(pinned), _NUMBER.findall(found), strict=True)
    return all(a == b or _near(a, b, relative, noise) for a, b in pairs)


def _near(a: str, b: str, relative: float, noise: float) -> bool:
    """Whether two numbers as written differ by rounding alone; whole numbers must be the same,
    but for the sign of a 0."""
    if float(a) == 0.0 and a.lstrip("-") == b.lstrip("-"):
        return True
    if not {*"."} & {*a, *b} and not {*"e"} & {*a, *b}:
        return False
    last = max(_last_place(a), _last_place(b))
    x, y = float(a), float(b)
    return abs(x - y) <= relative * abs(x) + 1.001 * last or max(abs(x), abs(y)) < noise


def _last_place(number: str) -> float:
    """What one unit of the last place of a written number is worth."""
    digits, _, power = number.partition("e")
    return 10.0 ** (int(power or 0) - len(digits.partition(".")[2]))
