"""The achieved error: a few small windows drawn again, every source by itself, and compared."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import lru_cache

import numpy as np
import scipy
from numpy.typing import NDArray

from catalog_tools.documents import JsonObject
from pipeline.arrays import Array, FrameStars, Geometry, concatenate
from pipeline.execute.blocks import around, body_parts, class_of, target_class
from pipeline.execute.light import add_beyond
from pipeline.execute.sources import (
    FrameTarget,
    excursion_px,
    place_targets,
    setting_stars,
    whole_stars,
)
from pipeline.execute.tables import core_of, kernel_of
from pipeline.physics.drawing.direct import Swept, draw_direct, reach_px, terms
from pipeline.physics.drawing.extended import draw_body, spread_body
from pipeline.physics.drawing.quadrature import (
    affordable,
    has_profile,
    nodes_of,
    points_of,
    profile_s,
)
from pipeline.physics.drawing.wings import (
    WingGrid,
    add_wings,
    convolve,
    grid_frequencies,
    spread,
    wing_grid,
)
from pipeline.physics.motion.streak import (
    LONGEST_PIECE_PX,
    POINT,
    Path,
    densest_share,
    in_few_runs,
    part_within,
    pieces,
    transfer,
)
from pipeline.physics.psf.pupil import Blur
from pipeline.physics.psf.response import Core
from pipeline.plan.checks import FINE_KERNELS, CheckCell, fine_ends
from pipeline.plan.optics.optics import LARGEST_CORE_SAMPLES
from pipeline.plan.plan import Plan
from pipeline.plan.response.own_paths import (
    EXACT_MERGE_PX,
    FINEST_MERGE_PX,
    paths_through,
    star_offsets,
)
from pipeline.plan.tiles import Tile
from pipeline.spec.scene import CELL_PX

Part = tuple[slice, slice]
Group = tuple[Array, Array, Array, Path]  # (x, y, light) of sources, and the path of each

WINDOW_PX = 16
LEAST_ERROR = 1e-14  # of the light: where nothing else is known of a core's error
OWN_PATHS = 8  # of stars near a window at least, more where they are far off
MOST_S = 0.5  # CPU seconds that the sources of a window may cost, on one core
SOURCE_S, SEGMENT_S, SPECTRUM_S = 1.5e-9, 2e-9, 3e-8  # of one term of a spectrum (measured)
RISING_S = 4e-9  # of one whose light rises along a segment
VALUE_S = 1.2e-8  # of a value of a profile
OFF_SHARE = 0.02  # of the light that may be off: what merging the segments of a path may cost
MOST_MERGED_PX = 1e-2
WING_BEND_PX = 2e-2  # that straight runs of a body's path may be off for its wings
MOST_FOLLOWED = 500  # of the brightest stars near a window, whose paths are looked at
FINER = 2  # times as many steps of light, and of a body's responses, that change along a path
MOST_VALUES = 5e7  # of profiles that the sources of a window may cost, if transforms serve too
MOST_POINTS = 1e6  # along the paths of a group of sources whose wings are swept so
SWEEP_STEP_PX = 32.0


def check_tile(
    plan: Plan,
    g: Geometry,
    tile: Tile,
    parts: list[FrameStars],
    light_e: list[Array],
    noise_e: Callable[[Part], Array],
) -> list[JsonObject]:
    """How far the light of a tile is from the reference in the cells that the plan checks.

    light_e : (rows, columns) images whose sum is the light of all sources
    noise_e : noise of the pixels of a part of the tile, in terms of that light
    A cell's windows are around its brightest pixel, and where the brightest source near it is
    expected to err most against the noise. One record for each window.
    """
    out = []
    for cell in cells_to_check(plan, int(g.frame[0]), tile):
        y, x = cell.row * CELL_PX - tile.y0, cell.column * CELL_PX - tile.x0
        part = np.s_[y : min(y + CELL_PX, tile.rows), x : min(x + CELL_PX, tile.columns)]
        drawn_e = np.sum([image[part] for image in light_e], axis=0)
        noise = noise_e(part)
        windows = [_window(drawn_e), _window(_expected(plan, g, cell, parts, noise))]
        for window in dict.fromkeys(_corner(w) for w in windows):
            out.append(_check_window(plan, g, cell, window, parts, drawn_e, noise))
    return out


def cells_to_check(plan: Plan, frame: int, tile: Tile) -> list[CheckCell]:
    """The cells of a tile that the plan checks in a frame."""
    return [
        cell
        for cell in plan.checks
        if cell.frame == frame
        and 0 <= cell.row * CELL_PX - tile.y0 < tile.rows
        and 0 <= cell.column * CELL_PX - tile.x0 < tile.columns
    ]


def _corner(part: Part) -> tuple[int, int, int, int]:
    """A window's first and last-plus-one rows and columns."""
    return part[0].start, part[0].stop, part[1].start, part[1].stop


def _expected(
    plan: Plan, g: Geometry, cell: CheckCell, parts: list[FrameStars], noise_e: Array
) -> Array:
    """What the brightest sources may err by in each pixel of a cell, over its noise.

    Transforms and tables err alike all over a core, the wings' grid most near its end; farther
    off it errs by less, as the wings fall.
    """
    rows, columns = noise_e.shape
    y0, x0 = cell.row * CELL_PX, cell.column * CELL_PX
    at = Tile(cell.row, cell.column, y0, x0, rows, columns)
    stars = around(concatenate(parts, FrameStars), at, plan.responses.reach_core_px)
    some = np.argsort(-stars.light_e, kind="stable")[:OWN_PATHS]
    x, y, light = (v[some].tolist() for v in (stars.x_px, stars.y_px, stars.light_e))
    found = list(zip(x, y, light, _core_class(plan, stars.light_e[some]).tolist(), strict=True))
    last = len(plan.responses.classes) - 1
    found += [
        (t.x_px, t.y_px, t.light_e, min(target_class(plan, t), last))
        for t in place_targets(plan, g)
    ]
    out = np.zeros(noise_e.shape)
    for x, y, light, k in found:
        core = plan.responses.classes[int(k)]
        error = max(core.wing_error, core.target_error, LEAST_ERROR)
        r = np.hypot(np.arange(rows)[:, None] + y0 - y, np.arange(columns) + x0 - x)
        far = np.maximum(1.0, r / core.radius_px) ** -3
        out = np.maximum(out, light * error * far)
    return out / noise_e


def _check_window(
    plan: Plan,
    g: Geometry,
    cell: CheckCell,
    window: tuple[int, int, int, int],
    parts: list[FrameStars],
    drawn_e: Array,
    noise_e: Array,
) -> JsonObject:
    """One record: the window in frame pixels, and how far the drawn light is from the reference."""
    part = slice(*window[:2]), slice(*window[2:])
    rows, columns = drawn_e[part].shape
    y0, x0 = cell.row * CELL_PX + part[0].start, cell.column * CELL_PX + part[1].start
    stars = concatenate(parts, FrameStars)
    exact, sources = reference(plan, g, Tile(cell.row, cell.column, y0, x0, rows, columns), stars)
    record: JsonObject = {
        "frame": cell.frame,
        "y0": y0,
        "x0": x0,
        "rows": rows,
        "columns": columns,
        "sources": sources,
    }
    if exact is None:
        return record | {"skipped": "too many sources for the reference"}
    error = np.abs(drawn_e[part] - exact)
    return record | {
        "light_e": float(exact.sum()),
        "brightest_pixel_e": float(exact.max()),
        "error_e": float(error.max()),
        "error_rms_e": float(np.sqrt(np.mean(error**2))),
        "error_sigma": float((error / noise_e[part]).max()),
    }


def _window(values: Array) -> Part:
    """The window of a cell: around the pixel of its largest value."""
    largest = np.unravel_index(int(np.argmax(values)), values.shape)
    sides = [min(WINDOW_PX, n) for n in values.shape]
    starts = [
        int(np.clip(b - side // 2, 0, n - side))
        for b, side, n in zip(largest, sides, values.shape, strict=True)
    ]
    return slice(starts[0], starts[0] + sides[0]), slice(starts[1], starts[1] + sides[1])


def reference(
    plan: Plan,
    g: Geometry,
    at: Tile,
    stars: FrameStars,
    own_paths: int = OWN_PATHS,
    most_s: float = MOST_S,
) -> tuple[Array | None, int]:
    """Light of all sources in a small window by the reference path, and how many sources.

    Every source stands at its exact place and streaks as stars in the window's middle do (targets
    and at least `own_paths` stars along their own path), with a core of twice the radius that
    its brightness asks for and the wings on a grid of half the spacing: the sum of the phases of
    its spectrum, in float64. Those alone on their path are integrated over each pixel instead
    where the profile of the response is known. None where that would cost more than `most_s`.
    """
    groups, bodies = _sources(plan, g, at, stars, own_paths)
    sources = sum(len(group[0]) for group, _ in groups) + len(bodies)
    most = MOST_VALUES / max(1, len(groups))
    together, alone, values = [], [], 0.0
    for group, end in groups:
        cost = _quadrature_cost(plan, at, group, most)
        if cost is None:
            together.append(group)
        else:
            alone.append((*group, end))
            values += cost
    work, size = _by_core(plan, at, together), (at.rows, at.columns)
    cost_s = sum(_spectra_s(core, swept, size) for core, swept in work.items())
    if cost_s + VALUE_S * values > most_s:
        return None, sources
    image = np.zeros(size)
    for core, swept in work.items():
        image += draw_direct(core, swept, size, (at.y0, at.x0))
    for x, y, light, path, end in alone:
        place = float(x[0]), float(y[0]), float(light[0])
        add_beyond(plan, image, at, path, *place, end, finer=True)
    if plan.responses.spacing_px:
        _add_fine_wings(plan, image, at, together)
    for body in bodies:
        _add_body(plan, image, at, body)
    return image, sources


def _sources(
    plan: Plan, g: Geometry, at: Tile, stars: FrameStars, own_paths: int
) -> tuple[list[tuple[Group, float]], list[FrameTarget]]:
    """Groups of points near a window, each with the radius where its light ends, and bodies."""
    every = around(stars, at, plan.halo_px + excursion_px(plan, g))
    near, setting = whole_stars(every), setting_stars(plan, g, every)
    targets = place_targets(plan, g)
    followed = _star_groups(plan, g, at, near, own_paths)
    groups = [(group, plan.responses.fades_px) for group in followed]
    for t in (*setting, *targets):
        if t.body is None and (group := _alone(plan, at, t)) is not None:
            groups.append((group, _end(plan, t)))
    return groups, [t for t in targets if t.body is not None]


def _spectra_s(core: Core, groups: list[Swept], size: tuple[int, int]) -> float:
    """CPU seconds of sources of one core, by the sum of their phases."""
    each = SPECTRUM_S
    for swept in groups:
        if swept.rise is None:
            each += SOURCE_S * len(swept.x_px) + SEGMENT_S * swept.path.segments
        else:
            each += RISING_S * len(swept.x_px) * swept.path.segments
    return terms(core, groups, size) * each


def _end(plan: Plan, t: FrameTarget) -> float:
    """Radius [px] where a point's light ends: that of one drawn by quadrature has none."""
    r = plan.responses
    return math.inf if target_class(plan, t) == len(r.classes) else r.fades_px


def _alone(plan: Plan, at: Tile, t: FrameTarget) -> Group | None:
    """A source as a group, with the part of its path whose light may reach a window.

    The whole path of one that is drawn by quadrature, whose light has no end; None if none may.
    """
    place = np.array([t.x_px]), np.array([t.y_px])
    if target_class(plan, t) == len(plan.responses.classes):
        return *place, np.array([t.light_e]), t.path
    reach = plan.halo_px + 2.0 * plan.responses.reach_core_px + LONGEST_PIECE_PX
    low_x, low_y = at.x0 - reach - t.x_px, at.y0 - reach - t.y_px
    box = (low_x, low_x + 2.0 * reach + at.columns, low_y, low_y + 2.0 * reach + at.rows)
    part = part_within(t.path, box)
    return None if part is None else (*place, np.array([part[1] * t.light_e]), part[0])


def _quadrature_cost(plan: Plan, at: Tile, group: Group, most: float) -> float | None:
    """Values that a single source costs by quadrature in a window.

    None for a group that is drawn by transforms: of several sources, of a response without a
    known profile, or of more than `most` with that profile (which other sources share, but may be
    dear), where it is no brighter than the core classes serve.
    """
    _, _, light, path = group
    r = plan.responses
    if len(light) != 1 or not _integrable(r.blurs, path, (at.rows, at.columns)):
        return None
    values = max(len(points_of(b, path, True)) * (1.5 * nodes_of(b)) ** 2 for b in r.blurs)
    cost = at.rows * at.columns * values
    if light[0] > min(r.classes[-1].brightest_e, r.classes[-1].target_e):
        return cost
    profile = max(profile_s(b, r.reach_px) for b in r.blurs) / VALUE_S
    return cost if cost + profile <= most else None


def _integrable(blurs: tuple[Blur, ...], path: Path, size: tuple[int, int]) -> bool:
    """Whether quadrature may draw a source of these responses along a path."""
    return all(has_profile(b) and affordable(b, path, size) for b in blurs)


def _star_groups(
    plan: Plan, g: Geometry, at: Tile, near: FrameStars, own_paths: int
) -> list[Group]:
    """(x, y, light, path) of the stars near a window: of most together, of some alone.

    Alone are those that their own path shifts most against the common one, the window's middle's,
    times their light, and those that are drawn by quadrature.
    """
    if not len(near):
        return []
    middle = at.x0 + 0.5 * (at.columns - 1), at.y0 + 0.5 * (at.rows - 1)
    aberration = plan.scene.star_effects["aberration"]
    some = np.argsort(-near.light_e, kind="stable")[:MOST_FOLLOWED]
    x, y, light = near.x_px[some], near.y_px[some], near.light_e[some]
    places = np.append(x, middle[0]), np.append(y, middle[1])
    changes = plan.responses.streaks.light
    if changes is not None:
        changes = replace(changes, steps=FINER * changes.steps)
    offsets = star_offsets(plan.camera, g, *places, aberration, changes)[:, :, 0]
    offsets, common = offsets[:, :-1], offsets[:, -1:]
    off_px = np.hypot(*(offsets - common)).max(axis=1)
    to_middle = np.stack([middle[0] - x, middle[1] - y])[..., None]
    apart = np.minimum(_nearest(offsets, to_middle), _nearest(common, to_middle))
    off_e = np.where(apart < 2.0 * WINDOW_PX, light * off_px, 0.0)
    allowed_e = OFF_SHARE * plan.responses.budget_e
    if own_paths:
        own_paths = max(own_paths, int(np.count_nonzero(off_e > allowed_e)))
    own = np.zeros(len(some), bool)
    own[np.argsort(-off_e, kind="stable")[:own_paths]] = True
    own &= off_e > 0.0
    own |= class_of(plan, light) == len(plan.responses.classes)
    together = np.ones(len(near), bool)
    together[some[own]] = False
    steps = common.shape[-1] - 1
    share = densest_share(common[0, 0], common[1, 0], np.full(steps, 1.0 / steps))
    merge_px = allowed_e / np.maximum(light * share, 1e-9)
    least_px = np.min(merge_px[~own], initial=EXACT_MERGE_PX)
    [path] = paths_through(common, np.array([max(least_px, FINEST_MERGE_PX)]))
    groups = [(near.x_px[together], near.y_px[together], near.light_e[together], path)]
    merge_px = np.clip(merge_px[own], FINEST_MERGE_PX, MOST_MERGED_PX)
    found = zip(np.flatnonzero(own), paths_through(offsets[:, own], merge_px), strict=True)
    return groups + [(x[[i]], y[[i]], light[[i]], its) for i, its in found]


def _nearest(offsets: Array, to_place: Array) -> Array:
    """Least distance (n,) from paths (2, n or 1, K) to places (2, n, 1) [px]."""
    way = np.diff(offsets, axis=2)
    along = ((to_place - offsets[..., :-1]) * way).sum(axis=0)
    share = np.clip(along / np.maximum((way**2).sum(axis=0), 1e-300), 0.0, 1.0)
    return np.hypot(*(to_place - offsets[..., :-1] - share * way)).min(axis=1)


def _by_core(plan: Plan, at: Tile, groups: list[Group]) -> dict[Core, list[Swept]]:
    """The sources that light a window, piece by piece of path, by the core that draws them."""
    out: dict[Core, list[Swept]] = {}
    for x, y, light, path in groups:
        classes = _core_class(plan, light)
        for k in np.unique(classes).tolist():
            near = [core_of(b, _radius(plan, k, b)) for b in _near_window(plan, k, at)]
            for x0, y0, piece, share in pieces(path):
                reach = max(reach_px(core, piece) for core in near)
                off_x = np.maximum(at.x0 - x - x0, x + x0 - (at.x0 + at.columns - 1))
                off_y = np.maximum(at.y0 - y - y0, y + y0 - (at.y0 + at.rows - 1))
                mine = (classes == k) & (off_x < reach) & (off_y < reach)
                if not mine.any():
                    continue
                found = Swept(piece, x[mine] + x0, y[mine] + y0, light[mine] * share)
                for blur, part in _shared_out(plan, found):
                    out.setdefault(core_of(blur, _radius(plan, k, blur)), []).append(part)
    return out


def _shared_out(plan: Plan, swept: Swept) -> Iterator[tuple[Blur, Swept]]:
    """The responses that take part in some sources on pieces alike: of a field of responses each
    source by itself, where it moves, with what changes along its path."""
    field, places = plan.responses.field, (swept.x_px, swept.y_px, swept.light_e)
    if field is None or not swept.path.length_px:
        for blur, which, light in plan.responses.parts(*places):
            yield blur, Swept(swept.path, swept.x_px[which], swept.y_px[which], light)
        return
    for i in range(len(swept.x_px)):
        x, y, light = (v[[i]] for v in places)
        for blur, part, rise, share in field.rising(swept.path, x.item(), y.item()):
            yield blur, Swept(part, x, y, light * share, rise)


def _core_class(plan: Plan, light_e: Array) -> np.ndarray:
    """The class (n,) whose cores stand for sources of so much light."""
    return np.minimum(class_of(plan, light_e), len(plan.responses.classes) - 1)


def _near_window(plan: Plan, k: int, at: Tile) -> tuple[Blur, ...]:
    """The responses of the sources of a class whose cores may light a window."""
    margin = 2.0 * plan.responses.classes[k].radius_px + LONGEST_PIECE_PX
    y1, x1 = at.y0 + at.rows + margin, at.x0 + at.columns + margin
    return plan.responses.near(at.y0 - margin, y1, at.x0 - margin, x1)


def _radius(plan: Plan, k: int, blur: Blur) -> float:
    """Core radius of the reference for sources of a class: twice what the engines take."""
    r = plan.responses
    most = LARGEST_CORE_SAMPLES / core_of(blur, r.classes[0].radius_px).oversampling
    return min(2.0 * r.classes[k].radius_px, max(most, r.classes[k].radius_px))


def _add_fine_wings(plan: Plan, image: Array, at: Tile, groups: list[Group]) -> None:
    """Wings of sources on grids of half the planned spacing.

    Each source sends its wings from points all along its own path, or, where those would be too
    many, from one grid of sources that is swept as a whole.
    """
    sweep = max((_sweep(path) for *_, path in groups), default=0.0)
    sweep = SWEEP_STEP_PX * math.ceil(sweep / SWEEP_STEP_PX)  # windows share their kernels
    for grid, ends in _fine_grids(plan, at, sweep):
        lights: dict[tuple[int, Blur, Path], Array] = {}
        for x, y, light, path in groups:
            dx, dy, share = _points(path, 0.5 * grid.spacing_px)
            rest = POINT
            if len(dx) * len(x) > MOST_POINTS:
                dx, dy, share, rest = np.zeros(1), np.zeros(1), np.ones(1), path
            classes = _core_class(plan, light)
            for k in np.unique(classes):
                mine = np.flatnonzero(classes == k)
                for blur, which, part in plan.responses.parts(x[mine], y[mine], light[mine]):
                    at_x, at_y = x[mine[which], None] + dx, y[mine[which], None] + dy
                    sent = spread(grid, at_x.ravel(), at_y.ravel(), np.outer(part, share).ravel())
                    key = int(k), blur, rest
                    lights[key] = lights[key] + sent if key in lights else sent
        total = np.zeros((grid.rows, grid.columns // 2 + 1), complex)
        for (k, blur, path), light in lights.items():
            wing = _wing(blur, _radius(plan, k, blur), grid, ends)
            if path.length_px:
                wing = wing * transfer(*grid_frequencies(grid), path.x_px, path.y_px, path.weight)
            total += scipy.fft.rfft2(light) * wing
        add_wings(image, (at.y0, at.x0), grid, convolve(total, grid))


def _points(path: Path, step_px: float) -> tuple[Array, Array, Array]:
    """Points (n,) along a path, at most `step_px` apart, and the share of the light that each is
    worth: the middles of even parts of its segments."""
    x, y = np.diff(path.x_px), np.diff(path.y_px)
    parts = np.maximum(1, np.ceil(np.hypot(x, y) / step_px)).astype(np.int64)
    of = np.repeat(np.arange(path.segments), parts)
    first = np.cumsum(parts) - parts
    within = (np.arange(len(of)) - first[of] + 0.5) / parts[of]
    return (
        path.x_px[of] + within * x[of],
        path.y_px[of] + within * y[of],
        path.weight[of] / parts[of],
    )


def _sweep(path: Path) -> float:
    """How far a path goes from its origin on either axis [px]."""
    return float(max(np.abs(path.x_px).max(), np.abs(path.y_px).max()))


def _add_body(plan: Plan, image: Array, at: Tile, target: FrameTarget) -> None:
    """An extended body with the reference's core, and its wings on the finer grid."""
    assert target.body is not None
    r, place, k = plan.responses, (target.y_px, target.x_px), target_class(plan, target)
    for blur, path, light_e in body_parts(plan, target, FINER):
        runs = in_few_runs(path, WING_BEND_PX)
        core = core_of(blur, _radius(plan, k, blur))
        draw_body(image, (at.y0, at.x0), target.body, core, place, light_e, path)
        for grid, ends in _fine_grids(plan, at, _sweep(runs)) if r.spacing_px else ():
            light = scipy.fft.rfft2(spread_body(grid, target.body, place, light_e))
            light = light * _wing(blur, core.radius_px, grid, ends)
            swept = transfer(*grid_frequencies(grid), runs.x_px, runs.y_px, runs.weight)
            add_wings(image, (at.y0, at.x0), grid, convolve(light * swept, grid))


def _fine_grids(
    plan: Plan, at: Tile, sweep_px: float
) -> list[tuple[WingGrid, tuple[float, float]]]:
    """Grids around a window, and from where to where [px] each has a source's wings."""
    r = plan.responses
    return [
        (wing_grid((at.rows, at.columns), (at.y0, at.x0), h, last + sweep_px), (first, last))
        for h, first, last in fine_ends(r.spacing_px, r.reach_px)
    ]


def _wing(
    blur: Blur, radius_px: float, grid: WingGrid, ends: tuple[float, float]
) -> NDArray[np.complex128]:
    """Transfer function of a wing between two distances from its source."""
    return _wing_kept(blur, radius_px, replace(grid, y0_px=0.0, x0_px=0.0), ends)


@lru_cache(maxsize=FINE_KERNELS)
def _wing_kept(
    blur: Blur, radius_px: float, grid: WingGrid, ends: tuple[float, float]
) -> NDArray[np.complex128]:
    kernel = kernel_of(blur, radius_px, grid, ends[1])
    return kernel - kernel_of(blur, radius_px, grid, ends[0]) if ends[0] else kernel


def summary(records: list[JsonObject]) -> JsonObject:
    """What the report says of the windows checked."""
    done = [r for r in records if "skipped" not in r]
    return {
        "windows": len(done),
        "windows_skipped": len(records) - len(done),
        "achieved_error_e": max((r["error_e"] for r in done), default=None),
        "achieved_error_sigma": max((r["error_sigma"] for r in done), default=None),
        "sources_drawn_again": sum(r["sources"] for r in done),
    }
