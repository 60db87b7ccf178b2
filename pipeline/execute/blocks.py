"""Light that is drawn block by block: wings on a coarse grid, and crowds of stars by transforms.

Blocks are fixed parts of the focal plane, whatever the tiles are, so that the bits do not depend
on tiles. A block is drawn once and serves all tiles that it overlaps.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from pipeline.arrays import Array, FrameStars, Geometry, concatenate, select
from pipeline.execute.sources import (
    FrameTarget,
    drawing_order,
    excursion_px,
    place_targets,
    setting_stars,
    streaks,
    too_short,
    whole_stars,
    zone_of,
)
from pipeline.execute.tables import kernel_of, spectral_of, spectral_plan_of, streak_of
from pipeline.physics.drawing.extended import spread_body
from pipeline.physics.drawing.quadrature import affordable
from pipeline.physics.drawing.spectral import Sources, draw_points, draw_spectral
from pipeline.physics.drawing.spectral_plan import brightest_for
from pipeline.physics.drawing.wings import WingGrid, convolve, spread, wing_grid
from pipeline.physics.motion.points import points_of_many, points_per_px
from pipeline.physics.motion.streak import POINT, Path, within
from pipeline.physics.psf.pupil import Blur
from pipeline.plan.accuracy import UNSEEN, crowd_error_e
from pipeline.plan.plan import Plan
from pipeline.plan.response.own_paths import star_offsets
from pipeline.plan.response.responses import CoreClass, first_above
from pipeline.plan.response.streaks import Streak, near_share, points_to, together_e
from pipeline.plan.tiles import BLOCK_PX, Tile, cut_up, distance_px

Spectrum = NDArray[np.complex128]

POINTS_AT_ONCE = 2**18  # of stars along their own paths, that are spread together
MOST_POINTS = 65_536  # of a body along its path, that are spread one by one
_POINT = np.zeros(1), np.zeros(1), np.ones(1)  # y, x and share of the light of a body


@dataclass(frozen=True)
class LightBlock:
    """The light of one block of the focal plane that its tiles take over.

    grid, star_wings, target_wings : the wings' grid and its fields; None where there are none
    crowd_e : (rows, columns) light of the stars drawn together, None where stamps draw all
    crowd_limit_e : stars of at most so much light are in it; own_limits_e : and those of each core
        class of at most so much, along their own paths
    wing_error_e : what the wings of the densest crowd of stars and of targets around may err by
    """

    place: Tile
    grid: WingGrid | None
    star_wings: Array | None
    target_wings: Array | None
    crowd_e: NDArray[np.floating] | None
    crowd_limit_e: float
    own_limits_e: tuple[float, ...]
    wing_error_e: float

    def in_crowd(self, plan: Plan, stars: FrameStars, paths: list[Streak]) -> NDArray[np.bool_]:
        """Which stars (n,) are in the block's own image already."""
        if self.crowd_e is None:
            return np.zeros(len(stars), bool)
        alike = (stars.light_e <= self.crowd_limit_e) & ~too_short(plan, stars, paths)
        if not any(self.own_limits_e):
            return alike
        own_e = np.array([*self.own_limits_e, 0.0])[class_of(plan, stars.light_e)]
        return alike | (stars.light_e <= own_e)


def plan_blocks(plan: Plan, most_stars: float) -> tuple[Tile, ...]:
    """The blocks of a frame; none where there are no wings and too few stars for transforms.

    most_stars : no frame holds more.
    """
    r = plan.responses
    if not r.spacing_px and most_stars < min(r.crowds_from, default=math.inf):
        return ()
    return cut_up(plan.scene.sensor.shape, (BLOCK_PX, BLOCK_PX))


def class_of(plan: Plan, light_e: Array) -> np.ndarray:
    """Core class (n,) of stars by their light: the first whose limit they do not exceed.

    One more than the last for stars that exceed all: these are drawn by quadrature.
    """
    return first_above(light_e, [c.brightest_e for c in plan.responses.classes])


def target_class(plan: Plan, target: FrameTarget) -> int:
    """Core class of a target; one more than the last where it is drawn by quadrature.

    Bodies with a size and too long paths are in the last class however bright they are.
    """
    r, shape = plan.responses, plan.scene.sensor.shape
    k = int(first_above(np.array([target.light_e]), [c.target_e for c in r.classes])[0])
    if k < len(r.classes):
        return k
    serves = target.body is None and all(affordable(b, target.path, shape) for b in r.blurs)
    return k if serves else k - 1


def parts_along(
    plan: Plan, path: Path, x_px: float, y_px: float, light_e: float, step_px: float
) -> list[tuple[Blur, Path, float]]:
    """(response, path, light [e-]) of the parts that a source is drawn by: of a field of responses
    the light of each step of so many px is shared out among those around it."""
    field = plan.responses.field
    if field is None:
        return [(plan.responses.blur, path, light_e)]
    return [(b, part, light_e * s) for b, part, s in field.along(path, x_px, y_px, step_px)]


def core_radius_px(plan: Plan, target: FrameTarget) -> float:
    """Where the core of a body with a size ends."""
    return plan.responses.classes[target_class(plan, target)].radius_px


def body_parts(plan: Plan, target: FrameTarget, finer: int = 1) -> list[tuple[Blur, Path, float]]:
    """The same of a body with a size, as if all were in its middle. finer : times the steps"""
    path, place = target.path, (target.x_px, target.y_px, target.light_e)
    step_px = plan.field_step_px(path, core_radius_px(plan, target), target.light_e) / finer
    return parts_along(plan, path, *place, step_px)


def is_near(stars: FrameStars, tile: Tile, reach: float) -> NDArray[np.bool_]:
    """Which stars (n,) are within `reach` pixels of a tile."""
    place = (tile.y0, tile.x0, tile.rows, tile.columns)
    return np.asarray(distance_px(stars.x_px, stars.y_px, *place) < reach)


def around(stars: FrameStars, tile: Tile, reach: float) -> FrameStars:
    """These stars, in drawing order."""
    return drawing_order(stars, is_near(stars, tile, reach))


def render_block(plan: Plan, g: Geometry, place: Tile, parts: list[FrameStars]) -> LightBlock:
    """Wings of all sources around a block, and its stars where they are many."""
    reach = plan.halo_px + excursion_px(plan, g)
    every = around(concatenate(parts, FrameStars), place, reach)
    stars, setting = whole_stars(every), setting_stars(plan, g, every)
    targets = place_targets(plan, g) if plan.responses.spacing_px else []
    error_e = _wing_error_e(plan, every, targets)
    paths = streaks(plan, g) if len(stars) else []
    grid, star_wings, target_wings = _wings(plan, place, reach, stars, paths, setting, targets)
    crowd, limit_e, own_e = _crowds(plan, g, place, stars, paths)
    return LightBlock(place, grid, star_wings, target_wings, crowd, limit_e, own_e, error_e)


def _wing_error_e(plan: Plan, stars: FrameStars, targets: list[FrameTarget]) -> float:
    """What the wings of sources around a block may err by in one pixel [e-]: of the densest crowd
    of stars, and of all targets; those that err by UNSEEN of their part or less are omitted."""
    r = plan.responses
    if not r.spacing_px:
        return 0.0
    errors = np.array([c.wing_error for c in r.classes] + [0.0])
    error_e = errors[class_of(plan, stars.light_e)] * stars.light_e
    seen = error_e > UNSEEN * r.budget_e
    x, y, sides = stars.x_px[seen], stars.y_px[seen], r.crowd_sides_px
    crowd_e = crowd_error_e(np.zeros(len(x)), x, y, error_e[seen], *sides)
    errors = np.array([c.target_error for c in r.classes] + [0.0])
    return crowd_e + math.fsum(errors[target_class(plan, t)] * t.light_e for t in targets)


def _crowds(
    plan: Plan, g: Geometry, place: Tile, stars: FrameStars, paths: list[Streak]
) -> tuple[NDArray[np.floating] | None, float, tuple[float, ...]]:
    """The stars of a block that are drawn together, and the light up to which those of the first
    core class are with common streaks, and those of each along their own paths."""
    cores = plan.responses.classes
    drawn, limits = list[NDArray[np.floating] | None](), [0.0] * len(cores)
    for k, core in enumerate(cores):
        if not core.together_from:
            continue
        mine = select(stars, class_of(plan, stars.light_e) == k)
        if len(mine) >= core.together_from:
            one, limits[k] = _own_crowd(plan, g, place, core, mine, paths)
            drawn.append(one)
    limit = 0.0
    if not any(limits[:1]):
        one, limit = _crowd(plan, place, stars, paths)
        drawn.append(one)
    images = [one for one in drawn if one is not None]
    return sum(images[1:], images[0]) if images else None, limit, tuple(limits)


def _own_crowd(
    plan: Plan,
    g: Geometry,
    place: Tile,
    core: CoreClass,
    stars: FrameStars,
    paths: list[Streak],
) -> tuple[NDArray[np.floating] | None, float]:
    """Stars of a core class together, each as points along its own path, and the light up to which
    they are drawn; none where no transform serves."""
    r = plan.responses
    shape, points = (place.rows, place.columns), points_to(r.crowd_band, paths)
    asked = core.radius_px, POINT, shape, len(stars) * points, r.budget_e / core.together_e
    near = _near(plan, place, core.radius_px + _farthest(paths))
    limit = min(core.brightest_e, together_e(r.streaks, paths))
    share = max(near_share(streak, core.radius_px) for streak in paths)
    for blur in near:
        spectral = spectral_plan_of(blur, *asked)
        if spectral is None:
            return None, 0.0
        limit = min(limit, brightest_for(spectral, r.budget_e, share))
    served, image = select(stars, stars.light_e <= limit), np.zeros(shape)
    if not len(served):
        return None, 0.0
    for blur in near:
        spectral, table = spectral_of(blur, *asked)
        along = _along_own(plan, g, served, blur, math.sqrt(2.0) * spectral.limit, points)
        image += draw_points(spectral, table, along, (place.y0, place.x0))
    return image, limit


def _along_own(
    plan: Plan, g: Geometry, stars: FrameStars, blur: Blur, band: float, points: int
) -> Iterator[tuple[Array, Array, Array]]:
    """x, y [px] and light [e-] of stars as about so many points each, of some stars at a time:
    their part in one response, for waves up to a band [cycles/px]."""
    aberration, changes = plan.scene.star_effects["aberration"], plan.responses.streaks.light
    nodes = g.nodes + (0 if changes is None else changes.steps)
    at_once = max(1, POINTS_AT_ONCE // max(points, nodes))
    for first in range(0, len(stars), at_once):
        some = slice(first, first + at_once)
        x, y, light = (v[some, None] for v in (stars.x_px, stars.y_px, stars.light_e))
        offsets = star_offsets(plan.camera, g, x[:, 0], y[:, 0], aberration, changes)[:, :, 0]
        for alike in _as_fast(offsets, points_per_px(band)):
            paths = offsets[:, alike]
            (along_x, along_y), share = points_of_many(paths, min(band, plan.responses.band))
            places = (x[alike] + along_x).ravel(), (y[alike] + along_y).ravel()
            light_e = (light[alike] * share).ravel()
            for one, which, part_e in plan.responses.parts(*places, light_e):
                if one == blur:
                    yield places[0][which], places[1][which], part_e


def _as_fast(offsets: Array, per_px: float) -> Iterator[slice | NDArray[np.intp]]:
    """Which of the stars of offsets (2, n, K) are worked out together, as so many points a px of
    the fastest: all, or few of those that are much faster, as beside a very wide field."""
    steps = offsets.shape[-1] - 1
    wanted = 1.0 + per_px * steps * np.hypot(*np.diff(offsets, axis=-1)).max(axis=-1)
    if len(wanted) * wanted.max() <= 2.0 * POINTS_AT_ONCE:
        yield slice(None)
        return
    order = np.argsort(wanted, kind="stable")
    while len(order):
        held = wanted[order] * np.arange(1, len(order) + 1) <= POINTS_AT_ONCE
        count = max(1, int(np.count_nonzero(held)))
        yield order[:count]
        order = order[count:]


def _crowd(
    plan: Plan, place: Tile, stars: FrameStars, paths: list[Streak]
) -> tuple[NDArray[np.floating] | None, float]:
    """The stars of the first core class together, and the light up to which they are drawn."""
    r = plan.responses
    if not r.spectral_from or len(stars) < r.spectral_from:
        return None, 0.0
    zones = zone_of(plan, stars.x_px, stars.y_px)
    found = [piece.path for zone in np.unique(zones) for piece in paths[zone].pieces]
    longest = max(found, key=lambda p: p.length_px)
    shape, radius = (place.rows, place.columns), r.classes[0].radius_px
    asked = radius, longest, shape, len(stars), r.budget_e / r.crowd_e
    near = _near(plan, place, radius + _farthest(paths))
    limit = min(r.classes[0].brightest_e, *(paths[zone].own_from_e for zone in np.unique(zones)))
    for blur in near:
        spectral = spectral_plan_of(blur, *asked)
        if spectral is None:
            return None, 0.0
        limit = min(limit, brightest_for(spectral, r.budget_e))
    image: NDArray[np.floating] | None = None
    for blur, sources in _crowd_sources(plan, near, stars, limit, paths).items():
        engine = spectral_of(blur, *asked)
        one = draw_spectral(*engine, sources, (place.y0, place.x0))
        image = one if image is None else image + one
    return image, limit


def _crowd_sources(
    plan: Plan, near: tuple[Blur, ...], stars: FrameStars, limit: float, paths: list[Streak]
) -> dict[Blur, list[Sources]]:
    """The stars of up to so much light, by the responses near a block that have a part in them."""
    groups: dict[Blur, list[Sources]] = {blur: [] for blur in near}
    zones, short = zone_of(plan, stars.x_px, stars.y_px), too_short(plan, stars, paths)
    for zone in np.unique(zones):
        mine, streak = (zones == zone) & (stars.light_e <= limit) & ~short, paths[zone]
        x, y, light = stars.x_px[mine], stars.y_px[mine], stars.light_e[mine]
        for piece in streak.pieces:
            dx, dy = streak.at(piece.centre, x, y)
            at_x, at_y = x + dx, y + dy
            for blur, which, part in plan.responses.parts(at_x, at_y, light * piece.share):
                if blur in groups:
                    groups[blur].append(Sources(at_x[which], at_y[which], part, piece.path))
    return {blur: sources for blur, sources in groups.items() if sources}


def _near(plan: Plan, place: Tile, margin_px: float) -> tuple[Blur, ...]:
    """The responses of all stars whose light may reach a block from within a margin around it."""
    y1, x1 = place.y0 + place.rows, place.x0 + place.columns
    return plan.responses.near(
        place.y0 - margin_px, y1 + margin_px, place.x0 - margin_px, x1 + margin_px
    )


def _farthest(paths: list[Streak]) -> float:
    """Farthest that light of a star is from its place, twice, and some pixels [px]."""
    return 2.0 * max(float(np.hypot(s.path.x_px, s.path.y_px).max()) for s in paths) + 8.0


def _wings(
    plan: Plan,
    place: Tile,
    reach: float,
    stars: FrameStars,
    paths: list[Streak],
    setting: list[FrameTarget],
    targets: list[FrameTarget],
) -> tuple[WingGrid | None, Array | None, Array | None]:
    """The wings' grid around a block, and the fields of its stars and of the targets.

    setting : stars with paths of their own
    """
    r = plan.responses
    if not r.spacing_px:
        return None, None, None
    grid = wing_grid((place.rows, place.columns), (place.y0, place.x0), r.spacing_px, reach)
    path = paths[_middle_zone(plan, place)].path if paths else None
    light = stars.light_e
    classes = class_of(plan, light)
    star_light = _point_wings(plan, grid, stars.x_px, stars.y_px, light, classes)
    if star_light is not None and path is not None:
        star_light *= streak_of(grid, path)
    star_light = _sum(star_light, _target_wings(plan, grid, setting))
    target_light = _target_wings(plan, grid, targets)
    star_wings, target_wings = (
        None if spectrum is None else convolve(spectrum, grid)
        for spectrum in (star_light, target_light)
    )
    return grid, star_wings, target_wings


def _sum(one: Spectrum | None, other: Spectrum | None) -> Spectrum | None:
    """Two spectra together, in place of the first; None where there is neither."""
    if one is None or other is None:
        return other if one is None else one
    one += other
    return one


def _wings_of(light_e: Array, kernel: Spectrum) -> Spectrum:
    """Spectrum of the wings of light on a grid."""
    out: Spectrum = scipy.fft.rfft2(light_e)
    out *= kernel
    return out


def _target_wings(plan: Plan, grid: WingGrid, targets: list[FrameTarget]) -> Spectrum | None:
    """Spectrum of the wings of sources along paths of their own.

    A body that the grid sees as hardly more than a point is a few points along its path.
    """
    narrow: list[FrameTarget] = []
    wide: list[FrameTarget] = []
    for target in targets:
        (wide if _is_wide(target, grid) else narrow).append(target)
    total = _point_wings(plan, grid, *_target_points(plan, narrow, grid))
    for target in wide:
        total = _sum(total, _body_wings(plan, grid, target))
    return total


def _is_wide(target: FrameTarget, grid: WingGrid) -> bool:
    """Whether a body has more points on the wings' grid than are spread along its path."""
    if target.body is None or 2.0 * target.radius_px > grid.spacing_px:
        return target.body is not None
    points = target.body.points(1.0 / grid.spacing_px)[2].size
    return points * math.fsum(_counts(target.path, grid)) > MOST_POINTS


def _counts(path: Path, grid: WingGrid) -> NDArray[np.int64]:
    """Points (segments,) that stand for each segment of a path on the wings' grid."""
    length = np.hypot(np.diff(path.x_px), np.diff(path.y_px))
    return np.maximum(1, np.ceil(length / (grid.spacing_px / 2.0))).astype(np.int64)


def _point_wings(
    plan: Plan, grid: WingGrid, x: Array, y: Array, light: Array, classes: np.ndarray
) -> Spectrum | None:
    """Spectrum of the wings of points at rest; classes : (n,) core classes of their sources."""
    total: Spectrum | None = None
    r = plan.responses
    for k, core in enumerate(r.classes):
        mine = np.flatnonzero(classes == k)
        if not mine.size:
            continue
        for blur, which, part_e in r.parts(x[mine], y[mine], light[mine]):
            kernel = kernel_of(blur, core.radius_px, grid, r.reach_px)
            at = mine[which]
            total = _sum(total, _wings_of(spread(grid, x[at], y[at], part_e), kernel))
    return total


def _body_wings(plan: Plan, grid: WingGrid, target: FrameTarget) -> Spectrum | None:
    """Spectrum of the wings of an extended body; None where it is off the grid."""
    assert target.body is not None
    radius, total = core_radius_px(plan, target), None
    for blur, path, light_e in body_parts(plan, target):
        light = spread_body(grid, target.body, (target.y_px, target.x_px), light_e)
        if light.any():
            kernel = kernel_of(blur, radius, grid, plan.responses.reach_px)
            total = _sum(total, _wings_of(light, kernel) * streak_of(grid, path))
    return total


def _target_points(
    plan: Plan, targets: list[FrameTarget], grid: WingGrid
) -> tuple[Array, Array, Array, Array]:
    """Targets as points along their paths, dense enough for the wings' grid, where they are near
    it: (x, y, light, core class of the target)."""
    points = [_points_near(plan, t, grid) for t in targets]
    if not points:
        return (np.empty(0),) * 4
    x, y, light, classes = (np.concatenate(of) for of in zip(*points, strict=True))
    return x, y, light, classes


def _points_near(plan: Plan, t: FrameTarget, grid: WingGrid) -> tuple[Array, Array, Array, Array]:
    """A target as points, as `_target_points`: the even parts of its path's segments of which the
    middle may be on the grid."""
    x0, y0, dx, dy = t.path.x_px[:-1], t.path.y_px[:-1], np.diff(t.path.x_px), np.diff(t.path.y_px)
    far = 2.0 * grid.spacing_px
    left, top = grid.x0_px - far - t.x_px, grid.y0_px - far - t.y_px
    wide, high = (2.0 * far + n * grid.spacing_px for n in (grid.columns, grid.rows))
    first, last = within(x0, y0, dx, dy, (left, left + wide, top, top + high))
    met, count = np.flatnonzero(first <= last), _counts(t.path, grid)
    begin = np.maximum(0, (first[met] * count[met]).astype(np.int64) - 1)
    end = np.minimum(count[met], (last[met] * count[met]).astype(np.int64) + 2)
    many = end - begin
    k = np.repeat(met, many)
    part = np.arange(len(k)) - np.repeat(np.cumsum(many) - many - begin, many)
    at = (part + 0.5) / count[k]
    body_y, body_x, share = _POINT if t.body is None else t.body.points(1.0 / grid.spacing_px)
    x = np.add.outer(body_x, t.x_px + x0[k] + at * dx[k]).ravel()
    y = np.add.outer(body_y, t.y_px + y0[k] + at * dy[k]).ravel()
    light = np.multiply.outer(share, t.light_e * t.path.weight[k] / count[k]).ravel()
    return x, y, light, np.full(x.size, float(target_class(plan, t)))


def _middle_zone(plan: Plan, block: Tile) -> int:
    """The zone whose streak a block's wings take."""
    x, y = block.x0 + 0.5 * block.columns, block.y0 + 0.5 * block.rows
    return int(zone_of(plan, np.array([x]), np.array([y]))[0])
