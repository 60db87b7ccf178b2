"""Light of a body worked out beforehand: along time, or on a grid of spin phase and time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Light = Callable[[Array, Array], Array]

FIRST_TIMES, FIRST_PHASES = 9, 32
NO_TIMES = np.empty(0)
FAINT = 0.1  # of the brightest moment: below it the error is told as a share of that
GOLDEN = 0.6180339887498949
KINK = 0.5  # of the share: what a middle may be off, as a kink may hide beside it
HALVED = 2.0  # shares that a grid may be off before it is halved: a quarter of it is left then
HELD_OUT = 64  # places between the rest that are looked at last
TURN = 2.0 * np.pi


@dataclass(frozen=True, eq=False)
class LightTable:
    """C lights at rising times (n,) and, of a spinning body, at P even phases from 0 on.

    values : (P, n, C), straight between; P = 1 where nothing spins
    error : what moments that were omitted differed by. Along time: the largest share of the light,
        or of FAINT of the brightest, with room for a kink between. With spin: the mean difference
        over the mean light, which is what exposures see of it
    worst : with spin, the largest difference over the brightest light; worked : moments it took
    """

    times_s: Array
    values: Array
    error: float
    worked: int
    worst: float = 0.0

    def at(self, time_s: Array, phase_rad: Array) -> Array:
        """Lights (m, C) at times (m,) within the table, at phases (m,)."""
        n, phases = len(self.times_s), len(self.values)
        k = np.clip(np.searchsorted(self.times_s, time_s, side="right") - 1, 0, n - 2)
        span = self.times_s[k + 1] - self.times_s[k]
        u = np.clip((time_s - self.times_s[k]) / span, 0.0, 1.0)[:, None]
        step = np.mod(np.asarray(phase_rad, float) / TURN, 1.0) * phases
        p = np.minimum(step.astype(np.int64), phases - 1)
        v = (step - p)[:, None] if phases > 1 else np.zeros((len(u), 1))
        q = (p + 1) % phases
        low = (1.0 - u) * self.values[p, k] + u * self.values[p, k + 1]
        high = (1.0 - u) * self.values[q, k] + u * self.values[q, k + 1]
        return np.asarray((1.0 - v) * low + v * high)


def tabulated(
    light: Light,
    start_s: float,
    end_s: float,
    share: float,
    most: int,
    spins: bool,
    turns_s: Array = NO_TIMES,
) -> LightTable | None:
    """A table of a body's light, so fine that its `error` is at most `share`.

    light : from phases (m,) [rad] and times (m,) [s] to lights (m, C), whose sum counts
    turns_s : times between the two at which it is looked at in any case, as it may turn there
    None where more than `most` moments would have to be worked out.
    """
    even = np.linspace(start_s, end_s, 3 if spins else FIRST_TIMES)
    times = np.union1d(even, turns_s)
    return (_grid if spins else _line)(light, times, share, most)


def _off(found: Array, told: Array, peak: float) -> Array:
    """Differences (m,) of sums of lights (m, C), as shares."""
    right = found.sum(axis=-1)
    off = np.abs(right - told.sum(axis=-1))
    return np.asarray(off / np.maximum(np.maximum(right, FAINT * peak), 1e-300))


def _line(light: Light, times: Array, share: float, most: int) -> LightTable | None:
    """Along time: pieces are halved until middles are told by ends, of a piece and of its halves.

    Then places by chance are looked at in the same way.
    """
    if len(times) > most:
        return None
    values = light(np.zeros(len(times)), times)
    where = np.sort(np.mod(GOLDEN * np.arange(1, HELD_OUT + 1), 1.0))
    by_chance = times[0] + (times[-1] - times[0]) * where
    at, worst = 0.5 * (times[:-1] + times[1:]), 0.0
    once = np.zeros(len(at), bool)  # pieces whose whole was told well
    while len(at) or len(by_chance):
        if not len(at):
            at, by_chance = by_chance[~np.isin(by_chance, times)], np.empty(0)
            once = np.ones(len(at), bool)
        if len(times) + len(at) > most:
            return None
        found = light(np.zeros(len(at)), at)
        told = LightTable(times, values[None], 0.0, 0).at(at, np.zeros(len(at)))
        peak = float(max(values.sum(axis=-1).max(), found.sum(axis=-1).max()))
        off = _off(found, told, peak)
        good = off <= KINK * share
        worst = max(worst, float(off[good & once].max(initial=0.0)))
        order = np.argsort(np.concatenate([times, at]), kind="stable")
        times, values = np.concatenate([times, at])[order], np.concatenate([values, found])[order]
        k = np.searchsorted(times, at)
        more = ~(good & once)
        k, passed = k[more], good[more]
        halves = np.concatenate([times[k - 1] + times[k], times[k] + times[k + 1]])
        at, first = np.unique(0.5 * halves, return_index=True)
        once = np.concatenate([passed, passed])[first]
    return LightTable(times, values[None], worst / KINK, len(times))


def _grid(light: Light, times: Array, share: float, most: int) -> LightTable | None:
    """Phase by time: each side is halved until what lies between is told by its neighbours.

    Where a face or a shadow sets in the light has kinks, which no even grid tells at once: the mean
    difference counts.
    """
    phases = FIRST_PHASES
    if phases * len(times) > most:
        return None
    values = _on_grid(light, np.arange(phases) * TURN / phases, times)
    for side in ("phase", "time"):
        mean = np.inf
        while mean > HALVED * share:
            if 2 * values[..., 0].size > most:
                return None
            table = LightTable(times, values, 0.0, 0)
            phase, at = np.arange(phases) * TURN / phases, 0.5 * (times[:-1] + times[1:])
            if side == "phase":
                phase, at = phase + 0.5 * TURN / phases, times
            found = _on_grid(light, phase, at)
            told = table.at(np.tile(at, len(phase)), np.repeat(phase, len(at)))
            mean, _ = _apart(found.reshape(told.shape), told)
            values = _woven(values, found, 0 if side == "phase" else 1)
            if side == "phase":
                phases *= 2
            else:
                times = np.sort(np.concatenate([times, at]))
    return _proved(light, LightTable(times, values, 0.0, values[..., 0].size), share)


def _apart(found: Array, told: Array) -> tuple[float, float]:
    """Mean and largest difference of sums of lights (m, C), over the mean and the largest sum."""
    right = found.sum(axis=-1)
    off = np.abs(right - told.sum(axis=-1))
    room = 1e-300
    return float(off.mean() / max(right.mean(), room)), float(off.max() / max(right.max(), room))


def _proved(light: Light, table: LightTable, share: float) -> LightTable | None:
    """The table with its error at places by chance; None where that is more than `share`."""
    k = np.arange(1, HELD_OUT + 1)
    start, end = table.times_s[[0, -1]]
    at, phase = start + (end - start) * np.mod(GOLDEN * k, 1.0), TURN * np.mod(GOLDEN**2 * 7 * k, 1)
    mean, worst = _apart(light(phase, at), table.at(at, phase))
    if mean > share:
        return None
    return LightTable(table.times_s, table.values, mean, table.worked + HELD_OUT, worst)


def _on_grid(light: Light, phase: Array, times: Array) -> Array:
    """Lights (P, n, C) at every phase and time."""
    flat = light(np.repeat(phase, len(times)), np.tile(times, len(phase)))
    return flat.reshape(len(phase), len(times), -1)


def _woven(values: Array, between: Array, axis: int) -> Array:
    """Values with those between them put in, in turn."""
    count = values.shape[axis] + between.shape[axis]
    shape = list(values.shape)
    shape[axis] = count
    out = np.empty(shape)
    out[(slice(None),) * axis + (slice(0, None, 2),)] = values
    out[(slice(None),) * axis + (slice(1, None, 2),)] = between
    return out
