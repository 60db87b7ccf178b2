"""The picture of detections: which targets are named in the piece of a frame that is shown."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
from matplotlib.figure import Figure

from pipeline.export.labels import TARGET
from pipeline.studies.detection.figure import SIDE_PX, _piece


def test_targets_in_the_piece_alone_are_named() -> None:
    """Of three the longest is in its middle; one is beside it along x, one along y."""
    x, y = np.array([400.0, 400.0, 900.0]), np.array([400.0, 900.0, 400.0])
    labels = SimpleNamespace(
        kind=np.full(3, TARGET), length_px=np.array([9.0, 1.0, 1.0]), x_px=x, y_px=y,
        x_light_px=x, y_light_px=y, name=np.array(["middle", "above", "beside"]),
    )  # fmt: skip
    axes = Figure().subplots()
    _piece(axes, {"labels": labels, "image": np.random.default_rng(1).normal(size=(1000, 1000))})
    assert SIDE_PX < 900
    assert [text.get_text() for text in axes.texts] == ["middle"]
