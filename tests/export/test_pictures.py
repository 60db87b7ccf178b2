"""The documentation's pictures are made by the product, by one command."""

from __future__ import annotations

import io
import shutil
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import zarr
from PIL import Image

from pipeline.export.files import _png
from pipeline.export.movie import movie_frames
from pipeline.export.picture import (
    CYAN,
    GREEN,
    GreyLimits,
    frame_picture,
    limits_of,
    shrink,
    stretch,
)

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


@pytest.fixture
def slope(tmp_path):
    """Two frames (64, 96) that grow brighter by row, less so by column, and from first to second;
    a target at (x, y) = (40, 10), and 61 cosmic rays of which the weakest lies apart."""
    y, x = np.mgrid[:64, :96]
    frames = np.array([1000 + 10 * y + x, 1600 + 10 * y + x], np.uint16)
    zarr.create_array(store=tmp_path / "cube.zarr" / "dn", data=frames)
    (tmp_path / "truth").mkdir()
    target = {"frame": [0], "in_frame": [True], "x_px": [40.0], "y_px": [10.0], "name": [""]}
    pq.write_table(pa.table(target), tmp_path / "truth" / "targets.parquet")
    rays = {"frame": [0] * 61, "electrons": [*range(2, 62), 1], "x_in_px": [70.0] * 60 + [20.0],
            "y_in_px": [40.0] * 61, "x_out_px": [60.0] * 60 + [20.0],
            "y_out_px": [44.0] * 61}  # fmt: skip
    pq.write_table(pa.table(rays), tmp_path / "truth" / "cosmic_rays.parquet")
    return tmp_path


def test_pictures_have_their_first_row_at_the_bottom(slope):
    """PNG, movie and preview alike; the frames of a movie share their grey levels."""
    first, second = movie_frames(slope, [0, 1], "dn", 1024)
    still = np.asarray(Image.open(io.BytesIO(_png(slope, 0, "dn"))))
    bare = np.asarray(frame_picture(slope, mark=False))[..., 0]
    for picture in (first, second, still, bare):
        assert picture.shape == (64, 96)
        assert picture[-1].mean() < picture[0].mean() - 20
        assert picture[:, 0].mean() < picture[:, -1].mean()
    assert first.mean() < second.mean() - 20


def test_a_picture_is_of_the_layer_that_is_asked_for(slope):
    """One that grows darker by column, beside `dn`, which grows brighter."""
    layer = np.linspace(9.0, 0.0, 96) + np.zeros((2, 64, 1))
    zarr.create_array(store=slope / "cube.zarr" / "calibrated_e", data=layer)
    bare = np.asarray(frame_picture(slope, mark=False, layer="calibrated_e"))[..., 0]
    assert bare[:, 0].mean() > bare[:, -1].mean()


def test_a_product_without_targets_has_none_marked(slope):
    """Its cosmic rays are, and nothing of another colour."""
    (slope / "truth" / "targets.parquet").unlink()
    marked = np.asarray(frame_picture(slope))
    changed = (marked != np.asarray(frame_picture(slope, mark=False))).any(axis=-1)
    assert changed.any()
    assert (marked[changed] == CYAN).all()


def test_marks_lie_about_what_they_mark(slope):
    """A circle of 12 px about the target; an ellipse as long as the track and 8 px more on each
    side about the rays, of the sixty with the most charge."""
    picture = np.asarray(frame_picture(slope))
    row, column = np.nonzero((picture == GREEN).all(axis=-1))
    assert abs(column.min() - (40.5 - 12)) <= 1
    assert abs(column.max() - (40.5 + 12)) <= 1
    assert abs(row.min() - (64 - 10.5 - 12)) <= 1
    row, column = np.nonzero((picture == CYAN).all(axis=-1))
    box = np.array([column.min(), column.max(), row.min(), row.max()])
    assert np.abs(box - [65.5 - 13, 65.5 + 13, 21.5 - 10, 21.5 + 10]).max() <= 1


def test_grey_levels_are_those_that_are_documented():
    """Black at the first percentile, white 12 scatters above the sky of an empty frame; asinh in
    between, softened by three scatters; a block shown is half its mean and half its maximum."""
    noise = np.random.default_rng(2).normal(100.0, 5.0, (600, 600))
    low, scatter, top = limits_of(noise)
    assert (low, scatter, top) == pytest.approx((100 - 2.3263 * 5, 5.0, 160.0), abs=0.3)
    half = 10.0 + 6.0 * np.sinh(0.5 * np.arcsinh(90.0 / 6.0))
    levels = stretch(np.array([[5.0, 10.0, half, 100.0, 900.0]]), GreyLimits(10.0, 2.0, 100.0))
    assert levels.tolist() == [[0, 0, 127, 255, 255]]
    blocks, factor = shrink(np.array([[0.0, 0, 1, 1, 9], [0, 8, 1, 1, 9], [9, 9, 9, 9, 9]]), 3)
    assert (blocks.tolist(), factor) == ([[5.0, 1.0]], 2)
