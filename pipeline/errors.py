"""The errors of the pipeline, and the exit code that each one means."""

from __future__ import annotations

import os
from pathlib import Path

from catalog_tools.errors import (
    NO_ROOM,
    BadInput,
    Damaged,
    DiskFull,
    Incomplete,
    Missing,
    NightglassError,
    TryLater,
    shorten,
    why_broken,
)

__all__ = [
    "NO_ROOM",
    "BadInput",
    "Damaged",
    "DiskFull",
    "Incomplete",
    "Interrupted",
    "Missing",
    "NightglassError",
    "NOT_NOW",
    "TryLater",
    "check_new",
    "exit_code",
    "make_folder",
    "shorten",
    "why_broken",
]


class Interrupted(NightglassError):
    """Stopped by the user; the text says what is kept and how to go on."""


def check_new(output: Path, empty: bool = False) -> None:
    """BadInput where what is written (`-o`) is there already; empty : a folder may be, if empty."""
    if output.exists() and not (empty and output.is_dir() and not any(output.iterdir())):
        raise BadInput("-o", str(output), "a path that does not exist yet")
    if file := next((p for p in output.parents if p.exists() and not p.is_dir()), None):
        raise BadInput("-o", str(output), f"a path in a folder; {file} is a file")


def make_folder(output: Path) -> None:
    """Make the folder that is written (`-o`); BadInput where it is none that can be written to."""
    allowed = "a folder that can be made and written to"
    try:
        output.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError, PermissionError):
        raise BadInput("-o", str(output), allowed) from None
    if not os.access(output, os.W_OK):
        raise BadInput("-o", str(output), allowed)


NOT_NOW = (0, 429, 503)  # statuses of a server that may answer later
EXIT_CODES: tuple[tuple[type[BaseException], int], ...] = (
    (BadInput, 2),
    (Incomplete, 3),
    (TryLater, 4),
    (Damaged, 2),
    (Interrupted, 130),
    (KeyboardInterrupt, 130),
)


def exit_code(error: BaseException) -> int:
    """Exit code of the command line for an error; 1 for an internal fault.

    An error with a `status` is a server's answer: 0 where none came.
    """
    status = getattr(error, "status", None)
    if status is not None:
        return 4 if status in NOT_NOW else 2 if 400 <= status < 500 else 1
    return next((code for kind, code in EXIT_CODES if isinstance(error, kind)), 1)
