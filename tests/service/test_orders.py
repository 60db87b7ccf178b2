"""What the engine's log says of the tiles that a worker draws."""

from __future__ import annotations

import logging

import dask
import pytest

from service.engine.orders import _tiles_told


def test_when_a_tile_fails_the_tiles_in_flight_are_named(caplog: pytest.LogCaptureFixture) -> None:
    """None of those that were drawn before, and nothing that is no tile."""

    def fails(*_: object) -> None:
        raise RuntimeError("broken")

    drawn, broken = ("tile", 0, 1, 2), ("tile", 0, 1, 3)
    graph = {("stars", 0): (int, 1), drawn: (float, ("stars", 0)), broken: (fails, drawn)}
    caplog.set_level(logging.DEBUG, "nightglass.engine")
    order = {"job": "j1", "scene": {"name": "x"}, "team": "red"}
    with pytest.raises(RuntimeError, match="broken"), _tiles_told(order):
        dask.get(graph, broken)
    said = [(line.message, getattr(line, "tile", None)) for line in caplog.records]
    assert said == [("tile drawn", "f0_r1_c2"), ("tiles in flight", "f0_r1_c3")]
