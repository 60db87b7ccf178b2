"""Attitudes of a scene's pointing at any moments: every mode and dwell, slews between them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Array
from pipeline.errors import BadInput
from pipeline.physics.constants import ARCSEC_RAD, DEG_RAD
from pipeline.physics.motion.attitude_table import (
    AttitudeTable,
    attitudes_at,
    conjugate,
    product,
)
from pipeline.physics.motion.disturbance import settling, slew_share, slewed, turned
from pipeline.physics.motion.pointing import (
    attitudes_drift,
    attitudes_local,
    attitudes_swept,
    boresight_frame,
    proper_attitude,
)
from pipeline.physics.positions.apparent import TargetSight, proper_to_astrometric, star_proper
from pipeline.physics.positions.times import Instants, elapsed_s, parse_utc
from pipeline.physics.vectors import from_angles, unit
from pipeline.plan.pointing.site import axes_of
from pipeline.plan.timing import DwellPlan, dwell_plans
from pipeline.spec.pointing.observer import FixedObserver, GroundObserver
from pipeline.spec.pointing.pointing import (
    LocalPointing,
    RatePointing,
    SiderealPointing,
    TablePointing,
    TargetPointing,
)
from pipeline.spec.scene import Scene

NORM_TOLERANCE = 1e-3  # of a table's quaternions; rounding to 4 digits is mended
COVER_S = 1e-6  # how far a table may end before the last exposure does


@dataclass(frozen=True)
class Vantage:
    """What attitudes follow from at n moments.

    offset_s : (n,) after the epoch; times : the same in three scales
    position_m, velocity_m_s, sun_m : (n, 3) barycentric, of the observer and the Sun
    place_m, speed_m_s : (n, 3) geocentric, of the observer; sights : of followed targets
    """

    offset_s: Array
    times: Instants
    position_m: Array
    velocity_m_s: Array
    sun_m: Array
    place_m: Array
    speed_m_s: Array
    sights: Mapping[int, TargetSight]

    def taken(self, k: NDArray[np.int64]) -> Vantage:
        """Some of the moments."""
        times = Instants(*(getattr(self.times, n)[k] for n in Instants.__dataclass_fields__))
        sights = {
            i: replace(s, direction_proper=s.direction_proper[k]) for i, s in self.sights.items()
        }
        return Vantage(
            self.offset_s[k],
            times,
            self.position_m[k],
            self.velocity_m_s[k],
            self.sun_m[k],
            self.place_m[k],
            self.speed_m_s[k],
            sights,
        )


def attitudes(scene: Scene, which: NDArray[np.int64], m: Vantage) -> Array:
    """Proper attitudes (n, 3, 3) at moments (n,) of dwells (n,), without random motion.

    Stars and boresight share one set of effects. Raises BadInput for what a scene cannot point at.
    """
    plans = dwell_plans(scene)
    if scene.dwells is None:
        return _moved(plans[0], _attitudes_of(scene, plans[0], m), m.offset_s)
    out = np.empty((len(which), 3, 3))
    for i in np.unique(which):
        mine = np.flatnonzero(which == i)
        part, plan = m.taken(mine), plans[i]
        made = _moved(plan, _attitudes_of(scene, plan, part), part.offset_s)
        if plan.slew_s is not None and (part.offset_s < plan.slew_s[1]).any():
            made = _slewed(scene, plans[i - 1], plan, part, made)
        out[mine] = made
    return out


def _slewed(scene: Scene, before: DwellPlan, plan: DwellPlan, m: Vantage, arrived: Array) -> Array:
    """Attitudes of which some are still on the way from the dwell before."""
    assert plan.slew is not None
    assert plan.slew_s is not None
    turning = np.flatnonzero(m.offset_s < plan.slew_s[1])
    part = m.taken(turning)
    start = _moved(before, _attitudes_of(scene, before, part), part.offset_s)
    share = slew_share(part.offset_s - plan.slew_s[0], plan.slew.duration_s, plan.slew.profile)
    out = arrived.copy()
    out[turning] = slewed(start, arrived[turning], share)
    return out


def _moved(plan: DwellPlan, held: Array, offset_s: Array) -> Array:
    """Attitudes with the dwell's drift and settling."""
    drift = None if plan.pointing.attitude is None else plan.pointing.attitude.drift
    settle = None if plan.dwell is None else plan.dwell.settle
    if drift is None and settle is None:
        return held
    x, y, roll = np.zeros((3, len(offset_s)))
    if drift is not None:
        t = (offset_s - plan.start_s) * ARCSEC_RAD
        x, y, roll = drift.x_arcsec_s * t, drift.y_arcsec_s * t, drift.roll_arcsec_s * t
    if settle is not None:
        begin = plan.start_s if plan.slew_s is None else plan.slew_s[1]
        size = settle.amplitude_arcsec * ARCSEC_RAD
        way = settling(offset_s - begin, size, settle.frequency_hz, settle.damping)
        angle = settle.direction_deg * DEG_RAD
        x, y = x + way * math.cos(angle), y + way * math.sin(angle)
    return turned(held, x, y, roll)


def _attitudes_of(scene: Scene, plan: DwellPlan, m: Vantage) -> Array:
    """Proper attitudes (n, 3, 3) that a dwell's pointing asks for."""
    p, effects = plan.pointing, scene.star_effects
    if isinstance(p, LocalPointing):
        return _local(scene, plan, p, m)
    if isinstance(p, TablePointing):
        frames = _from_table(scene, plan, p, m.offset_s)
        if p.frame == "gcrs":
            return frames
    elif isinstance(p, TargetPointing):
        names = [t.name for t in scene.targets]
        proper = m.sights[names.index(p.target)].direction_proper
        observer = m.position_m, m.velocity_m_s, m.sun_m
        astrometric = proper_to_astrometric(np.ascontiguousarray(proper), observer, **effects)
        return proper_attitude(boresight_frame(astrometric, p.roll_deg * DEG_RAD), proper)
    else:
        frames = _on_the_sky(p, m.offset_s - plan.start_s if plan.start_s else m.offset_s)
    proper = star_proper(frames[:, 2], m.position_m, m.velocity_m_s, m.sun_m, **effects)
    return proper_attitude(frames, proper)


def _on_the_sky(p: RatePointing | SiderealPointing, since_s: Array) -> Array:
    """Astrometric attitudes (n, 3, 3) of what is held or moves among the stars."""
    roll = p.roll_deg * DEG_RAD
    start = from_angles(
        np.array(p.boresight_ra_deg * DEG_RAD), np.array(p.boresight_dec_deg * DEG_RAD)
    )
    if isinstance(p, SiderealPointing):
        return np.broadcast_to(boresight_frame(start, roll), (len(since_s), 3, 3))
    rates = (p.rate_ra_arcsec_s * ARCSEC_RAD, p.rate_dec_arcsec_s * ARCSEC_RAD)
    more = (p.acceleration_ra_arcsec_s2 * ARCSEC_RAD, p.acceleration_dec_arcsec_s2 * ARCSEC_RAD)
    if not any(more):
        made = attitudes_drift(start, roll, *rates, since_s)
    else:
        made = attitudes_swept(start, roll, rates, more, since_s)
    if not p.roll_rate_deg_s:
        return made
    zero = np.zeros_like(since_s)
    return turned(made, zero, zero, p.roll_rate_deg_s * DEG_RAD * since_s)


def swept_rad(p: RatePointing, since_s: float, time_s: float) -> float:
    """Most that a rate pointing sweeps in an exposure that ends `since_s` after its start [rad]."""
    rate = math.hypot(p.rate_ra_arcsec_s, p.rate_dec_arcsec_s)
    more = math.hypot(p.acceleration_ra_arcsec_s2, p.acceleration_dec_arcsec_s2)
    return (rate + more * since_s) * ARCSEC_RAD * time_s


def _local(scene: Scene, plan: DwellPlan, p: LocalPointing, m: Vantage) -> Array:
    """Attitudes held in the horizon of a site, or in the local frame of an orbit."""
    o = scene.observer
    if isinstance(o, FixedObserver):
        allowed = "a ground site or an orbit as observer for mode local"
        raise BadInput(pointing_field(plan, "mode"), "local", allowed)
    if isinstance(o, GroundObserver):
        axes = axes_of(o, m.times)
    else:
        up = unit(m.place_m)
        along = m.speed_m_s - np.sum(m.speed_m_s * up, axis=-1, keepdims=True) * up
        if not np.sum(along**2, axis=-1).min() > 0.0:
            allowed = "an orbit that does not move straight up"
            raise BadInput(pointing_field(plan, "mode"), "local", allowed)
        forward = unit(along)
        axes = np.stack([forward, np.cross(forward, up), up], axis=1)
    angles = (p.azimuth_deg * DEG_RAD, p.elevation_deg * DEG_RAD, p.roll_deg * DEG_RAD)
    return attitudes_local(axes, *angles)


def _from_table(scene: Scene, plan: DwellPlan, p: TablePointing, offset_s: Array) -> Array:
    table = quaternion_table(p, pointing_field(plan, "rows"))
    at = offset_s + _epoch_shift_s(p, scene.epoch, plan)
    first, last = float(table.time_s[0]), float(table.time_s[-1])
    if at.min() < first - COVER_S or at.max() > last + COVER_S:
        shift = _epoch_shift_s(p, scene.epoch, plan)
        raise BadInput(
            pointing_field(plan, "rows" if p.rows is not None else "path"),
            f"rows from {first - shift:.6g} to {last - shift:.6g} s after the scene's epoch",
            f"a table that covers {at.min() - shift:.6g} to {at.max() - shift:.6g} s",
        )
    return attitudes_at(table, np.clip(at, first, last))


def rows_s(scene: Scene, plan: DwellPlan, p: TablePointing) -> Array:
    """Times of a table's rows (n,), after the scene's epoch [s]."""
    table = quaternion_table(p, pointing_field(plan, "rows"))
    return np.asarray(table.time_s - _epoch_shift_s(p, scene.epoch, plan))


@lru_cache(maxsize=16)
def quaternion_table(p: TablePointing, field: str) -> AttitudeTable:
    """The rows of a scene's table as unit quaternions camera to sky, scalar last.

    BadInput for numbers that are not finite, times that do not increase, and quaternions whose
    norm is not one.
    """
    if p.rows is None:
        raise BadInput(field.replace("rows", "path"), p.path, "a table that was read")
    rows = np.array(p.rows)
    check_rows(rows, field)
    q = unit(rows[:, 1:])
    if p.scalar == "first":
        q = q[:, [1, 2, 3, 0]]
    if p.rotation == "sky_to_camera":
        q = conjugate(q)
    if p.mounting is not None:
        turn = np.array([p.mounting])
        size = float(np.sqrt(np.sum(turn**2)))
        if abs(size - 1.0) > NORM_TOLERANCE:
            name = field.replace("rows", "mounting")
            raise BadInput(name, p.mounting, f"a unit quaternion; its norm is {size:.6g}")
        turn = unit(turn)
        q = product(q, turn[:, [1, 2, 3, 0]] if p.scalar == "first" else turn)
    return AttitudeTable(rows[:, 0], q, p.interpolation)


def check_rows(rows: Array, field: str) -> None:
    """Refuse rows (n, 5) of time and quaternion that cannot be used, naming the first such row."""
    bad = ~np.isfinite(rows).all(axis=-1)
    if bad.any():
        k = int(np.argmax(bad))
        raise BadInput(field, f"row {k + 1}: {rows[k].tolist()}", "finite numbers in every row")
    late = np.diff(rows[:, 0]) <= 0.0
    if late.any():
        k = int(np.argmax(late)) + 1
        value = f"row {k + 1}: time {rows[k, 0]:.9g} s after {rows[k - 1, 0]:.9g} s"
        raise BadInput(field, value, "times that increase from row to row")
    norm = np.sqrt(np.sum(rows[:, 1:] ** 2, axis=-1))
    off = np.abs(norm - 1.0) > NORM_TOLERANCE
    if off.any():
        k = int(np.argmax(off))
        allowed = f"unit quaternions (norm 1 within {NORM_TOLERANCE:g})"
        raise BadInput(field, f"row {k + 1}: norm {norm[k]:.6g}", allowed)


def _epoch_shift_s(p: TablePointing, scene_epoch: str, plan: DwellPlan) -> float:
    """Seconds from the table's epoch to the scene's."""
    if p.epoch is None:
        return 0.0
    zero = parse_utc(p.epoch, pointing_field(plan, "epoch"))
    return float(elapsed_s(zero, *parse_utc(scene_epoch)))


def pointing_field(plan: DwellPlan, key: str) -> str:
    """Dotted name of a key of a dwell's pointing, for messages."""
    own = plan.dwell is not None and plan.dwell.pointing is not None
    return f"dwells.{plan.index}.pointing.{key}" if own else f"pointing.{key}"
