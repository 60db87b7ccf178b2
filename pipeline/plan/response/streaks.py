"""Common streaks: zones whose stars move alike, and the pieces of time that they are drawn in.

Stars of one frame move along almost the same path. In each piece of the exposure all stars of a
zone get one shape, placed where each star's own light is in that piece; so what remains of the
difference between two paths is divided by the number of pieces, and few tables serve all stars.
Stars so bright that even that would show are drawn in more pieces, and those of which that would
show along their own path, one by one.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Array, Geometry
from pipeline.physics.motion.points import bend_px, points_per_px
from pipeline.physics.motion.streak import (
    HALVINGS,
    LONGEST_PIECE_PX,
    Path,
    densest_share,
    light_near,
    path_through,
)
from pipeline.physics.positions.focal_plane import Camera, ifov_rad
from pipeline.plan.pointing.star_light import ChangingLight, steps_for
from pipeline.plan.response.own_paths import FINEST_MERGE_PX, exact_path, star_offsets
from pipeline.plan.response.zones import CHECKS, NODES, Zone, biquadratic, lagrange, zone_of_frame
from pipeline.spec.scene import CELL_PX, USUAL_FRACTION

__all__ = [
    "StreakSegment",
    "Streak",
    "StreakPlan",
    "centroid",
    "exact_path",
    "merged_px",
    "over_field",
    "plan_streaks",
    "resting",
    "zone_streak",
]

PATH_STEP_PX = 2.0**-11  # shapes are rounded to it, so that alike ones share their tables
MERGE_TOLERANCE_PX = 2e-4  # these two at the usual accuracy
SPREAD_TOLERANCE_PX = 4e-3
MOST_PIECES, MOST_OF_A_FRAME = 16, 1024  # that plans ask for; of frames that turn more than theirs
SHORTEST_PIECE_PX, FINER_SHAPE = 2.0, 4.0  # of those of bright stars; times finer are these rounded
ROUNDED = 2.2e-16  # rad: what directions are rounded to, in float64
MOST_NODES = 17  # by which the length of a star's streak is taken
SLACK = 1.5  # over what the plan knows of some frames: what others may differ or be longer by
SHOWN = 0.02  # of the budget: what merging the nodes of own paths may err by
POINTS = 0.25  # and what the table of the points may, that such paths are drawn as
STEP_PART = 0.2  # and what responses of the middle of steps may, where these change over the field
EVEN = 0.1  # of a tolerance: what light that changes may be off between steps of equal light
UNKNOWN_E = 1e12  # of the brightest star, where it is not known


@dataclass(frozen=True)
class StreakSegment:
    """One part of the exposure: the shape of its light about its centroid, and where that stands.

    path : on the PATH_STEP_PX grid, weights of sum one; share : part of the light
    centre : (2, 3, 3) x and y of the centroid, from the star's place at mid-exposure, for stars
        at the zone's NODES (rows of v, columns of u)
    """

    path: Path
    share: float
    centre: Array


@dataclass(frozen=True)
class Streak:
    """How the stars of a zone move in one frame.

    path : of the star in the middle of the zone, from its place at mid-exposure
    followed : (K, 2, 3, 3) places at equal steps of time, or of light where that changes, of stars
        at the zone's NODES, from mid-exposure
    own_from_e : stars of more light are drawn along their own path
    uneven : streaks of some stars may be shorter than that in the middle by more than SLACK, as
        around the centre of a turn: what is bright depends on each one's own length
    """

    zone: Zone
    path: Path
    pieces: tuple[StreakSegment, ...]
    followed: Array
    own_from_e: float
    uneven: bool = False

    @property
    def start(self) -> Array:
        """(2, 3, 3) first places of the paths of stars at the zone's NODES."""
        return self.followed[0]

    @property
    def end(self) -> Array:
        """(2, 3, 3) and their last ones."""
        return self.followed[-1]

    def at(self, table: Array, x_px: Array, y_px: Array) -> tuple[Array, Array]:
        """A quantity known at the zone's NODES for stars at (x, y): biquadratic interpolation."""
        return biquadratic(table, *self.zone.uv(x_px, y_px))

    def places_px(self, x_px: Array, y_px: Array) -> Array:
        """Places (m, 2, n) of stars of the zone from mid-exposure, MOST_NODES of each at most."""
        u, v = self.zone.uv(x_px, y_px)
        nodes = np.unique(np.linspace(0, len(self.followed) - 1, MOST_NODES).astype(np.intp))
        return np.array([biquadratic(self.followed[k], u, v) for k in nodes])

    def lengths_px(self, x_px: Array, y_px: Array) -> Array:
        """Lengths (n,) of the streaks of stars of the zone."""
        steps = np.diff(self.places_px(x_px, y_px), axis=0)
        return np.asarray(np.hypot(*steps.swapaxes(0, 1)).sum(axis=0))

    def bright(self, x_px: Array, y_px: Array, light_e: Array) -> NDArray[np.bool_]:
        """Which stars (n,) of the zone are drawn along their own path: by light per px of it."""
        if not self.uneven:
            return np.asarray(light_e > self.own_from_e)
        own_px = np.clip(self.lengths_px(x_px, y_px), 1.0, self.path.length_px)
        return np.asarray(light_e > self.own_from_e * own_px / self.path.length_px)


@dataclass(frozen=True)
class StreakPlan:
    """Zones per axis, pieces of an exposure, and what is left: px from a star's own path.

    shapes : different pieces that a frame has at most
    step_px, merge_px : what shapes are rounded to, and how far their bends may be off
    own_from_e_px : light per px of path from which on stars are drawn along their own path
    floor_e, budget_e : noise of a pixel without sources, and what streaks may err by there
    own_px : px from a star's own path, where that is interpolated across its zone
    rounded_px : what places along paths are rounded to
    photons : light has noise of its own, so that a pixel with more of it may err by more
    at_rest : what a pixel errs by of a star's light where every shape is a point
    shortest_px : of all streaks; tolerance_px : what `spread_px` may be
    light : what changes the light along them, None where it is even; light_px : how far that is
        off between its steps
    field_px : the same of responses that change over the field, of which pieces take those of
        their middle
    finer : the same in more pieces, for brighter stars; None where that leaves no less
    """

    zones: int
    pieces: int
    spread_px: float
    longest_px: float
    shapes: int
    step_px: float
    merge_px: float
    own_from_e_px: float = math.inf
    floor_e: float = 1.0
    budget_e: float = math.inf
    own_px: float = math.inf
    rounded_px: float = FINEST_MERGE_PX
    photons: bool = True
    at_rest: float = math.inf
    shortest_px: float = 0.0
    tolerance_px: float = SPREAD_TOLERANCE_PX
    light: ChangingLight | None = None
    light_px: float = 0.0
    field_px: float = 0.0
    finer: StreakPlan | None = None

    @property
    def rounding_px(self) -> float:
        """How far off light is for what shapes are rounded to."""
        return 0.5 * self.step_px + self.merge_px

    @property
    def off_px(self) -> float:
        """How far light may be from where a star's own path has it, of stars with one shape.

        A pixel errs by at most that part of the light of a px of path.
        """
        apart = min(self.spread_px + self.rounding_px + self.light_px, self.longest_px)
        return min(apart + self.field_px, self.at_rest)

    @property
    def still(self) -> bool:
        """Whether every shape is a point: the longest is rounded to none."""
        return self.longest_px <= 0.25 * self.step_px

    def error_e(self, light_e: float) -> float:
        """What a star of so much light may err by for having a streak in common [e-].

        In a pixel at the noise floor: one with the star's light may err by more as it has noise.
        """
        return min(self.off_px * light_e, self.budget_e) if self.off_px else 0.0

    def errors_e(self, light_e: Array, points_e: Array) -> Array:
        """What each of the stars there are (n,) errs by, as `error_e`: of one shape by its light;
        too bright for that by one of more pieces, or by merging its own path (the brightest by the
        rounding of places), and by the table of its points [e-].

        points_e : what the table that serves each errs by, of all its light; 0 without one
        """
        longest, shortest = (
            max(1.0, v) for v in (self.longest_px * SLACK, self.shortest_px / SLACK)
        )
        per_px = np.minimum(light_e / shortest, self.own_from_e_px)
        hidden = self.photons and not self.still
        error_e = self.off_px * per_px / np.sqrt(1.0 + hidden * per_px / self.floor_e**2)
        shown_e = SHOWN * self.budget_e
        bright_e = shown_e + np.maximum(shown_e, self.rounded_e(light_e))
        bright_e = bright_e + np.minimum(points_e, POINTS * self.budget_e)
        bright_e = bright_e + STEP_PART * self.budget_e * bool(self.field_px)
        if self.finer is not None:
            bright_e = np.maximum(bright_e, self.finer.errors_e(light_e, points_e))
        error_e = np.where(light_e > self.own_from_e_px * longest, bright_e, error_e)
        return np.minimum(error_e, self.budget_e)

    def rounded_e(self, light_e: Array) -> Array:
        """What stars (n,) err by as places along their own paths are rounded, and as light that
        changes is even between steps, halved as paths are [e-]; 0 of points."""
        hidden = allowed_e(light_e, self.floor_e, 1.0, self.photons)
        off_px = self.rounded_px + self.light_px / 4.0**HALVINGS
        return off_px * bool(self.off_px) * light_e / hidden


def plan_streaks(
    camera: Camera,
    ends: Geometry,
    aberration: bool,
    noise_fraction: float = USUAL_FRACTION,
    floor_e: float = 1.0,
    budget_e: float = math.inf,
    photons: bool = True,
    brightest_e: float = UNKNOWN_E,
    light: ChangingLight | None = None,
) -> StreakPlan:
    """Fewest zones, then fewest pieces, whose stars streak alike.

    They do to SPREAD_TOLERANCE_PX at the usual accuracy; a finer one makes all tolerances finer.
    floor_e : noise of a pixel without sources; budget_e : what streaks may err by there. A pixel
    with more light may err by as much more as it has noise. photons : see `StreakPlan`.
    brightest_e : light of the brightest star; light : what changes that of stars, if anything
    """
    finer = 2.0 ** min(0.0, max(-8.0, math.floor(math.log2(noise_fraction / USUAL_FRACTION))))
    tolerance = SPREAD_TOLERANCE_PX * finer
    most = max(1, math.ceil(max(camera.rows, camera.columns) / CELL_PX))
    zones, light_px = 1, 0.0
    if light is not None:
        noise = floor_e, budget_e, photons
        light, light_px = _uneven(light, camera, ends, aberration, brightest_e, noise, tolerance)
    while True:
        offsets = _followed(camera, ends, zones, aberration, light)
        lengths = np.hypot(*np.diff(offsets, axis=-1)).sum(axis=-1)
        longest = float(lengths.max())
        fewest = _power_of_two(longest / LONGEST_PIECE_PX)
        pieces, spread = fewest, _spread_px(offsets, fewest)
        while spread > tolerance and pieces < MOST_PIECES:
            pieces, spread = 2 * pieces, _spread_px(offsets, 2 * pieces)
        if spread <= tolerance or zones >= most:
            shapes = zones**2 * _shapes(offsets, pieces)
            step, merge = PATH_STEP_PX * finer, MERGE_TOLERANCE_PX * finer
            own = _interpolated_px(offsets)
            made = StreakPlan(
                zones,
                pieces,
                spread,
                longest,
                shapes,
                step,
                merge,
                math.inf,
                floor_e,
                budget_e,
                own,
                FINEST_MERGE_PX + ROUNDED / ifov_rad(camera),
                photons,
                shortest_px=float(lengths.min()),
                tolerance_px=tolerance,
                light=light,
                light_px=light_px,
            )
            if not made.off_px:
                return made
            made = replace(made, own_from_e_px=light_from(made.off_px, made))
            return replace(made, finer=_finer(made, offsets))
        zones = min(2 * zones, most)


def _uneven(
    light: ChangingLight,
    camera: Camera,
    ends: Geometry,
    aberration: bool,
    brightest_e: float,
    noise: tuple[float, float, bool],
    tolerance_px: float,
) -> tuple[ChangingLight | None, float]:
    """Light that changes along streaks with the steps that this takes, and how far off they leave
    it; None where even light is off by no more than merging nodes may be for the brightest star.

    noise : as the last of `merged_px`
    """
    even, at_equal = (_followed(camera, ends, 1, aberration, of) for of in (None, light))
    each = (at_equal.shape[-1] - 1) // (even.shape[-1] - 1)
    moved_px = float(np.hypot(*(at_equal[..., ::each] - even)).max())
    longest_px = float(np.hypot(*np.diff(even, axis=-1)).sum(axis=-1).max())
    brightest = np.array(brightest_e or UNKNOWN_E)
    if moved_px <= merged_px(brightest, 1.0 / max(longest_px, 1.0), *noise):
        return None, 0.0
    steps = steps_for(moved_px, EVEN * tolerance_px)
    return replace(light, steps=steps), moved_px / steps**2


def _finer(plan: StreakPlan, offsets: Array) -> StreakPlan | None:
    """The plan in so many more pieces that what is left is about what shapes are rounded to."""
    pieces = plan.pieces * _power_of_two(plan.spread_px / plan.rounding_px)
    while plan.longest_px < SHORTEST_PIECE_PX * pieces:
        pieces //= 2
    if pieces <= plan.pieces or not math.isfinite(plan.own_from_e_px):
        return None
    made = replace(
        plan,
        pieces=pieces,
        spread_px=_spread_px(offsets, pieces),
        shapes=plan.zones**2 * _shapes(offsets, pieces),
        step_px=plan.step_px / FINER_SHAPE,
        merge_px=plan.merge_px / FINER_SHAPE,
        tolerance_px=plan.rounding_px,
    )
    return replace(made, own_from_e_px=light_from(made.off_px, made))


def resting(plan: StreakPlan, curvature: float, slope: float) -> StreakPlan:
    """The plan of stars that move so little that each is a point, at the centroid of its light.

    curvature : what a pixel errs by, per unit light and px^2 of five times the light's variance
    along a path, at most a quarter of its length squared; slope : and per px that the point is off
    (drawing/extended.py)
    """
    error = curvature * 5.0 * plan.longest_px**2 / 4.0 + slope * min(plan.own_px, plan.spread_px)
    made = replace(plan, at_rest=error)
    return replace(made, own_from_e_px=light_from(made.off_px, made))


def over_field(plan: StreakPlan, change: Callable[[float], float]) -> StreakPlan:
    """The plan of streaks over a field of responses.

    change : what a pixel errs by at the ends of a streak of some px that is drawn with the
        responses of its middle, per unit light
    """
    piece_px = plan.longest_px / plan.pieces
    made = replace(
        plan,
        field_px=piece_px * change(piece_px),
        finer=None if plan.finer is None else over_field(plan.finer, change),
    )
    return replace(made, own_from_e_px=light_from(made.off_px, made))


def merged_px(
    light_e: Array, share_per_px: float, floor_e: float, budget_e: float, photons: bool
) -> Array:
    """How far straight runs of a source's own path may be off [px] (n,): by SHOWN of the budget.

    share_per_px : `densest_share` of the path; floor_e, budget_e, photons : as of a StreakPlan
    """
    along_e = np.maximum(light_e, 1e-9) * share_per_px
    most_e = SHOWN * allowed_e(along_e, floor_e, budget_e, photons)
    return np.clip(most_e / along_e, FINEST_MERGE_PX, MERGE_TOLERANCE_PX)


def allowed_e(along_e: Array, floor_e: float, budget_e: float, photons: bool) -> Array:
    """What a pixel may err by that holds so much light [e-] (n,): more as it has more noise."""
    return np.asarray(budget_e * np.sqrt(1.0 + photons * along_e / floor_e**2))


def light_from(off_px: float, plan: StreakPlan) -> float:
    """Light per px of path x [e-] where its error x off equals budget sqrt(1 + x/floor^2) [e-],
    or, where light has no noise of its own, the budget."""
    if off_px == 0.0 or not math.isfinite(plan.budget_e):
        return math.inf
    if not plan.photons:
        return plan.budget_e / off_px
    rise = (plan.budget_e / (off_px * plan.floor_e)) ** 2
    return 0.5 * (rise + math.sqrt(rise * rise + 4.0 * rise * plan.floor_e * plan.floor_e))


def together_e(plan: StreakPlan, paths: list[Streak]) -> float:
    """Light up to which stars of a frame are drawn together, as points along their own paths: what
    their paths err by between nodes is SHOWN of the budget. paths : the common ones of its zones"""
    followed = [np.moveaxis(streak.followed, 0, -1) for streak in paths]
    steps = [np.hypot(*np.diff(places, axis=-1)) for places in followed]
    shortest_px = min(float(step.sum(axis=-1).min()) for step in steps) / SLACK
    off_px = SLACK * max(map(bend_px, followed)) + plan.rounded_px
    densest = max(densest_share(s.path.x_px, s.path.y_px, s.path.weight) for s in paths)
    return light_from(off_px / SHOWN, plan) * min(max(1.0, shortest_px), 1.0 / densest)


def near_share(streak: Streak, radius_px: float) -> float:
    """Largest part of a star's light, of any of the streak's zone, within a radius of a pixel."""
    return 1.0 if streak.uneven else min(1.0, SLACK * light_near(streak.path, radius_px)[0])


def points_to(band: float, paths: list[Streak]) -> int:
    """About how many points, for a band [cycles/px], stand for a star's own path in a frame: as
    if it moved as fast all the time as it does at most."""
    steps = [np.hypot(*np.diff(np.moveaxis(s.followed, 0, -1), axis=-1)) for s in paths]
    fastest_px = max(step.shape[-1] * float(step.max()) for step in steps)
    return math.ceil(points_per_px(band) * fastest_px) + 1


def _power_of_two(n: float) -> int:
    return int(2 ** max(0, math.ceil(math.log2(max(n, 1.0)))))


def _followed(
    camera: Camera, g: Geometry, zones: int, aberration: bool, light: ChangingLight | None = None
) -> Array:
    """(2, zones looked at, points, frames, nodes) offsets of stars from mid-exposure.

    Points are the 3 x 3 NODES and the 4 x 4 CHECKS of the zones in the frame's corners, edges and
    middle, where paths differ most and least; with distortion, of all zones.
    """
    looked_at = sorted({0, zones // 2, zones - 1} if camera.distortion is None else range(zones))
    u, v = (np.concatenate([np.meshgrid(a, a)[k].ravel() for a in (NODES, CHECKS)]) for k in (0, 1))
    places = [zone_of_frame(camera, r, c, zones).places(u, v) for r in looked_at for c in looked_at]
    x, y = np.concatenate([p[0] for p in places]), np.concatenate([p[1] for p in places])
    offsets = star_offsets(camera, g, x, y, aberration, light)
    return offsets.reshape(2, len(places), u.size, *offsets.shape[2:])


def _resampled(offsets: Array, pieces: int) -> Array:
    """Offsets (..., n + 1) at equal times of which each piece has at least two steps."""
    steps = offsets.shape[-1] - 1
    wanted = max(steps, 2 * pieces)
    if wanted == steps:
        return offsets
    at = np.arange(wanted + 1) * (steps / wanted)
    low = np.minimum(at.astype(int), steps - 1)
    t = at - low
    return offsets[..., low] * (1.0 - t) + offsets[..., low + 1] * t


def _in_pieces(offsets: Array, pieces: int) -> tuple[Array, Array]:
    """(..., pieces, steps + 1) offsets piece by piece, and their mean places (..., pieces)."""
    fine = _resampled(offsets, pieces)
    steps = (fine.shape[-1] - 1) // pieces
    index = np.arange(pieces)[:, None] * steps + np.arange(steps + 1)[None, :]
    parts = fine[..., index]
    means = 0.5 * (parts[..., 1:] + parts[..., :-1]).mean(axis=-1)
    return parts, means


def _spread_px(offsets: Array, pieces: int) -> float:
    """Largest distance between a star's own path and the one that it is drawn along [px]."""
    parts, means = _in_pieces(offsets, pieces)
    nodes = NODES.size**2
    shapes = np.moveaxis(parts[:, :, :nodes] - means[:, :, :nodes, ..., None], 2, -1)
    table = np.moveaxis(means[:, :, :nodes], 2, -1)

    def off(at: int, a: float, b: float) -> float:
        """At point `at`, which stands at (a, b) in the zone's own units."""
        place = np.outer(lagrange(np.array([b]))[:, 0], lagrange(np.array([a]))[:, 0]).ravel()
        drawn = (table @ place)[..., None] + shapes[..., nodes // 2]
        return float(np.hypot(*(parts[:, :, at] - drawn)).max())

    worst = 0.0
    for first, axis in ((0, NODES), (nodes, CHECKS)):
        u, v = (m.ravel() for m in np.meshgrid(axis, axis))
        for k, (a, b) in enumerate(zip(u, v, strict=True)):
            worst = max(worst, off(first + k, a, b))
    return worst


def _interpolated_px(offsets: Array) -> float:
    """Largest error of paths that are interpolated across their zone from its NODES [px]."""
    u, v = (m.ravel() for m in np.meshgrid(CHECKS, CHECKS))
    weight = (lagrange(v)[:, None] * lagrange(u)[None, :]).reshape(NODES.size**2, -1)
    at_nodes, at_checks = np.split(offsets, [NODES.size**2], axis=2)
    off = at_checks - np.einsum("czpfk,pq->czqfk", at_nodes, weight)
    return float(np.hypot(*off).max())


def _apart(parts: Array, means: Array) -> float:
    """Largest distance between the shapes at a zone's NODES and the one in its middle [px]."""
    shapes = parts - means[..., None]
    return float(np.hypot(*(shapes - shapes[:, [NODES.size**2 // 2]])).max())


def _shapes(offsets: Array, pieces: int) -> int:
    """Different shapes among the pieces of one zone's frame: one where it moves evenly."""
    parts, means = _in_pieces(offsets, pieces)
    shape = parts[:, :, NODES.size**2 // 2] - means[:, :, NODES.size**2 // 2, ..., None]
    apart = np.abs(shape - shape[..., :1, :]).max()
    return 1 if apart < 0.25 * PATH_STEP_PX else pieces


def zone_streak(
    camera: Camera, g: Geometry, row: int, column: int, plan: StreakPlan, aberration: bool
) -> Streak:
    """The common streak of a zone's stars in the one frame of `g`."""
    zone = zone_of_frame(camera, row, column, plan.zones)
    u, v = (m.ravel() for m in np.meshgrid(NODES, NODES))
    offsets = star_offsets(camera, g, *zone.places(u, v), aberration, plan.light)[:, :, 0]
    middle = NODES.size**2 // 2
    longest = float(np.hypot(*np.diff(offsets, axis=-1)).sum(axis=-1).max())
    count = max(plan.pieces, _power_of_two(longest / LONGEST_PIECE_PX))  # this frame may be faster
    parts, means = _in_pieces(offsets, count)
    allowed = SLACK * max(plan.spread_px, plan.tolerance_px)
    while _apart(parts, means) > allowed and count < MOST_OF_A_FRAME:  # or turn more
        count *= 2
        parts, means = _in_pieces(offsets, count)
    made = []
    for k in range(count):
        path = _rounded(parts[:, middle, k] - means[:, middle, k, None], plan)
        centre = (means[:, :, k] - np.array(centroid(path))[:, None]).reshape(2, 3, 3)
        made.append(StreakSegment(path, 1.0 / count, centre))
    followed = np.moveaxis(offsets, -1, 0).reshape(-1, 2, 3, 3)
    whole = _rounded(offsets[:, middle], plan)
    own_e = plan.own_from_e_px * max(1.0, whole.length_px)
    steps = np.diff(offsets, axis=-1)
    apart = float(np.hypot(*(steps - steps[:, [middle]])).sum(axis=-1).max())
    uneven = whole.length_px > SLACK and SLACK * apart > (SLACK - 1.0) * whole.length_px
    return Streak(zone, whole, tuple(made), followed, own_e, uneven)


def _rounded(places: Array, plan: StreakPlan) -> Path:
    """Path through places at equal times, straight runs merged, on the plan's grid."""
    dx, dy = places
    steps = len(dx) - 1
    path = path_through(dx, dy, np.full(steps, 1.0 / steps), plan.merge_px)
    x, y = (np.round(a / plan.step_px) * plan.step_px + 0.0 for a in (path.x_px, path.y_px))
    return Path(x, y, path.weight)


def centroid(path: Path) -> tuple[float, float]:
    """Mean place of the light of a path (x, y)."""
    middle_x = 0.5 * (path.x_px[1:] + path.x_px[:-1])
    middle_y = 0.5 * (path.y_px[1:] + path.y_px[:-1])
    return float(path.weight @ middle_x), float(path.weight @ middle_y)
