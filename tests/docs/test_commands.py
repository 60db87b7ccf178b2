"""The commands that the pages give: known to the command line, run in order, or named with why."""

from __future__ import annotations

import importlib.util
import shlex
from pathlib import Path

import pytest
import typer.main

from pipeline.cli import app

ROOT = Path(__file__).resolve().parents[2]
_spec = importlib.util.spec_from_file_location("doc_commands", ROOT / "docs/tools/commands.py")
assert _spec is not None
assert _spec.loader is not None
doc_commands = importlib.util.module_from_spec(_spec)
import sys  # noqa: E402

sys.modules["doc_commands"] = doc_commands  # its dataclass looks itself up
_spec.loader.exec_module(doc_commands)
COMMANDS = list(doc_commands.commands())


def test_every_page_gives_commands_and_reasons_are_used():
    assert {c.page for c in COMMANDS} == set(doc_commands.PAGES)
    pages = {p.relative_to(ROOT / "docs").as_posix() for p in (ROOT / "docs/howto").glob("*.md")}
    assert pages <= set(doc_commands.PAGES)
    assert sum(c.why_not is None for c in COMMANDS) >= 15
    for part in doc_commands.NOT_RUN:
        assert any(part in c.text for c in COMMANDS), part


@pytest.mark.parametrize("text", sorted({
    line.strip() for c in COMMANDS for line in c.text.splitlines()
    if line.strip().startswith("nightglass") and "PRODUCT" not in line
}))  # fmt: skip
def test_the_command_line_knows_it(text):
    """Its options and arguments are read, nothing is run."""
    words = shlex.split(text, comments=True)[1:]
    command, name = typer.main.get_command(app), "nightglass"
    while getattr(command, "commands", None):
        name, words = words[0], words[1:]
        command = command.commands[name]
    command.make_context(name, words)


@pytest.mark.slow
def test_all_run(tmp_path):
    rows = doc_commands.run_all(tmp_path)
    assert sum(row["not_run"] is None for row in rows) >= 15
