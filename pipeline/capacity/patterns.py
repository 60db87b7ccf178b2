"""Search patterns: the fields that sensors step through, and the objects that are in them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pipeline.capacity.course import KEPT_SENSORS, StudyCourse, moments
from pipeline.capacity.fields import axes_of_fields, field_rad
from pipeline.spec.study import SearchPattern
from pipeline.survey.elements import Elements
from pipeline.survey.sights import Sights, sights_of
from pipeline.survey.watch import WatchMoments

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Slots:
    """The dwells of one single sensor in a window, in order.

    watch : the sensor at their middles (q,); axes : (q, 3, 3) across, up and along of each field,
    TEME; frame_s : (f,) middles of the frames from the middle of the dwell
    """

    watch: WatchMoments
    axes: Array
    frame_s: Array


@lru_cache(maxsize=KEPT_SENSORS)
def slots_of(course: StudyCourse, window: int, unit_: int) -> Slots:
    """The slots of a single sensor (number among all) in a window."""
    j = int(course.units[unit_])
    watcher, sensor, pattern = course.watchers[j], course.study.sensors[j], course.study.tasking
    assert isinstance(pattern, SearchPattern)
    search = course.rounds[unit_]
    count = search.fields
    first = (unit_ - int(np.searchsorted(course.units, j))) * count // sensor.count
    start, *_, end = course.offsets_s(window)
    number, middle_s = _times(start, end, count, first, search.each_s, search.back_s)
    watch = watcher.watch(middle_s)
    at_deg = search.at_deg[number % count]
    e = watcher.resolved.scene.exposure
    frames = np.asarray((np.arange(e.frames) - 0.5 * (e.frames - 1)) * e.step_s, float)
    return Slots(watch, axes_of_fields(watcher, watch, pattern, at_deg), frames)


def _times(
    start: float, end: float, count: int, first: int, each: float, more: float
) -> tuple[Index, Array]:
    """Numbers of the dwells (q,) from start to end [s], and their middles [s].

    A round of `count` fields takes `each` [s] for a field, and `more` for the way back; at 0 s the
    first round has come to the field `first`
    """
    rounds = np.array([start, end]) / (count * each + more)
    number = np.arange(int(rounds[0]) * count, (int(rounds[1]) + 2) * count)
    middle_s = (number - first + 0.5) * each + number // count * more
    inside = (middle_s >= start) & (middle_s < end)
    return number[inside], middle_s[inside]


@njit(cache=True, nogil=True, error_model="numpy")
def in_fields(
    place, speed, near, start_s, step_s, slot_s, axes, observer, motion, frame_s, tangent
):
    """Objects in fields, frame by frame.

    place, speed : (m, n, 3) at even steps from start_s; near : (m, n) what may be seen about a
    step; slot_s : (q,) middles of dwells, with axes (q, 3, 3), observer, motion (q, 3); frame_s :
    (f,) from the middle; tangent : (2,) of half the field, across and up. Between steps places
    are cubic (Hermite: 1 m off in low orbits at 60 s). Returns object (r,), slot (r,), number of
    frames that have it (r,), place and velocity (r, 3) at the middle of the dwell.
    """
    rows = [(np.int64(0), np.int64(0), np.int64(0))]
    states = [(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)]
    for i in range(place.shape[0]):
        for q in range(slot_s.size):
            k = int((slot_s[q] - start_s) / step_s)
            k = max(0, min(place.shape[1] - 2, k))
            if not (near[i, k] or near[i, k + 1]):
                continue
            frames = 0
            for f in range(frame_s.size):
                r, _ = _between(place[i], speed[i], k, slot_s[q] + frame_s[f] - start_s, step_s)
                d = r - observer[q] - motion[q] * frame_s[f]
                along = d[0] * axes[q, 2, 0] + d[1] * axes[q, 2, 1] + d[2] * axes[q, 2, 2]
                x = d[0] * axes[q, 0, 0] + d[1] * axes[q, 0, 1] + d[2] * axes[q, 0, 2]
                y = d[0] * axes[q, 1, 0] + d[1] * axes[q, 1, 1] + d[2] * axes[q, 1, 2]
                inside = abs(x) <= tangent[0] * along and abs(y) <= tangent[1] * along
                frames += 1 if inside and along > 0.0 else 0
            if frames:
                r, v = _between(place[i], speed[i], k, slot_s[q] - start_s, step_s)
                rows.append((np.int64(i), np.int64(q), np.int64(frames)))
                states.append((r[0], r[1], r[2], v[0], v[1], v[2]))
    return np.array(rows)[1:], np.array(states)[1:]


@njit(cache=True, nogil=True, error_model="numpy")
def _between(place, speed, k, at_s, step_s):
    """Place and velocity (3,) by the cubic through steps k and k + 1, at_s after the first step."""
    u = at_s / step_s - k
    a, b = place[k], place[k + 1]
    va, vb = speed[k] * step_s, speed[k + 1] * step_s
    c, d = 3.0 * (b - a) - 2.0 * va - vb, 2.0 * (a - b) + va + vb
    return a + u * (va + u * (c + u * d)), (va + u * (2.0 * c + 3.0 * u * d)) / step_s


Found = tuple[WatchMoments, Sights, Index, Index]


def pattern_sights(
    course: StudyCourse,
    window: int,
    sensor: int,
    elements: Elements,
    some: Index,
    states: tuple[Array, Array],
    near: NDArray[np.bool_],
) -> Iterator[Found]:
    """Of each single sensor: its moments, sights, frames that have each, and its number."""
    watcher = course.watchers[sensor]
    start_s = float(moments(course, window)[sensor].offset_s[0])
    tangent = np.tan(0.5 * np.array(field_rad(watcher)[::-1]))
    for unit_ in np.flatnonzero(course.units == sensor):
        slots = slots_of(course, window, int(unit_))
        watch = slots.watch
        rows, at = in_fields(
            *states, near, start_s, course.study.step_s, watch.offset_s, slots.axes,
            watch.observer_m, watch.motion_m_s, slots.frame_s, tangent,
        )  # fmt: skip
        rows, at = rows.reshape(-1, 3), at.reshape(-1, 6)
        who = some[rows[:, 0]]
        s = sights_of(
            watcher, watch, rows[:, 1], who, at[:, :3], at[:, 3:], elements.reflecting_m2[who],
            elements.shaded[who],
        )  # fmt: skip
        yield watch, s, rows[s.row, 2], np.full(len(s), unit_)
