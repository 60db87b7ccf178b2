"""The stars around a field: their light in the fullest frame, their motion, what covers it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pipeline.arrays import Array
from pipeline.plan.coverage import FieldCoverage
from pipeline.plan.decision import Decision
from pipeline.plan.response.sources import KnownSources


@dataclass(frozen=True)
class StarCounts:
    """The stars that light a frame.

    light_e : their light [e-] (n,), sorted; each : how many each stands for
    beyond_px : how far off the frame each is at mid-exposure (n,), 0 on it; none given: all on it
    """

    light_e: Array
    each: float = 1.0
    beyond_px: Array | None = None

    @property
    def total(self) -> int:
        return round(self.each * len(self.light_e))

    def near(self, reach_px: float) -> StarCounts:
        """Those at most so far off the frame."""
        if self.beyond_px is None:
            return self
        near = self.beyond_px <= reach_px
        return StarCounts(self.light_e[near], self.each, self.beyond_px[near])

    def brighter(self, light_e: float) -> float:
        """Stars of more light than so many electrons."""
        fainter = np.searchsorted(self.light_e, light_e, "right")
        return self.each * float(len(self.light_e) - fainter)

    def between(self, low_e: float, high_e: float) -> float:
        """Stars of more than `low_e` and at most `high_e` electrons."""
        return self.brighter(low_e) - self.brighter(high_e) if low_e < high_e else 0.0


class OwnMotion(NamedTuple):
    """The most that stars move by themselves [mas a year], and by parallax [mas for each au]."""

    proper_motion_mas_yr: float
    parallax_mas: float


@dataclass(frozen=True)
class FieldStars:
    """What was found of the stars around the field.

    counts : those that light the fullest of some frames; own_motion : the most that any has
    layers : the decisions about catalogues laid over the main one
    coverage : of the frames by the main catalogue
    sources : the stars of all of the scene's frames; None where not all were looked at
    """

    counts: StarCounts
    own_motion: OwnMotion
    layers: tuple[Decision, ...] = ()
    coverage: FieldCoverage | None = None
    sources: KnownSources | None = None
