"""The documentation's pictures are made by the product, by one command."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from pipeline.export.picture import frame_picture

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


def test_targets_are_marked_unless_the_earth_hides_them(labelled, tmp_path):
    """The picture of a truth whose targets are all hidden is the one without marks."""
    product, name = tmp_path / "run", "truth/targets.parquet"
    shutil.copytree(labelled, product)
    table = pq.read_table(product / name)
    bare = frame_picture(product, mark=False).tobytes()
    assert frame_picture(product).tobytes() != bare
    none = pa.array(np.zeros(len(table)))
    at = table.column_names.index("visible_fraction")
    pq.write_table(table.set_column(at, "visible_fraction", none), product / name)
    assert frame_picture(product).tobytes() == bare
