"""Numerical propagation: DOP853 stepped on demand from the epoch, with dense output."""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import lru_cache, partial

import erfa.ufunc as era
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import DOP853, DenseOutput

from pipeline.errors import BadInput
from pipeline.physics.constants import ASTRONOMICAL_UNIT_M
from pipeline.physics.positions.orbit_forces import (
    REENTRY_HEIGHT_M,
    Forces,
    acceleration,
    height_m,
    sunlit,
)

Array = NDArray[np.float64]

MOST_STEPS = 50_000  # about a year in low orbit at the default tolerance
EDGE_S = 1e-4  # how near steps end to an edge of the shadow
_LOOKED_AT = np.linspace(0.0, 1.0, 9)[1:]  # where a step is searched for re-entry and shadows
_DAY_S = 86_400.0


class Trajectory:
    """One satellite's way, as far as it was asked for.

    Steps start at the epoch and run on without an end in sight, so that a place does not depend on
    what else was asked for. The Earth's axis is that of the epoch (it turns by 20 arcsec a year);
    the Sun is ERFA's epv00, the Moon moon98.
    """

    def __init__(
        self, state: Array, tt: tuple[float, float], forces: Forces, relative_tolerance: float
    ) -> None:
        self._start, self._tt, self._forces = state, tt, forces
        self._tolerance = relative_tolerance
        self._pole = np.ascontiguousarray(era.pnm06a(*tt)[2])
        self._lock = threading.Lock()
        self._ways: dict[int, _Way] = {}

    def states(self, since_s: ArrayLike, field: str = "orbit") -> tuple[Array, Array]:
        """GCRS positions [m] and velocities [m/s] (n, 3) at seconds (n,) from the epoch.

        Raises BadInput where the satellite comes below 100 km while it feels drag, and where the
        integration would take too many steps or ones too small (stiff).
        """
        since = np.atleast_1d(np.asarray(since_s, float))
        out = np.empty((len(since), 6))
        with self._lock:
            for sign in (1, -1):
                chosen = since >= 0 if sign > 0 else since < 0
                if not np.any(chosen):
                    continue
                if sign not in self._ways:
                    self._ways[sign] = self._begin(sign)
                out[chosen] = self._ways[sign].states(sign * since[chosen], field)
        return out[:, :3], out[:, 3:]

    def _begin(self, sign: int) -> _Way:
        scale = self._tolerance * np.repeat([1e6, 1e3], 3)

        def solver(t: float, y: Array, end: float, first: float | None, law: int) -> DOP853:
            rate = partial(self._rate, lit=(0.0, None, 1.0)[law])
            return DOP853(rate, t, y, end, first_step=first, rtol=self._tolerance, atol=scale)

        return _Way(solver, self._start, sign, self._ends, self._light)

    def _rate(self, t: float, y: Array, lit: float | None) -> Array:
        sun, moon = self._bodies(t)
        return np.concatenate([y[3:], acceleration(y, self._pole, sun, moon, self._forces, lit)])

    def _bodies(self, t: float) -> tuple[Array, Array]:
        """Geocentric Sun and Moon (3,) [m], zero where no force needs them."""
        f, none = self._forces, np.zeros(3)
        tt1, tt2 = self._tt[0], self._tt[1] + t / _DAY_S
        sun = none
        if f.sun or f.radiation_m2_kg > 0.0:
            # as `earth_and_sun` has it, of moments that never come again
            sun = np.asarray(-era.epv00(tt1, tt2)[0]["p"]) * ASTRONOMICAL_UNIT_M
        moon = np.asarray(era.moon98(tt1, tt2)["p"]) * ASTRONOMICAL_UNIT_M if f.moon else none
        return sun, moon

    def _light(self, t: float, y: Array) -> int:
        """0 in the dark, 1 in penumbra, 2 in the Sun: between them the force has edges."""
        if self._forces.radiation_m2_kg == 0.0:
            return 2
        seen = sunlit(y[:3], self._bodies(t)[0], self._forces.conical)
        return 0 if seen == 0.0 else 2 if seen == 1.0 else 1

    def _ends(self, y: Array) -> bool:
        """True where the satellite counts as re-entered."""
        if self._forces.drag_m2_kg == 0.0:
            return False
        return not height_m(y[:3], self._pole) > REENTRY_HEIGHT_M


class _Way:
    """The steps in one direction of time; steps end where the satellite's light changes its law."""

    def __init__(
        self,
        solver: Callable[[float, Array, float, float | None, int], DOP853],
        start: Array,
        sign: int,
        ends: Callable[[Array], bool],
        light: Callable[[float, Array], int],
    ) -> None:
        self._new, self._start, self._sign = solver, start, sign
        self._ends, self._light = ends, light
        self._now = light(0.0, start)
        self._solver = solver(0.0, start, sign * np.inf, None, self._now)
        self._edges: list[float] = [0.0]
        self._dense: list[DenseOutput] = []
        self._end_s = 0.0 if ends(start) else np.inf

    def states(self, after_s: Array, field: str) -> Array:
        """States (n, 6) at seconds >= 0 along this direction."""
        self._step_to(float(after_s.max()), field)
        if after_s.max() >= self._end_s:
            raise BadInput(
                field,
                f"re-entry {self._end_s / 60.0:.0f} min from the epoch",
                f"an orbit that stays above {REENTRY_HEIGHT_M / 1e3:.0f} km during all exposures",
            )
        if not self._dense:
            return np.repeat(self._start[None], len(after_s), axis=0)
        index = np.clip(
            np.searchsorted(self._edges, after_s, side="right") - 1, 0, len(self._dense) - 1
        )
        out = np.empty((len(after_s), 6))
        for i in np.unique(index):
            here = index == i
            out[here] = self._dense[i](self._sign * after_s[here]).T
        return out

    def _step_to(self, until_s: float, field: str) -> None:
        while self._edges[-1] < until_s and self._end_s == np.inf:
            y = self._solver.y
            step = self._step(self._solver, field)
            change = self._change(step)
            if change is None:
                self._keep(step)
                continue
            time, law = change
            first = min(self._solver.step_size, abs(time - step.t_old))
            to_edge = self._new(step.t_old, y, time, first, self._now)
            while to_edge.status == "running":
                self._keep(self._step(to_edge, field))
            self._now = law
            self._solver = self._new(time, to_edge.y, self._sign * np.inf, 1.0, law)

    def _step(self, solver: DOP853, field: str) -> DenseOutput:
        """The dense output of one more step; BadInput where there is none."""
        message = solver.step() if len(self._dense) < MOST_STEPS else "too many steps"
        if message or not np.all(np.isfinite(solver.y)):
            raise BadInput(
                field,
                f"integration stopped {self._edges[-1]:.1f} s from the epoch: {message}",
                f"a smooth orbit of at most {MOST_STEPS} steps (nearer epoch, larger "
                "relative_tolerance, less drag; not through the atmosphere)",
            )
        return solver.dense_output()

    def _change(self, step: DenseOutput) -> tuple[float, int] | None:
        """When the light's law changes within a step, and to which; None where it does not.

        A change at the very beginning of a step is the one that the last step ended at.
        """
        before = step.t_old + self._sign * 2.0 * EDGE_S
        for after in step.t_old + _LOOKED_AT * (step.t - step.t_old):
            if abs(after - step.t_old) <= abs(before - step.t_old):
                continue
            law = self._light(after, step(after))
            if law == self._now:
                before = after
                continue
            while abs(after - before) > EDGE_S:
                middle = 0.5 * (before + after)
                found = self._light(middle, step(middle))
                if found == self._now:
                    before = middle
                else:
                    after, law = middle, found
            return float(after), law
        return None

    def _keep(self, step: DenseOutput) -> None:
        times = step.t_old + _LOOKED_AT * (step.t - step.t_old)
        below = [t for t in times if self._ends(step(t))]
        if below:
            self._end_s = min(self._end_s, abs(float(below[0])))
        self._edges.append(abs(float(step.t)))
        self._dense.append(step)


@lru_cache(maxsize=1024)
def trajectory(
    position_m: tuple[float, float, float],
    velocity_m_s: tuple[float, float, float],
    tt: tuple[float, float],
    forces: Forces,
    relative_tolerance: float,
) -> Trajectory:
    """The trajectory of a state (GCRS) at a TT date; kept, so that frames share its steps."""
    state = np.array([*position_m, *velocity_m_s], float)
    return Trajectory(state, tt, forces, relative_tolerance)
