"""What the commands of catalogues share: their place, numbers from text, progress."""

from __future__ import annotations

import sys
from typing import Annotated, Any

import typer

from catalog_tools.errors import BadInput
from pipeline.commands.pages import stage_progress

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


def stages(quiet: bool) -> Any:
    """A bar for each stage on stderr; nothing when it is no terminal or not wanted."""
    return stage_progress(quiet or not sys.stderr.isatty())
