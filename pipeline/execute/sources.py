"""Sources of a frame: where each star and target stands, and how much light it sends."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Array, FrameStars, Geometry, StarTable, select
from pipeline.execute.guards import LOOKED_AT, guard_places
from pipeline.physics.motion.streak import Path, curve_through, densest_share, within
from pipeline.physics.positions.apparent import star_astrometric, star_proper
from pipeline.physics.positions.focal_plane import deproject, project
from pipeline.physics.positions.refraction import refract
from pipeline.physics.targets.disc import Appearance, Sphere, photocentre_offset
from pipeline.physics.targets.off_axis import OffAxis, Perspective
from pipeline.physics.vectors import from_angles, to_angles
from pipeline.plan.bodies.sizes import limb_px
from pipeline.plan.optics.pupil import mean_pupil_fraction, pupil_along, pupil_fraction
from pipeline.plan.pointing.air import path_transmission, star_transmission
from pipeline.plan.pointing.occultation import seen_fraction, stars_clear, visible_path
from pipeline.plan.pointing.star_paths import excursions_px, rolled_stars
from pipeline.plan.resolved import ResolvedScene
from pipeline.plan.response.own_paths import star_offsets
from pipeline.plan.response.responses import point_curvature, point_slope
from pipeline.plan.response.streaks import (
    MERGE_TOLERANCE_PX,
    Streak,
    StreakPlan,
    zone_streak,
)
from pipeline.plan.tiles import distance_px
from pipeline.spec.targets.body import SphereBody
from pipeline.spec.targets.mesh import MeshBody

POINT_RADIUS_PX = 1e-4  # smaller bodies are points whatever their light
UNMOVED = 0.01  # of a part's budget, up to which a sphere is drawn as in the middle of the field
MOST_OFF = 10.0  # radii by which the edge of a field may move a body's limb
STEP_PX = 0.125  # beside a body's middle, where its stretch is looked at
MIDDLE = Perspective(1.0, 0.0, 0.0, 1.0, 0.0, 0.0)
SETTING_PARTS = 16  # of a step of a star that sets, where its light changes
SQUARE_PX = 64.0  # stars are drawn square by square, so that a stamp's pixels stay in the cache


@dataclass(frozen=True)
class FrameTarget:
    """One target in one frame: its place at mid-exposure [px], path around it, light [e-].

    radius_px : of the body; body : its resolved image, None where a point serves
    """

    index: int
    x_px: float
    y_px: float
    path: Path
    light_e: float
    radius_px: float = 0.0
    body: Appearance | None = None


def place_stars(
    plan: ResolvedScene, stars: StarTable, g: Geometry, ref_epoch_jyear: float, catalogue: int = 0
) -> FrameStars:
    """Stars of a table that send light onto the focal plane in the frame of `g` (one frame).

    catalogue : the number of theirs among the scene's, and its reference epoch.
    """
    request, middle = plan.scene.stars, g.middle
    assert request is not None
    observer = g.observer_at(0, middle)
    astrometric = star_astrometric(
        stars.ra_rad,
        stars.dec_rad,
        stars.pm_ra_cosdec_rad_yr,
        stars.pm_dec_rad_yr,
        stars.parallax_rad,
        stars.radial_velocity_m_s,
        ref_epoch_jyear,
        float(g.tt1[0, middle]),
        float(g.tt2[0, middle]),
        observer[0],
        request.parallax,
    )
    proper = star_proper(
        astrometric, *observer, deflection=request.deflection, aberration=request.aberration
    )
    observed = refract(proper, g.air_at(0, middle))
    x, y = project(plan.camera, g.attitude[0, middle], observed)
    frame = (0, 0, plan.camera.rows, plan.camera.columns)
    reach = plan.halo_px + excursion_px(plan, g)
    near = distance_px(x, y, *frame) < reach
    longer = np.ones(len(x))
    if plan.camera.line_s:
        seen = rolled_stars(plan.camera, g, x[near], y[near], request.aberration)
        x[near], y[near], longer[near] = seen
        near &= distance_px(x, y, *frame) < reach
    which = np.flatnonzero(near)  # once: some 4 times as fast as the mask for each column
    x, y, observed, kept = x[which], y[which], observed[which], select(stars, which)
    ra, dec = to_angles(astrometric[which])
    visible = seen_fraction(plan.scene, plan.camera, g, proper[which], y, reach)
    guard_some(plan, g, x, y, observed, kept.source_id)
    light = kept.rate_e_s * plan.integration_s(int(g.frame[0]))
    if plan.responses.streaks.light is None or plan.camera.line_s:
        light = light * pupil_fraction(plan.scene, plan.camera, x, y)
    else:
        light = light * mean_pupil_fraction(plan.scene, g, observed)
    if plan.camera.line_s:
        light = light * longer[which]
    passed = visible
    if plan.extinction is not None:
        passed = visible * star_transmission(plan.extinction, plan.camera, g, observed)
        some = np.flatnonzero((visible > 0.0) & (visible < 1.0))
        if len(some):
            passed[some] = _passed_while_seen(plan, g, observed[some], proper[which[some]], y[some])
    return FrameStars(
        kept.source_id,
        x,
        y,
        light * passed,
        ra,
        dec,
        kept.g_mag,
        kept.colour_flag,
        np.full(len(kept), catalogue, np.uint8),
        visible,
    )


def _passed_while_seen(
    plan: ResolvedScene, g: Geometry, observed: Array, proper: Array, y_px: Array
) -> Array:
    """Share (n,) of the light of stars that comes down in the one exposure of `g`, of those that
    the Earth hides for a part of it; directions (n, 3) as `star_transmission` and `stars_clear`."""
    assert plan.extinction is not None
    clear = stars_clear(plan.scene, plan.camera, g, proper, y_px)
    passed = plan.extinction.transmission(np.maximum(observed @ g.air[0, :, :3].T, 0.0))
    still, front = np.zeros(g.nodes), np.ones(g.nodes - 1, bool)
    found = (
        visible_path(still, still, *one, front, 0.0) for one in zip(passed, clear, strict=True)
    )
    return np.array([share for _, share in found])


def whole_stars(stars: FrameStars) -> FrameStars:
    """The stars that are seen during all of an exposure: most often all that there are."""
    seen = stars.visible_fraction >= 1.0
    return stars if seen.all() else select(stars, seen)


def setting_stars(plan: ResolvedScene, g: Geometry, stars: FrameStars) -> list[FrameTarget]:
    """The stars that the Earth hides for a part of the one exposure of `g`: points like targets,
    each with its own path, where it is seen. Their index is that among `stars`."""
    which = np.flatnonzero((stars.visible_fraction > 0.0) & (stars.visible_fraction < 1.0))
    return [_setting_star(plan, g, stars, int(i)) for i in which]


def _setting_star(plan: ResolvedScene, g: Geometry, stars: FrameStars, index: int) -> FrameTarget:
    """One of them, worked out alone, so that it is the same whatever others a tile sees."""
    effects, middle = plan.scene.star_effects, g.middle
    observer = g.observer_at(0, middle)
    star = select(stars, [index])
    proper = star_proper(
        from_angles(star.ra_rad, star.dec_rad),
        *observer,
        deflection=effects["deflection"],
        aberration=effects["aberration"],
    )
    clear = stars_clear(plan.scene, plan.camera, g, proper, star.y_px)[0]
    x, y = star_offsets(plan.camera, g, star.x_px, star.y_px, effects["aberration"])[:, 0, 0]
    changes, light = plan.responses.streaks.light, np.ones(g.nodes)
    if changes is not None:
        light = changes.along(g, star.x_px, star.y_px)[0, 0]
    front = np.ones(g.nodes - 1, bool)
    whole_e = float(star.light_e[0] / star.visible_fraction[0])  # of the whole exposure
    merge_px = _merge_px(plan, np.full(g.nodes - 1, whole_e / (g.nodes - 1)), x, y)
    parts = 1 if changes is None else SETTING_PARTS
    path, _ = visible_path(x, y, light, clear, front, merge_px, parts)
    place = float(star.x_px[0]), float(star.y_px[0])
    return FrameTarget(index, *place, path, float(star.light_e[0]))


def guard_some(
    plan: ResolvedScene, g: Geometry, x_px: Array, y_px: Array, observed: Array, source_id: Array
) -> None:
    """Look at the places of a few of the stars that stand on the frame.

    Not with a rolling shutter, where each star's place is of its own row's time.
    """
    if plan.camera.line_s:
        return
    some = np.arange(0, len(x_px), max(1, len(x_px) // LOOKED_AT))
    frame = (0, 0, plan.camera.rows, plan.camera.columns)
    some = some[distance_px(x_px[some], y_px[some], *frame) <= 0.0]
    names = [f"star {int(i)}" for i in source_id[some]]
    guard_places(plan, g.attitude[0, g.middle], x_px[some], y_px[some], observed[some], names)


def drawing_order(stars: FrameStars, near: NDArray[np.bool_] | None = None) -> FrameStars:
    """Stars in the one order in which every tile draws them: by square of the frame, then by id.

    Two catalogues may use one id for two stars. near : (n,) which of the stars; default: all
    """
    if near is None:
        near = np.ones(len(stars), bool)
    which = np.flatnonzero(near)
    if len(which) < 2:
        return select(stars, which)
    row, column = (np.floor(v[which] / SQUARE_PX) for v in (stars.y_px, stars.x_px))
    row, column = row - row.min(), column - column.min()
    square = (row * (column.max() + 1.0) + column).astype(np.int64)
    if square.max() < 1 << 16:
        square = square.astype(np.uint16)  # which numpy sorts ten times as fast
    if not _is_ascending(stars.source_id[which]):
        by_id = np.lexsort((stars.catalogue[which], stars.source_id[which]))
        which, square = which[by_id], square[by_id]
    return select(stars, which[np.argsort(square, kind="stable")])


def truth_order(stars: FrameStars) -> FrameStars:
    """Stars as the truth tables list them: by id."""
    if _is_ascending(stars.source_id):
        return stars
    return select(stars, np.lexsort((stars.catalogue, stars.source_id)))


def _is_ascending(source_id: NDArray[np.int64]) -> bool:
    """Whether stars are by id already, as those of one shard are."""
    return bool((source_id[1:] > source_id[:-1]).all())


def excursion_px(plan: ResolvedScene, g: Geometry) -> float:
    """Farthest that a star of one frame moves from its place at mid-exposure, in whole 16 px."""
    return float(excursions_px(plan.camera, g, plan.scene.star_effects["aberration"])[0])


def streaks(plan: ResolvedScene, g: Geometry, streaks: StreakPlan | None = None) -> list[Streak]:
    """The common streak of each zone, row by row; streaks : in place of the plan's own."""
    streaks = streaks or plan.responses.streaks
    aberration = plan.scene.star_effects["aberration"]
    return [
        zone_streak(plan.camera, g, row, column, streaks, aberration)
        for row in range(streaks.zones)
        for column in range(streaks.zones)
    ]


def too_short(plan: ResolvedScene, stars: FrameStars, paths: list[Streak]) -> NDArray[np.bool_]:
    """Which stars (n,) are bright for their own short streak in an uneven zone."""
    out = np.zeros(len(stars), bool)
    if not any(streak.uneven for streak in paths):
        return out
    zones = zone_of(plan, stars.x_px, stars.y_px)
    for zone in np.unique(zones):
        mine = zones == zone
        if paths[zone].uneven:
            out[mine] = paths[zone].bright(stars.x_px[mine], stars.y_px[mine], stars.light_e[mine])
    return out


def zone_of(plan: ResolvedScene, x_px: Array, y_px: Array) -> np.ndarray:
    """Zone number (n,) of places; those off the frame belong to the nearest zone."""
    zones = plan.responses.streaks.zones
    row = np.clip(np.floor((y_px + 0.5) * zones / plan.camera.rows), 0, zones - 1)
    column = np.clip(np.floor((x_px + 0.5) * zones / plan.camera.columns), 0, zones - 1)
    return (row * zones + column).astype(np.int64)


def place_targets(plan: ResolvedScene, g: Geometry, everywhere: bool = False) -> list[FrameTarget]:
    """Targets that are in front of the camera and lit, with their light [e-] along their path.

    One that is behind the camera for a part of the exposure sends light in the rest of it alone.
    everywhere : also those whose light does not reach the frame
    """
    electrons = plan.sun_rate_e_s_m2 * plan.facts.area_m2 * plan.integration_s(int(g.frame[0]))
    out = []
    for i in range(len(plan.scene.targets)) if everywhere else reaching(plan, g):
        x, y, light = g.target_x_px[i, 0], g.target_y_px[i, 0], g.target_light[i, 0]
        seen = np.isfinite(x) & np.isfinite(y)
        if not seen.any():
            continue
        light = light * pupil_along(plan.scene, plan.camera, g.offset_s[0], x, y)
        if plan.extinction is not None:
            light = light * path_transmission(plan.extinction, plan.camera, g, x, y)
        nearest = _nearest(seen)
        x, y = x[nearest], y[nearest]
        x0, y0 = float(x[g.middle]), float(y[g.middle])
        lit = light, seen[:-1] & seen[1:], g.target_clear[i, 0], electrons
        path, total = _lit_path(plan, x - x0, y - y0, *lit)
        out.append(seen_as(plan, g, FrameTarget(i, x0, y0, path, total * electrons)))
    return out


def _lit_path(
    plan: ResolvedScene,
    x_px: Array,
    y_px: Array,
    light: Array,
    front: NDArray[np.bool_],
    clear: Array,
    electrons: float,
) -> tuple[Path, float]:
    """A target's path around its place at mid-exposure, and the mean of its light.

    x_px, y_px, light : (K,) at the nodes; front : (K - 1,) where it is before the camera
    clear : (K,) of the Earth; where that is far above zero nothing is cut
    electrons : that light of 1 gives in the exposure
    """
    steps = len(light) - 1
    share = np.where(front, 0.5 * (light[:-1] + light[1:]) / steps, 0.0)
    merge_px = _merge_px(plan, electrons * share, x_px, y_px)
    if clear.min() <= np.abs(np.diff(clear, 2)).max():
        return visible_path(x_px, y_px, light, clear, front, merge_px)
    total = float(share.sum())
    weight = share / total if total > 0 else np.full(steps, 1.0 / steps)
    return curve_through(x_px, y_px, weight, merge_px), total


def _merge_px(plan: ResolvedScene, step_e: Array, x_px: Array, y_px: Array) -> float:
    """How far straight runs of one path (K,) may be off; step_e : (K - 1,) light on its steps."""
    total_e = float(step_e.sum())
    if not total_e > 0.0:
        return MERGE_TOLERANCE_PX
    share = densest_share(x_px, y_px, step_e / total_e)
    return float(plan.merged_px(np.array(total_e), share))


def _nearest(seen: np.ndarray) -> np.ndarray:
    """Of each node (K,) the nearest one that is seen: itself where it is."""
    index = np.flatnonzero(seen)
    if len(index) == len(seen):
        return index
    after = np.clip(np.searchsorted(index, np.arange(len(seen))), 0, len(index) - 1)
    before = np.maximum(after - 1, 0)
    k = np.arange(len(seen))
    nearer = np.abs(index[before] - k) < np.abs(index[after] - k)
    return np.where(nearer, index[before], index[after])


def reaching(plan: ResolvedScene, g: Geometry) -> list[int]:
    """Targets whose path, with all that may be drawn around it, touches the frame."""
    x, y = g.target_x_px[:, 0], g.target_y_px[:, 0]
    size = np.array([_radius_m(t.body) for t in plan.scene.targets])
    with np.errstate(invalid="ignore", divide="ignore"):
        radius = limb_px(size, g.target_range_m[:, 0].min(axis=-1), plan.facts.ifov_rad)
        margin = plan.halo_px + plan.responses.reach_core_px + radius
        low_x, high_x = np.fmin.reduce(x, axis=-1), np.fmax.reduce(x, axis=-1)  # NaN: behind
        low_y, high_y = np.fmin.reduce(y, axis=-1), np.fmax.reduce(y, axis=-1)
        inside = (high_x > -margin) & (low_x < plan.camera.columns + margin)
        inside &= (high_y > -margin) & (low_y < plan.camera.rows + margin)
    return [int(i) for i in np.flatnonzero(inside) if comes_by(plan, x[i], y[i], float(margin[i]))]


def comes_by(plan: ResolvedScene, x: Array, y: Array, margin_px: float) -> bool:
    """Whether a path through places (K,), NaN where it is behind the camera, touches the frame
    and a margin around it."""
    box = (-margin_px, plan.camera.columns + margin_px, -margin_px, plan.camera.rows + margin_px)
    seen = _nearest(np.isfinite(x) & np.isfinite(y))
    x, y = x[seen], y[seen]
    first, last = within(x[:-1], y[:-1], np.diff(x), np.diff(y), box)
    return bool((first <= last).any())


def _radius_m(body: object) -> float:
    """Radius about a body's reference point of what may be drawn of it, 0 where it is a point."""
    if isinstance(body, SphereBody):
        return 0.5 * body.diameter_m
    return float(body.model.radius_m) if isinstance(body, MeshBody) else 0.0


def _mesh_seen(plan: ResolvedScene, g: Geometry, target: FrameTarget) -> FrameTarget:
    """A mesh as a point at the centre of its light, or with its picture where that errs too much.

    The picture is that of mid-exposure.
    """
    from pipeline.execute.mesh_bodies import picture_of, pose_of, spread_of

    targets, budget_e = plan.scene.targets, plan.responses.budget_e
    body = targets[target.index].body
    assert isinstance(body, MeshBody)
    number = sum(isinstance(t.body, MeshBody) for t in targets[: target.index])
    distance = float(g.target_range_m[target.index, 0, g.middle])
    radius = float(limb_px(body.model.radius_m, distance, plan.facts.ifov_rad))
    scale = radius / body.model.radius_m  # of the whole picture, as of its outermost point
    if radius < POINT_RADIUS_PX or target.light_e <= 0.0:
        return replace(target, radius_px=radius)
    blur = plan.responses.blur
    pose = pose_of(body, g.target_pose[number, 0], g.target_pose_s[number, 0])
    found = spread_of(pose)
    error = point_curvature(blur) * 5.0 * found.variance_m2 * scale**2  # a sphere's is r^2/5
    error += point_slope(blur) * found.off_m * scale
    if target.light_e * error > budget_e and found.variance_m2 > 0.0:
        seen = picture_of(pose, scale, blur, budget_e / target.light_e)
        return replace(target, radius_px=radius, body=seen)
    x, y = target.x_px + found.x_m * scale, target.y_px + found.y_m * scale
    return replace(target, x_px=x, y_px=y, radius_px=radius)


def seen_as(plan: ResolvedScene, g: Geometry, target: FrameTarget) -> FrameTarget:
    """The target as a point where its light is, or with its disc where that shows.

    The disc and its lit side are those of mid-exposure.
    """
    body = plan.scene.targets[target.index].body
    if isinstance(body, MeshBody):
        return _mesh_seen(plan, g, target)
    if not isinstance(body, SphereBody):
        return target
    distance = float(g.target_range_m[target.index, 0, g.middle])
    radius = float(limb_px(0.5 * body.diameter_m, distance, plan.facts.ifov_rad))
    if radius < POINT_RADIUS_PX:
        return replace(target, radius_px=radius)
    phase = min(math.pi, max(0.0, float(g.target_phase_rad[target.index, 0, g.middle])))
    blur, budget_e = plan.responses.blur, plan.responses.budget_e
    axes, perspective, stretch = g.attitude[0, g.middle], MIDDLE, 1.0
    off_e = target.light_e * point_slope(blur) * radius  # what a pixel errs by, moved by that much
    if MOST_OFF * off_e > UNMOVED * budget_e:
        turned, found = _perspective_at(plan, g, target)
        grown = found.stretch((-radius, radius, -radius, radius))
        off = max(abs(v - 1.0) for v in (found.xx, found.yy, grown))
        if UNMOVED * budget_e < off * off_e < math.inf:
            axes, perspective, stretch = turned, found, grown
    angle, limb = _sun_angle(g, target.index, distance, axes), radius * stretch
    if target.light_e * point_curvature(blur) * limb**2 > budget_e:
        sphere = Sphere(radius, phase, angle)
        seen = sphere if perspective is MIDDLE else OffAxis(sphere, perspective)
        return replace(target, radius_px=limb, body=seen)
    off = float(photocentre_offset(radius, phase))
    x, y = perspective.forward(off * math.cos(angle), off * math.sin(angle))
    return replace(target, x_px=target.x_px + x, y_px=target.y_px + y, radius_px=limb)


def _perspective_at(
    plan: ResolvedScene, g: Geometry, target: FrameTarget
) -> tuple[Array, Perspective]:
    """The camera's axes (3, 3) turned to a target at mid-exposure, and how it shows what lies
    across the line of sight there: gnomonic, with its distortion as it is at that place."""
    attitude, ifov = g.attitude[0, g.middle], plan.facts.ifov_rad
    towards = deproject(plan.camera, attitude, np.array([target.x_px]), np.array([target.y_px]))[0]
    forward = float(attitude[2] @ towards)
    turned = attitude[:2] @ towards / (1.0 + forward)
    across = attitude[:2] - turned[:, None] * (towards + attitude[2])
    step = STEP_PX * ifov * np.concatenate([across, -across])
    x, y = project(plan.camera, attitude, towards + step)
    xx, xy, yx, yy = (np.concatenate([x[:2] - x[2:], y[:2] - y[2:]]) / (2.0 * STEP_PX)).tolist()
    wx, wy = (across @ attitude[2] * (ifov / forward)).tolist()
    return np.vstack([across, towards]), Perspective(xx, xy, yx, yy, wx, wy)


def _sun_angle(g: Geometry, index: int, distance_m: float, axes: Array) -> float:
    """Direction of the Sun as seen at a target, from the first of three axes (3, 3) towards the
    second: +x (columns) and +y (rows) [rad]."""
    towards = g.target_direction[index, 0]
    place = g.observer_m[0, g.middle] + distance_m * towards
    sun = g.sun_m[0, g.middle] - place
    x, y, _ = axes @ (sun - (sun @ towards) * towards)
    return math.atan2(float(y), float(x))
