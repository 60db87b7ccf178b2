"""Light of the sources in one tile: cores by stamps, wings by the coarse grid of their block."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.fft

from pipeline.arrays import Array, FrameStars, Geometry, concatenate, select
from pipeline.execute.sources import (
    FrameTarget,
    distance_px,
    drawing_order,
    excursion_px,
    place_targets,
    streaks,
    zone_of,
)
from pipeline.execute.tables import kernel_of, streak_of, swept_core, table_of
from pipeline.physics.drawing.stamps import draw_stamps
from pipeline.physics.drawing.wings import WingGrid, add_wings, convolve, spread, wing_grid
from pipeline.physics.motion.streak import Path, pieces
from pipeline.physics.psf.response import stamp_at
from pipeline.plan.responses import BLOCK_PX, Streak
from pipeline.plan.scene_plan import Plan
from pipeline.plan.tiles import Tile


@dataclass(frozen=True)
class Wings:
    """The wings of one block of the focal plane: its grid and the fields of stars and targets.

    brightest_e : light of the brightest source in them, which their errors go with
    """

    block: Tile
    grid: WingGrid
    stars: Array | None
    targets: Array | None
    brightest_e: float


def plan_blocks(plan: Plan) -> tuple[Tile, ...]:
    """The fixed blocks in which wings are convolved; none where the response has no wings."""
    if not plan.responses.spacing_px:
        return ()
    rows, columns = plan.scene.sensor.shape
    return tuple(
        Tile(i, j, y0, x0, min(BLOCK_PX, rows - y0), min(BLOCK_PX, columns - x0))
        for i, y0 in enumerate(range(0, rows, BLOCK_PX))
        for j, x0 in enumerate(range(0, columns, BLOCK_PX))
    )


def class_of(plan: Plan, light_e: Array) -> np.ndarray:
    """Core class (n,) of sources by their light: the first whose limit they do not exceed."""
    limits = np.array([c.brightest_e for c in plan.responses.classes])
    return np.searchsorted(limits, light_e, side="left").clip(0, len(limits) - 1)


def render_wings(plan: Plan, g: Geometry, block: Tile, parts: list[FrameStars]) -> Wings:
    """Wings of all sources around a block."""
    reach = plan.halo_px + excursion_px(plan, g)
    grid = wing_grid(
        (block.rows, block.columns), (block.y0, block.x0), plan.responses.spacing_px, reach
    )
    stars = drawing_order(_around(concatenate(parts, FrameStars), block, reach))
    paths = streaks(plan, g) if len(stars) else []
    path = paths[_middle_zone(plan, block)].path if paths else None
    star_field = _wing_field(plan, grid, stars.x_px, stars.y_px, stars.light_e, stars.light_e, path)
    x, y, light, whole = _target_points(plan, place_targets(plan, g))
    brightest = max(float(stars.light_e.max(initial=0.0)), float(whole.max(initial=0.0)))
    target_field = _wing_field(plan, grid, x, y, light, whole, None)
    return Wings(block, grid, star_field, target_field, brightest)


def _wing_field(
    plan: Plan, grid: WingGrid, x: Array, y: Array, light: Array, whole: Array, path: Path | None
) -> Array | None:
    """Grid values of the wings of points; `whole` is the light of the source each belongs to."""
    total: np.ndarray | None = None
    classes = class_of(plan, whole)
    r = plan.responses
    for k, core in enumerate(r.classes):
        mine = classes == k
        if mine.any():
            kernel = kernel_of(r.blur, core.radius_px, grid, r.reach_px)
            part = scipy.fft.rfft2(spread(grid, x[mine], y[mine], light[mine])) * kernel
            total = part if total is None else total + part
    if total is None:
        return None
    return convolve(total if path is None else total * streak_of(grid, path), grid)


def _target_points(plan: Plan, targets: list[FrameTarget]) -> tuple[Array, Array, Array, Array]:
    """Targets as points along their paths, dense enough for the wings' grid."""
    step = plan.responses.spacing_px / 2.0
    x: list[Array] = []
    y: list[Array] = []
    light: list[Array] = []
    whole: list[Array] = []
    for t in targets:
        for k in range(t.path.segments):
            ends = (t.path.x_px[k], t.path.x_px[k + 1], t.path.y_px[k], t.path.y_px[k + 1])
            count = int(np.ceil(np.hypot(ends[1] - ends[0], ends[3] - ends[2]) / step)) or 1
            at = (np.arange(count) + 0.5) / count
            x.append(t.x_px + ends[0] + at * (ends[1] - ends[0]))
            y.append(t.y_px + ends[2] + at * (ends[3] - ends[2]))
            light.append(np.full(count, t.light_e * t.path.weight[k] / count))
            whole.append(np.full(count, t.light_e))
    if not x:
        return (np.empty(0),) * 4
    return np.concatenate(x), np.concatenate(y), np.concatenate(light), np.concatenate(whole)


def draw_stars(
    plan: Plan, g: Geometry, tile: Tile, parts: list[FrameStars], wings: list[Wings]
) -> Array:
    """Electrons of the stars in a tile: (rows, columns) float64, before the flat."""
    image = np.zeros((tile.rows, tile.columns))
    paths = streaks(plan, g)
    reach = _core_reach(plan, paths)
    stars = drawing_order(_around(concatenate(parts, FrameStars), tile, reach))
    zones, classes = zone_of(plan, stars.x_px, stars.y_px), class_of(plan, stars.light_e)
    for k in range(len(plan.responses.classes)):
        for zone in np.unique(zones[classes == k]):
            mine = select(stars, (classes == k) & (zones == zone))
            streak = paths[zone]
            for x0, y0, piece, share in pieces(streak.path):
                x, y = x0 + streak.shift_x_px, y0 + streak.shift_y_px
                _draw_pieces(plan, image, tile, k, piece, mine, x, y, share)
    for w in wings:
        _add(image, tile, w, w.stars)
    return image


def draw_targets(plan: Plan, g: Geometry, tile: Tile, wings: list[Wings]) -> Array:
    """Electrons of the targets in a tile: (rows, columns) float64, before the flat."""
    image = np.zeros((tile.rows, tile.columns))
    for target in place_targets(plan, g):
        k = int(class_of(plan, np.array([target.light_e]))[0])
        for x0, y0, piece, share in pieces(target.path):
            x, y = target.x_px + x0, target.y_px + y0
            _draw_exact(plan, image, tile, k, piece, x, y, target.light_e * share)
    for w in wings:
        _add(image, tile, w, w.targets)
    return image


def _draw_pieces(
    plan: Plan,
    image: Array,
    tile: Tile,
    k: int,
    piece: Path,
    stars: FrameStars,
    x0: float,
    y0: float,
    share: float,
) -> None:
    """One piece of the streak of one class of stars, from its table or star by star."""
    core, blur = plan.responses.classes[k], plan.responses.blur
    x, y, light = stars.x_px + x0, stars.y_px + y0, stars.light_e * share
    if core.phases:
        table = table_of(blur, core.radius_px, piece, core.phases)
        cubic = light * table.linear_error > plan.responses.budget_e
        draw_stamps(image, (tile.y0, tile.x0), table, x, y, light, cubic)
        return
    for i in range(len(stars)):
        _draw_exact(plan, image, tile, k, piece, float(x[i]), float(y[i]), float(light[i]))


def _draw_exact(
    plan: Plan, image: Array, tile: Tile, k: int, piece: Path, x: float, y: float, light: float
) -> None:
    """One source drawn at its exact place, without a table."""
    radius = plan.responses.classes[k].radius_px
    reach_x = radius + float(np.abs(piece.x_px).max()) + 4
    reach_y = radius + float(np.abs(piece.y_px).max()) + 4
    inside_x = tile.x0 - reach_x < x < tile.x0 + tile.columns + reach_x
    if not (inside_x and tile.y0 - reach_y < y < tile.y0 + tile.rows + reach_y):
        return
    swept = swept_core(plan.responses.blur, radius, piece)
    row, column, stamp = stamp_at(*swept, y, x)
    top, left = row - tile.y0, column - tile.x0
    r0, r1 = max(0, -top), min(stamp.shape[0], tile.rows - top)
    c0, c1 = max(0, -left), min(stamp.shape[1], tile.columns - left)
    if r1 > r0 and c1 > c0:
        image[top + r0 : top + r1, left + c0 : left + c1] += light * stamp[r0:r1, c0:c1]


def _around(stars: FrameStars, tile: Tile, reach: float) -> FrameStars:
    """Stars within `reach` pixels of a tile."""
    place = (tile.y0, tile.x0, tile.rows, tile.columns)
    return select(stars, distance_px(stars.x_px, stars.y_px, *place) < reach)


def _core_reach(plan: Plan, paths: list[Streak]) -> float:
    """Farthest pixel that the largest core of a streaked star touches."""
    sweep = max(float(np.hypot(s.path.x_px, s.path.y_px).max()) for s in paths)
    return plan.responses.classes[-1].radius_px + sweep + 8.0


def _middle_zone(plan: Plan, block: Tile) -> int:
    """The zone whose streak a block's wings take."""
    x, y = block.x0 + 0.5 * block.columns, block.y0 + 0.5 * block.rows
    return int(zone_of(plan, np.array([x]), np.array([y]))[0])


def _add(image: Array, tile: Tile, wings: Wings, field: Array | None) -> None:
    """Add the part of a block's wings that falls in a tile."""
    if field is None:
        return
    b = wings.block
    y0, y1 = max(tile.y0, b.y0), min(tile.y0 + tile.rows, b.y0 + b.rows)
    x0, x1 = max(tile.x0, b.x0), min(tile.x0 + tile.columns, b.x0 + b.columns)
    if y1 > y0 and x1 > x0:
        part = image[y0 - tile.y0 : y1 - tile.y0, x0 - tile.x0 : x1 - tile.x0]
        add_wings(part, (y0, x0), wings.grid, field)
