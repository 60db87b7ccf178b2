"""The commands that the pages give: known to the command line, run in order, or named with why."""

from __future__ import annotations

import importlib.util
import json
import re
import shlex
from pathlib import Path

import pytest
import typer.main

from pipeline.cli import app
from pipeline.spec.load import load_scene, parse_scene
from tests.command import nightglass

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
    python = "howto/python.md"  # is run as a session (test_python.py)
    assert pages - {python} <= set(doc_commands.PAGES)
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


FILES = doc_commands.files()


def test_every_yaml_block_of_a_scene_is_a_file():
    """So that the tests below plan it: a block that holds a whole scene names its file."""
    blocks = [
        (page, block)
        for page in (ROOT / "docs").rglob("*.md")
        for block in page.read_text().split("```yaml\n")[1:]
        if "schema: nightglass/scene/1" in block
    ]
    assert len(blocks) >= 6
    for page, block in blocks:
        assert block.startswith("# "), page
        assert block.split("\n", 1)[0][2:] in FILES, page


@pytest.mark.parametrize("name", [name for name in FILES if name.endswith(".yaml")])
def test_scenes_of_the_pages_are_planned(name, tmp_path, monkeypatch):
    """With the files that the pages give beside them: valid, in view, and without a warning."""
    for file, text in FILES.items():
        (tmp_path / file).write_text(text)
    monkeypatch.chdir(tmp_path)
    done = nightglass("plan", name, "--json")
    assert done.returncode == 0, done.stderr
    plan = json.loads(done.stdout)
    assert plan["warnings"] == []
    scene = load_scene(tmp_path / name)
    assert parse_scene(scene.as_dict()) == scene


@pytest.mark.slow
def test_all_run(tmp_path):
    rows = doc_commands.run_all(tmp_path)
    assert sum(row["not_run"] is None for row in rows) >= 15


def test_links_and_tests_that_the_pages_name_are_there() -> None:
    """In the repository itself, where the built pages are not."""
    for page in sorted((ROOT / "docs").rglob("*.md")):
        text = page.read_text()
        for link in re.findall(r"\]\(([^)#:\s]+\.md)[)#]", text):
            assert (page.parent / link).exists(), (page.name, link)
        for name in re.findall(r"`(tests/[\w/.]+)(?:`|::)", text):
            assert (ROOT / name).exists(), (page.name, name)
