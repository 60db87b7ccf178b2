"""What an ECSV file says of its columns in the comments before its header line."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

LONGEST = 1 << 20
BEGINNING = b"# %ECSV"


def is_ecsv(comments: Sequence[bytes]) -> bool:
    """Whether the comments of a text table are those of an ECSV file."""
    return any(line.startswith(BEGINNING) for line in comments)


def units_of(comments: Sequence[bytes]) -> dict[str, str]:
    """Units by column; none where the comments are no ECSV or can't be read."""
    if not is_ecsv(comments) or sum(map(len, comments)) > LONGEST:
        return {}
    lines = [line.removeprefix(b"# ").decode("utf-8", "replace") for line in comments]
    if "datatype:" not in lines:
        return {}
    start = end = lines.index("datatype:") + 1
    while end < len(lines) and lines[end][:1] in ("-", " "):
        end += 1
    return dict(_units("\n".join(lines[start:end])))


@lru_cache(maxsize=8)  # the files of a release have the same columns
def _units(text: str) -> tuple[tuple[str, str], ...]:
    """Names and units of a YAML list of columns."""
    try:
        columns = YAML(typ="safe", pure=True).load(text)
    except (YAMLError, ValueError, RecursionError):
        return ()
    if not isinstance(columns, list):
        return ()
    found = (c for c in columns if isinstance(c, dict) and "name" in c and "unit" in c)
    return tuple((str(column["name"]), str(column["unit"])) for column in found)
