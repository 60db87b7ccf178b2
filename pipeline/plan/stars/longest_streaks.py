"""The longest streak that a scene draws."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pipeline.arrays import Geometry
from pipeline.plan.tiles import distance_px

if TYPE_CHECKING:
    from pipeline.plan.resolved import ResolvedScene


def longest_px(plan: ResolvedScene, g: Geometry) -> float:
    """The longest streak of stars, or of a target that comes into the frame."""
    longest = 0.0 if plan.scene.stars is None else plan.responses.streaks.longest_px
    x, y = g.target_x_px, g.target_y_px
    inside = distance_px(x, y, 0, 0, plan.camera.rows, plan.camera.columns) <= 0.0
    lengths = np.hypot(np.diff(x, axis=-1), np.diff(y, axis=-1)).sum(axis=-1)
    return max(longest, float(np.nan_to_num(lengths)[inside.any(axis=-1)].max(initial=0.0)))
