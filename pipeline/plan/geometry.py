"""Where observer, boresight and targets are during each exposure, at as many nodes as needed."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields, replace

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Geometry
from pipeline.errors import BadInput
from pipeline.physics.constants import (
    ARCSEC_RAD,
    ASTRONOMICAL_UNIT_M,
    DEG_RAD,
    EARTH_EQUATORIAL_RADIUS_M,
    JULIAN_YEAR_DAYS,
    SPEED_OF_LIGHT_M_S,
)
from pipeline.physics.motion.pointing import attitudes_drift, boresight_frame, proper_attitude
from pipeline.physics.positions.apparent import (
    TargetSight,
    aberrate,
    proper_to_astrometric,
    star_proper,
    unaberrate,
)
from pipeline.physics.positions.earth import EarthState, earth_and_sun, site_state
from pipeline.physics.positions.focal_plane import Camera, deproject, ifov_rad, project, stretch
from pipeline.physics.positions.orbit import check_above_earth
from pipeline.physics.positions.refraction import refract, unrefract
from pipeline.physics.positions.times import Instants, instants, parse_utc
from pipeline.physics.vectors import from_angles, separation
from pipeline.plan.air import air_of, lifted
from pipeline.plan.bodies import flicker_share
from pipeline.plan.orbits import orbit_states
from pipeline.plan.target_paths import Moments, sights, target_paths
from pipeline.spec.detector import TimeDelay
from pipeline.spec.observer import FixedObserver, GroundObserver
from pipeline.spec.pointing import RatePointing, SiderealPointing, TargetPointing
from pipeline.spec.scene import Scene

Array = NDArray[np.float64]

J2000_JD = 2_451_545.0
PATH_TOLERANCE_PX = 2e-3  # how far linear motion between nodes may be from the real path
FEWEST_NODES, MOST_NODES = 9, 1025
MOST_LIGHT_NODES = 257  # what flickers faster is told in the plan
LONGEST_STREAK_PX = 1e5  # a longer one in one exposure is taken for a mistake in the scene


def epochs_jyear(g: Geometry) -> Array:
    """Julian years (F,) of mid-exposure, TT."""
    days = (g.tt1[:, g.middle] - J2000_JD) + g.tt2[:, g.middle]
    return 2000.0 + days / JULIAN_YEAR_DAYS


def observer_distances_au(g: Geometry) -> Array:
    """Distances (F,) of the observer from the barycentre at mid-exposure."""
    return np.sqrt(np.sum(g.observer_m[:, g.middle] ** 2, axis=-1)) / ASTRONOMICAL_UNIT_M


def camera_of(scene: Scene) -> Camera:
    """The focal plane of a scene's sensor."""
    s = scene.sensor
    camera = Camera(s.shape[0], s.shape[1], s.pixel_pitch_um * 1e-6, s.focal_length_m)
    if s.detector is not None and isinstance(s.detector.readout, TimeDelay):
        camera = replace(camera, charge_px_s=s.detector.readout.rows_per_s)
    if s.distortion is None:
        return camera
    from pipeline.physics.positions.distortion import distortion_of

    wish = s.distortion.model_dump()
    distortion = distortion_of(wish, camera.rows, camera.columns, ifov_rad(camera))
    return replace(camera, distortion=distortion)


def sampled_frames(scene: Scene) -> NDArray[np.int64]:
    """The frames that decisions look at: the first, the last, and up to seven between them."""
    last = scene.exposure.frames - 1
    return np.unique(np.linspace(0, last, 9).round()).astype(np.int64)


def plan_geometry(scene: Scene, frames: NDArray[np.int64], dut1_s: float) -> Geometry:
    """Geometry of the given frames; nodes are doubled until paths and light are straight between.

    Each frame stands on its own: the same frame gives the same bits in whatever window it is asked
    for, because the number of nodes is chosen from `sampled_frames` of the whole scene.
    Raises BadInput for a sensor that looks at the Earth, orbits inside it and absurd motion.
    """
    looked_at = sampled_frames(scene)
    nodes = FEWEST_NODES
    while True:
        geometry = _geometry(scene, looked_at, nodes, dut1_s)
        bend = _bend_px(scene, geometry)
        flicker = flicker_share(geometry, near_frame(scene, geometry))
        smooth = flicker <= scene.accuracy.flux_fraction
        if bend <= PATH_TOLERANCE_PX and (smooth or nodes >= MOST_LIGHT_NODES):
            break
        if nodes >= MOST_NODES:
            raise BadInput(
                "exposure.integration_s",
                scene.exposure.integration_s,
                f"an exposure whose streaks are smooth; this one bends by {bend:.3g} px between "
                f"{nodes} nodes (see pointing and orbits)",
            )
        nodes = 2 * nodes - 1
    if not np.array_equal(frames, looked_at):
        geometry = _geometry(scene, frames, nodes, dut1_s)
    _check_paths(scene, geometry)
    return geometry


def _geometry(scene: Scene, frames: NDArray[np.int64], nodes: int, dut1_s: float) -> Geometry:
    exposure = scene.exposure
    within = np.linspace(0.0, 1.0, nodes) * exposure.integration_s
    offset = frames[:, None] * exposure.step_s + within[None, :]
    flat = offset.ravel()
    epoch = parse_utc(scene.epoch)
    times = instants(epoch, flat, dut1_s)
    earth = earth_and_sun(times.tt1, times.tt2)
    geocentric, velocity = _observer(scene, epoch, flat, times, earth)
    position = earth.position_m + geocentric
    sun = earth.position_m + earth.sun_from_earth_m
    at = Moments(epoch, flat, times, earth, geocentric, velocity)
    attitude = _attitudes(scene, flat, position, velocity, sun, _followed(scene, at))
    camera, air = camera_of(scene), air_of(scene, times)
    if air is not None:
        attitude = lifted(camera, attitude, air)
    _check_view(scene, geocentric, attitude[:, 2])
    t = target_paths(scene, camera, attitude, at, len(frames), air)
    grid, grid3 = offset.shape, (*offset.shape, 3)
    each = (len(scene.targets), *grid)
    return Geometry(
        frames, offset, times.tt1.reshape(grid), times.tt2.reshape(grid),
        times.utc1.reshape(grid), times.utc2.reshape(grid), position.reshape(grid3),
        velocity.reshape(grid3), sun.reshape(grid3), attitude.reshape(*grid, 3, 3),
        t.x_px.reshape(each),
        t.y_px.reshape(each) - camera.charge_px_s * (within - within[nodes // 2]),
        t.light.reshape(each), t.range_m.reshape(each), t.phase_rad.reshape(each),
        t.sunlit.reshape(each), t.direction, t.pose, t.pose_s, t.turn_rad,
        np.empty((*grid, 0)) if air is None else air.reshape(*grid, 5),
    )  # fmt: skip


def watch(scene: Scene, offsets: Array, dut1_s: float) -> tuple[Array, Array, Array]:
    """Observer's geocentric place [m], velocity [m/s] and proper boresight (n, 3), any moments.

    offsets : (n,) seconds after the scene's epoch
    """
    epoch, flat = parse_utc(scene.epoch), np.asarray(offsets, float)
    times = instants(epoch, flat, dut1_s)
    earth = earth_and_sun(times.tt1, times.tt2)
    place, velocity = _observer(scene, epoch, flat, times, earth)
    at = Moments(epoch, flat, times, earth, place, velocity)
    position, sun = earth.position_m + place, earth.position_m + earth.sun_from_earth_m
    attitude = _attitudes(scene, flat, position, velocity, sun, _followed(scene, at))
    return place, velocity - earth.velocity_m_s, attitude[:, 2]


def _followed(scene: Scene, at: Moments) -> dict[int, TargetSight]:
    """How the observer sees the target that the pointing follows; nothing where it follows none."""
    if not isinstance(scene.pointing, TargetPointing):
        return {}
    names = [t.name for t in scene.targets]
    index = names.index(scene.pointing.target)
    seen, _ = sights(scene, [index], at)
    return {index: TargetSight(*(getattr(seen, f.name)[0] for f in fields(seen)))}


def _observer(
    scene: Scene, epoch: tuple[float, float], offsets: Array, times: Instants, earth: EarthState
) -> tuple[Array, Array]:
    """Geocentric place and barycentric velocity of the observer: (n, 3) each."""
    o = scene.observer
    if isinstance(o, GroundObserver):
        place, speed = site_state(
            o.latitude_deg * DEG_RAD, o.longitude_deg * DEG_RAD, o.height_m, times
        )
    elif isinstance(o, FixedObserver):
        fixed = np.array(o.position_au) * ASTRONOMICAL_UNIT_M
        velocity = np.array(o.velocity_m_s)
        if not np.sqrt(velocity @ velocity) < SPEED_OF_LIGHT_M_S:
            raise BadInput("observer.velocity_m_s", o.velocity_m_s, "a speed below that of light")
        place = fixed - earth.position_m
        check_above_earth(place, "observer.position_au")
        return place, np.broadcast_to(velocity, place.shape)
    else:
        place, speed = orbit_states(o.orbit, "observer.orbit", epoch, offsets, times)
    return place, speed + earth.velocity_m_s


def _attitudes(
    scene: Scene,
    offsets: Array,
    position: Array,
    velocity: Array,
    sun: Array,
    sights: Mapping[int, TargetSight],
) -> Array:
    """Proper attitudes (n, 3, 3) of the pointing; stars and boresight share one set of effects."""
    p, effects = scene.pointing, scene.star_effects
    roll = p.roll_deg * DEG_RAD
    if isinstance(p, TargetPointing):
        names = [t.name for t in scene.targets]
        proper = sights[names.index(p.target)].direction_proper
        astrometric = np.concatenate([
            proper_to_astrometric(u[None], r, v, s, **effects)
            for u, r, v, s in zip(proper, position, velocity, sun, strict=True)
        ])  # fmt: skip
        return proper_attitude(boresight_frame(astrometric, roll), proper)
    start = from_angles(
        np.array(p.boresight_ra_deg * DEG_RAD), np.array(p.boresight_dec_deg * DEG_RAD)
    )
    if isinstance(p, RatePointing):
        rates = (p.rate_ra_arcsec_s * ARCSEC_RAD, p.rate_dec_arcsec_s * ARCSEC_RAD)
        swept = math.hypot(*rates) * scene.exposure.integration_s
        if swept > LONGEST_STREAK_PX * ifov_rad(camera_of(scene)) or swept > np.pi / 2:
            raise BadInput(
                "pointing.rate_ra_arcsec_s, rate_dec_arcsec_s",
                (p.rate_ra_arcsec_s, p.rate_dec_arcsec_s),
                f"rates of at most {LONGEST_STREAK_PX:.0f} px and 90 degrees in one exposure",
            )
        frames = attitudes_drift(start, roll, *rates, offsets)
    else:
        assert isinstance(p, SiderealPointing)
        frames = np.broadcast_to(boresight_frame(start, roll), (len(offsets), 3, 3))
    proper = np.concatenate([
        star_proper(a[2][None], r, v, s, **effects)
        for a, r, v, s in zip(frames, position, velocity, sun, strict=True)
    ])  # fmt: skip
    return proper_attitude(frames, proper)


def _check_view(scene: Scene, observer_m: Array, boresight: Array) -> None:
    """Refuse a boresight that ends in the Earth: below the horizon, or inside its disc."""
    distance = np.sqrt(np.sum(observer_m**2, axis=-1))
    down = -observer_m / distance[:, None]
    if isinstance(scene.observer, GroundObserver):
        elevation = separation(boresight, down) - np.pi / 2
        if elevation.min() < 0:
            raise BadInput(
                "pointing", f"elevation {np.degrees(elevation.min()):.2f} deg",
                "a boresight above the horizon of the site during all exposures",
            )  # fmt: skip
        return
    disc = np.arcsin(np.minimum(1.0, EARTH_EQUATORIAL_RADIUS_M / distance))
    limb = separation(boresight, down) - disc
    if limb.min() < 0:
        raise BadInput(
            "pointing", f"{-np.degrees(limb.min()):.2f} deg inside the Earth's limb",
            "a boresight beside the Earth's disc during all exposures",
        )  # fmt: skip


def _check_paths(scene: Scene, g: Geometry) -> None:
    """Refuse absurd streaks over the frame: a bad orbit, a near collision, a wild pointing."""
    rows, columns = scene.sensor.shape
    with np.errstate(invalid="ignore", over="ignore"):
        x, y = g.target_x_px, g.target_y_px
        length = np.hypot(np.diff(x, axis=-1), np.diff(y, axis=-1)).sum(axis=-1)
        touches = (x.max(axis=-1) > 0) & (x.min(axis=-1) < columns)
        touches &= (y.max(axis=-1) > 0) & (y.min(axis=-1) < rows)
    absurd = touches & (length > LONGEST_STREAK_PX)
    if absurd.any():
        target, frame = np.argwhere(absurd)[0]
        raise BadInput(
            f"targets.{target}.orbit",
            f"{length[target, frame]:.3g} px over the frame in exposure {g.frame[frame]}",
            f"streaks of at most {LONGEST_STREAK_PX:.0f} px: a shorter exposure, or another orbit",
        )
    if scene.stars is None:
        return
    camera = camera_of(scene)
    paths = star_paths(camera, g, *_field_points(camera), scene.star_effects["aberration"])
    length = np.hypot(*np.diff(paths, axis=-1)).sum(axis=-1).max(axis=0)
    absurd = ~(length <= LONGEST_STREAK_PX)
    if absurd.any():
        frame = int(np.argmax(absurd))
        raise BadInput(
            "pointing",
            f"stars that streak {length[frame]:.3g} px in exposure {g.frame[frame]}",
            f"streaks of at most {LONGEST_STREAK_PX:.0f} px: a shorter exposure, or a slower "
            "pointing",
        )


def near_frame(scene: Scene, g: Geometry) -> NDArray[np.bool_]:
    """Targets and frames (T, F) whose path in the exposure touches the frame or what is beside it.

    Beside it: within the frame's longer side. Others must not slow down the rest, nor be smooth.
    """
    rows, columns = scene.sensor.shape
    side = max(rows, columns)
    x, y = g.target_x_px, g.target_y_px
    with np.errstate(invalid="ignore"):
        near = (x.max(axis=-1) > -side) & (x.min(axis=-1) < columns + side)
        near &= (y.max(axis=-1) > -side) & (y.min(axis=-1) < rows + side)
    return np.asarray(near)  # NaN, behind the camera, is not near


def _bend_px(scene: Scene, g: Geometry) -> float:
    """How far linear motion between the nodes is from the real one, at the worst place [px].

    Linear interpolation between nodes twice as far apart errs four times as much, so a quarter of
    what it misses at the nodes between is the error of the nodes themselves.
    """
    camera = camera_of(scene)
    paths = star_paths(camera, g, *_field_points(camera), scene.star_effects["aberration"])
    seen, near = np.isfinite(paths).all(axis=(0, -1)), near_frame(scene, g)
    xs = np.concatenate([g.target_x_px[near], paths[0][seen]])
    ys = np.concatenate([g.target_y_px[near], paths[1][seen]])
    if not len(xs):
        return 0.0
    length = np.hypot(np.diff(xs, axis=-1), np.diff(ys, axis=-1)).sum(axis=-1)
    if length.max() > LONGEST_STREAK_PX:
        raise BadInput(
            "exposure.integration_s", scene.exposure.integration_s,
            f"streaks of at most {LONGEST_STREAK_PX:.0f} px; here {length.max():.3g} px in one "
            "exposure (see pointing rates and orbits)",
        )  # fmt: skip
    bend = np.hypot(
        xs[..., 1:-1:2] - 0.5 * (xs[..., :-2:2] + xs[..., 2::2]),
        ys[..., 1:-1:2] - 0.5 * (ys[..., :-2:2] + ys[..., 2::2]),
    )
    return float(bend.max()) / 4.0


def excursions_px(camera: Camera, g: Geometry, aberration: bool = True) -> Array:
    """Farthest (F,) that a star of each frame moves from its place at mid-exposure, in whole 16 px.

    Told from the centre and the corners of the field.
    """
    paths = star_paths(camera, g, *_field_points(camera), aberration)
    worst = np.hypot(*(paths - paths[..., [g.middle]])).max(axis=(0, 2))
    worst *= stretch(camera) ** 2  # between the points looked at
    return np.where(worst > 1e-3, 16.0 * np.ceil(worst / 16.0), 0.0)


def star_paths(
    camera: Camera, g: Geometry, x_px: Array, y_px: Array, aberration: bool = True
) -> Array:
    """Pixel places (2, n, F, K) of the stars that stand at (x, y) at mid-exposure of each frame."""
    out = np.empty((2, len(x_px), *g.offset_s.shape))
    beta = g.observer_m_s / SPEED_OF_LIGHT_M_S * (1.0 if aberration else 0.0)
    for f in range(len(g.frame)):
        seen = deproject(camera, g.attitude[f, g.middle], x_px, y_px)
        stars = unaberrate(unrefract(seen, g.air_at(f, g.middle)), beta[f, g.middle])
        for k in range(g.nodes):
            u = refract(aberrate(stars, beta[f, k]), g.air_at(f, k))
            out[:, :, f, k] = project(camera, g.attitude[f, k], u)
        if camera.charge_px_s:
            out[1, :, f] -= camera.charge_px_s * (g.offset_s[f] - g.offset_s[f, g.middle])
    return out


def _field_points(camera: Camera) -> tuple[Array, Array]:
    """Centre and corners of the frame [px]."""
    columns, rows = camera.columns - 1.0, camera.rows - 1.0
    return (
        np.array([columns / 2, 0.0, columns, 0.0, columns]),
        np.array([rows / 2, 0.0, 0.0, rows, rows]),
    )
