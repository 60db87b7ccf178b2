"""Where observer, boresight and targets are during each exposure, at as many nodes as needed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Geometry, Refined
from pipeline.errors import BadInput
from pipeline.physics.constants import (
    ASTRONOMICAL_UNIT_M,
    JULIAN_YEAR_DAYS,
    SPEED_OF_LIGHT_M_S,
)
from pipeline.physics.motion.disturbance import turned
from pipeline.physics.motion.rolling import rolled_sources
from pipeline.physics.positions.apparent import (
    TargetSight,
)
from pipeline.physics.positions.earth import EarthState, earth_and_sun
from pipeline.physics.positions.focal_plane import Camera, ifov_rad
from pipeline.physics.positions.limb import limb_angle, pole_at, upright
from pipeline.physics.positions.orbit import check_above_earth
from pipeline.physics.positions.times import Instants, instants, parse_utc
from pipeline.physics.vectors import separation, to_angles
from pipeline.plan.bodies.bodies import flicker_shares, missed_shares
from pipeline.plan.bodies.changes import MOST_LIGHT_NODES
from pipeline.plan.bodies.orbits import orbit_states
from pipeline.plan.bodies.paths import target_paths
from pipeline.plan.bodies.sights import Moments, sights
from pipeline.plan.pointing.air import air_of, check_height, lifted
from pipeline.plan.pointing.attitude_motion import motion_plan, random_motion_rad
from pipeline.plan.pointing.paths import (
    LONGEST_STREAK_PX,
    bends_px,
    check_paths,
    missed_px,
    near_frame,
)
from pipeline.plan.pointing.pointing import Vantage, attitudes, pointing_field, swept_rad
from pipeline.plan.pointing.site import axes_of, place_of
from pipeline.plan.pointing.star_paths import field_points, star_paths
from pipeline.plan.pointing.timescales import looks
from pipeline.plan.timing import (
    dwell_of,
    dwell_plans,
    frame_count,
    frame_times,
    integration_range_s,
    last_row_late_s,
)
from pipeline.spec.pointing.observer import FixedObserver, GroundObserver
from pipeline.spec.pointing.pointing import RatePointing, SiderealPointing, TargetPointing
from pipeline.spec.scene import USUAL_FRACTION, Scene
from pipeline.spec.sensor.detector import RollingShutter, TimeDelay

Array = NDArray[np.float64]

J2000_JD = 2_451_545.0
PATH_TOLERANCE_PX = 2e-3  # how far linear motion between nodes may be from the real path
FINE_PX, FINE_NODES = 2e-4, 129  # the same at the usual accuracy, where so many nodes suffice
FEWEST_NODES, MOST_NODES = 9, 1025
LOOKS_BETWEEN = 8  # intervals between two nodes in which the paths of tables are looked at
ROUNDED_PX = 1e-9  # places are no better known
ROUGH_PX = 0.1  # how far a table of attitudes may be off between MOST_NODES nodes
MOST_DWELLS_SAMPLED = 64


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
    if s.detector is not None and isinstance(s.detector.readout, RollingShutter):
        r = s.detector.readout
        camera = replace(camera, line_s=r.line_s if r.first == "low_rows" else -r.line_s)
    if s.distortion is None:
        return camera
    from pipeline.physics.positions.distortion import distortion_of

    request = s.distortion.model_dump()
    distortion = distortion_of(request, camera.rows, camera.columns, ifov_rad(camera))
    return replace(camera, distortion=distortion)


def sampled_frames(scene: Scene) -> NDArray[np.int64]:
    """The frames that decisions look at: the first, the last, and up to seven between them.

    Of several dwells also the first and the last of each, of at most MOST_DWELLS_SAMPLED.
    """
    last = frame_count(scene) - 1
    frames = np.linspace(0, last, 9).round()
    if scene.dwells is not None:
        plans = dwell_plans(scene)[:MOST_DWELLS_SAMPLED]
        edges = [k for p in plans for k in (p.first, p.first + p.frames - 1)]
        frames = np.concatenate([frames, edges])
    return np.unique(frames).astype(np.int64)


def plan_geometry(
    scene: Scene, frames: NDArray[np.int64], dut1_s: float, least: int = FEWEST_NODES
) -> Geometry:
    """Geometry of the given frames; nodes are doubled until paths and light are straight between.

    Each frame stands on its own: the same frame gives the same bits in whatever window it is asked
    for. The number of nodes follows from `sampled_frames` of the whole scene; a frame that needs
    more gets more of its own (`Refined`); `least` are there anyway. Raises BadInput for a sensor
    that looks at the Earth, orbits inside it and absurd motion.
    """
    nodes = max(_nodes(scene, dut1_s), least)
    return _finer(scene, _geometry(scene, frames, nodes, dut1_s), dut1_s)


def with_frames(scene: Scene, g: Geometry, frames: NDArray[np.int64], dut1_s: float) -> Geometry:
    """A geometry with more frames, where it does not hold these already."""
    wanted = np.union1d(g.frame, frames)
    return g if len(wanted) == len(g.frame) else plan_geometry(scene, wanted, dut1_s)


_COUNTED: list[tuple[Scene, float, int]] = []  # the last scene whose nodes were counted


def _nodes(scene: Scene, dut1_s: float) -> int:
    """Nodes of an exposure that the sampled frames of a scene need."""
    for known, dut1, nodes in tuple(_COUNTED):
        if known is scene and dut1 == dut1_s:
            return nodes
    _check_rates(scene)
    looked_at = sampled_frames(scene)
    g = _geometry(scene, looked_at, FEWEST_NODES, dut1_s)
    nodes = int(_seen_from(scene, g, dut1_s).min())
    while True:
        g = g if nodes == g.nodes else _geometry(scene, looked_at, nodes, dut1_s)
        if not _needs_more(scene, g, nodes, _star_paths(scene, g)).any():
            break
        nodes = 2 * nodes - 1
    motion = motion_plan(scene)
    if motion is not None:
        nodes = max(nodes, motion.nodes)
    _COUNTED[:] = [(scene, dut1_s, nodes)]
    return nodes


def _finer(scene: Scene, geometry: Geometry, dut1_s: float) -> Geometry:
    """The geometry with the random motion, and more nodes for the frames that need them."""
    finer: dict[int, Geometry] = {}
    left, made, nodes = np.arange(len(geometry.frame)), geometry, geometry.nodes
    paths, seen_from = _star_paths(scene, geometry), _seen_from(scene, geometry, dut1_s)
    first = paths
    while True:
        more = _needs_more(scene, made, nodes, paths) | (seen_from[left] > nodes)
        if nodes > geometry.nodes:
            finer |= {int(left[k]): made.frame_slice(int(k)) for k in np.flatnonzero(~more)}
        left = left[more]
        if not len(left):
            break
        nodes = max(2 * nodes - 1, int(seen_from[left].min()))
        made = _geometry(scene, geometry.frame[left], nodes, dut1_s)
        paths = _star_paths(scene, made)
    _check_all(scene, geometry, first, finer)
    if motion_plan(scene) is not None:
        finer = {k: _geometry(scene, g.frame, g.nodes, dut1_s, True) for k, g in finer.items()}
        geometry = _geometry(scene, geometry.frame, geometry.nodes, dut1_s, True)
        try:
            _check_all(scene, geometry, _star_paths(scene, geometry), finer)
        except BadInput as error:
            allowed = f"streaks of at most {LONGEST_STREAK_PX:.0f} px: weaker or slower motion"
            raise BadInput("pointing.attitude", error.value, allowed) from None
    return Refined.of(geometry, finer) if finer else geometry


def _check_all(
    scene: Scene, geometry: Geometry, paths: Array, finer: Mapping[int, Geometry]
) -> None:
    """Refuse absurd paths (`check_paths`) of frames that have more nodes, too."""
    check_paths(scene, geometry, paths)
    for g in finer.values():
        check_paths(scene, g, _star_paths(scene, g))


def _seen_from(scene: Scene, coarse: Geometry, dut1_s: float) -> NDArray[np.int64]:
    """From how many nodes (F,) on each frame shows what happens between fewer ones.

    Under a rolling shutter, whose rows see light after the nodes, as many as it is looked at.
    """
    many = looks(scene, coarse, near_frame(scene, coarse))
    out = np.full(len(many), FEWEST_NODES)
    if last_row_late_s(scene):
        return np.maximum(out, np.minimum(many, MOST_LIGHT_NODES))
    for k in np.flatnonzero(many > FEWEST_NODES):
        g = _geometry(scene, coarse.frame[k : k + 1], int(many[k]), dut1_s)
        paths, near = _star_paths(scene, g), near_frame(scene, g)
        while out[k] < many[k]:
            step = (int(many[k]) - 1) // (int(out[k]) - 1)
            bent = missed_px(scene, g, paths, step)[0] > _straight_px(scene, int(out[k]))
            dim = missed_shares(g, near, step)[0] > scene.accuracy.flux_fraction
            if not (bent or (dim and out[k] < MOST_LIGHT_NODES)):
                break
            out[k] = 2 * out[k] - 1
    return out


def _straight_px(scene: Scene, nodes: int) -> float:
    """How far paths may be from straight between so many nodes."""
    if nodes >= FINE_NODES:
        return PATH_TOLERANCE_PX
    return FINE_PX * min(1.0, scene.accuracy.noise_fraction / USUAL_FRACTION)


def _needs_more(scene: Scene, g: Geometry, nodes: int, paths: Array) -> NDArray[np.bool_]:
    """Frames (F,) whose paths (of stars: `paths`) or light are not straight between the nodes.

    Raises BadInput for a path that still bends where there are most; a table of attitudes, whose
    rows may be noisy, is drawn as it is there, and the plan says how far it is off.
    """
    bends = bends_px(scene, g, paths)
    bent = bends > _straight_px(scene, nodes)
    if bent.any() and nodes >= MOST_NODES:
        tables = [p for p in dwell_plans(scene) if p.pointing.mode == "table"]
        if bends.max() > ROUGH_PX or not tables:
            raise BadInput(
                "exposure.integration_s",
                integration_range_s(scene)[1],
                f"an exposure whose streaks are smooth; this one bends by {bends.max():.3g} px "
                f"between {nodes} nodes (see pointing and orbits)",
            )
        bent &= False
    if nodes >= MOST_LIGHT_NODES:
        return bent
    return bent | (flicker_shares(g, near_frame(scene, g)) > scene.accuracy.flux_fraction)


def bend_px(scene: Scene, g: Geometry, dut1_s: float) -> float:
    """How far paths of stars and targets are from straight lines between the nodes, at most [px].

    Of those over and beside the frames of a geometry, without random motion: how far that is from
    straight is in its own plan. With a table, whose rows may be kinks of which the nodes tell too
    little, the frame that bends most is looked at between its nodes.
    """
    each = [g.frame_slice(k) for k in range(len(g.frame))]
    if motion_plan(scene) is not None:
        each = [_geometry(scene, one.frame, one.nodes, dut1_s) for one in each]
    found = [float(bends_px(scene, one, _star_paths(scene, one))[0]) for one in each]
    if any(p.pointing.mode == "table" for p in dwell_plans(scene)):
        found.append(_beside_px(scene, each[int(np.argmax(found))], dut1_s))
    return max(ROUNDED_PX, *found)


def _beside_px(scene: Scene, g: Geometry, dut1_s: float) -> float:
    """How far stars of one frame pass by the lines between its nodes, looked at in between."""
    if all(p.pointing.mode != "target" for p in dwell_plans(scene)):
        scene = scene.model_copy(update={"targets": (), "populations": ()})
    fine = _geometry(scene, g.frame, LOOKS_BETWEEN * (g.nodes - 1) + 1, dut1_s)
    return float(missed_px(scene, fine, _star_paths(scene, fine), LOOKS_BETWEEN)[0])


def _star_paths(scene: Scene, g: Geometry) -> Array:
    """Paths (2, 5, F, K) of stars in the middle and the corners of the field."""
    camera = camera_of(scene)
    return star_paths(camera, g, *field_points(camera), scene.star_effects["aberration"])


def _check_rates(scene: Scene) -> None:
    """Refuse rates that sweep too far in an exposure."""
    for plan in dwell_plans(scene):
        p = plan.pointing
        if isinstance(p, RatePointing):
            swept = swept_rad(p, plan.end_s - plan.start_s, max(plan.times_s))
            if swept > LONGEST_STREAK_PX * ifov_rad(camera_of(scene)) or swept > np.pi / 2:
                raise BadInput(
                    pointing_field(plan, "rate_ra_arcsec_s, rate_dec_arcsec_s"),
                    (p.rate_ra_arcsec_s, p.rate_dec_arcsec_s),
                    f"rates of at most {LONGEST_STREAK_PX:.0f} px and 90 degrees in one exposure",
                )


def _geometry(
    scene: Scene,
    frames: NDArray[np.int64],
    nodes: int,
    dut1_s: float,
    random: bool = False,
    late_s: float | Array = 0.0,
    anywhere: bool = False,
) -> Geometry:
    """Geometry of frames at a number of nodes; `random`: with the random motion of the pointing.

    late_s : by which all exposures, or each (F,), are shifted; anywhere : also of a camera that
        looks at the ground
    """
    within = np.linspace(0.0, 1.0, nodes)
    start, time = frame_times(scene, frames)
    start = start + late_s if np.any(late_s) else start
    since = within[None, :] * time[:, None]
    offset = start[:, None] + since
    which = np.repeat(dwell_of(dwell_plans(scene), frames), nodes)
    at, attitude = aimed(scene, offset.ravel(), dut1_s, which)
    times, earth, geocentric, velocity = at.times, at.earth, at.observer_m, at.observer_m_s
    position = earth.position_m + geocentric
    sun = earth.position_m + earth.sun_from_earth_m
    if random:
        attitude = turned(attitude, *random_motion_rad(scene, frames, nodes).reshape(-1, 3).T)
    camera, air = camera_of(scene), air_of(scene, times)
    if air is not None:
        attitude = lifted(attitude, air)
    if not anywhere:
        if air is not None:
            check_height(camera, attitude, air)
        check_view(scene, geocentric, attitude[:, 2])
    t = target_paths(scene, camera, attitude, at, len(frames), air)
    grid, grid3 = offset.shape, (*offset.shape, 3)
    each = (len(scene.targets), *grid)
    x, y, light = t.x_px.reshape(each), t.y_px.reshape(each), t.light.reshape(each)
    clear = t.clear.reshape(each)
    if camera.line_s:
        until = offset[:, [-1]] + within * last_row_late_s(scene)
        late = _light(scene, frames, until, dut1_s)
        seen = x, y, light, late, clear
        x, y, light, clear = rolled_sources(*seen, since, camera.line_s, camera.rows)
    return Geometry(
        frames,
        offset,
        times.tt1.reshape(grid),
        times.tt2.reshape(grid),
        times.utc1.reshape(grid),
        times.utc2.reshape(grid),
        position.reshape(grid3),
        velocity.reshape(grid3),
        sun.reshape(grid3),
        attitude.reshape(*grid, 3, 3),
        x,
        y - camera.charge_px_s * (since - since[:, [nodes // 2]]),
        light,
        t.range_m.reshape(each),
        t.phase_rad.reshape(each),
        t.sunlit.reshape(each),
        clear,
        t.direction,
        t.pose,
        t.pose_s,
        t.turn_rad,
        np.empty((*grid, 0)) if air is None else air.reshape(*grid, 5),
    )


def _light(scene: Scene, frames: NDArray[np.int64], offset_s: Array, dut1_s: float) -> Array:
    """Light (T, F, K) of the targets at moments (F, K) as cameras of these frames are pointed:
    above the air, wherever that puts them in the frame."""
    which = np.repeat(dwell_of(dwell_plans(scene), frames), offset_s.shape[1])
    at, attitude = aimed(scene, offset_s.ravel(), dut1_s, which)
    found = target_paths(scene, camera_of(scene), attitude, at, len(frames))
    return found.light.reshape(len(scene.targets), *offset_s.shape)


def late_geometry(scene: Scene, g: Geometry, dut1_s: float, late_s: float) -> Geometry:
    """The geometry of the frames of another one, all of them so much later."""
    return _geometry(scene, g.frame, g.nodes, dut1_s, late_s=late_s)


def geometry_anywhere(
    scene: Scene,
    frames: NDArray[np.int64],
    dut1_s: float,
    late_s: Array,
    nodes: int = FEWEST_NODES,
) -> Geometry:
    """Geometry of exposures like those of frames (F,), each `late_s` (F,) later: of a camera that
    looks at the ground too, without random motion."""
    return _geometry(scene, frames, nodes, dut1_s, late_s=late_s, anywhere=True)


def light_nodes(scene: Scene, g: Geometry, which: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Nodes (F,) that the light of some targets (T,) asks for, wherever they are."""
    near = np.repeat(which[:, None], len(g.frame), axis=1)
    return np.minimum(looks(scene, g, near), MOST_LIGHT_NODES)


def watch(scene: Scene, offsets: Array, dut1_s: float, dwell: int) -> tuple[Array, Array, Array]:
    """Observer's geocentric place [m], velocity [m/s] and proper boresight (n, 3) in a dwell.

    offsets : (n,) seconds after the scene's epoch
    """
    at, attitude = aimed(scene, offsets, dut1_s, np.full(len(offsets), dwell))
    return at.observer_m, at.observer_m_s - at.earth.velocity_m_s, attitude[:, 2]


def aimed(
    scene: Scene, offsets: Array, dut1_s: float, dwells: NDArray[np.int64] | None = None
) -> tuple[Moments, Array]:
    """The observer and the proper attitudes (n, 3, 3) at any moments, before the air lifts them.

    offsets : (n,) seconds after the scene's epoch; dwells : (n,) which dwell holds each; default:
        the first one that has not ended
    """
    at = moments_at(scene, dut1_s, np.asarray(offsets, float))
    if dwells is None:
        ends = [plan.end_s for plan in dwell_plans(scene)]
        dwells = np.searchsorted(ends[:-1], at.offset_s, side="right")
    return at, attitudes(scene, dwells, _vantage(scene, at))


def moments_at(scene: Scene, dut1_s: float, offsets: Array) -> Moments:
    """Moments at offsets (n,) from a scene's epoch [s], and where its observer is then."""
    epoch = parse_utc(scene.epoch)
    times = instants(epoch, offsets, dut1_s)
    earth = earth_and_sun(times.tt1, times.tt2)
    place, velocity = _observer(scene, epoch, offsets, times, earth)
    return Moments(
        epoch, offsets, times, earth, place, velocity, partial(moments_at, scene, dut1_s)
    )


def zenith_pointing(scene: Scene) -> SiderealPointing:
    """A pointing to the zenith of a scene's site at its epoch, or away from the Earth's centre."""
    at, o = moments_at(scene, 0.0, np.zeros(1)), scene.observer
    up = axes_of(o, at.times)[:, 2] if isinstance(o, GroundObserver) else at.observer_m
    ra, dec = (float(np.degrees(v[0])) for v in to_angles(up))
    return SiderealPointing(mode="sidereal", boresight_ra_deg=ra, boresight_dec_deg=dec)


def _vantage(scene: Scene, at: Moments) -> Vantage:
    """What attitudes follow from at some moments."""
    e = at.earth
    return Vantage(
        at.offset_s,
        at.times,
        e.position_m + at.observer_m,
        at.observer_m_s,
        e.position_m + e.sun_from_earth_m,
        at.observer_m,
        at.observer_m_s - e.velocity_m_s,
        _followed(scene, at),
    )


def _followed(scene: Scene, at: Moments) -> Mapping[int, TargetSight]:
    """How the observer sees the targets that pointings follow; nothing where they follow none."""
    followed = [
        p.pointing.target for p in dwell_plans(scene) if isinstance(p.pointing, TargetPointing)
    ]
    if not followed:
        return {}
    names = [t.name for t in scene.targets]
    which = sorted({names.index(name) for name in followed})
    seen, _ = sights(scene, which, at)
    return {
        i: TargetSight(*(getattr(seen, f.name)[k] for f in fields(seen)))
        for k, i in enumerate(which)
    }


def _observer(
    scene: Scene, epoch: tuple[float, float], offsets: Array, times: Instants, earth: EarthState
) -> tuple[Array, Array]:
    """Geocentric place and barycentric velocity of the observer: (n, 3) each."""
    o = scene.observer
    if isinstance(o, GroundObserver):
        place, speed = place_of(o, times)
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


def check_view(scene: Scene, observer_m: Array, boresight: Array) -> None:
    """Refuse a boresight that ends in the Earth: below the horizon, or inside its disc."""
    if isinstance(scene.observer, GroundObserver):
        elevation = separation(boresight, -upright(observer_m)) - np.pi / 2
        if elevation.min() < 0:
            raise BadInput(
                "pointing",
                f"elevation {np.degrees(elevation.min()):.2f} deg",
                "a boresight above the horizon of the site during all exposures",
            )
        return
    limb = limb_angle(observer_m, boresight, pole_at(parse_utc(scene.epoch)))
    if limb.min() < 0:
        raise BadInput(
            "pointing",
            f"{-np.degrees(limb.min()):.2f} deg inside the Earth's limb",
            "a boresight beside the Earth's disc during all exposures",
        )
