"""LAYOUT.md carries the tree, each caption equal to the first docstring line of its file."""

from __future__ import annotations

import ast
import re
import subprocess
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
MODULE = "nightglass.py"
PACKAGES = ("service", "pipeline", "catalog_tools")


def files() -> list[Path]:
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard", MODULE, *PACKAGES],
        cwd=ROOT, capture_output=True, text=True,
    )  # fmt: skip
    if listed.returncode:
        pytest.skip("not a git checkout")
    found = [ROOT / name for name in listed.stdout.split() if name.endswith(".py")]
    return sorted(found, key=lambda path: (path.parent, path.name))


@cache
def parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text())


def caption(path: Path) -> str:
    return (ast.get_docstring(parsed(path)) or "").splitlines()[0]


def test_captions_are_the_docstrings():
    layout = (ROOT / "LAYOUT.md").read_text()
    written = dict(re.findall(r"^- `([^`]+)` (.+)$", layout, flags=re.MULTILINE))
    wanted = {p.relative_to(ROOT).as_posix(): caption(p) for p in files()}
    assert written == wanted, "run `python tests/test_layout.py` to renew LAYOUT.md"


def test_captions_are_sentences():
    for path in files():
        line = caption(path)
        assert line.endswith("."), path
        assert len(line) <= 110, path


def test_functions_are_short():
    """No function's code is longer than 70 lines without its docstring."""
    for path in files():
        for node in ast.walk(parsed(path)):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                doc = len((ast.get_docstring(node, clean=False) or "").splitlines())
                assert node.end_lineno - node.lineno + 1 - doc <= 70, f"{path}:{node.name}"


INTRO = """# Layout

`nightglass.py` is the door for Python. Behind it stand three packages, one direction: `service` >
`pipeline` > `catalog_tools`. Inside `pipeline` the folders are the data's route: `spec` (what is
asked) and `physics` (pure functions) at the bottom, then `plan`, `inputs` and `store`, `execute`
and `export`, `route`, `sweep`, `studies`, `commands`. Packages inside them are subjects; where one
has a main file, that has its own name.
import-linter holds the arrows (`pyproject.toml`); this page is made from the docstrings by
`python tests/test_layout.py`.
"""


def write() -> None:
    lines, folder = [INTRO], None
    for path in files():
        name = path.relative_to(ROOT).as_posix()
        if path.parent != folder:
            folder = path.parent
            title = "import nightglass" if folder == ROOT else folder.relative_to(ROOT).as_posix()
            lines.append(f"\n## {title}\n")
        lines.append(f"- `{name}` {caption(path)}")
    lines.append("\n## Beside the packages\n")
    for name, text in (
        ("tests", "mirrors the tree; rules/ is what holds for every scene, acceptance/ the whole"),
        ("benchmarks", "figures measured in one run"),
        ("examples", "scenes to start from"),
        ("deploy", "running the service"),
    ):
        lines.append(f"* `{name}/`: {text}")
    (ROOT / "LAYOUT.md").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    write()
