"""How closely an exposure is looked at, so that nothing that a scene names passes between looks."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Array, Geometry
from pipeline.physics.constants import ARCSEC_RAD, SPEED_OF_LIGHT_M_S
from pipeline.physics.positions.times import parse_utc
from pipeline.plan.bodies.attitudes import since_s
from pipeline.plan.pointing.pointing import rows_s
from pipeline.plan.timing import (
    DwellPlan,
    dwell_of,
    dwell_plans,
    frame_times,
    last_row_late_s,
)
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
STILL_PX = 1e-4  # what is left of an oscillation that has died away
SLACK_S = 0.1  # by which a target's light may leave earlier or later than at the nodes known


def looks(scene: Scene, g: Geometry, near: NDArray[np.bool_]) -> NDArray[np.int64]:
    """At how many moments (F,) each frame's exposure is looked at: 9, 17, 33 and on to 1025.

    Often enough for the rows of tables (attitudes, light curves) that fall into it, for settling
    after a slew, and for bodies that spin. near : (T, F) targets that are over or beside the frame
    """
    doublings = np.ceil(np.log2(np.maximum(_asked(scene, g, near), FEWEST) / FEWEST))
    return np.minimum(FEWEST * 2 ** doublings.astype(np.int64), MOST) + 1


def changing(scene: Scene) -> NDArray[np.bool_]:
    """Targets (T,) that a table or a turn of theirs changes: which `looks` has to look at."""
    epoch = parse_utc(scene.epoch)
    bodies = [t.body for t in scene.targets]
    return np.array([any(_tables(b, epoch)) or any(_turns_s(b)) for b in bodies], np.bool_)


def hurried_remarks(scene: Scene, g: Geometry, near: NDArray[np.bool_]) -> list[str]:
    """What is said where tables or turns are too fast for as many looks as there are."""
    asked = _asked(scene, g, near)
    worst = int(np.argmax(asked))
    if asked[worst] <= MOST:
        return []
    exposed_s = float(frame_times(scene, g.frame)[1][worst])
    return [
        f"exposure.integration_s: rows of a table, or turns, come every "
        f"{exposed_s * LOOKS / asked[worst]:.2g} s in an exposure of {exposed_s:g} s (frame "
        f"{g.frame[worst]}), which is looked at every {exposed_s / MOST:.2g} s: a flash or a jolt "
        "shorter than that may be missed, and the mean of faster turns be off"
    ]


def _asked(scene: Scene, g: Geometry, near: NDArray[np.bool_]) -> Array:
    """How many times (F,) each exposure should be looked at; at light, until its last row's end."""
    start, time = g.offset_s[:, 0], frame_times(scene, g.frame)[1]
    plans, late_s = dwell_plans(scene), last_row_late_s(scene)
    which, shortest = dwell_of(plans, g.frame), np.full(len(g.frame), np.inf)
    for i in np.unique(which):
        mine = which == i
        shortest[mine] = _of_pointing(scene, plans[i], start[mine], (start + time)[mine])
    out, epoch = LOOKS * time / shortest, parse_utc(scene.epoch)
    for t in np.flatnonzero(near.any(axis=-1)):
        body = scene.targets[t].body
        tables, turns_s = list(_tables(body, epoch)), list(_turns_s(body))
        if not (tables or turns_s):
            continue
        away_s = g.target_range_m[t] / SPEED_OF_LIGHT_M_S
        first = start - np.nanmax(away_s, axis=-1) - SLACK_S
        last = start + time + late_s - np.nanmin(away_s, axis=-1) + SLACK_S
        own = np.full(len(start), min(turns_s, default=math.inf) * LOOKS / LOOKS_A_TURN)
        for times_s, period_s in tables:
            own = np.minimum(own, _apart_s(times_s, period_s, first, last))
        out = np.maximum(out, near[t] * LOOKS * np.maximum(time, late_s) / own)
    return np.asarray(out)


def _of_pointing(scene: Scene, plan: DwellPlan, start_s: Array, end_s: Array) -> Array:
    """Shortest time (F,) in which the pointing of a dwell may change in some exposures [s]."""
    out = np.full(len(start_s), np.inf)
    if isinstance(plan.pointing, TablePointing):
        out = _apart_s(rows_s(scene, plan, plan.pointing), None, start_s, end_s)
    settle = None if plan.dwell is None else plan.dwell.settle
    if settle is not None:
        begin_s = plan.start_s if plan.slew_s is None else plan.slew_s[1]
        s = scene.sensor
        size_px = (
            settle.amplitude_arcsec * ARCSEC_RAD * s.focal_length_m / (s.pixel_pitch_um * 1e-6)
        )
        fall = 2.0 * math.pi * settle.frequency_hz * settle.damping
        left_px = size_px * np.exp(-fall * np.maximum(0.0, start_s - begin_s))
        own = LOOKS / LOOKS_A_TURN / settle.frequency_hz
        out = np.where(left_px > STILL_PX, np.minimum(out, own), out)
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
