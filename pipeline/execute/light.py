"""Light of the sources in one tile: stars by stamps or from their block, targets, wings."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Array, FrameStars, Geometry, concatenate, select
from pipeline.execute.blocks import (
    LightBlock,
    around,
    body_parts,
    class_of,
    core_radius_px,
    is_near,
    parts_along,
    target_class,
)
from pipeline.execute.guards import guard_brightness, guard_light, guard_stars, inside_tile
from pipeline.execute.sources import (
    FrameTarget,
    excursion_px,
    place_targets,
    setting_stars,
    streaks,
    too_short,
    whole_stars,
    zone_of,
)
from pipeline.execute.tables import core_of, still_core, swept_core, table_of
from pipeline.physics.drawing.along import stamp_along
from pipeline.physics.drawing.crowds import crowd_light
from pipeline.physics.drawing.extended import draw_body
from pipeline.physics.drawing.quadrature import draw_quadrature
from pipeline.physics.drawing.stamps import draw_stamps
from pipeline.physics.drawing.wings import add_wings
from pipeline.physics.motion.points import in_fewer_points, points_along
from pipeline.physics.motion.streak import (
    LONGEST_PIECE_PX,
    POINT,
    Box,
    Path,
    densest_share,
    light_near,
    pieces,
)
from pipeline.physics.psf.response import stamp_at
from pipeline.plan.plan import Plan
from pipeline.plan.response.own_paths import own_paths
from pipeline.plan.response.streaks import POINTS, Streak
from pipeline.plan.tiles import Tile, overlap

Light = tuple[Array, Array, Array, Array]  # x, y [px], light, `crowd_light` [e-] of stars (n,)


def draw_stars(
    plan: Plan, g: Geometry, tile: Tile, parts: list[FrameStars], blocks: list[LightBlock]
) -> Array:
    """Electrons of the stars in a tile: (rows, columns) float64, before the flat."""
    image = np.zeros((tile.rows, tile.columns))
    paths = streaks(plan, g)
    moved, every = excursion_px(plan, g), concatenate(parts, FrameStars)
    reach = _core_reach(plan, paths, moved)
    guard_stars(g, tile, every)
    stars = whole_stars(around(every, tile, reach))
    if not any(b.crowd_e is not None for b in blocks):
        _draw_stamps(plan, g, image, tile, paths, stars)
    else:
        for block in blocks:
            part = overlap(tile, block.place)
            mine = select(stars, ~block.in_crowd(plan, stars, paths) & is_near(stars, part, reach))
            piece = _cut(image, tile, part)
            _draw_stamps(plan, g, piece, part, paths, mine)
            if block.crowd_e is not None:
                piece += _cut(block.crowd_e, block.place, part)
    beyond = class_of(plan, every.light_e) == len(plan.responses.classes)
    alone = select(every, beyond | (every.visible_fraction < 1.0))
    far = around(alone, tile, plan.halo_px + moved)
    for star in setting_stars(plan, g, far):
        _draw_point(plan, image, tile, star)
    draw_along(plan, g, image, tile, whole_stars(far), paths)
    cores_e = float(image.sum())
    for block in blocks:
        add_wings_of(image, tile, block, block.star_wings)
    inside = inside_tile(plan, tile, every.x_px, every.y_px, _sweep(paths))
    guard_light(plan, g, tile, "stars_e", image, cores_e, every.light_e, inside)
    return image


def draw_targets(plan: Plan, g: Geometry, tile: Tile, blocks: list[LightBlock]) -> Array:
    """Electrons of the targets in a tile: (rows, columns) float64, before the flat."""
    image = np.zeros((tile.rows, tile.columns))
    targets = place_targets(plan, g)
    for target in targets:
        guard_brightness(plan, target.x_px, target.y_px, target.light_e)
        if target.body is not None:
            place, radius = (target.y_px, target.x_px), core_radius_px(plan, target)
            for blur, path, light in body_parts(plan, target):
                core = core_of(blur, radius)
                draw_body(image, (tile.y0, tile.x0), target.body, core, place, light, path)
            continue
        _draw_point(plan, image, tile, target)
    cores_e = float(image.sum())
    for block in blocks:
        add_wings_of(image, tile, block, block.target_wings)
    every = np.array([(t.x_px, t.y_px, t.light_e) for t in targets]).reshape(-1, 3)
    sweep = max((t.path.length_px + t.radius_px for t in targets), default=0.0)
    inside = inside_tile(plan, tile, every[:, 0], every[:, 1], sweep)
    guard_light(plan, g, tile, "targets_e", image, cores_e, every[:, 2], inside)
    return image


def _draw_point(plan: Plan, image: Array, tile: Tile, target: FrameTarget) -> None:
    """A point of light along its own path."""
    place = target.x_px, target.y_px, target.light_e
    _draw_path(plan, image, tile, target_class(plan, target), target.path, *place)


def _draw_stamps(
    plan: Plan, g: Geometry, image: Array, tile: Tile, paths: list[Streak], stars: FrameStars
) -> None:
    """Stars by stamps, class by class and zone by zone; bright streaks in more pieces, or along
    their own path."""
    zones, classes = zone_of(plan, stars.x_px, stars.y_px), class_of(plan, stars.light_e)
    crowd_e = crowd_light(stars.x_px, stars.y_px, stars.light_e)
    every = stars.x_px, stars.y_px, stars.light_e, crowd_e
    fine = _in_more_pieces(plan, g, paths, stars)
    for k, core in enumerate(plan.responses.classes):
        for zone in np.unique(zones[classes == k]):
            mine = np.flatnonzero((classes == k) & (zones == zone))
            bright = paths[zone].bright(*(v[mine] for v in every[:3]))
            some = _some(every, mine[~bright])
            _draw_pieces(plan, image, tile, k, core.phases, paths[zone], some)
            mine = mine[bright]
            if core.fine_phases and len(mine):
                bright = fine[zone].bright(*(v[mine] for v in every[:3]))
                some = _some(every, mine[~bright])
                _draw_pieces(plan, image, tile, k, core.fine_phases, fine[zone], some, True)
                mine = mine[bright]
            draw_along(plan, g, image, tile, select(stars, mine), paths)


def _in_more_pieces(
    plan: Plan, g: Geometry, paths: list[Streak], stars: FrameStars
) -> list[Streak]:
    """The zones' streaks in more pieces; none where no star needs them."""
    if not any(core.fine_phases for core in plan.responses.classes):
        return []
    bright = stars.light_e > min(streak.own_from_e for streak in paths)
    if not bright.any() and not too_short(plan, stars, paths).any():
        return []
    return streaks(plan, g, plan.responses.streaks.finer)


def _some(every: Light, which: NDArray[np.intp]) -> Light:
    x, y, light, crowd = every
    return x[which], y[which], light[which], crowd[which]


def _draw_pieces(
    plan: Plan,
    image: Array,
    tile: Tile,
    k: int,
    phases: int,
    streak: Streak,
    light: Light,
    cubic: bool = False,
) -> None:
    """Stars of class k in a zone by the pieces of its streak."""
    x, y, light_e, crowd_e = light
    for piece in streak.pieces:
        dx, dy = streak.at(piece.centre, x, y)
        some = x + dx, y + dy, light_e * piece.share, crowd_e * piece.share
        _draw_piece(plan, image, tile, k, phases, piece.path, some, cubic)


def draw_along(
    plan: Plan,
    g: Geometry,
    image: Array,
    tile: Tile,
    stars: FrameStars,
    paths: list[Streak] | None = None,
) -> None:
    """Stars one by one, each along its own path (adds to the image).

    As points of a table at rest where a class has one that serves, else swept without tables.
    paths : `streaks` of the frame, where they are known already
    """
    if not len(stars):
        return
    paths, zones = paths or streaks(plan, g), zone_of(plan, stars.x_px, stars.y_px)
    classes, aberration = class_of(plan, stars.light_e), plan.scene.star_effects["aberration"]
    along, band = plan.responses.streaks, plan.responses.band
    for zone in np.unique(zones):
        mine = np.flatnonzero(zones == zone)
        x, y, light = (v[mine] for v in (stars.x_px, stars.y_px, stars.light_e))
        streak, off_px = paths[zone], along.own_px
        common = streak.path
        merge = plan.merged_px(light, densest_share(common.x_px, common.y_px, common.weight))
        places = streak.zone, streak.followed, off_px, x, y
        own = own_paths(plan.camera, g, *places, merge, aberration, along.light)
        for i, path in enumerate(own):
            place = float(x[i]), float(y[i]), float(light[i])
            k, reach_px = int(classes[mine[i]]), plan.responses.fades_px
            if _draw_points(plan, image, tile, k, path, *place, band):
                continue
            if k < len(plan.responses.classes):
                path = in_fewer_points(path, band)
            _draw_path(plan, image, tile, k, path, *place, reach_px)


def _draw_points(
    plan: Plan,
    image: Array,
    tile: Tile,
    k: int,
    path: Path,
    x: float,
    y: float,
    light_e: float,
    band: float,
) -> bool:
    """A star of class k as points along a path of its own (adds to the image).

    band : of all responses, so that any table serves the points
    False where the class has no table of a star at rest, or this star is too bright for it.
    """
    core = None if k == len(plan.responses.classes) else plan.responses.classes[k]
    if core is None or not core.point_phases:
        return False
    near_e, along_e = light_e * np.array(light_near(path, core.radius_px))
    if near_e * core.point_error > POINTS * plan.allowed_e(along_e):
        return False
    at_x, at_y, share = points_along(path, band)
    near = _reaches(tile, core.radius_px, POINT, at_x + x, at_y + y)
    each_e = light_e * share[near]
    places = at_x[near] + x, at_y[near] + y, each_e, each_e
    _draw_piece(plan, image, tile, k, core.point_phases, POINT, places, cubic=True)
    return True


def _draw_path(
    plan: Plan,
    image: Array,
    tile: Tile,
    k: int,
    path: Path,
    x: float,
    y: float,
    light_e: float,
    reach_px: float = math.inf,
) -> None:
    """One source of class k along a path of its own, without a table (adds to the image).

    reach_px : where its light ends if it is brighter than all core classes serve
    """
    if k == len(plan.responses.classes):
        add_beyond(plan, image, tile, path, x, y, light_e, reach_px)
        return
    radius = plan.responses.classes[k].radius_px
    step_px = plan.field_step_px(path, radius, light_e)
    for x0, y0, piece, share in pieces(path, near=_box(tile, radius, x, y)):
        at_x, at_y = x + x0, y + y0
        if _reaches(tile, radius, piece, at_x, at_y):
            parts = parts_along(plan, piece, at_x, at_y, light_e * share, step_px)
            for blur, part, part_e in parts:
                swept = (*still_core(blur, radius, piece), part)
                _add(image, tile, stamp_along(*swept, at_y, at_x), part_e)


def add_beyond(
    plan: Plan,
    image: Array,
    tile: Tile,
    path: Path,
    x: float,
    y: float,
    light_e: float,
    reach_px: float = math.inf,
    finer: bool = False,
) -> None:
    """A source brighter than all core classes serve, by quadrature (adds to the image).

    reach_px : where its light ends
    """
    guard_brightness(plan, x, y, light_e)
    step_px = plan.field_step_px(path, plan.responses.reach_core_px, light_e) / (1 + finer)
    window = image.shape, (tile.y0, tile.x0), y, x, reach_px, finer, plan.scene.sensor.shape
    for blur, part, part_e in parts_along(plan, path, x, y, light_e, step_px):
        image += part_e * draw_quadrature(blur, part, *window)


def _draw_piece(
    plan: Plan,
    image: Array,
    tile: Tile,
    k: int,
    phases: int,
    piece: Path,
    every: Light,
    cubic: bool = False,
) -> None:
    """One piece of the streaks of stars of one class, from a table of so many phases or (0)
    star by star. cubic : between phases in any case

    What those of a pixel err by together is within one approximation's part: the brightest of it
    are interpolated finer, or drawn at their exact places where the table's rounding would show.
    """
    x, y, light, crowd = every
    core, budget_e = plan.responses.classes[k], plan.responses.budget_e
    exact = np.ones(len(x), bool)
    if phases and len(x):
        parts = [
            (table_of(blur, core.radius_px, piece, phases), mine, part)
            for blur, mine, part in plan.responses.parts(x, y, light)
        ]
        exact = crowd * max(table.cubic_error for table, _, _ in parts) > budget_e
        for table, mine, part in parts:
            keep = ~exact[mine]
            linear = crowd[mine] * table.linear_error <= (0.0 if cubic else budget_e)
            place = x[mine][keep], y[mine][keep], part[keep]
            draw_stamps(image, (tile.y0, tile.x0), table, *place, ~linear[keep])
    if exact.any():
        draw_exact(plan, image, tile, k, piece, x[exact], y[exact], light[exact])


def draw_exact(
    plan: Plan, image: Array, tile: Tile, k: int, piece: Path, x: Array, y: Array, light: Array
) -> None:
    """Sources (n,) drawn at their exact places, without a table.

    Response by response: no more than one of sharp cores may be kept at a time.
    """
    radius = plan.responses.classes[k].radius_px
    near = _reaches(tile, radius, piece, x, y)
    x, y, light = x[near], y[near], light[near]
    if not len(x):
        return
    for blur, mine, part in plan.responses.parts(x, y, light):
        swept = swept_core(blur, radius, piece)
        for at_x, at_y, light_e in zip(x[mine], y[mine], part, strict=True):
            _add(image, tile, stamp_at(*swept, float(at_y), float(at_x)), float(light_e))


def _reaches(
    tile: Tile, radius_px: float, piece: Path, x: Array | float, y: Array | float
) -> NDArray[np.bool_]:
    """Whether cores swept along a piece of path around places (n,) may light a tile."""
    reach_x = radius_px + float(np.abs(piece.x_px).max()) + 4
    reach_y = radius_px + float(np.abs(piece.y_px).max()) + 4
    inside_x = np.abs(x - tile.x0 - 0.5 * tile.columns) < reach_x + 0.5 * tile.columns
    inside_y = np.abs(y - tile.y0 - 0.5 * tile.rows) < reach_y + 0.5 * tile.rows
    return np.logical_and(inside_x, inside_y)


def _box(tile: Tile, radius_px: float, x: float, y: float) -> Box:
    """Where a path from (x, y) must come by for one of its pieces to light a tile."""
    margin = radius_px + LONGEST_PIECE_PX
    low_x, low_y = tile.x0 - margin - x, tile.y0 - margin - y
    across = 2.0 * margin
    return low_x, low_x + across + tile.columns, low_y, low_y + across + tile.rows


def _add(image: Array, tile: Tile, stamp: tuple[int, int, Array], light_e: float) -> None:
    """Add a stamp (first row, first column, values) of a source to the image of a tile."""
    row, column, values = stamp
    top, left = row - tile.y0, column - tile.x0
    r0, r1 = max(0, -top), min(values.shape[0], tile.rows - top)
    c0, c1 = max(0, -left), min(values.shape[1], tile.columns - left)
    if r1 > r0 and c1 > c0:
        image[top + r0 : top + r1, left + c0 : left + c1] += light_e * values[r0:r1, c0:c1]


def _core_reach(plan: Plan, paths: list[Streak], moved_px: float) -> float:
    """Farthest pixel that the largest core of a streaked star touches: those beside a wide field
    move farther (`moved_px`) than those in the middle of its zones."""
    return plan.responses.classes[-1].radius_px + max(_sweep(paths), moved_px) + 8.0


def _sweep(paths: list[Streak]) -> float:
    """Farthest that light of a star is from its place [px]."""
    return max(float(np.hypot(s.path.x_px, s.path.y_px).max()) for s in paths)


def _cut(image: np.ndarray, place: Tile, part: Tile) -> np.ndarray:
    """View of a part of an image that stands at `place`."""
    top, left = part.y0 - place.y0, part.x0 - place.x0
    return image[top : top + part.rows, left : left + part.columns]


def add_wings_of(image: Array, tile: Tile, block: LightBlock, field: Array | None) -> None:
    """Add the part of a block's wings that falls in a tile."""
    part = overlap(tile, block.place)
    if field is not None and block.grid is not None and part.rows and part.columns:
        add_wings(_cut(image, tile, part), (part.y0, part.x0), block.grid, field)
