"""Which sensor observes what, when: the most overdue first, or all free sensors at their best."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from pipeline.capacity.course import StudyCourse
from pipeline.physics.constants import DEG_RAD
from pipeline.physics.noise.streams import philox, stream_key, uniform
from pipeline.physics.vectors import separation
from pipeline.spec.study import CuedTasking
from pipeline.survey.elements import Elements, named_by

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Scored = tuple[Index, Array, Array]

AGAIN = 0.5  # of its revisit time an object is left alone after it was detected
MOST_OVERDUE = 1e3  # times its revisit time: what was never detected
NEVER_S = -1e12  # when an object that was not detected yet was last


@dataclass
class SensorState:
    """What windows hand on: when each single sensor (u,) is free [s], where it looks (u, 3); when
    each object (n,) was detected last [s]."""

    free_s: Array
    direction: Array
    last_s: Array


def begin_state(course: StudyCourse) -> SensorState:
    """Before the first window: all free, looking nowhere, nothing detected."""
    units, objects = len(course.units), len(course.elements)
    return SensorState(np.zeros(units), np.zeros((units, 3)), np.full(objects, NEVER_S))


def wanted(rule: CuedTasking, elements: Elements) -> tuple[Array, Array]:
    """Priority and revisit time [s] of each object (n,): by the first rule that names it."""
    priority, revisit = np.ones(len(elements)), np.full(len(elements), rule.revisit_h * 3600.0)
    for r, named in named_by(rule.rules[::-1], elements):
        priority[named] = r.priority
        revisit[named] = (r.revisit_h or rule.revisit_h) * 3600.0
    return priority, revisit


@njit(cache=True)
def draws(frame, unit_, object_, k0, k1):
    """Uniform draws (r,) in (0, 1) of observations, each by its step, sensor and object."""
    out = np.empty(frame.size)
    for i in range(frame.size):
        a, b, _, _ = philox(object_[i], unit_[i], frame[i], 0, k0, k1)
        out[i] = uniform(a, b)
    return out


def detected(
    course: StudyCourse, frame: Index, unit_: Index, object_: Index, chance: Array
) -> NDArray[np.bool_]:
    """Whether observations (r,) of these chances detect their object."""
    key = stream_key(course.study.seed, "detections")
    numbers = [np.ascontiguousarray(v, dtype=np.int64) for v in (frame, unit_, object_)]
    return np.asarray(draws(numbers[0], numbers[1], numbers[2], *key) < chance)


@dataclass(frozen=True, eq=False)
class Candidates:
    """Rows (r,) of a window that a cued study may choose from, by step."""

    step: Index
    sensor: Index
    object: Index
    direction: Array
    chance: Array


@dataclass(frozen=True, eq=False)
class Taken:
    """Observations (r,): rows of the candidates, single sensors, starts [s], lengths [s] from the
    slew on, and whether each detected its object."""

    row: Index
    unit: Index
    start_s: Array
    length_s: Array
    detected: NDArray[np.bool_]


def task_window(course: StudyCourse, c: Candidates, state: SensorState) -> Taken:
    """Choose the observations of a window, and carry the state on to its end.

    Rounds: in each step the sensors that are free before its end take one object each, until none
    is; with `greedy` one after another, with `assignment` together at the largest sum of scores
    (Kuhn 1955; scipy's linear_sum_assignment). A score is priority x overdue x chance over the
    seconds that it takes; overdue is the time since the last detection over the revisit time. What
    would end after the period is not taken.
    """
    rule = course.study.tasking
    assert isinstance(rule, CuedTasking)
    clerk = _Clerk(course, c, state, *wanted(rule, course.elements))
    edges = np.searchsorted(c.step, np.arange(c.step.min(initial=0), c.step.max(initial=-1) + 2))
    for first, last in pairwise(edges):
        if last > first:
            clerk.step(int(first), int(last), rule.scheduler == "assignment")
    return clerk.taken()


class _Clerk:
    """Keeps the book of a window: who is free, what is taken."""

    def __init__(
        self,
        course: StudyCourse,
        c: Candidates,
        state: SensorState,
        priority: Array,
        revisit: Array,
    ) -> None:
        self.course, self.c, self.state = course, c, state
        self.priority, self.revisit = priority, revisit
        slews = [course.study.sensors[j].slewing for j in course.units]
        self.rate = np.array([s.rate_deg_s * DEG_RAD for s in slews])
        self.fixed = np.array([s.settle_s for s in slews])
        self.fixed += [course.watchers[j].dwell_s for j in course.units]
        self.until_s = course.steps * course.study.step_s  # what ends later is not taken
        self.gone = np.zeros(len(course.elements), bool)  # in the step
        self.book: list[tuple[int, int, float, float, bool]] = []

    def step(self, first: int, last: int, together: bool) -> None:
        """Fill one step, whose candidates are the rows first to last."""
        end_s = float(self.c.step[first] + 1) * self.course.study.step_s
        free = np.maximum(self.state.free_s, end_s - self.course.study.step_s)
        open_ = np.arange(first, last)
        open_ = open_[self.priority[self.c.object[open_]] > 0.0]
        rows = [open_[self.c.sensor[open_] == j] for j in range(len(self.course.watchers))]
        self.gone[:] = False
        while (busy := free >= end_s).sum() < len(busy):
            waiting = np.flatnonzero(~busy)
            round_ = waiting if together else waiting[[int(np.argmin(free[waiting]))]]
            scored = [self._scores(u, rows[self.course.units[u]], free[u]) for u in round_]
            picks = _assigned(self.c, scored) if together else [_best(scored[0][1])]
            for u, pick, (these, _, length) in zip(round_, picks, scored, strict=True):
                if pick is None:
                    free[u] = end_s
                else:
                    self._take(int(u), int(these[pick]), float(free[u]), float(length[pick]))
                    free[u] = self.state.free_s[u]

    def _scores(self, unit_: int, rows: Index, now_s: float) -> Scored:
        """Rows that a sensor may take now, their scores, and how long each takes [s]."""
        c, state = self.c, self.state
        object_ = c.object[rows]
        overdue = (now_s - state.last_s[object_]) / self.revisit[object_]
        due = (overdue >= AGAIN) & ~self.gone[object_]
        rows, object_, overdue = rows[due], object_[due], np.minimum(overdue[due], MOST_OVERDUE)
        turn = np.zeros(len(rows))
        if state.direction[unit_].any():
            turn = separation(state.direction[unit_], c.direction[rows])
        length = turn / self.rate[unit_] + self.fixed[unit_]
        score = self.priority[object_] * overdue * c.chance[rows] / length
        ends = now_s + length <= self.until_s
        return rows[ends], score[ends], length[ends]

    def _take(self, unit_: int, row: int, now_s: float, took_s: float) -> None:
        c, one = self.c, np.array([row])
        object_ = int(c.object[row])
        seen = detected(self.course, c.step[one], np.array([unit_]), c.object[one], c.chance[one])
        self.gone[object_] = True
        self.state.direction[unit_], self.state.free_s[unit_] = c.direction[row], now_s + took_s
        if seen[0]:
            self.state.last_s[object_] = now_s + took_s
        self.book.append((row, unit_, now_s, took_s, bool(seen[0])))

    def taken(self) -> Taken:
        """The book as columns."""
        row, unit_, start, length, seen = zip(*self.book, strict=True) if self.book else ((),) * 5
        return Taken(
            np.array(row, np.int64),
            np.array(unit_, np.int64),
            np.array(start, float),
            np.array(length, float),
            np.array(seen, bool),
        )


def _best(score: Array) -> int | None:
    """The place of the highest score, the first of equal ones; None where there is none."""
    return int(np.argmax(score)) if len(score) else None


def _assigned(c: Candidates, scored: list[Scored]) -> list[int | None]:
    """A place for each sensor, no object twice, of the largest sum of scores."""
    objects = np.unique(np.concatenate([c.object[rows] for rows, *_ in scored]))
    table, which = np.zeros((len(scored), len(objects))), np.full((len(scored), len(objects)), -1)
    for i, (rows, score, _) in enumerate(scored):
        column = np.searchsorted(objects, c.object[rows])
        table[i, column], which[i, column] = score, np.arange(len(rows))
    out: list[int | None] = [None] * len(scored)
    for i, k in zip(*linear_sum_assignment(table, maximize=True), strict=True):
        out[i] = int(which[i, k]) if which[i, k] >= 0 else None
    return out
