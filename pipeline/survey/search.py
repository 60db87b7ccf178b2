"""Every moment at which objects are seen by a sensor: screened in steps, none missed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pipeline.physics.positions.orbit_screen import WHOLE, states_apart, states_together
from pipeline.physics.positions.orbit_sgp4 import since_epochs_s
from pipeline.physics.positions.regard import may_be_seen
from pipeline.physics.vectors import unit
from pipeline.survey.elements import Elements
from pipeline.survey.prune import never_seen
from pipeline.survey.sights import Sights, sights_of
from pipeline.survey.watch import MOST_LIFT_RAD, Watcher, WatchMoments

if TYPE_CHECKING:
    from sgp4.api import Satrec

Array = NDArray[np.float64]
Index = NDArray[np.int64]

SCREEN_S = 60.0  # about the length of the steps that are screened
MOST_STATES = 400_000  # of objects and steps looked at in one go


@dataclass(frozen=True, eq=False)
class Search:
    """A watcher at moments (n,), and steps (s,) that hold `stride` of them each.

    coarse : the watcher at the middles of the steps; half_s : half their length
    """

    watcher: Watcher
    watch: WatchMoments
    coarse: WatchMoments
    stride: int
    half_s: float
    least_snr: float

    def of(self, elements: Elements) -> tuple[Sights, int]:
        """All sights of some objects that the field of regard allows and whose SNR suffices, by
        object and moment; and how many of the objects SGP4 cannot follow."""
        hopeful = np.flatnonzero(
            ~never_seen(self.watcher, self.watch, elements, self.least_snr)
        ).astype(np.int64)
        step = max(16, MOST_STATES // len(self.coarse.offset_s))
        parts, failed = [], 0
        for first in range(0, len(hopeful), step):
            found, bad = self._some(elements, hopeful[first : first + step])
            parts.append(found)
            failed += bad
        if not parts:
            return _none(), 0
        return Sights(
            *(np.concatenate([getattr(p, name) for p in parts]) for name in _COLUMNS)
        ), failed

    def _some(self, elements: Elements, which: Index) -> tuple[Sights, int]:
        satellites = elements.take(which).satellites()
        since = since_epochs_s(satellites, self.watcher.epoch)
        place, speed, codes = states_together(satellites, since, self.coarse.offset_s)
        c = self.coarse
        near = may_be_seen(
            place, speed, c.observer_m, c.motion_m_s, c.up, c.lowest, c.turn_rad_s, c.works,
            unit(c.sun_m), self.half_s, False,
        ) & (codes == WHOLE)  # fmt: skip
        i, k = np.nonzero(near)
        moment = (k[:, None] * self.stride + np.arange(self.stride)).ravel()
        who = np.repeat(i, self.stride)
        there = moment < len(self.watch.offset_s)
        there[there] &= self.watch.works[moment[there]]
        found = self._rows(elements, which, satellites, since, who[there], moment[there])
        return found, int((codes != WHOLE).any(axis=1).sum())

    def _rows(
        self,
        elements: Elements,
        which: Index,
        satellites: list[Satrec],
        since: Array,
        who: Index,
        moment: Index,
    ) -> Sights:
        """Sights at the moments themselves of pairs that the screen has left."""
        w = self.watch
        place, speed, codes = states_apart(satellites, since, who, w.offset_s[moment])
        sun = unit(w.sun_m)
        seen = may_be_seen(
            place[None], speed[None], w.observer_m[moment], w.motion_m_s[moment], w.up[moment],
            w.lowest[moment] - MOST_LIFT_RAD, w.turn_rad_s[moment], w.works[moment], sun[moment],
            0.0, bool(elements.shaded[which].all()),
        )[0] & (codes == WHOLE)  # fmt: skip
        who, moment = which[who[seen]], moment[seen]
        s = sights_of(
            self.watcher, w, moment, who, place[seen], speed[seen], elements.reflecting_m2[who],
            elements.shaded[who],
        )  # fmt: skip
        return s.take(s.snr >= self.least_snr)


_COLUMNS = tuple(Sights.__dataclass_fields__)


def _none() -> Sights:
    index, one, three = np.zeros(0, np.int64), np.zeros(0), np.zeros((0, 3))
    return Sights(index, index, index, three, three, *[one] * 10)


def make_search(watcher: Watcher, offsets_s: Array, least_snr: float) -> Search:
    """The search of a watcher at evenly spaced moments (n,) [s] after its epoch."""
    step_s = float(offsets_s[1] - offsets_s[0]) if len(offsets_s) > 1 else SCREEN_S
    stride = max(1, min(len(offsets_s), round(SCREEN_S / step_s)))
    first = np.arange(0, len(offsets_s), stride)
    last = np.minimum(first + stride, len(offsets_s)) - 1
    middles = 0.5 * (offsets_s[first] + offsets_s[last])
    half_s = 0.5 * float((offsets_s[last] - offsets_s[first]).max()) + 1e-6
    watch, coarse = watcher.watch(offsets_s), watcher.watch(middles)
    lowest = np.minimum.reduceat(watch.lowest, first)
    coarse.lowest[:] = np.minimum(lowest, coarse.lowest) - MOST_LIFT_RAD
    coarse.works[:] = np.logical_or.reduceat(watch.works, first)
    return Search(watcher, watch, coarse, stride, half_s, least_snr)
