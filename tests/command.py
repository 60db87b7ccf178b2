"""The command line as the tests call it: in this process, by its own entry point."""

from __future__ import annotations

import contextlib
import io
import subprocess
import sys
from pathlib import Path

import pytest

from pipeline.cli import main


def nightglass(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    """What `nightglass ARGUMENTS` ends with and prints; whatever else it raises fails the test."""
    out, err = io.StringIO(), io.StringIO()
    with (
        pytest.MonkeyPatch.context() as patch,
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        patch.setattr(sys, "argv", ["nightglass", *map(str, arguments)])
        with pytest.raises(SystemExit) as exit_:
            main()
    code = exit_.value.code
    return subprocess.CompletedProcess([], int(code or 0), out.getvalue(), err.getvalue())
