"""The how-to for Python, run as one session in an empty folder, prints what it says."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "howto" / "python.md"


def test_the_python_howto_prints_what_it_says(tmp_path: Path) -> None:
    """All of its blocks one after the other; a warning of any kind is an error."""
    blocks = re.findall(r"(?ms)^```(python|text)\n(.*?)^```$", PAGE.read_text())
    code = "\n".join(text for kind, text in blocks if kind == "python")
    world = {k: v for k, v in os.environ.items() if k != "NIGHTGLASS_DATA"}  # embedded spectra
    world |= {"PYTHONPATH": str(ROOT), "PYTHONWARNINGS": "error::FutureWarning"}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env=world, check=False, timeout=300,
        capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    assert done.stdout == "".join(text for kind, text in blocks if kind == "text")
