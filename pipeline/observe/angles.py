"""Rates, azimuths and angles to Sun and Moon of all targets at the middles of some exposures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.arrays import Array, Geometry
from pipeline.physics.constants import SPEED_OF_LIGHT_M_S
from pipeline.physics.positions.apparent import aberrate, unaberrate
from pipeline.physics.positions.sky_angles import horizontal, motion
from pipeline.physics.vectors import separation, unit
from pipeline.plan.bodies.paths import batches
from pipeline.plan.bodies.sights import Moments, sights
from pipeline.plan.pointing.geometry import aimed, moments_at
from pipeline.plan.pointing.lamps import Lamp, bodies_m, sun_and_moon
from pipeline.plan.pointing.site import axes_of
from pipeline.plan.resolved import ResolvedScene
from pipeline.plan.timing import dwell_of, dwell_plans
from pipeline.spec.pointing.observer import GroundObserver
from pipeline.spec.scene import Scene

HALF_STEP_S = 0.05  # of differences: 3e-7 of the rate of a low orbit at the zenith


@dataclass(frozen=True)
class Angles:
    """Of T targets in F exposures, at their middles; (F, T) each, [rad], [rad/s], [m/s].

    direction : (F, T, 3) apparent, before refraction; rate, position_angle : of its motion
    azimuth, elevation : as observed, through the air where the scene refracts; NaN in space
    sun, moon : as the frame has them (F,); elongation, from_moon : from the target to their middles
    """

    direction: Array
    rate: Array
    position_angle: Array
    range_rate: Array
    azimuth: Array
    elevation: Array
    elongation: Array
    from_moon: Array
    sun: Lamp
    moon: Lamp

    def seen_from(self, corner_rad: float) -> tuple[Lamp, Lamp]:
        """Sun and Moon (F, T) as a camera pointed at each target would have them."""
        return (
            _about(self.sun, self.elongation, corner_rad),
            _about(self.moon, self.from_moon, corner_rad),
        )


def _about(lamp: Lamp, angle: Array, corner_rad: float) -> Lamp:
    broad = {k: getattr(lamp, k)[:, None] + 0.0 * angle for k in ("radius", "hidden", "elevation")}
    return Lamp(off_axis=angle, off_frame=np.maximum(angle - corner_rad, 0.0), **broad)


def angles_of(plan: ResolvedScene, g: Geometry) -> Angles:
    """Angles of all targets in the exposures of `g`."""
    scene, middle_s = plan.scene, g.offset_s[:, g.middle]
    at, attitude = aimed(scene, middle_s, plan.dut1_s, dwell_of(dwell_plans(scene), g.frame))
    direction, rate, angle, range_rate = _moving(scene, plan.dut1_s, middle_s)
    azimuth, elevation = _horizontal(scene, at, np.swapaxes(g.target_direction, 0, 1))
    sun, moon = (unit(body_m) for body_m in bodies_m(at))
    moon = unaberrate(moon, at.earth.velocity_m_s / SPEED_OF_LIGHT_M_S)  # which moves along
    to_sun, to_moon = (
        separation(direction, aberrate(u, at.observer_m_s / SPEED_OF_LIGHT_M_S)[:, None])
        for u in (sun, moon)
    )
    lamps = sun_and_moon(scene, at, attitude)
    return Angles(direction, rate, angle, range_rate, azimuth, elevation, to_sun, to_moon, *lamps)


def _moving(scene: Scene, dut1_s: float, middle_s: Array) -> tuple[Array, Array, Array, Array]:
    """Apparent directions (F, T, 3), rate, position angle and range rate (F, T) of targets."""
    step = 2.0 * HALF_STEP_S
    around = middle_s[:, None] + [-HALF_STEP_S, HALF_STEP_S]
    at = moments_at(scene, dut1_s, around.ravel())
    shape = (len(scene.targets), len(middle_s), 2)
    u, range_m = np.empty((*shape, 3)), np.empty(shape)
    for which in batches(len(scene.targets), around.size):
        seen, _ = sights(scene, which, at)
        u[which] = seen.direction_proper.reshape(len(which), *shape[1:], 3)
        range_m[which] = seen.range_m.reshape(len(which), *shape[1:])
    u, range_m = np.swapaxes(u, 0, 1), np.swapaxes(range_m, 0, 1)
    return *motion(u[..., 0, :], u[..., 1, :], step), np.diff(range_m, axis=-1)[..., 0] / step


def _horizontal(scene: Scene, at: Moments, observed: Array) -> tuple[Array, Array]:
    """Azimuth and elevation (F, T) of observed directions (F, T, 3)."""
    o = scene.observer
    if not isinstance(o, GroundObserver):
        nowhere = np.full(observed.shape[:2], np.nan)
        return nowhere, nowhere
    return horizontal(observed, axes_of(o, at.times)[:, None])
