"""Far light of targets that streak: what is spread on a block's grid is that part of it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pipeline.execute import blocks
from pipeline.execute.sources import FrameTarget
from pipeline.physics.drawing.wings import WingGrid
from pipeline.physics.motion.streak import Path


@pytest.mark.parametrize("middle_px", [50.0, 500.0, 1100.0])
def test_a_part_of_a_streak_has_that_part_of_its_light(
    middle_px: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A streak of 2000 px that crosses a grid of 200 px: what lies on it, and a margin."""
    monkeypatch.setattr(blocks, "target_class", lambda plan, target: 0)
    grid = WingGrid(100, 100, 2, 0.0, 0.0)
    path = Path(np.array([-1000.0, 1000.0]), np.zeros(2), np.ones(1))
    target = FrameTarget(0, middle_px, 100.0, path, 1e6)
    plan: Any = SimpleNamespace()
    x, _, light, _ = blocks._target_points(plan, [target], grid)
    inside = (x >= 0.0) & (x < 200.0)
    covered = np.clip([0.0, 200.0], middle_px - 1000.0, middle_px + 1000.0)
    there_e = 1e6 * np.ptp(covered) / 2000.0
    assert light[inside].sum() == pytest.approx(there_e, rel=0.01)
    assert light.sum() == pytest.approx(there_e, rel=0.15)
