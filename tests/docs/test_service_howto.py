"""The service how-to, step by step as its reader goes, ends with a fetched product."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

from pipeline.spec.load import load_scene
from pipeline.store.product import check
from tests.service.conftest import Server

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "howto" / "submit-jobs.md"


def test_the_service_howto_leads_to_a_product(tmp_path: Path) -> None:
    """Its commands, and both of its Python texts, in an empty folder with the examples."""
    shutil.copytree(ROOT / "examples", tmp_path / "examples")
    text = PAGE.read_text()
    commands = [line.strip() for line in text.splitlines() if line.startswith("    nightglass ")]
    assert commands[0].startswith("nightglass serve --home jobs ")
    server = Server(tmp_path / "jobs")
    bin_ = tmp_path / "bin"
    bin_.mkdir()
    (bin_ / "nightglass").write_text(f'#!/bin/sh\nexec {sys.executable} -m pipeline "$@"\n')
    (bin_ / "nightglass").chmod(0o755)
    world = os.environ | {"PATH": f"{bin_}:{os.environ['PATH']}"}
    try:
        for command in commands[1:]:
            line = command.replace("http://127.0.0.1:8765", server.url)
            subprocess.run(["bash", "-ec", line], cwd=tmp_path, env=world, check=True, timeout=300)
        assert check(tmp_path / "fetched").whole
        scene = load_scene(tmp_path / "examples" / "space-based-rate.yaml").as_dict()
        for name in ("scene.yaml", "scene.json"):
            (tmp_path / name).write_text(json.dumps(scene | {"stars": {"catalogue": "sky"}}))
        for block in (part.partition("```")[0] for part in text.split("```python\n")[1:]):
            code = block.replace("http://127.0.0.1:8765", server.url)
            done = subprocess.run(
                [sys.executable, "-c", code], cwd=tmp_path, env=world, check=False, timeout=300,
                capture_output=True, text=True,
            )  # fmt: skip
            assert done.returncode == 0, done.stderr
        assert check(tmp_path / "product").whole
        assert done.stdout.startswith("COMPLETED")
        assert "report.json" in done.stdout
    finally:
        server.stop()
