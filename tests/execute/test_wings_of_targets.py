"""Far light of targets that streak: what is spread on a block's grid is that part of it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pipeline.execute import blocks
from pipeline.execute.sources import FrameTarget, streaks
from pipeline.physics.drawing.wings import WingGrid
from pipeline.physics.motion.streak import Path
from tests.execute.test_engines import WHOLE, field, geometry_of, plan_of


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


@pytest.mark.parametrize("way_px", [0.0, 1e-20, -1e-20, 1e-3, 100.0])
def test_a_source_that_is_off_the_grid_is_no_point_on_it(
    way_px: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However little it moves: steps to the grid are then more than can be numbered."""
    monkeypatch.setattr(blocks, "target_class", lambda plan, target: 0)
    path = Path(np.array([0.0, way_px]), np.array([-way_px, 0.0]), np.ones(1))
    off = [FrameTarget(0, *place, path, 1e6) for place in ((900.0, 100.0), (100.0, -700.0))]
    found = blocks._target_points(SimpleNamespace(), off, WingGrid(100, 100, 2, 0.0, 0.0))  # type: ignore
    assert [len(v) for v in found] == [0] * 4


def test_a_star_with_a_path_of_its_own_is_swept_along_no_other() -> None:
    """Beside stars on a common streak: its far light is what it is without them."""
    plan = plan_of({"kind": "airy", "wavelength_nm": 650.0}, 25.0, 0.0)
    g, reach = geometry_of(plan), plan.halo_px + 30.0
    stars = field(np.array([40.0]), np.array([50.0]), np.array([1e4]))
    none, paths = field(*np.zeros((3, 0))), streaks(plan, g)
    own = FrameTarget(0, 90.0, 80.0, Path(np.zeros(2), np.array([-3.0, 3.0]), np.ones(1)), 1e5)
    both, common, alone = (
        blocks._wings(plan, WHOLE, reach, of, streaked, setting, [])[1]
        for of, streaked, setting in ((stars, paths, [own]), (stars, paths, []), (none, [], [own]))
    )
    assert both is not None
    assert common is not None
    assert alone is not None
    np.testing.assert_allclose(both, common + alone, atol=1e-9 * np.abs(both).max())
