"""When every frame of a scene starts and how long it is exposed: the one place that knows."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Array
from pipeline.errors import BadInput
from pipeline.spec.pointing.dwell import Dwell, Slew
from pipeline.spec.pointing.pointing import Pointing
from pipeline.spec.scene import Exposure, Scene
from pipeline.spec.sensor.detector import RollingShutter

MOST_FRAMES = 100_000
BIAS_PLANNED_AS_S = 1e-6  # what plans take for the exposure of bias frames: no light, no division
SAME_S = 1e-9  # sums of times are rounded: 3 x 0.2 s end after 0.6 s


@dataclass(frozen=True)
class DwellPlan:
    """One dwell of a scene, with all defaults filled in.

    first : number of its first frame; frames : how many; start_s : of the first, after the epoch
    step_s : between starts, None where each frame follows the one before
    times_s : integration times that the frames take in turn
    slew_s : start and end of the slew to it, None where there is none
    """

    index: int
    dwell: Dwell | None
    pointing: Pointing
    first: int
    frames: int
    start_s: float
    step_s: float | None
    times_s: tuple[float, ...]
    slew_s: tuple[float, float] | None = None

    @property
    def slew(self) -> Slew | None:
        return None if self.dwell is None else self.dwell.slew

    @property
    def end_s(self) -> float:
        """End of its last exposure, after the epoch."""
        last = np.array([self.frames - 1])
        return float(self.starts_s(last)[0] + self.integrations_s(last)[0])

    def starts_s(self, k: NDArray[np.int64]) -> Array:
        """Starts (n,) of its frames k (n,), counted from 0, after the epoch."""
        if self.step_s is not None:
            return np.asarray(self.start_s + k * self.step_s)
        many, rest = np.divmod(k, len(self.times_s))
        before = np.concatenate([[0.0], np.cumsum(self.times_s)])
        return np.asarray(self.start_s + many * before[-1] + before[rest])

    def integrations_s(self, k: NDArray[np.int64]) -> Array:
        """Integration times (n,) of its frames k (n,)."""
        return np.array(self.times_s)[k % len(self.times_s)]


def dwell_plans(scene: Scene) -> tuple[DwellPlan, ...]:
    """The scene's dwells in order; one where it names none. BadInput where they overlap."""
    exposure = scene.exposure
    if scene.dwells is None:
        return (
            DwellPlan(
                0,
                None,
                scene.pointing,
                0,
                exposure.frames,
                0.0,
                exposure.step_s,
                (exposure.integration_s,),
            ),
        )
    return _plans_of(scene.dwells, exposure, scene.pointing, last_row_late_s(scene))


@lru_cache(maxsize=16)  # they are asked for over and over, for single frames too
def _plans_of(
    dwells: tuple[Dwell, ...], exposure: Exposure, pointing: Pointing, late_s: float
) -> tuple[DwellPlan, ...]:
    """The same of named dwells; late_s : of a scene's last row."""
    out: list[DwellPlan] = []
    first, end = 0, 0.0
    for i, dwell in enumerate(dwells):
        times, step = _times_s(exposure, i, dwell)
        start, slew = _begin_s(i, dwell, end, late_s)
        held, frames = dwell.pointing or pointing, dwell.frames or exposure.frames
        out.append(DwellPlan(i, dwell, held, first, frames, start, step, times, slew))
        first, end = first + frames, out[-1].end_s
    if first > MOST_FRAMES:
        raise BadInput("dwells", f"{first} frames", f"at most {MOST_FRAMES} frames in all")
    return tuple(out)


def last_row_late_s(scene: Scene) -> float:
    """How much longer than the first row the last one is exposed: 0 but for rolling shutters."""
    d = scene.sensor.detector
    readout = None if d is None else d.readout
    if not isinstance(readout, RollingShutter):
        return 0.0
    return readout.line_s * (scene.sensor.shape[0] - 1)


def _times_s(exposure: Exposure, i: int, dwell: Dwell) -> tuple[tuple[float, ...], float | None]:
    """Integration times of dwell `i`, and the time between its frames' starts as in DwellPlan."""
    own = dwell.integration_s
    times = exposure.integration_s if own is None else own
    times = times if isinstance(times, tuple) else (times,)
    step = dwell.cadence_s or exposure.cadence_s
    if step is None and len(times) == 1:
        step = times[0]
    if step is not None and step < max(times):
        raise BadInput(
            f"dwells.{i}.integration_s",
            max(times),
            f"at most the cadence, {step:g} s, or a longer cadence_s",
        )
    return times, step


def _begin_s(
    i: int, dwell: Dwell, end: float, late_s: float
) -> tuple[float, tuple[float, float] | None]:
    """When the first frame of dwell `i` starts, and its slew.

    end : of the dwell before it; late_s : after that its last row is exposed, and a slew starts
    """
    if dwell.slew is not None and i == 0:
        raise BadInput("dwells.0.slew", "a slew", "a slew only after another dwell")
    slew = None
    if dwell.slew is not None:
        slew = (end + late_s, end + late_s + dwell.slew.duration_s)
    if dwell.start_s is None:
        return (end if slew is None else slew[1]) + dwell.wait_s, slew
    if dwell.start_s < end - SAME_S:
        raise BadInput(
            f"dwells.{i}.start_s",
            dwell.start_s,
            f"at least {end:g} s, when the dwell before it ends",
        )
    return dwell.start_s, slew


def frame_count(scene: Scene) -> int:
    """How many frames a scene has."""
    if scene.dwells is None:
        return scene.exposure.frames
    return sum(d.frames or scene.exposure.frames for d in scene.dwells)


def end_s(scene: Scene) -> float:
    """End of the last exposure, seconds after the epoch."""
    return dwell_plans(scene)[-1].end_s


def dwell_of(plans: tuple[DwellPlan, ...], frames: NDArray[np.int64]) -> NDArray[np.int64]:
    """Which dwell (n,) each frame (n,) belongs to."""
    firsts = np.array([p.first for p in plans])
    return np.searchsorted(firsts, frames, side="right") - 1


def frame_times(scene: Scene, frames: NDArray[np.int64]) -> tuple[Array, Array]:
    """Starts after the epoch and integration times (n,) each [s] of frames (n,) of a scene."""
    plans = dwell_plans(scene)
    start, time = np.empty(len(frames)), np.empty(len(frames))
    which = dwell_of(plans, frames)
    for i in np.unique(which):
        mine = which == i
        k = frames[mine] - plans[i].first
        start[mine], time[mine] = plans[i].starts_s(k), plans[i].integrations_s(k)
    return start, time


def integration_s(scene: Scene, frame: int) -> float:
    """Integration time of one frame [s]."""
    if scene.dwells is None:
        return scene.exposure.integration_s
    return float(frame_times(scene, np.array([frame]))[1][0])


def integration_range_s(scene: Scene) -> tuple[float, float]:
    """Shortest and longest integration time of a scene's frames [s], for planning.

    Bias frames (0 s) hold no light that could be drawn wrong and do not count; a scene of them
    alone is planned for BIAS_PLANNED_AS_S.
    """
    times = [t for p in dwell_plans(scene) for t in p.times_s[: p.frames]]
    exposed = [t for t in times if t > 0.0] or [BIAS_PLANNED_AS_S]
    return min(exposed), max(exposed)


def longest_s(scene: Scene) -> float:
    """Longest integration time of a scene's frames [s]; 0 for bias frames alone."""
    return max(max(p.times_s[: p.frames]) for p in dwell_plans(scene))


def simpson(moments: int, nodes: int) -> tuple[dict[int, float], float]:
    """Weights of some of the nodes of an exposure, and their sum: of its middle alone, or those of
    Simpson's rule over 3, 5, 9 ... moments."""
    if moments == 1:
        return {nodes // 2: 1.0}, 1.0
    intervals = moments - 1
    weights = [1.0, *(intervals // 2 - 1) * [4.0, 2.0], 4.0, 1.0]
    places = [k * (nodes - 1) // intervals for k in range(moments)]
    return dict(zip(places, weights, strict=True)), 3.0 * intervals
