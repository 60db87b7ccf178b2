"""What the pictures of a study's page draw: on axes that keep what they are given."""

from __future__ import annotations

from typing import Any
from unittest.mock import MagicMock

import healpy
import numpy as np
import pyarrow as pa
import pytest

from pipeline.capacity.page import _draw_gaps, _draw_hours, _draw_reach, _draw_sky
from pipeline.capacity.results import GAP_BINS_H


def given(call: Any) -> list[np.ndarray]:
    return [np.asarray(a) for a in call.args]


def test_sky_has_east_to_the_left() -> None:
    """What was looked at at 30 degrees of right ascension and 10 of declination."""
    counts = np.zeros(3072, np.int64)
    counts[healpy.ang2pix(16, 30.0, 10.0, nest=True, lonlat=True)] = 999
    axes = MagicMock()
    _draw_sky(axes, pa.table({"pixel": np.arange(3072), "observations": counts}))
    x, y, shown = given(axes.pcolormesh.call_args)
    row, column = np.nonzero(shown > 0.0)
    assert np.degrees(x[column]).mean() == pytest.approx(-30.0, abs=2.0)
    assert np.degrees(y[row]).mean() == pytest.approx(10.0, abs=2.0)
    np.testing.assert_allclose(shown.max(), 3.0)


def test_gaps_add_up_to_all_of_them() -> None:
    counts, axes = np.zeros(61, np.int64), MagicMock()
    counts[[10, 20, 30]] = 1, 1, 2
    _draw_gaps(axes, {"LEO": counts, "GEO": 0 * counts}, 24.0)
    ((at, share), *others) = [given(call) for call in axes.step.call_args_list]
    assert not others
    np.testing.assert_array_equal(at, GAP_BINS_H[1:])
    assert share[[9, 10, 19, 20, 29, 30, 60]].tolist() == [0.0, 0.25, 0.25, 0.5, 0.5, 1.0, 1.0]
    assert axes.set_xlim.call_args.args == (GAP_BINS_H[1], 24.0)


def test_hours_and_reach_have_their_own_columns() -> None:
    hours = {"hour": [0, 1], "observations": [5, 7], "detections": [2, 3]}
    axes = MagicMock()
    _draw_hours(axes, pa.table(hours))
    for call in axes.step.call_args_list:
        assert [a.tolist() for a in given(call)] == [[0, 1], hours[call.kwargs["label"]]]
    reach = {"range_km": [300.0, 400.0], "one": [0.1, 0.2], "two": [0.3, 0.4]}
    _draw_reach(axes, pa.table(reach))
    for call in axes.plot.call_args_list:
        assert [a.tolist() for a in given(call)] == [reach["range_km"], reach[call.kwargs["label"]]]
