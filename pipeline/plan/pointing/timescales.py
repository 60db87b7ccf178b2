"""How closely an exposure is looked at, so that nothing that a scene names passes between looks."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Array, Geometry
from pipeline.physics.constants import ARCSEC_RAD, SPEED_OF_LIGHT_M_S
from pipeline.physics.positions.times import parse_utc
from pipeline.plan.bodies.bodies import flicker_share
from pipeline.plan.bodies.changes import (
    CLOSE,
    LOOKS,
    LOOKS_A_TURN,
    MOST_LOOKS,
    apart_s,
    has_means,
    is_changing,
    looks_asked,
    most_looks,
)
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

FEWEST = 8  # intervals between looks
STILL_PX = 1e-4  # what is left of an oscillation that has died away
STEEPEST_PER_PX = 2.0  # how fast a pixel's share of a source falls, of the sharpest images
SLACK_S = 0.1  # by which a target's light may leave earlier or later than at the nodes known


def looks(scene: Scene, g: Geometry, near: NDArray[np.bool_]) -> NDArray[np.int64]:
    """At how many moments (F,) each frame's exposure is looked at: 9, 17, 33 and on to 1025.

    Often enough for the rows of tables (attitudes, light curves) that fall into it, for settling
    after a slew, and for bodies that spin. near : (T, F) targets that are over or beside the frame
    """
    of_bodies = asked_of_bodies(scene, g, near).max(axis=0, initial=0.0)
    asked = np.maximum(asked_of_pointing(scene, g), of_bodies)
    doublings = np.ceil(np.log2(np.maximum(asked, FEWEST) / FEWEST))
    return np.minimum(FEWEST * 2 ** doublings.astype(np.int64), MOST_LOOKS) + 1


def changing(scene: Scene) -> NDArray[np.bool_]:
    """Targets (T,) that a table or a turn of theirs changes: which `looks` has to look at."""
    epoch = parse_utc(scene.epoch)
    return np.array([is_changing(t.body, epoch) for t in scene.targets], np.bool_)


def light_off(scene: Scene, g: Geometry, near: NDArray[np.bool_]) -> float:
    """How far the light between the nodes may be off, as a share of a target's in its exposure.

    Of all targets that are `near` (T, F), as `flicker_shares` has it. Where the nodes hold means,
    the whole is right to CLOSE of `flux_fraction`, and light stands wrongly by a step between nodes
    at most: a pixel gains or loses twice the step of it. 1 where light changes too fast to be
    looked at.
    """
    asked = asked_of_bodies(scene, g, near)
    bodies = [t.body for t in scene.targets]
    if any((row > most_looks(body)).any() for body, row in zip(bodies, asked, strict=True)):
        return 1.0
    means = np.array([has_means(body, row) for body, row in zip(bodies, asked, strict=True)])
    if last_row_late_s(scene) or not means.any():  # exposure and reading out may differ in it
        return flicker_share(g, near)
    plain = flicker_share(g, near & ~means)
    steps_px = np.hypot(np.diff(g.target_x_px), np.diff(g.target_y_px)).max(axis=-1)
    moved = min(1.0, STEEPEST_PER_PX * float(steps_px[means].max()))
    return max(plain, CLOSE * scene.accuracy.flux_fraction + moved * flicker_share(g, means))


def light_warnings(scene: Scene, g: Geometry, near: NDArray[np.bool_]) -> list[str]:
    """That light between the nodes is off by more than `accuracy.flux_fraction` asks for; of what
    changes too fast to be looked at `hurried_remarks` speaks."""
    off, asked = light_off(scene, g, near), scene.accuracy.flux_fraction
    if not asked < off < 1.0:
        return []
    return [
        f"targets: light that changes in an exposure is drawn in steps, {g.nodes} nodes of the "
        f"frames looked at: a pixel may be off by up to {off:.2g} of a target's light in the "
        f"exposure (asked: {asked:g}, accuracy.flux_fraction)"
    ]


def hurried_remarks(scene: Scene, g: Geometry, near: NDArray[np.bool_]) -> list[str]:
    """What is said where tables or turns are too fast for as many looks as there are."""
    most = np.array([*(most_looks(t.body) for t in scene.targets), MOST_LOOKS])[:, None]
    asked = np.vstack([asked_of_bodies(scene, g, near), asked_of_pointing(scene, g)])
    over = asked / most
    row, worst = np.unravel_index(int(np.argmax(over)), over.shape)
    if over[row, worst] <= 1.0:
        return []
    exposed_s = float(frame_times(scene, g.frame)[1][worst])
    return [
        f"exposure.integration_s: rows of a table, turns or highlights come every "
        f"{exposed_s * LOOKS / asked[row, worst]:.2g} s in an exposure of {exposed_s:g} s (frame "
        f"{g.frame[worst]}), which is looked at every {exposed_s / float(most[row, 0]):.2g} s: a "
        "flash or a jolt shorter than that may be missed, and the mean of faster turns be off"
    ]


def asked_of_pointing(scene: Scene, g: Geometry) -> Array:
    """How many times (F,) each exposure should be looked at for the sake of its pointing."""
    start, time = g.offset_s[:, 0], frame_times(scene, g.frame)[1]
    plans = dwell_plans(scene)
    which, shortest = dwell_of(plans, g.frame), np.full(len(g.frame), np.inf)
    for i in np.unique(which):
        mine = which == i
        shortest[mine] = _of_pointing(scene, plans[i], start[mine], (start + time)[mine])
    return np.asarray(LOOKS * time / shortest)


def asked_of_bodies(scene: Scene, g: Geometry, near: NDArray[np.bool_]) -> Array:
    """The same for the light of each target (T, F), until its last row's end; 0 of those that are
    not `near` (T, F)."""
    start, time = g.offset_s[:, 0], frame_times(scene, g.frame)[1]
    late_s, epoch = last_row_late_s(scene), parse_utc(scene.epoch)
    out = np.zeros((len(scene.targets), len(start)))
    for t in np.flatnonzero(near.any(axis=-1)):
        body = scene.targets[t].body
        if not is_changing(body, epoch):
            continue
        away_s = g.target_range_m[t] / SPEED_OF_LIGHT_M_S
        first = start - np.nanmax(away_s, axis=-1) - SLACK_S
        last = start + time + late_s - np.nanmin(away_s, axis=-1) + SLACK_S
        out[t] = near[t] * looks_asked(body, epoch, first, last, np.maximum(time, late_s))
    return out


def _of_pointing(scene: Scene, plan: DwellPlan, start_s: Array, end_s: Array) -> Array:
    """Shortest time (F,) in which the pointing of a dwell may change in some exposures [s]."""
    out = np.full(len(start_s), np.inf)
    if isinstance(plan.pointing, TablePointing):
        out = apart_s(rows_s(scene, plan, plan.pointing), None, start_s, end_s)
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
