"""The documentation's pictures are made by the product, by one command."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def test_pictures_are_made_by_the_product(labelled, tmp_path, monkeypatch):
    """The one command that makes them runs, on a small product: frame, masks, detection study."""
    pytest.importorskip("sep")
    monkeypatch.syspath_prepend(str(ROOT / "docs" / "tools"))
    import pictures

    (tmp_path / "demo").mkdir()
    shutil.copytree(labelled, tmp_path / "demo" / "product")
    arguments = ["pictures", "--demo", str(tmp_path / "demo"), "--docs", str(tmp_path / "docs")]
    monkeypatch.setattr(sys, "argv", arguments)
    pictures.main()
    made = {p.name for p in (tmp_path / "docs" / "pictures").iterdir()}
    assert made == {"demo.jpg", "masks.png", "detection.png"}
    wanted = {p.name for p in (ROOT / "docs" / "pictures").iterdir()}
    assert wanted == made | {"report.png", "omissions.png"}  # of docs/tools/scene_report.py
    assert "Detection results" in (tmp_path / "docs" / "detection.md").read_text()
