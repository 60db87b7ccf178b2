"""Star counts of a frame from the shards' row counts: a forecast that reads no star."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol

from pipeline.plan.scene_plan import Plan, StarForecast, field_area_sr


class RowGroupLike(Protocol):
    """A run of rows of a shard."""

    @property
    def rows(self) -> int: ...
    @property
    def bytes(self) -> int: ...


class LeafLike(Protocol):
    """A shard of a catalogue: a HEALPix pixel, with the row groups to read."""

    @property
    def order(self) -> int: ...
    @property
    def radius_rad(self) -> float: ...
    @property
    def row_groups(self) -> Sequence[RowGroupLike]: ...


def forecast_stars(leaves: Sequence[LeafLike], stars_per_frame: float) -> StarForecast:
    """Rows and bytes to read of leaves, and stars of the fullest frame."""
    groups = [group for leaf in leaves for group in leaf.row_groups]
    return StarForecast(
        len(leaves), len(groups), sum(g.rows for g in groups), sum(g.bytes for g in groups),
        round(stars_per_frame),
    )  # fmt: skip


def share_in_field(plan: Plan, leaf: LeafLike) -> float:
    """Share of a leaf's rows that a field in its middle would hold: the ratio of their areas.

    The leaf's area is that of its pixel, 4 pi / (12 x 4^order) sr (Gorski et al. 2005, ApJ 622,
    759), or of the cap that holds its rows where that is smaller (a deep field inside a pixel).
    """
    cap = 2.0 * math.pi * (1.0 - math.cos(leaf.radius_rad))
    area = min(math.pi / (3.0 * 4.0**leaf.order), cap)
    return min(1.0, field_area_sr(plan) / area) if area > 0 else 1.0
