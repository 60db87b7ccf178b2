"""Text in lines that fit the terminal: paragraphs, and tables with rows of two lines if need be.

And the same tables as Markdown.
"""

from __future__ import annotations

import shutil
import textwrap
from collections.abc import Iterable, Sequence


def width() -> int:
    """Columns to write in: those of the terminal, 80 where there is none, at most 120."""
    return min(shutil.get_terminal_size((80, 24)).columns, 120)


def fold(text: str, indent: str = "", first: str | None = None) -> str:
    """Text in lines that fit; later lines begin with `indent`, the first with `first`."""
    return textwrap.fill(
        text,
        width(),
        initial_indent=indent if first is None else first,
        subsequent_indent=indent,
        break_long_words=False,
        break_on_hyphens=False,
    )


def pair(name: str, text: str, size: int) -> str:
    """A name of `size` characters and what is told of it, beside it or below where it is long."""
    first = f"{name:>{size}}  "
    if max(map(len, text.split()), default=0) + len(first) <= width():
        return fold(text, " " * len(first), first)
    return f"{first.rstrip()}\n{fold(text, '    ')}"


def table(heads: Sequence[str], rows: Sequence[Sequence[str]], texts: int) -> str:
    """A table whose first `texts` columns are text, the others short and set to the right.

    Where a row does not fit, its text stands in a line of its own, above the rest.
    """
    sizes = [max(map(len, column)) for column in zip(heads, *rows, strict=True)]
    if sum(sizes) + 2 * (len(sizes) - 1) <= width():
        return "\n".join(
            "  ".join([*map(str.ljust, row[:texts], sizes), _right(row[texts:], sizes[texts:])])
            for row in (heads, *rows)
        )
    words = [head.split() for head in heads[texts:]]  # heads one word above the other
    tall = max(map(len, words))
    above = [[""] * (tall - len(w)) + w for w in words]
    cells = [row[texts:] for row in rows]
    short = [
        max(map(len, column)) for column in zip(*zip(*above, strict=True), *cells, strict=True)
    ]
    lines = [", ".join(heads[:texts])]
    lines += ["  " + _right(line, short) for line in zip(*above, strict=True)]
    for row, numbers in zip(rows, cells, strict=True):
        lines += [
            fold(", ".join(filter(None, row[:texts])), "  ", ""),
            "  " + _right(numbers, short),
        ]
    return "\n".join(map(str.rstrip, lines))


def markdown_table(heads: Sequence[str], rows: Iterable[Sequence[str]], texts: int) -> str:
    """The same table as Markdown, with its last line ended."""
    rule = ["---"] * texts + ["---:"] * (len(heads) - texts)
    escaped = ([c.replace("|", "\\|").replace("*", "\\*") for c in row] for row in rows)
    return "".join(f"| {' | '.join(row)} |\n" for row in (heads, rule, *escaped))


def _right(cells: Sequence[str], sizes: Sequence[int]) -> str:
    return "  ".join(map(str.rjust, cells, sizes))
