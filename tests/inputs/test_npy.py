"""NPY files that are cut off or none: refused in one line by every reader."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from pipeline.errors import BadInput
from pipeline.inputs.npy import read_npy
from pipeline.inputs.pointing_tables import _read as read_columns
from pipeline.inputs.sensor.cosmic_ray_darks import open_darks
from pipeline.inputs.sensor.images import read_image
from pipeline.inputs.sky.stray_light import _npy as read_albedo
from pipeline.inputs.targets.mesh_surfaces import read_brdf_table


def whole() -> bytes:
    held = io.BytesIO()
    np.save(held, np.ones((4, 4)))
    return held.getvalue()


def archive() -> bytes:
    held = io.BytesIO()
    np.savez(held, a=np.ones(3))
    return held.getvalue()


CUT = whole().replace(b"(4, 4), }", b"(4, 4   ")
BAD = {
    "header cut off": CUT, "no header": whole()[:8], "numbers cut off": whole()[:-9],
    "archive": archive(), "archive cut off": archive()[:40], "empty": b"",
    "terabytes": whole().replace(b"(4, 4)", b"(4000000000000,)")[:128],
}  # fmt: skip
READERS: dict[str, Callable[[Path], object]] = {
    "image": lambda path: read_image(path, "f"),
    "albedo": read_albedo,
    "brdf": lambda path: read_brdf_table(path, 1.0, "f"),
    "darks": lambda path: open_darks([path]),
    "attitude": lambda path: read_columns(path, "f"),
}


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("bad", BAD)
def test_files_that_are_no_arrays_are_refused(bad: str, reader: str, tmp_path: Path) -> None:
    path = tmp_path / "a.npy"
    path.write_bytes(BAD[bad])
    with pytest.raises(BadInput, match=r"a\.npy|1 frame"):
        READERS[reader](path)


def test_whole_ones_are_read(tmp_path: Path) -> None:
    (tmp_path / "a.npy").write_bytes(whole())
    for mapped in (False, True):
        np.testing.assert_array_equal(read_npy(tmp_path / "a.npy", mapped), np.ones((4, 4)))
