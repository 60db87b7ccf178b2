"""The command line: `nightglass render`, `plan`, `catalog` and the rest; how it ends in errors."""

from __future__ import annotations

import errno
import io
import os
import sys
from typing import Annotated

import typer

from catalog_tools.engine.heap import few_collections, one_heap
from pipeline.commands.lazy import lazy_group
from pipeline.commands.table import COMMANDS
from pipeline.errors import NO_ROOM, NightglassError, exit_code
from pipeline.lines import fold

NO_THREAD = "can't start new thread"  # as Python says it
# What a path may be that is no place for a file: exit code 2, as the user gave it.
NO_PLACE = (
    errno.ENOENT, errno.ENOTDIR, errno.EISDIR, errno.ENAMETOOLONG,
    errno.ELOOP, errno.EACCES, errno.EPERM, errno.EROFS,
)  # fmt: skip

INTERRUPTED = (
    "interrupted; the same command continues a catalogue or a download, all else begins anew"
)

app = lazy_group(COMMANDS, completion=True, name="nightglass")


def _print_version(wanted: bool) -> None:
    if wanted:
        from catalog_tools.engine.code import own_version

        print(f"nightglass {own_version()}")
        raise typer.Exit


@app.callback()
def _common(
    version: Annotated[
        bool,
        typer.Option("--version", help="print the version", is_eager=True, callback=_print_version),
    ] = False,
) -> None:
    """Electro-optical scene simulator for Space Domain Awareness."""


def main() -> None:
    """Run the command line; every error is one message and an exit code."""
    _open_streams()
    one_heap()
    few_collections()
    try:
        code = app(prog_name="nightglass", standalone_mode=False) or 0
        if code == 130:  # the library takes Ctrl-C for an exit
            raise KeyboardInterrupt
        sys.exit(code)
    except SystemExit:
        raise
    except BaseException as error:
        sys.exit(_explain(error))


def _open_streams() -> None:
    """A stream that the caller closed (`2>&-`) leads nowhere, and no file takes its number; letters
    that stdout does not have are escaped, as those of stderr."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            stream = os.fdopen(os.open(os.devnull, os.O_RDWR), mode, encoding="utf-8")
            os.set_inheritable(stream.fileno(), True)
            setattr(sys, name, stream)
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")


def _explain(error: BaseException) -> int:
    """Print what went wrong on one line (or a few) and return the exit code."""
    if isinstance(error, typer.Exit):
        return error.exit_code
    if hasattr(error, "format_message"):  # a usage error of the command line itself
        if said := error.format_message():  # none where a group of commands shows its help
            _say(f"{said} (see --help)")
        return 2
    if isinstance(error, KeyboardInterrupt | typer.Abort):
        _say(INTERRUPTED)
        return 130
    if isinstance(error, OSError) and error.errno is not None:
        full = f"the disk is full ({os.strerror(error.errno)})"
        misplaced = 2 if error.errno in NO_PLACE else 1
        said, code = (full, 3) if error.errno in NO_ROOM else (error.strerror, misplaced)
        _say(f"{error.filename or 'a file'}: {said}")
        return code
    if isinstance(error, NightglassError):
        _say(str(error))
        return exit_code(error)
    if lacking := _lacking(error):
        _say(lacking)
        return 3
    if os.environ.get("NIGHTGLASS_DEBUG"):
        raise error
    name = type(error).__name__
    _say(f"internal fault: {name}: {error}\n(this is a bug; NIGHTGLASS_DEBUG=1 shows where)")
    return 1


def _lacking(error: BaseException) -> str:
    """What the machine has too little of for this work; "" where an error is of something else."""
    if isinstance(error, MemoryError):
        asked = f" ({error})" if str(error) else ""
        return f"no memory is left{asked}: fewer --workers, or smaller tiles, need less"
    if isinstance(error, RuntimeError) and str(error) == NO_THREAD:
        return "no thread can be started (ulimit -u, or -v): fewer --workers need less"
    return ""


def _say(message: str) -> None:
    """Print a message of one line, or a few; at a terminal no word of it is broken by its edge."""
    text = f"nightglass: {message}"
    if sys.stderr.isatty():
        text = "\n".join(fold(line, "  ", "") for line in text.splitlines())
    print(text, file=sys.stderr)
