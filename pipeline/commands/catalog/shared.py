"""What the commands of catalogues share: their place, numbers from text, notes."""

from __future__ import annotations

import sys
from typing import Annotated, Any

import typer

from catalog_tools.errors import BadInput

CataloguePlace = Annotated[
    str, typer.Argument(metavar="CATALOGUE", help="folder, s3:// or http:// URL")
]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="replace a catalogue that is there")]


def numbers(option: str, text: str, count: int, example: str) -> Any:
    """Numbers parted by commas."""
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) != count:
        raise BadInput(option, text, f"{count} numbers such as {example}")
    return numbers


def note(text: str) -> None:
    """A note on stderr, beside the result."""
    print(f"note: {text}", file=sys.stderr)
