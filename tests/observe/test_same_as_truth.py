"""What is observed at a scene's exposures is its truth, to the last digit."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from pipeline.observe.observe import OF_TRUTH, observe
from pipeline.route.run import Options, render
from pipeline.spec.load import parse_scene
from tests.observe.conftest import SENSOR, night

SPACE = {"kind": "orbit", "orbit": {"kind": "state", "position_m": [3.5e6, 6.1e6, 0],
                                    "velocity_m_s": [-6535.0, 3773.0, 0]}}  # fmt: skip
NEAR = {"kind": "state", "position_m": [3.46e6, 6.13e6, 3e3], "velocity_m_s": [-6546.0, 3754, 2]}



def wide(population: dict[str, Any]) -> dict[str, Any]:
    """A file of objects in a wide field: some cross it, most do not."""
    sensor = SENSOR | {"focal_length_m": 0.01}
    pointing = {"mode": "sidereal", "boresight_ra_deg": 200.0, "boresight_dec_deg": 4.0}
    return night(sensor=sensor, pointing=pointing, populations=[population])


def in_space(population: dict[str, Any]) -> dict[str, Any]:
    ball = {"kind": "sphere", "diameter_m": 1.0, "albedo": 0.2}
    targets = [{"name": "chaser", "orbit": NEAR, "body": ball}]
    pointing = {"mode": "target", "target": "chaser"}
    return night(observer=SPACE, targets=targets, pointing=pointing, background=None)


SCENES = {"tracked": lambda population: night(), "wide": wide, "in space": in_space}


@pytest.mark.parametrize("name", SCENES)
def test_rows_are_those_of_the_truth(
    name: str, population: dict[str, Any], tmp_path: Path
) -> None:
    scene = parse_scene(SCENES[name](population))
    render(scene, tmp_path / "run", Options("synchronous"))
    truth = pq.read_table(tmp_path / "run" / "truth" / "targets.parquet").to_pylist()
    seen = {(row["frame"], row["name"]): row for row in observe(scene).table.to_pylist()}
    compared = 0
    for row in truth:
        own = seen[row["frame"], row["name"]]
        for column in OF_TRUTH:
            if own["snr_at"] == "boresight" and column in ("electrons", "snr"):
                continue
            assert np.array_equal(own[column], row[column], equal_nan=True), column
            compared += own["snr_at"] == "frame"
        assert own["snr_at"] == "frame" or row["snr"] == 0.0
    assert compared >= 3 * len(OF_TRUTH)
    if "populations" in SCENES[name](population):
        assert len(seen) == 3 * 603
        assert len(truth) < 3 * 603


def test_other_times_agree_with_the_exposures() -> None:
    """Exposures asked for as times of their middles are the same, but for rounding."""
    scene = parse_scene(night())
    first, second = observe(scene).table, observe(scene, [1.0, 21.0, 41.0]).table
    assert first["utc"].equals(second["utc"])
    for column in first.column_names:
        if first[column].type == "double":
            a, b = (t[column].to_numpy() for t in (first, second))
            np.testing.assert_allclose(a, b, rtol=1e-6, atol=1e-6, err_msg=column)


def test_out_of_the_field_is_as_if_pointed_at() -> None:
    """Electrons and SNR of a target out of the field are those of a scene that tracks it."""
    away = {row["name"]: row for row in observe(parse_scene(night())).table.to_pylist()}["far"]
    there = night(pointing={"mode": "target", "target": "far"})
    own = {row["name"]: row for row in observe(parse_scene(there)).table.to_pylist()}["far"]
    assert (away["snr_at"], own["snr_at"]) == ("boresight", "frame")
    assert away["seen"] == "out of field"
    assert away["electrons"] == pytest.approx(own["electrons"], rel=1e-6)
    rows = []
    for off_deg in (0.0, 20.0):
        pointing = {"mode": "sidereal", "boresight_ra_deg": own["ra_deg"],
                    "boresight_dec_deg": own["dec_deg"] + off_deg}  # fmt: skip
        scene = parse_scene(night(pointing=pointing, background={"uniform_e_per_s": 3.0}))
        rows.append({row["name"]: row for row in observe(scene).table.to_pylist()}["far"])
    assert [row["snr_at"] for row in rows] == ["frame", "boresight"]
    assert rows[1]["streak_px"] == pytest.approx(rows[0]["streak_px"], rel=1e-3)
    assert rows[1]["snr"] == pytest.approx(rows[0]["snr"], rel=0.01)
