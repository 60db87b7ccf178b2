"""How closely an exposure is looked at, so that nothing that a scene names passes between looks."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Array
from pipeline.physics.positions.times import parse_utc
from pipeline.plan.bodies.attitudes import since_s
from pipeline.plan.pointing.pointing import rows_s
from pipeline.plan.timing import DwellPlan, dwell_of, dwell_plans, frame_times
from pipeline.spec.pointing.pointing import TablePointing
from pipeline.spec.scene import Scene
from pipeline.spec.targets.body import (
    Attitude,
    Body,
    CompositeBody,
    LightCurveBody,
    SphereBody,
    SpinAttitude,
    TableAttitude,
)
from pipeline.spec.targets.mesh import MeshBody, SpinJoint

LOOKS = 4.0  # at least, from a row of a table to the next
LOOKS_A_TURN = 32.0  # in a period or a turn: a box shows four faces in one
FEWEST, MOST = 8, 1024  # intervals between looks
LIGHT_S = 20.0  # that the light of a target is on its way at most


def looks(scene: Scene, frames: NDArray[np.int64]) -> NDArray[np.int64]:
    """At how many moments (F,) each frame's exposure is looked at: 9, 17, 33 and on to 1025.

    Often enough for the rows of tables (attitudes, light curves) that fall into it, for settling
    after a slew, and for bodies that spin.
    """
    doublings = np.ceil(np.log2(np.maximum(_asked(scene, frames), FEWEST) / FEWEST))
    return np.minimum(FEWEST * 2 ** doublings.astype(np.int64), MOST) + 1


def hurried_remarks(scene: Scene, frames: NDArray[np.int64]) -> list[str]:
    """What is said where tables or turns are too fast for as many looks as there are."""
    asked = _asked(scene, frames)
    worst = int(np.argmax(asked))
    if asked[worst] <= MOST:
        return []
    exposed_s = float(frame_times(scene, frames)[1][worst])
    return [
        f"exposure.integration_s: rows of a table, or turns, come every "
        f"{exposed_s * LOOKS / asked[worst]:.2g} s in an exposure of {exposed_s:g} s (frame "
        f"{frames[worst]}), which is looked at every {exposed_s / MOST:.2g} s: a flash or a jolt "
        "shorter than that may be missed, and the mean of faster turns be off"
    ]


def _asked(scene: Scene, frames: NDArray[np.int64]) -> Array:
    """How many times (F,) each exposure should be looked at."""
    start, time = frame_times(scene, frames)
    end, shortest = start + time, np.full(len(frames), np.inf)
    which = dwell_of(dwell_plans(scene), frames)
    for plan in dwell_plans(scene):
        mine = which == plan.index
        shortest[mine] = _of_pointing(scene, plan, start[mine], end[mine])
    for body in {id(t.body): t.body for t in scene.targets}.values():
        for times_s, period_s in _tables(body, parse_utc(scene.epoch)):
            own = _apart_s(times_s, period_s, start - LIGHT_S, end)
            shortest = np.minimum(shortest, own)
        turn = min(_turns_s(body), default=math.inf)
        shortest = np.minimum(shortest, turn * LOOKS / LOOKS_A_TURN)
    return np.asarray(LOOKS * time / shortest)


def _of_pointing(scene: Scene, plan: DwellPlan, start_s: Array, end_s: Array) -> Array:
    """Shortest time (F,) in which the pointing of a dwell turns its mind in some exposures [s]."""
    out = np.full(len(start_s), np.inf)
    if isinstance(plan.pointing, TablePointing):
        out = _apart_s(rows_s(scene, plan, plan.pointing), None, start_s, end_s)
    if plan.dwell is not None and plan.dwell.settle is not None:
        out = np.minimum(out, LOOKS / LOOKS_A_TURN / plan.dwell.settle.frequency_hz)
    return out


def _apart_s(times_s: Array, period_s: float | None, start_s: Array, end_s: Array) -> Array:
    """How far apart rows are (F,) that fall into some times, at least [s]; inf where none do."""
    apart = np.diff(times_s)
    if period_s is not None:
        return np.full(len(start_s), apart.min())
    first, last = (np.searchsorted(times_s, v) for v in (start_s, end_s))
    out = np.full(len(start_s), np.inf)
    for k in np.flatnonzero(last > first):
        out[k] = apart[max(first[k] - 1, 0) : last[k]].min(initial=np.inf)
    return out


def _tables(
    body: Body | MeshBody, epoch: tuple[float, float]
) -> Iterator[tuple[Array, float | None]]:
    """Times of a body's tables, after the scene's epoch [s], and the period of each."""
    if isinstance(body, LightCurveBody):
        yield np.array(body.times_s) - since_s(body.epoch, epoch, "body"), body.period_s
    for law in _laws(body):
        if isinstance(law, TableAttitude):
            yield np.array(law.times_s) - since_s(law.epoch, epoch, "body.attitude"), None


def _turns_s(body: Body | MeshBody) -> Iterator[float]:
    """How long each turn of what spins takes [s]."""
    laws: list[object] = list(_laws(body))
    if isinstance(body, MeshBody):
        laws += [part.joint for part in body.parts]
    for law in laws:
        if isinstance(law, SpinAttitude | SpinJoint) and law.rate_deg_s:
            yield 360.0 / abs(law.rate_deg_s)


def _laws(body: Body | MeshBody) -> Iterator[Attitude | None]:
    """The attitudes of a body and its parts."""
    if isinstance(body, LightCurveBody | SphereBody):
        return
    yield body.attitude
    if isinstance(body, CompositeBody):
        yield from (part.attitude for part in body.parts if not isinstance(part, SphereBody))
