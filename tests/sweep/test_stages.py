"""What a sweep shares between its points is shared by all that it follows from."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pipeline.execute.blocks import LightBlock
from pipeline.physics.colour import ColourFit
from pipeline.plan.tiles import Tile
from pipeline.sweep.stages import _block_bytes, _read_key, stages

FIT = ColourFit(
    "x", np.array([0.0, 0.1]), (-0.5, 4.0), 0.01, 0.02, 0.0, 0.8, 0.3, 0.03, 1e10, "made up", 9
)


def test_what_is_kept_leaves_room_for_a_process_on_each_core(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """800 MB free and four cores: 100 MB of values each stay, the next makes room for itself."""
    monkeypatch.setattr("pipeline.sweep.stages.free_mb", lambda: 800.0)
    monkeypatch.setattr("pipeline.sweep.stages.cores", lambda: 4)
    kept = stages("a run of this test")
    for number in (1, 2, 1, 3, 1, 2):
        kept.get("light", (number,), lambda: None, lambda _: 50_000_000)
    assert kept.drawn["light"] == 4  # 2 gave way to 3, and is drawn again


def key_of(**changes: Any) -> str:
    asked: dict[str, Any] = {
        "digests": ("a", "b"), "left_out": (np.arange(3), np.arange(0)), "faintest_g_mag": 18.0,
        "space_motion": True, "colour": FIT, "area_m2": 0.2,
    } | changes  # fmt: skip
    stars = SimpleNamespace(
        faintest_g_mag=asked["faintest_g_mag"], space_motion=asked["space_motion"]
    )
    catalogues = [SimpleNamespace(digest=d) for d in asked["digests"]]
    base: Any = SimpleNamespace(
        prepared=SimpleNamespace(catalogues=catalogues, left_out=asked["left_out"])
    )
    plan: Any = SimpleNamespace(
        scene=SimpleNamespace(stars=stars), colour=asked["colour"],
        facts=SimpleNamespace(area_m2=asked["area_m2"]),
    )  # fmt: skip
    return _read_key(base, plan)


def test_rows_of_a_shard_are_shared_by_all_that_they_follow_from() -> None:
    changed: list[dict[str, Any]] = [
        {}, {"digests": ("a", "c")}, {"digests": ("b", "a")}, {"digests": ("a",)},
        {"left_out": (np.arange(4), np.arange(0))}, {"left_out": (np.arange(0), np.arange(3))},
        {"faintest_g_mag": 18.5}, {"space_motion": False}, {"area_m2": 0.21},
        {"colour": replace(FIT, coefficients=np.array([0.0, 0.2]))},
        {"colour": replace(FIT, default_colour=0.9)},
        {"colour": replace(FIT, zero_electrons_s_m2=2e10)},
    ]  # fmt: skip
    keys = [key_of(**changes) for changes in changed]
    assert len(set(keys)) == len(keys)
    assert key_of() == keys[0]


def test_a_kept_block_counts_all_of_its_images() -> None:
    """Of wings and of a crowd, which has every pixel of its 2048."""
    wings, crowd = np.zeros((40, 50)), np.zeros((300, 200), np.float32)
    block = LightBlock(Tile(0, 0, 0, 0, 300, 200), None, wings, 2.0 * wings, crowd, 0.0, (), 0.0)
    assert 0 <= _block_bytes(block) - (2 * wings.nbytes + crowd.nbytes) <= 2000
    bare = replace(block, star_wings=None, target_wings=None, crowd_e=None)
    assert 0 < _block_bytes(bare) <= 2000
