"""Where Sun, Moon, Earth and planets stand in all exposures: as frames, horizon and limb see."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.physics.constants import (
    DEG_RAD,
    EARTH_EQUATORIAL_RADIUS_M,
    SPEED_OF_LIGHT_M_S,
    SUN_RADIUS_M,
)
from pipeline.physics.positions.apparent import aberrate, unaberrate
from pipeline.physics.positions.focal_plane import (
    Camera,
    corner_radius,
    deproject,
    project,
)
from pipeline.physics.positions.limb import limb_angle, pole_at, upright
from pipeline.physics.positions.planets import OFF_RAD, PLANETS, brightest_v_mag, planet_m
from pipeline.physics.positions.times import parse_utc
from pipeline.physics.targets.shadow import MOON_RADIUS_M, moon_m
from pipeline.physics.vectors import angular_radius, separation, unit
from pipeline.plan.bodies.sights import Moments
from pipeline.plan.pointing.air import air_of
from pipeline.plan.pointing.geometry import aimed, camera_of, check_view
from pipeline.plan.pointing.pointing import swept_rad
from pipeline.plan.pointing.turns import turning_frames
from pipeline.plan.timing import dwell_of, dwell_plans, frame_count, frame_times
from pipeline.spec.pointing.observer import GroundObserver
from pipeline.spec.pointing.pointing import RatePointing
from pipeline.spec.scene import Scene

Array = NDArray[np.float64]
Ticks = NDArray[np.int64]

TICKS = 65  # moments of an exposure that may be looked at
STEP_S = 300.0  # most between two moments looked at first: orbits turn by 20 degrees in it
STEP_RAD = 20.0 * DEG_RAD  # most that a rate turns by in it
FIRST, MOST_FIRST, MOST_MOMENTS = 256, 2049, 8192
REFRACTED_RAD = 0.57 * DEG_RAD  # by which the air lifts what stands at the horizon


@dataclass(frozen=True)
class Lamp:
    """A body that lights the sky at n moments; angles [rad], each (n,).

    off_axis : from the boresight to its middle; off_frame : from the nearest place of the frame to
    it, 0 inside; radius : of its disc; hidden : how far the whole disc is behind the Earth's limb
    or the horizon, below 0 where some of it is seen; elevation : of its middle without refraction
    """

    off_axis: Array
    off_frame: Array
    radius: Array
    hidden: Array
    elevation: Array


@dataclass(frozen=True)
class LampGeometry:
    """Sun, Moon, Earth and planets at n moments of the exposures, in order.

    tick : (n,) number of the moment: TICKS of each frame; earth : its disc, or all below a site's
    horizon; planets : by name, with V (n,) at full phase
    place_m, sun_m, moon_m : (n, 3) of the observer and of both bodies, from the Earth's centre
    boresight : (n, 3) before the air lifts it
    turn : (n - 1,) angle [rad] by which what is looked at turns from each moment to the next:
    camera, horizon and bodies together
    """

    tick: Ticks
    sun: Lamp
    moon: Lamp
    earth: Lamp
    planets: dict[str, tuple[Lamp, Array]]
    place_m: Array
    sun_m: Array
    moon_m: Array
    boresight: Array
    turn: Array

    def frame(self, k: int) -> int:
        """Frame of moment k."""
        return int(self.tick[k]) // TICKS


def look(
    scene: Scene, dut1_s: float, margin: Callable[[LampGeometry], Array]
) -> tuple[LampGeometry, bool]:
    """Sun and Moon in the exposures, at moments that are halved where something may be missed.

    margin : how far (n,) [rad] each moment is from what is looked for, at or below 0 where that is
    found. Two neighbours are enough where neither has found it and both are farther from it than
    everything turns between them (twice what an even turn needs). Also returns whether that holds
    everywhere; where not, it is at MOST_MOMENTS, or within neighbouring moments of an exposure.
    """
    ticks = _first(scene, dut1_s)
    while True:
        found = _look(scene, dut1_s, ticks)
        least = margin(found)
        nearer = np.minimum(least[:-1], least[1:])
        doubtful = (nearer > 0.0) & (nearer <= found.turn)
        split = doubtful & (np.diff(ticks) > 1)
        if not split.any() or len(ticks) >= MOST_MOMENTS:
            within = ticks[:-1] // TICKS == ticks[1:] // TICKS
            return found, not (split | (doubtful & within)).any()
        ticks = np.union1d(ticks, ((ticks[:-1] + ticks[1:]) // 2)[split])


def look_through(scene: Scene, dut1_s: float, frame: int) -> LampGeometry:
    """Sun and Moon at all TICKS moments of one exposure, at even steps."""
    return _look(scene, dut1_s, frame * TICKS + np.arange(TICKS))


def _first(scene: Scene, dut1_s: float) -> Ticks:
    """Moments looked at first: at even steps, where each dwell begins and ends, and wherever the
    camera turns far."""
    plans, frames = dwell_plans(scene), frame_count(scene)
    steps = max((plans[-1].end_s - plans[0].start_s) / STEP_S, min(2 * frames, FIRST))
    if any(p.pointing.mode == "table" for p in plans):  # may turn as it likes
        steps = 2 * frames
    for p in plans:
        if isinstance(p.pointing, RatePointing):
            span_s = p.end_s - p.start_s
            steps = max(steps, swept_rad(p.pointing, span_s, span_s) / STEP_RAD)
    even = np.linspace(0, frames * TICKS - 1, min(MOST_FIRST, 2 + math.ceil(steps)))
    ends = [(p.first * TICKS, (p.first + p.frames) * TICKS - 1) for p in plans]
    edges = np.array(ends).ravel()[:: math.ceil(2 * len(ends) / MOST_MOMENTS)]
    turns = np.empty(0, np.int64)
    if any(p.pointing.mode == "table" for p in plans):
        turns = turning_frames(scene, dut1_s) * TICKS + TICKS // 2
    return np.unique(np.concatenate([even.round().astype(np.int64), edges, turns]))


def _look(scene: Scene, dut1_s: float, ticks: Ticks) -> LampGeometry:
    frames = ticks // TICKS
    start, time = frame_times(scene, frames)
    moments = start + time * (ticks % TICKS) / (TICKS - 1)
    at, attitude = aimed(scene, moments, dut1_s, dwell_of(dwell_plans(scene), frames))
    if air_of(scene, at.times) is None:  # the air lifts what is near a horizon
        check_view(scene, at.observer_m, attitude[:, 2])
    camera, (sun, moon) = camera_of(scene), bodies_m(at)
    lamps = (*sun_and_moon(scene, at, attitude), _earth(scene, camera, attitude, at.observer_m))
    turned = [separation(v[:-1], v[1:]) for v in (*np.moveaxis(attitude, 1, 0), at.observer_m)]
    bodies = np.maximum(*(separation(v[:-1], v[1:]) for v in (sun, moon)))
    planets = {n: _planet(scene, camera, attitude, at, n, sun) for n in PLANETS}
    places = at.observer_m, sun + at.observer_m, moon + at.observer_m, attitude[:, 2]
    return LampGeometry(ticks, *lamps, planets, *places, np.max(turned, axis=0) + bodies)


def bodies_m(at: Moments) -> tuple[Array, Array]:
    """Vectors (n, 3) from the observer to Sun and Moon."""
    sun = at.earth.sun_from_earth_m - at.observer_m
    return sun, moon_m(at.times.tt1, at.times.tt2) - at.observer_m


def apparent_bodies(at: Moments) -> tuple[Array, Array]:
    """Directions (n, 3) in which the moving observer sees Sun and Moon.

    The Moon goes round the Sun with the Earth: where it stands is known in the Earth's frame, out
    of which it is taken first (as in `target_apparent`).
    """
    sun, moon = (unit(body_m) for body_m in bodies_m(at))
    moon = unaberrate(moon, at.earth.velocity_m_s / SPEED_OF_LIGHT_M_S)
    beta = at.observer_m_s / SPEED_OF_LIGHT_M_S
    return aberrate(sun, beta), aberrate(moon, beta)


def sun_and_moon(scene: Scene, at: Moments, attitude: Array) -> tuple[Lamp, Lamp]:
    """Both at moments (n,), as a camera of attitudes (n, 3, 3) sees them."""
    camera, (sun, moon) = camera_of(scene), bodies_m(at)
    moves = scene.star_effects["aberration"]
    to_sun, to_moon = apparent_bodies(at) if moves else (unit(sun), unit(moon))
    return (
        _lamp(scene, camera, attitude, at, sun, to_sun, SUN_RADIUS_M),
        _lamp(scene, camera, attitude, at, moon, to_moon, MOON_RADIUS_M),
    )


def _earth(scene: Scene, camera: Camera, attitude: Array, place_m: Array) -> Lamp:
    """The Earth's disc at geocentric places (n, 3), which move along with it: of a site all that is
    below its horizon, which comes into a frame by a corner."""
    seen = np.full(len(place_m), -np.pi)
    if isinstance(scene.observer, GroundObserver):
        down = -unit(upright(place_m))
        off_axis, radius = separation(attitude[:, 2], down), np.full(len(down), 0.5 * np.pi)
        x = np.array([-0.5, camera.columns - 0.5])
        x, y = np.tile(x, 2), np.repeat([-0.5, camera.rows - 0.5], 2)
        corners = np.stack([deproject(camera, axes, x, y) for axes in attitude])
        off_frame = separation(corners, down[:, None]).min(axis=-1)
        return Lamp(off_axis, off_frame, radius, seen, seen)
    down = unit(-place_m)
    off_axis = separation(attitude[:, 2], down)
    radius = angular_radius(EARTH_EQUATORIAL_RADIUS_M, place_m)  # holds the ellipsoid
    return Lamp(off_axis, _off_frame(camera, attitude, down, off_axis), radius, seen, seen)


def _lamp(
    scene: Scene,
    camera: Camera,
    attitude: Array,
    at: Moments,
    body_m: Array,
    towards: Array,
    radius_m: float,
) -> Lamp:
    """A body at vectors (n, 3) from the observer, who sees it in directions (n, 3)."""
    radius = angular_radius(radius_m, body_m)
    elevation = 0.5 * np.pi - separation(body_m, upright(at.observer_m))
    off_axis = separation(attitude[:, 2], towards)
    return Lamp(
        off_axis,
        _off_frame(camera, attitude, towards, off_axis),
        radius,
        hidden_rad(scene, at.observer_m, body_m, elevation) - radius,
        elevation,
    )


def _planet(
    scene: Scene, camera: Camera, attitude: Array, at: Moments, name: str, sun_m: Array
) -> tuple[Lamp, Array]:
    """A planet, a point that is known to OFF_RAD, and its V (n,) at full phase."""
    from_sun = planet_m(name, at.times.tt1, at.times.tt2)
    body = sun_m + from_sun
    towards, far = unit(body), [np.sqrt(np.sum(v**2, axis=-1)) for v in (from_sun, body)]
    elevation = 0.5 * np.pi - separation(body, upright(at.observer_m))
    off_axis = separation(attitude[:, 2], towards)
    off_frame = off_axis - corner_radius(camera)  # at least
    near = off_frame <= OFF_RAD
    off_frame[near] = _off_frame(camera, attitude[near], towards[near], off_axis[near])
    hidden = hidden_rad(scene, at.observer_m, body, elevation)
    lamp = Lamp(off_axis, off_frame, np.full(len(off_axis), OFF_RAD), hidden, elevation)
    return lamp, brightest_v_mag(name, *far)


def hidden_rad(scene: Scene, place_m: Array, body_m: Array, elevation: Array) -> Array:
    """How far (n,) [rad] a body's middle is behind the horizon of a site, or the Earth's limb."""
    o = scene.observer
    if isinstance(o, GroundObserver):
        radius = EARTH_EQUATORIAL_RADIUS_M
        dip = math.acos(radius / (radius + max(o.height_m, 0.0)))
        return -elevation - dip - REFRACTED_RAD
    height, distance = (np.sqrt(np.sum(v**2, axis=-1)) for v in (place_m, body_m))
    off_limb = limb_angle(place_m, body_m, pole_at(parse_utc(scene.epoch)))
    return np.where(distance < height, -np.pi, -off_limb)


def _off_frame(camera: Camera, attitude: Array, towards: Array, off_axis: Array) -> Array:
    """Angle (n,) from the nearest pixel of the frame to directions (n, 3) [rad]; 0 inside it."""
    out = off_axis - corner_radius(camera)  # of what is seen by no pixel: at least this
    for k, (axes, u) in enumerate(zip(attitude, towards, strict=True)):
        x, y = (float(v[0]) for v in project(camera, axes, u[None]))
        if math.isfinite(x) and math.isfinite(y):
            x1, y1 = min(max(x, -0.5), camera.columns - 0.5), min(max(y, -0.5), camera.rows - 0.5)
            nearest = deproject(camera, axes, np.array([x1]), np.array([y1]))
            inside = (x1, y1) == (x, y)
            out[k] = 0.0 if inside else float(separation(nearest, u[None])[0])
    return out
