"""Star counts of a frame from the shards' row counts: a forecast that reads no star."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Protocol

from pipeline.plan.scene_plan import Plan, StarForecast, field_area_sr


class BandLike(Protocol):
    """A magnitude band of a shard."""

    @property
    def brightest_g_mag(self) -> float: ...
    @property
    def rows(self) -> int: ...
    @property
    def bytes(self) -> int: ...


class LeafLike(Protocol):
    """A shard of the catalogue: a HEALPix pixel and its bands."""

    @property
    def order(self) -> int: ...
    @property
    def radius_rad(self) -> float: ...
    @property
    def rows(self) -> int: ...
    @property
    def bands(self) -> tuple[BandLike, ...]: ...


def forecast_stars(plan: Plan, leaves: Iterable[LeafLike]) -> StarForecast:
    """Rows and bytes to read, and stars per frame at each leaf's mean density."""
    assert plan.scene.stars is not None
    limit = plan.scene.stars.faintest_g_mag
    leaves = list(leaves)
    bands = [
        band
        for leaf in leaves
        for band in leaf.bands
        if limit is None or band.brightest_g_mag <= limit
    ]
    rows = sum(b.rows for b in bands)
    stars = sum(
        share_in_field(plan, leaf)
        * sum(b.rows for b in leaf.bands if limit is None or b.brightest_g_mag <= limit)
        for leaf in leaves
    )
    return StarForecast(len(leaves), len(bands), rows, sum(b.bytes for b in bands), round(stars))


def share_in_field(plan: Plan, leaf: LeafLike) -> float:
    """Share of a leaf's rows that a field in its middle would hold: the ratio of their areas.

    The leaf's area is that of its pixel, 4 pi / (12 x 4^order) sr (Gorski et al. 2005, ApJ 622,
    759), or of the cap that holds its rows where that is smaller (a deep field inside a pixel).
    """
    cap = 2.0 * math.pi * (1.0 - math.cos(leaf.radius_rad))
    area = min(math.pi / (3.0 * 4.0**leaf.order), cap)
    return min(1.0, field_area_sr(plan) / area) if area > 0 else 1.0
