"""Tables or star by star: the cheapest way to draw the stars of each core class and streak.

The choice follows from the scene and the stars of its fullest frame (of a few), never from tiles or
workers. It changes costs alone: either way meets the bounds that the plan states.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from pipeline.arrays import Geometry
from pipeline.physics.drawing.spectral_plan import CROWD_PX
from pipeline.physics.motion.streak import LONGEST_PIECE_PX, Path, path_through, transfer
from pipeline.physics.psf.pupil import Blur
from pipeline.physics.psf.response import band_of, oversampling_for
from pipeline.plan.pointing.star_paths import excursions_px
from pipeline.plan.response.responses import (
    FIELD_BYTES,
    SPECTRAL_S_PER_PIXEL,
    STAMP_S,
    STAMP_S_PER_PIXEL,
    CoreClass,
    ResponsePlan,
    stamp_s,
    table_bytes,
)
from pipeline.plan.response.streaks import Streak, densest_share, zone_streak
from pipeline.plan.stars.field_stars import StarCounts
from pipeline.plan.tiles import BLOCK_PX

if TYPE_CHECKING:
    from pipeline.plan.resolved import ResolvedScene

# Seconds a star, a sample of its transform, one with light for each segment of its own path, a
# value of a table: one core of the 2-core reference machine. A cubic stamp costs as much more as
# it has points.
STAR_S, STAR_S_PER_SAMPLE, ALONG_S_PER_SAMPLE, TABLE_S_PER_VALUE = 2e-4, 9e-9, 5e-9, 4e-8
CUBIC = 3.0
FEWEST_PHASES, MOST_PHASES = 8, 32
MIXTURE_BYTES = 48e6  # what the three tables of a mixture may take
BRIGHTEST_E = 1e12  # of a star whose own path is cut into segments
SURE = 4.0  # times cheaper must star by star be: other frames may hold more
FREQUENCIES = 65
FEW_BRIGHT = 0.1  # of the cost of transforms: what the stars may cost that are too bright for them
TOGETHER = 5.0  # standard deviations of what a crowd's errors add up to


@dataclass(frozen=True)
class StarEngines:
    """The engines that were chosen for the stars.

    responses : with tables only where these are cheaper; ways : how stars are drawn, in words
    tables : whether there are any
    """

    responses: ResponsePlan
    ways: tuple[str, ...]
    tables: bool


def choose_engines(plan: ResolvedScene, g: Geometry, counts: StarCounts) -> StarEngines | None:
    """The cheapest engines for the stars of a frame; None where there are no responses to choose.

    g : some of the scene's frames
    """
    r = plan.responses
    if not r.classes:
        return None
    streaks, far_px = _streaks(plan, g), _farthest_px(plan, g)
    limits = [0.0, *(core.brightest_e for core in r.classes), math.inf]
    classes, said, near, stars_s = [], [], [], 0.0
    for core, low_e in zip(r.classes, limits, strict=False):
        near.append(counts.near(core.radius_px + far_px))
        crowds = core is r.classes[0] and _in_crowds(plan, core, streaks, counts)
        chosen, words, seconds = _choose(plan, core, low_e, streaks, near[-1], crowds)
        classes.append(chosen)
        said += words
        stars_s += seconds
    ends = zip([*near, near[-1]], pairwise(limits), strict=True)
    expected = tuple(some.between(*light_e) for some, light_e in ends)
    spent_s = None if r.products else stars_s
    made = replace(r, classes=tuple(classes), stars_s=spent_s, expected=expected)
    if r.spectral_from:
        made = replace(made, crowd_e=_crowd_e(plan, counts, streaks))
    drawn = r.spectral_from or r.products or any(c.phases or c.mixed_phases for c in classes)
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
    bright = [counts.between(split, core.brightest_e) for split in splits]
    if crowds:
        usual = [math.inf] * len(usual)
    tables_s, singly_s = _mean_s(_Costs.tables, ways, usual), _mean_s(_Costs.singly, ways, usual)
    mixtures_s = _mean_s(_Costs.mixtures, ways, bright)
    along_s = _mean_s(_Costs.along, ways, bright)
    tables = plan.responses.products or tables_s <= SURE * singly_s
    phases = core.phases * tables
    mixed = max(way.mixed_phases for way in ways) * (mixtures_s <= along_s)
    usual_s = 0.0 if crowds else tables_s if tables else singly_s
    said = _said(core, max(usual), max(bright), phases, mixed)
    made = replace(core, phases=phases, mixed_phases=mixed)
    return made, said, min(mixtures_s, along_s) + usual_s


def _splits(core: CoreClass, low_e: float, streaks: list[Streak]) -> list[float]:
    """Light [e-] from which on stars of a class are bright for each of some streaks."""
    return [float(np.clip(s.mixed_from_e, low_e, core.brightest_e)) for s in streaks]


def _in_crowds(
    plan: ResolvedScene, core: CoreClass, streaks: list[Streak], counts: StarCounts
) -> bool:
    """Whether transforms draw the usual stars of the first class together: all that light a block
    are counted, as the drawing does."""
    r = plan.responses
    stars = max(counts.between(0.0, split) for split in _splits(core, 0.0, streaks))
    return 0 < r.spectral_from * _blocks(plan) <= stars


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
    limit_e = min(r.classes[0].brightest_e, *(streak.mixed_from_e for streak in streaks))
    if 1.0 <= left < len(light):
        limit_e = min(limit_e, float(light[-int(left)]))
    elif left >= len(light):
        return limit_e
    faint = light[light <= limit_e]
    area = math.prod(plan.scene.sensor.shape)
    crowd_e = TOGETHER * math.sqrt(CROWD_PX * counts.each * float(faint @ faint) / area)
    return max(limit_e, crowd_e)


def _blocks(plan: ResolvedScene) -> int:
    return math.ceil(math.prod(plan.scene.sensor.shape) / BLOCK_PX**2)


class _Costs:
    """Seconds of drawing stars of a class in one frame, by each way.

    bright_e : light from which on they are bright streaks: most of these are hardly brighter
    """

    def __init__(
        self, plan: ResolvedScene, core: CoreClass, streak: Streak, bright_e: float
    ) -> None:
        r = plan.responses
        self._core, self._count = core, len(streak.pieces)
        self._frames = 1.0 if r.streaks.longest_px else plan.frames  # that share their tables
        self._tables = r.streaks.shapes * len(r.blurs)
        self._each = min(4, len(r.blurs))  # responses that one star is drawn by
        self._segments = _own_segments(plan, streak, bright_e)
        self._per_px2 = 0.5 * max(oversampling_for(b) for b in r.blurs) ** 2
        self._lit = min(1.0, 0.5 * math.pi * max(band_of(b) for b in r.blurs) ** 2 / self._per_px2)
        self._path = max((p.path for p in streak.pieces), key=lambda p: p.length_px)
        self._sweep = streak.path
        self._across_px = math.hypot(*plan.scene.sensor.shape) + 2.0 * core.radius_px
        self.mixed_phases = self._phases_of_mixtures(r, streak)

    def tables(self, stars: float) -> float:
        """From tables of the common shapes."""
        made = self._table_s(self._core.phases) * self._tables / self._frames
        return made + stars * self._each * self._count * self._stamp_s(1.0)

    def singly(self, stars: float) -> float:
        """Each at its exact place, with the common shapes."""
        one_s = STAR_S + STAR_S_PER_SAMPLE * self._samples(self._path)
        return stars * self._each * self._count * one_s

    def mixtures(self, stars: float) -> float:
        """From tables of three shapes."""
        if not self.mixed_phases or math.isinf(stars):
            return math.inf
        made = 3.0 * self._table_s(self.mixed_phases) * self._tables
        return made + stars * self._each * self._count * 3.0 * self._stamp_s(CUBIC)

    def along(self, stars: float) -> float:
        """Each along its own path, of which the pieces that come near the frame are drawn."""
        pieces = max(1.0, math.ceil(self._sweep.length_px / LONGEST_PIECE_PX))
        near = math.ceil(self._across_px / LONGEST_PIECE_PX) + 2.0
        swept_s = ALONG_S_PER_SAMPLE * self._lit * max(self._segments / pieces, 1.0)
        one_s = STAR_S + (0.5 * STAR_S_PER_SAMPLE + swept_s) * self._samples(self._sweep, pieces)
        return stars * self._each * one_s * min(pieces, near)

    def _stamp_s(self, more: float) -> float:
        radius = self._core.radius_px
        pixels = math.pi * radius**2 + 2.0 * radius * self._path.length_px
        return STAMP_S + more * STAMP_S_PER_PIXEL * pixels

    def _table_s(self, phases: int) -> float:
        return TABLE_S_PER_VALUE * table_bytes(phases, self._core.radius_px, self._path) / 4.0

    def _samples(self, path: Path, pieces: float = 1.0) -> float:
        """Samples of the spectrum of a core that is swept by one of so many pieces of a path."""
        sides = [
            2.0 * self._core.radius_px + float(np.ptp(v)) / pieces + 10.0
            for v in (path.x_px, path.y_px)
        ]
        return self._per_px2 * math.prod(sides)

    def _phases_of_mixtures(self, r: ResponsePlan, streak: Streak) -> int:
        """Fewest phases whose cubic interpolation serves the class's brightest; 0 for none."""
        piece = streak.pieces[len(streak.pieces) // 2]
        brightest = self._core.brightest_e * piece.share
        if not math.isfinite(brightest):
            return 0
        needed = max(cubic_bound(b, piece.base) for b in r.blurs) * brightest / r.budget_e
        wanted = 2 ** math.ceil(0.25 * math.log2(max(needed, 1e-9)))
        phases = max(FEWEST_PHASES, int(wanted)) if wanted <= MOST_PHASES else 0
        together = 3.0 * table_bytes(phases, self._core.radius_px, piece.base) * self._tables
        most = MIXTURE_BYTES * max(1, r.streaks.shapes) if r.field is None else FIELD_BYTES
        return phases if together <= most else 0


def _farthest_px(plan: ResolvedScene, g: Geometry) -> float:
    """Farthest that a star moves from its place at mid-exposure in any of some frames."""
    return float(excursions_px(plan.camera, g, plan.scene.star_effects["aberration"]).max())


def _own_segments(plan: ResolvedScene, streak: Streak, light_e: float) -> int:
    """Segments of the own path of a star of so much light in the middle of a streak's zone."""
    x_px, y_px = streak.followed[:, :, 1, 1].T
    weight = np.full(len(x_px) - 1, 1.0 / (len(x_px) - 1))
    share = densest_share(x_px, y_px, weight)
    merge_px = plan.merged_px(np.array(min(light_e, BRIGHTEST_E)), share)
    return path_through(x_px, y_px, weight, float(merge_px)).segments


def cubic_bound(blur: Blur, path: Path) -> float:
    """Upper bound of the error of cubic interpolation between phases, times their number^4.

    Per unit light: 3/128 times the integral of ((2 pi fx)^4 + (2 pi fy)^4) |T| over frequencies.
    """
    end = blur.band_limit(1e-3)
    f = np.linspace(-end, end, 2 * FREQUENCIES - 1)
    swept = np.abs(transfer(f, f, path.x_px, path.y_px, path.weight))
    swept *= np.abs(blur.transfer(f[:, None], f[None, :]))
    fourth = (2.0 * np.pi * f) ** 4
    integrand = (fourth[:, None] + fourth[None, :]) * swept
    return 3.0 / 128.0 * float(np.trapezoid(np.trapezoid(integrand, f), f))


def _said(core: CoreClass, usual: float, bright: float, phases: int, mixed: int) -> list[str]:
    """What the decision says of a class."""
    name = f"cores of {core.radius_px:.0f} px"
    said = []
    if core.phases and not phases and usual >= 0.5:
        said.append(f"about {usual:.0f} stars with {name} one by one, without tables")
    if bright >= 0.5:
        way = f"by mixtures of {mixed} phases" if mixed else "each along its own path"
        said.append(f"about {bright:.0f} bright streaks with {name} {way}")
    return said
