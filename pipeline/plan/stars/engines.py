"""Tables or star by star: the cheapest way to draw the stars of each core class and streak.

The choice follows from the scene and the stars of its fullest frame (of a few), never from tiles or
workers. It changes costs alone: either way meets the bounds that the plan states.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from pipeline.arrays import Geometry
from pipeline.physics.drawing.quadrature import NEAR_PX, drawn_s
from pipeline.physics.drawing.spectral_plan import CROWD_PX, ROUNDING
from pipeline.physics.motion.points import in_fewer_points, points_per_px
from pipeline.physics.motion.streak import (
    LONGEST_PIECE_PX,
    POINT,
    Path,
    curve_through,
    densest_share,
    light_near,
)
from pipeline.physics.psf.product import is_product, product_table
from pipeline.physics.psf.pupil import Blur
from pipeline.physics.psf.response import oversampling_for
from pipeline.plan.pointing.star_paths import excursions_px
from pipeline.plan.response.responses import (
    FIELD_BYTES,
    FINEST_ERROR,
    SPECTRAL_S,
    SPECTRAL_S_PER_PIXEL,
    STAMP_S,
    STAMP_S_PER_PIXEL,
    CoreClass,
    ResponsePlan,
    crowd_s,
    stamp_s,
    table_bytes,
)
from pipeline.plan.response.streaks import (
    POINTS,
    Streak,
    light_from,
    near_share,
    points_to,
    together_e,
    zone_streak,
)
from pipeline.plan.stars.field_stars import StarCounts
from pipeline.plan.tiles import BLOCK_PX, blocks_of

if TYPE_CHECKING:
    from pipeline.plan.resolved import ResolvedScene

# Seconds a star, a sample of its transform, one with light for each segment of its own path, a
# value of a table: one core of the 2-core reference machine. A cubic stamp costs as much more as
# it has points.
STAR_S, STAR_S_PER_SAMPLE, ALONG_S_PER_SAMPLE, TABLE_S_PER_VALUE = 2e-4, 9e-9, 5e-9, 4e-8
CUBIC = 3.0
FEWEST_PHASES, MOST_PHASES = 8, 256  # of tables of points
POINT_BYTES = 64e6  # what the table of points may take
POINT_ROUNDING = 7e-8  # of their light: tables are in single precision (psf/response.py)
ENDS = 6.0  # more points than a long line has: those of a segment, for its ends
BRIGHTEST_E = 1e12  # of a star whose own path is cut into segments
SURE = 4.0  # times cheaper must star by star be: other frames may hold more
FREQUENCIES = 65
FEW_BRIGHT = 0.1  # of the cost of transforms: what the stars may cost that are too bright for them
TOGETHER_SIGMA = 5.0  # standard deviations of what a crowd's errors add up to
CHEAPER, FEWER = 0.5, 0.125  # of the cost of other ways, and of the stars of the fullest frame
OWN_S, USUAL_BAND = 1e-5, 1.6  # of a star's own path; cycles/px that SPECTRAL_S_PER_PIXEL is of
GRID_OVER, GRID_POINTS = 2.5, 1e8  # points to a band's wave, and what their memory allows
SHARP_PEAK, EPSILON = 0.3, 2.0**-23  # of light in one pixel, hardly ever more; of float32


@dataclass(frozen=True)
class StarEngines:
    """The engines that were chosen for the stars.

    responses : with tables only where these are cheaper; ways : how stars are drawn, in words
    tables : whether there are any of usual stars, or transforms of many in their place
    """

    responses: ResponsePlan
    ways: tuple[str, ...]
    tables: bool


def choose_engines(plan: ResolvedScene, g: Geometry, counts: StarCounts) -> StarEngines:
    """The cheapest engines for the stars of a frame. g : some of the scene's frames."""
    r = plan.responses
    streaks, far_px = _streaks(plan, g), _farthest_px(plan, g)
    limits = [0.0, *(core.brightest_e for core in r.classes), math.inf]
    classes, said, near, stars_s = [], [], [], 0.0
    pixels = math.prod(plan.scene.sensor.shape)
    for core, low_e in zip(r.classes, limits, strict=False):
        near.append(counts.near(core.radius_px + far_px))
        crowds = core is r.classes[0] and _in_crowds(plan, core, streaks, counts)
        chosen, words, seconds = _choose(plan, core, low_e, streaks, near[-1], crowds)
        else_s = seconds + crowds * crowd_s(r, pixels, near[-1].between(low_e, core.brightest_e))
        if found := _together(plan, chosen, low_e, streaks, near[-1], else_s):
            chosen, words, seconds = found
        classes.append(chosen)
        said += words
        stars_s += seconds
    beyond = counts.near(plan.halo_px + far_px)  # drawn as far as their light reaches
    stars_s += _beyond_s(plan, limits[-2], streaks, beyond, counts.near(NEAR_PX + far_px))
    ends = zip([*near, beyond], pairwise(limits), strict=True)
    expected = tuple(some.between(*light_e) for some, light_e in ends)
    around = tuple(beyond.between(*light_e) for light_e in pairwise(limits))[:-1]
    spent_s = None if r.products else stars_s
    made = replace(r, classes=tuple(classes), stars_s=spent_s, expected=expected, around=around)
    if r.spectral_from:
        made = replace(made, crowd_e=_crowd_e(plan, counts, streaks))
    drawn = r.spectral_from or r.products or any(c.phases or c.together_from for c in classes)
    return StarEngines(made, tuple(said), bool(drawn))


def _choose(
    plan: ResolvedScene,
    core: CoreClass,
    low_e: float,
    streaks: list[Streak],
    counts: StarCounts,
    crowds: bool,
) -> tuple[CoreClass, list[str], float]:
    """A class of stars above `low_e` with its phases, what is said of it, and the CPU seconds of
    its stars, 0 of those in crowds.

    counts : the stars whose cores reach the frame; crowds : whether its usual ones are drawn so
    """
    splits = _splits(core, low_e, streaks)
    ways = [_Costs(plan, core, *one) for one in zip(streaks, splits, strict=True)]
    usual = [counts.between(low_e, split) for split in splits]
    if crowds:
        usual = [math.inf] * len(usual)
    tables_s, singly_s = _mean_s(_Costs.tables, ways, usual), _mean_s(_Costs.singly, ways, usual)
    tables = plan.responses.products or tables_s <= SURE * singly_s
    usual_s = 0.0 if crowds else tables_s if tables else singly_s
    made, said, bright_s = _choose_bright(core, ways, splits, counts)
    if core.phases and not tables and max(usual) >= 0.5:
        said = [
            f"about {max(usual):.0f} stars with {_named(core)} one by one, without tables",
            *said,
        ]
    return replace(made, phases=core.phases * tables), said, bright_s + usual_s


def _together(
    plan: ResolvedScene,
    core: CoreClass,
    low_e: float,
    streaks: list[Streak],
    counts: StarCounts,
    else_s: float,
) -> tuple[CoreClass, list[str], float] | None:
    """A class whose stars above `low_e` are drawn together, as points along their own paths, where
    that takes no more than CHEAPER of `else_s`; as of `_choose`."""
    r, blocks = plan.responses, blocks_of(plan.scene.sensor.shape)
    band, many = r.crowd_band, len(r.blurs)
    sides = [min(n, BLOCK_PX) + 2.0 * core.radius_px for n in plan.scene.sensor.shape]
    if r.streaks.still or math.prod(sides) * (GRID_OVER * band) ** 2 > GRID_POINTS:
        return None
    to_e = _together_to_e(plan, core, low_e, streaks)
    served = [counts.between(low_e, e) for e in to_e]
    if max(served) < 1.0:
        return None
    fixed_s = SPECTRAL_S_PER_PIXEL * max(1.0, (band / USUAL_BAND) ** 2) * math.prod(sides)
    each_s = OWN_S + SPECTRAL_S * points_to(band, streaks)
    together_s = many * (blocks * fixed_s + each_s * sum(served) / len(served))
    ways = [_Costs(plan, core, *one) for one in zip(streaks, to_e, strict=True)]
    rest_s, as_points, most = _one_by_one(core, ways, to_e, counts)
    if together_s + rest_s > CHEAPER * else_s:
        return None
    together_from = max(1, math.ceil(FEWER * max(served) / blocks))
    crowds_e = map(partial(_crowd_noise_e, plan, counts, core.radius_px), streaks, to_e)
    finest = max(ways, key=lambda way: way.point_phases)
    points = finest.point_phases * as_points
    made = replace(
        core,
        fine_phases=0,
        point_phases=points,
        point_error=finest.point_error if points else 0.0,
        together_from=together_from,
        together_e=max(*to_e, *crowds_e),
    )
    said = [f"about {max(served):.0f} stars with {_named(core)} together, along their own paths"]
    said += _said_of_bright(core, 0.0, most, points)
    return made, said, together_s + rest_s


def _together_to_e(
    plan: ResolvedScene, core: CoreClass, low_e: float, streaks: list[Streak]
) -> list[float]:
    """Light up to which stars of a class are drawn together, for each of some streaks."""
    r = plan.responses
    near = max(near_share(streak, core.radius_px) for streak in streaks)
    finest = SHARP_PEAK * (near * FINEST_ERROR + ROUNDING * EPSILON)
    most_e = min(core.brightest_e, r.budget_e / finest)
    return [max(low_e, min(most_e, together_e(r.streaks, [streak]))) for streak in streaks]


def _crowd_noise_e(
    plan: ResolvedScene, counts: StarCounts, radius_px: float, streak: Streak, to_e: float
) -> float:
    """Light [e-] of one star that errs as much as all of at most so much light that pass a pixel,
    as errors of many stars add up like noise."""
    near, _ = light_near(streak.path, radius_px)
    around_px2 = near**2 * (CROWD_PX + 2.0 * radius_px * streak.path.length_px)
    light = counts.light_e[counts.light_e <= to_e]
    area = math.prod(plan.scene.sensor.shape)
    return TOGETHER_SIGMA * math.sqrt(around_px2 * counts.each * float(light @ light) / area)


def _beyond_s(
    plan: ResolvedScene,
    bright_e: float,
    streaks: list[Streak],
    every: StarCounts,
    near: StarCounts,
) -> float:
    """CPU seconds of stars brighter than all classes serve, by quadrature along their own paths.

    every : the stars whose light reaches the frame, near : of them those whose paths may cross it
    """
    stars, pixels = every.brighter(bright_e), math.prod(plan.scene.sensor.shape)
    if not stars:
        return 0.0
    crossing, blurs = near.brighter(bright_e) / stars, plan.responses.blurs
    paths = [_own_path(plan, streak, bright_e) for streak in streaks]
    each_s = [max(drawn_s(b, path, pixels, crossing) for b in blurs) for path in paths]
    return stars * sum(each_s) / len(paths)


def _choose_bright(
    core: CoreClass, ways: list[_Costs], splits: list[float], counts: StarCounts
) -> tuple[CoreClass, list[str], float]:
    """The same of the bright streaks alone: those of more light than `splits`, for each streak."""
    pairs = list(zip(ways, splits, strict=True))
    ends = [float(np.clip(way.fine_to_e, split, core.brightest_e)) for way, split in pairs]
    finer = [counts.between(*one) for one in zip(splits, ends, strict=True)]
    finer_s = _mean_s(_Costs.finer, ways, finer)
    alone, rest = (_one_by_one(core, ways, from_e, counts) for from_e in (splits, ends))
    fine = finer_s + rest[0] < alone[0]
    one_by_one_s, as_points, most = rest if fine else alone
    finest = max(ways, key=lambda way: way.point_phases)
    points = finest.point_phases * as_points
    made = replace(
        core,
        fine_phases=max(way.fine_phases for way in ways) * fine,
        point_phases=points,
        point_error=finest.point_error if points else 0.0,
    )
    said = _said_of_bright(core, max(finer) * fine, most, points)
    return made, said, one_by_one_s + (finer_s if fine else 0.0)


def _one_by_one(
    core: CoreClass, ways: list[_Costs], from_e: list[float], counts: StarCounts
) -> tuple[float, bool, float]:
    """CPU seconds of drawing stars of a class from so much light on along their own paths, whether
    as points those that a table serves, and most of them."""
    stars = [counts.between(light_e, core.brightest_e) for light_e in from_e]
    to_e = [
        float(np.clip(way.points_to_e, e, core.brightest_e))
        for way, e in zip(ways, from_e, strict=True)
    ]
    served = [counts.between(*one) for one in zip(from_e, to_e, strict=True)]
    others = [n - as_points for n, as_points in zip(stars, served, strict=True)]
    points_s = _mean_s(_Costs.points, ways, served) + _mean_s(_Costs.along, ways, others)
    along_s = _mean_s(_Costs.along, ways, stars)
    return min(points_s, along_s), points_s <= along_s, max(stars)


def _said_of_bright(core: CoreClass, finer: float, alone: float, points: int) -> list[str]:
    """What the decision says of the bright streaks of a class: so many in more pieces, and so many
    one by one."""
    said = []
    if finer >= 0.5:
        said.append(f"about {finer:.0f} bright streaks with {_named(core)} in more segments")
    if alone >= 0.5:
        way = f", as points of a table of {points} phases" if points else ""
        bright = f"about {alone:.0f} bright streaks with {_named(core)}"
        said.append(f"{bright} each along its own path{way}")
    return said


def _splits(core: CoreClass, low_e: float, streaks: list[Streak]) -> list[float]:
    """Light [e-] from which on stars of a class are bright for each of some streaks."""
    return [float(np.clip(s.own_from_e, low_e, core.brightest_e)) for s in streaks]


def _in_crowds(
    plan: ResolvedScene, core: CoreClass, streaks: list[Streak], counts: StarCounts
) -> bool:
    """Whether transforms draw the usual stars of the first class together: all that light a block
    are counted, as the drawing does."""
    r = plan.responses
    stars = max(counts.between(0.0, split) for split in _splits(core, 0.0, streaks))
    return 0 < r.spectral_from * blocks_of(plan.scene.sensor.shape) <= stars


def _mean_s(
    cost_s: Callable[[_Costs, float], float], ways: list[_Costs], stars: list[float]
) -> float:
    """Mean over the streaks of what so many stars on each cost."""
    return sum(cost_s(way, n) for way, n in zip(ways, stars, strict=True)) / len(ways)


def _streaks(plan: ResolvedScene, g: Geometry) -> list[Streak]:
    """The common streak at the field's middle in each of some frames."""
    streaks, aberration = plan.responses.streaks, plan.scene.star_effects["aberration"]
    middle = streaks.zones // 2
    return [
        zone_streak(plan.camera, g.frame_slice(k), middle, middle, streaks, aberration)
        for k in range(len(g.frame))
    ]


def _crowd_e(plan: ResolvedScene, counts: StarCounts, streaks: list[Streak]) -> float:
    """Light [e-] up to which transforms are to serve stars: the finer they are the dearer.

    So many brighter ones are left to stamps as cost FEW_BRIGHT of the transforms. Not below what
    the sum of all in a pixel errs by together, as errors of many stars add up like noise.
    """
    r = plan.responses
    light, fixed_s = counts.light_e, SPECTRAL_S_PER_PIXEL * math.prod(plan.scene.sensor.shape)
    left = FEW_BRIGHT * fixed_s / (r.streaks.pieces * stamp_s(r)) / counts.each
    limit_e = min(r.classes[0].brightest_e, *(streak.own_from_e for streak in streaks))
    if 1.0 <= left < len(light):
        limit_e = min(limit_e, float(light[-int(left)]))
    elif left >= len(light):
        return limit_e
    faint = light[light <= limit_e]
    area = math.prod(plan.scene.sensor.shape)
    crowd_e = TOGETHER_SIGMA * math.sqrt(CROWD_PX * counts.each * float(faint @ faint) / area)
    return max(limit_e, crowd_e)


class _Costs:
    """Seconds of drawing stars of a class in one frame, by each way.

    bright_e : light from which on they are bright streaks: most of these are hardly brighter
    """

    def __init__(
        self, plan: ResolvedScene, core: CoreClass, streak: Streak, bright_e: float
    ) -> None:
        r = plan.responses
        self._plan, self._core, self._count = plan, core, len(streak.pieces)
        self._frames = 1.0 if r.streaks.longest_px else plan.frames  # that share their tables
        self._tables = r.streaks.shapes * len(r.blurs)
        self._each = min(4, len(r.blurs))  # responses that one star is drawn by
        self._segments = _own_segments(plan, streak, bright_e)
        self._per_px2 = 0.5 * max(oversampling_for(b) for b in r.blurs) ** 2
        self._band = r.band
        self._lit = min(1.0, 0.5 * math.pi * self._band**2 / self._per_px2)
        self._path = max((p.path for p in streak.pieces), key=lambda p: p.length_px)
        self._sweep = streak.path
        self._across_px = math.hypot(*plan.scene.sensor.shape) + 2.0 * core.radius_px
        step_px = plan.field_step_px(self._sweep, core.radius_px, min(bright_e, BRIGHTEST_E))
        self._steps = max(self._segments, math.ceil(self._sweep.length_px / step_px))
        light_e = min(core.brightest_e, BRIGHTEST_E)
        self.point_phases, self.point_error = self._table_at(light_e, POINT, 1)
        near, densest = light_near(self._sweep, core.radius_px)
        off_px = self.point_error / POINTS * near / densest
        self.points_to_e = light_from(off_px, r.streaks) / densest
        self._fine, self.fine_to_e, self.fine_phases = r.streaks.finer, 0.0, 0
        if self._fine is not None:
            self.fine_to_e = self._fine.own_from_e_px * max(1.0, self._sweep.length_px)
            self._fine_path = self._sweep.scaled(1.0 / self._fine.pieces)
            light_e = min(light_e, self.fine_to_e)
            self.fine_phases = self._table_at(light_e, self._fine_path, self._fine.shapes)[0]

    def tables(self, stars: float) -> float:
        """From tables of the common shapes."""
        made = self._table_s(self._core.phases, self._path) * self._tables / self._frames
        return made + stars * self._each * self._count * self._stamp_s(1.0, self._path)

    def singly(self, stars: float) -> float:
        """Each at its exact place, with the common shapes."""
        one_s = STAR_S + STAR_S_PER_SAMPLE * self._samples(self._path)
        return stars * self._each * self._count * one_s

    def finer(self, stars: float) -> float:
        """From tables of common shapes in more pieces."""
        if self._fine is None or not self.fine_phases:
            return math.inf
        tables = self._fine.shapes * len(self._plan.responses.blurs)
        made = self._table_s(self.fine_phases, self._fine_path) * tables
        each_s = self._fine.pieces * self._stamp_s(CUBIC, self._fine_path)
        return made + stars * self._each * each_s

    def points(self, stars: float) -> float:
        """Each as points along its own path, of which those near the frame are drawn."""
        if not self.point_phases or math.isinf(stars):
            return math.inf
        tables = len(self._plan.responses.blurs) / self._plan.frames
        made = self._table_s(self.point_phases, POINT) * tables
        length_px = self._sweep.length_px
        near = min(1.0, self._across_px / max(length_px, 1.0))
        points = near * (points_per_px(self._band) * length_px + ENDS * self._segments)
        return made + stars * self._each * (STAR_S + points * self._stamp_s(CUBIC, POINT))

    def along(self, stars: float) -> float:
        """Each along its own path, of which the pieces that come near the frame are drawn."""
        pieces = max(1.0, math.ceil(self._sweep.length_px / LONGEST_PIECE_PX))
        near = math.ceil(self._across_px / LONGEST_PIECE_PX) + 2.0
        swept_s = ALONG_S_PER_SAMPLE * self._lit * max(self._steps / pieces, 1.0)
        one_s = STAR_S + (0.5 * STAR_S_PER_SAMPLE + swept_s) * self._samples(self._sweep, pieces)
        return stars * self._each * one_s * min(pieces, near)

    def _stamp_s(self, more: float, path: Path) -> float:
        """Of a stamp of a path, so much dearer a pixel than a linear one."""
        radius = self._core.radius_px
        pixels = math.pi * radius**2 + 2.0 * radius * path.length_px
        return STAMP_S + more * STAMP_S_PER_PIXEL * pixels

    def _table_s(self, phases: int, path: Path) -> float:
        """Of a table of a path."""
        return TABLE_S_PER_VALUE * table_bytes(phases, self._core.radius_px, path) / 4.0

    def _samples(self, path: Path, pieces: float = 1.0) -> float:
        """Samples of the spectrum of a core that is swept by one of so many pieces of a path."""
        sides = [
            2.0 * self._core.radius_px + float(np.ptp(v)) / pieces + 10.0
            for v in (path.x_px, path.y_px)
        ]
        return self._per_px2 * math.prod(sides)

    def _table_at(self, light_e: float, path: Path, shapes: int) -> tuple[int, float]:
        """Phases of the tables of some shapes whose cubic interpolation serves stars of so much
        light, or as many as there may be, and its error per unit light; 0 for none."""
        r, radius = self._plan.responses, self._core.radius_px
        near, densest = light_near(self._sweep, radius)
        allowed = POINTS * self._plan.allowed_e(light_e * densest) / (light_e * near)
        fourth = max(map(cubic_bound, r.blurs))
        wanted = (fourth / max(allowed - POINT_ROUNDING, 1e-12)) ** 0.25
        phases = int(np.clip(2 ** math.ceil(math.log2(wanted)), FEWEST_PHASES, MOST_PHASES))
        most = POINT_BYTES if r.field is None else FIELD_BYTES
        while phases and table_bytes(phases, radius, path) * shapes * len(r.blurs) > most:
            phases = phases // 2 if phases > FEWEST_PHASES else 0
        return phases, max(_point_error(b, radius, max(phases, 1)) for b in r.blurs)


def _farthest_px(plan: ResolvedScene, g: Geometry) -> float:
    """Farthest that a star moves from its place at mid-exposure in any of some frames."""
    return float(excursions_px(plan.camera, g, plan.scene.star_effects["aberration"]).max())


def _own_segments(plan: ResolvedScene, streak: Streak, light_e: float) -> int:
    """Segments of `_own_path` where it is drawn as points."""
    path = in_fewer_points(_own_path(plan, streak, light_e), plan.responses.band)
    return int(np.count_nonzero(path.weight))


def _own_path(plan: ResolvedScene, streak: Streak, light_e: float) -> Path:
    """The own path of a star of so much light in the middle of a streak's zone."""
    x_px, y_px = streak.followed[:, :, 1, 1].T
    weight = np.full(len(x_px) - 1, 1.0 / (len(x_px) - 1))
    share = densest_share(x_px, y_px, weight)
    merge_px = plan.merged_px(np.array(min(light_e, BRIGHTEST_E)), share)
    return curve_through(x_px, y_px, weight, float(merge_px))


def _point_error(blur: Blur, radius_px: float, phases: int) -> float:
    """What a pixel of a star at rest errs by from a table of so many phases, per unit light."""
    if is_product(blur, 0.0):
        return product_table(blur, radius_px).cubic_error
    return cubic_bound(blur) / phases**4 + POINT_ROUNDING


@lru_cache(maxsize=256)
def cubic_bound(blur: Blur) -> float:
    """Upper bound of the error of cubic interpolation between phases, times their number^4.

    Per unit light: 3/128 times the integral of ((2 pi fx)^4 + (2 pi fy)^4) |T| over frequencies.
    """
    end = blur.band_limit(1e-3)
    f = np.linspace(-end, end, 2 * FREQUENCIES - 1)
    fourth = (2.0 * np.pi * f) ** 4
    size = np.abs(blur.transfer(f[:, None], f[None, :]))
    integrand = (fourth[:, None] + fourth[None, :]) * size
    return 3.0 / 128.0 * float(np.trapezoid(np.trapezoid(integrand, f), f))


def _named(core: CoreClass) -> str:
    return f"cores of {core.radius_px:.0f} px"
