"""What the engine's log says of the tiles that a worker draws, and what it begins anew."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import dask
import pytest

from service.engine.orders import ORDERS, _tiles_told


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


@pytest.mark.parametrize("do", ["render", "sweep"])
def test_a_job_whose_data_changed_while_the_service_was_down_begins_anew(
    tmp_path: Path, scene: dict[str, Any], monkeypatch: pytest.MonkeyPatch, do: str
) -> None:
    """A table of the data folder is another one than that which it was begun with."""
    axes = [{"field": "sensor.read_noise_e", "values": [1.0, 2.0]}]
    sweep = {"schema": "nightglass/sweep/1", "name": "two", "scene": scene, "axes": axes}
    table = tmp_path / "data" / "stellar_spectra" / "pickles_uvk" / "x.fits"
    table.parent.mkdir(parents=True)
    monkeypatch.setenv("NIGHTGLASS_DATA", str(tmp_path / "data"))
    monkeypatch.chdir(tmp_path)
    order = {"do": do, "scene": scene if do == "render" else sweep, "product": "p", "workers": 1}
    order |= {"scheduler": "threads", "most_cpu_s": 1e6, "job": "j", "resume": False}
    made = []
    for content in ("one", "one", "another"):
        table.write_text(content)
        made.append(ORDERS[do](order, lambda _: None))
        (tmp_path / "p" / "_COMPLETE").unlink()
        kept = tmp_path / "p" / "kept"
        assert kept.exists() == (len(made) == 2)
        kept.touch()
        order["resume"] = True
    assert made[0] == made[1] == made[2]
