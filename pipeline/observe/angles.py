"""Rates, azimuths and angles to Sun and Moon of all targets at the middles of some exposures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Array, Geometry
from pipeline.physics.constants import ARCSEC_RAD, DEG_RAD
from pipeline.physics.positions.focal_plane import corner_radius
from pipeline.physics.vectors import horizontal, position_angle, separation, unit
from pipeline.plan.bodies.paths import batches
from pipeline.plan.bodies.sights import Moments, sights
from pipeline.plan.pointing.geometry import aimed, moments_at
from pipeline.plan.pointing.lamps import Lamp, apparent_bodies, sun_and_moon
from pipeline.plan.pointing.site import axes_of
from pipeline.plan.resolved import ResolvedScene
from pipeline.plan.timing import dwell_of, dwell_plans
from pipeline.spec.pointing.observer import GroundObserver

# Of differences: the rate of a direction that turns by t in two half steps errs by t^2 / 12 of it.
HALF_STEP_S, LEAST_HALF_STEP_S, SHORTER = 0.05, 1e-7, 32.0
MOST_TURNED = 0.003  # rad: 7.5e-7 of the rate; a low orbit turns by half of it


@dataclass(frozen=True)
class Angles:
    """Of T targets in F exposures, at their middles.

    columns : (F, T) by their names in the table; direction, velocity : (F, T, 3) apparent, before
        refraction, and its change [1/s]
    lamps : Sun and Moon as the frames (F,) have them; turned : as a camera would that is pointed
        at each target (F, T)
    """

    columns: dict[str, Array]
    direction: Array
    velocity: Array
    lamps: tuple[Lamp, ...]
    turned: tuple[Lamp, ...]


def angles_of(plan: ResolvedScene, g: Geometry) -> Angles:
    """Angles of all targets in the exposures of `g`."""
    scene, middle_s = plan.scene, g.offset_s[:, g.middle]
    at, attitude = aimed(scene, middle_s, plan.dut1_s, dwell_of(dwell_plans(scene), g.frame))
    u, velocity, range_rate = _moving(plan, middle_s)
    azimuth, elevation = _horizontal(plan, at, np.swapaxes(g.target_direction, 0, 1))
    off = [separation(u, seen[:, None]) for seen in apparent_bodies(at)]
    lamps, corner = sun_and_moon(scene, at, attitude), corner_radius(plan.camera)
    columns = {
        "azimuth_deg": azimuth / DEG_RAD,
        "elevation_deg": elevation / DEG_RAD,
        "range_rate_m_s": range_rate,
        "rate_arcsec_s": np.sqrt(np.sum(velocity**2, axis=-1)) / ARCSEC_RAD,
        "position_angle_deg": position_angle(u, velocity) / DEG_RAD,
        "solar_elongation_deg": off[0] / DEG_RAD,
        "moon_separation_deg": off[1] / DEG_RAD,
    }
    turned = tuple(_about(lamp, angle, corner) for lamp, angle in zip(lamps, off, strict=True))
    return Angles(columns, u, velocity, lamps, turned)


def _about(lamp: Lamp, off_axis: Array, corner_rad: float) -> Lamp:
    radius, hidden, up = (v[:, None] for v in (lamp.radius, lamp.hidden, lamp.elevation))
    return Lamp(off_axis, np.maximum(off_axis - corner_rad, 0.0), radius, hidden, up)


def _moving(plan: ResolvedScene, middle_s: Array) -> tuple[Array, Array, Array]:
    """Apparent directions, their change [1/s] (F, T, 3) and range rates [m/s] (F, T) of targets.

    Central differences, over less time for targets that turn by more than MOST_TURNED within it.
    """
    count, frames = len(plan.scene.targets), len(middle_s)
    u, velocity = np.empty((2, frames, count, 3))
    range_rate = np.empty((frames, count))
    which, half_s = np.arange(count), HALF_STEP_S
    while len(which):
        before, after, u_of, speed_of, rate_of = _differences(plan, middle_s, which, half_s)
        u[:, which], velocity[:, which], range_rate[:, which] = u_of, speed_of, rate_of
        turned = separation(before, after).max(axis=0, initial=0.0)
        which, half_s = which[turned > MOST_TURNED], half_s / SHORTER
        if half_s < LEAST_HALF_STEP_S:
            break
    return u, velocity, range_rate


def _differences(
    plan: ResolvedScene, middle_s: Array, which: NDArray[np.int64], half_s: float
) -> tuple[Array, Array, Array, Array, Array]:
    """Of some targets (W): directions before and after, halfway, their change, the range's."""
    around = middle_s[:, None] + [-half_s, half_s]
    at = moments_at(plan.scene, plan.dut1_s, around.ravel())
    u, range_m = np.empty((len(which), around.size, 3)), np.empty((len(which), around.size))
    for some in batches(len(which), around.size):
        seen, _ = sights(plan.scene, which[some].tolist(), at)
        u[some], range_m[some] = seen.direction_proper, seen.range_m
    before, after = np.swapaxes(u[:, ::2], 0, 1), np.swapaxes(u[:, 1::2], 0, 1)
    step = (around[:, 1] - around[:, 0])[:, None]  # as rounded
    range_rate = (range_m[:, 1::2] - range_m[:, ::2]).T / step
    return before, after, unit(before + after), (after - before) / step[..., None], range_rate


def _horizontal(plan: ResolvedScene, at: Moments, observed: Array) -> tuple[Array, Array]:
    """Azimuth and elevation (F, T) of observed directions (F, T, 3); NaN in space."""
    o = plan.scene.observer
    if isinstance(o, GroundObserver):
        return horizontal(observed, axes_of(o, at.times)[:, None])
    nowhere = np.full(observed.shape[:2], np.nan)
    return nowhere, nowhere
