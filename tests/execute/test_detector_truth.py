"""Truth about the detector: failing pixels as a table; and TDI rows that are exposed in part."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from pipeline.physics.noise.transfer import exposed_share
from pipeline.physics.vectors import to_angles
from pipeline.plan.pointing.geometry import plan_geometry
from pipeline.route.prepare import plan_scene, prepare
from pipeline.route.run import Options, render
from pipeline.store.product import check
from tests.execute.test_detector import ALL_LAYERS, SIDE, frames, scene

FAULTS: dict[str, Any] = {
    "bad": {"pixels": [[3, 300]], "rows": [7], "reads_dn": 65535},
    "dead": {"columns": [256], "fraction": 1e-3},
    "hot": {"pixels": [[300, 2, 5e3], [7, 9, 80.0]], "fraction": 1e-3},
}


def test_failing_pixels_stand_in_the_truth(tmp_path: Path) -> None:
    one = scene(FAULTS)
    report = render(one, tmp_path / "run")
    table = pq.read_table(tmp_path / "run" / "truth" / "pixels.parquet").to_pandas()
    assert report["truth_rows"]["pixels"] == len(table)
    maps = prepare(one).maps
    told = dict(iter(table.groupby("fault")))
    for name, image in (("dead", maps.flat == 0), ("hot", maps.dark_e_per_s > 3.0)):
        found = np.zeros((SIDE, SIDE), bool)
        found[told[name]["row"], told[name]["column"]] = True
        assert np.array_equal(found, image)
    hot = told["hot"]
    assert np.allclose(hot["dark_e_per_s"], maps.dark_e_per_s[hot["row"], hot["column"]] - 3.0)
    bad = told["bad"]
    assert len(bad) == SIDE + 1
    dn = frames(tmp_path / "run")["dn"][0]
    assert np.all(dn[bad["row"], bad["column"]] == bad["reads_dn"])
    assert list(zip(table["row"], table["column"], strict=True)) == sorted(
        zip(table["row"], table["column"], strict=True)
    )
    assert check(tmp_path / "run").whole
    reasons = [d["reason"] for d in plan_scene(one)["decisions"] if d["component"] == "bad_pixels"]
    assert "truth/pixels.parquet" in reasons[0]


def test_no_table_without_faults(tmp_path: Path) -> None:
    render(scene({"prnu": 0.01}), tmp_path / "run")
    assert not (tmp_path / "run" / "truth" / "pixels.parquet").exists()


@pytest.mark.parametrize("rate", [-700.0, -31.0, 0.0, 12.5, 160.0, 900.0])
def test_exposed_share_against_steps(rate: float) -> None:
    """Charge followed in small steps of time."""
    rows, time_s = 100, 2.0
    t = (np.arange(20_000) + 0.5) / 20_000 * time_s - 0.5 * time_s
    at = np.arange(rows)[:, None] + rate * t
    share = ((at > -0.5) & (at < rows - 0.5)).mean(axis=1)
    assert exposed_share(rows, rate, time_s) == pytest.approx(share, abs=2e-4)


def test_tdi_edges_in_frames(tmp_path: Path) -> None:
    """Sky and dark fall off towards both edges; the same in every tiling, calibrated and told."""
    readout = {"kind": "tdi", "rows_per_s": 60.0, "edges": "partial"}
    whole = scene({"readout": readout | {"edges": "full"}}, output={"layers": ALL_LAYERS})
    part = scene({"readout": readout}, output={"layers": ALL_LAYERS})
    tiled = scene({"readout": readout}, output={"layers": ALL_LAYERS, "tile_shape": [256, 256]})
    render(whole, tmp_path / "full")
    render(part, tmp_path / "part", Options("synchronous"))
    render(tiled, tmp_path / "tiled", Options("threads", 2))
    full, ours, tiles = (frames(tmp_path / n) for n in ("full", "part", "tiled"))
    share = exposed_share(SIDE, 60.0, 2.0)[:, None]
    assert share.min() == pytest.approx(0.5, abs=0.01)
    for name in ("background_e", "dark_e"):
        assert ours[name][0] == pytest.approx(full[name][0] * share, rel=1e-6)
    assert all(np.array_equal(ours[n], tiles[n], equal_nan=True) for n in ALL_LAYERS)
    level = np.nanmean(ours["calibrated_e"][0], axis=1)
    assert level == pytest.approx(np.full(SIDE, 1000.0), rel=0.02)
    (line,) = (d for d in plan_scene(part)["decisions"] if d["component"] == "tdi")
    assert "0.375 of the rows" in line["reason"]


def test_streaks_in_rows_exposed_in_part_are_told_with_their_size(tmp_path: Path) -> None:
    """Against short exposures of charge that is on the array, added up as it moves."""
    per_s, parts = 60.0, 60
    aim = prepare(scene(pointing={"mode": "target", "target": "t"})).plan
    ahead = plan_geometry(aim.scene, np.zeros(1, np.int64), aim.dut1_s).attitude[0, 0, 2]
    ra, dec = (float(np.degrees(v)) for v in to_angles(ahead))
    pointing = {
        "mode": "rate", "boresight_ra_deg": ra, "boresight_dec_deg": dec + 0.19,
        "rate_ra_arcsec_s": 0.0, "rate_dec_arcsec_s": -210.0,
    }  # fmt: skip
    changes: dict[str, Any] = {"pointing": pointing, "output": {"layers": ["dn", "targets_e"]}}
    readout = {"kind": "tdi", "rows_per_s": per_s}
    whole = scene({"readout": readout | {"edges": "partial"}}, **changes)
    short = {"integration_s": 2.0 / parts, "frames": parts, "cadence_s": 2.0 / parts}
    render(whole, tmp_path / "whole")
    render(scene({"readout": readout}, exposure=short, **changes), tmp_path / "parts")
    found = frames(tmp_path / "whole")["targets_e"][0]
    expected = np.zeros((SIDE, SIDE))
    for k, image in enumerate(frames(tmp_path / "parts")["targets_e"]):
        moved = round(per_s * ((k + 0.5) * 2.0 / parts - 1.0))
        on = np.arange(max(0, -moved), min(SIDE, SIDE - moved))
        expected[on] += image[on + moved]
    (told,) = (w for w in prepare(whole).plan.warnings if "readout.edges" in w)
    off_e = np.abs(found - expected).max()
    told_e = float(re.search(r"up to ([\d.e+-]+) e-", told)[1])
    assert 0.2 * found.max() < off_e < told_e < 20.0 * off_e
    kept = scene({"readout": readout | {"edges": "partial", "rows_per_s": 0.0}})
    for quiet in (scene({"readout": readout}, **changes), kept):
        assert not [w for w in prepare(quiet).plan.warnings if "readout.edges" in w]
