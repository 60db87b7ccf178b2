"""How sources are drawn: core radii by brightness, phases, the coarse grid of the wings."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

from pipeline.arrays import Geometry
from pipeline.errors import BadInput
from pipeline.physics.drawing.extended import point_error
from pipeline.physics.drawing.wings import CUT_FROM, wing_error
from pipeline.physics.motion.streak import POINT, Path
from pipeline.physics.positions.focal_plane import Camera
from pipeline.physics.psf.pupil import Blur
from pipeline.physics.psf.response import compact_core, oversampling_for
from pipeline.plan.facts import Facts
from pipeline.plan.optics import missing_light
from pipeline.plan.streaks import StreakPlan, plan_streaks, zone_streak
from pipeline.spec.scene import Scene

TABLE_BYTES = 48e6
MOST_CLASSES = 5
SMALLEST_Q, LARGEST_Q = 0.02, 64.0
LARGEST_CORE_SAMPLES = 1024  # radius times samples a pixel: what one transform may hold
SMALL_RADIUS_PX = 1e-2
STILL = StreakPlan(1, 1, 0.0, 0.0, 1)
BLOCK_PX = 2048  # wings and crowds are drawn in fixed blocks of the focal plane
# Seconds a star, a stamp's pixel, a star and a pixel of the spectral engine, a sample of a
# transform: one core of the 2-core reference machine (benchmarks/drawing.py prints them anew).
STAMP_S, STAMP_S_PER_PIXEL = 1e-7, 1.2e-9
SPECTRAL_S, SPECTRAL_S_PER_PIXEL = 1.5e-7, 8e-8
TRANSFORM_S_PER_SAMPLE = 4e-8


@dataclass(frozen=True)
class CoreClass:
    """Sources up to `brightest_e` electrons get cores of `radius_px`.

    wing_error : largest error of a wing pixel per electron of the source (0 without wings)
    phases : sub-pixel phases of its tables; 0 draws each source by its own transform
    """

    radius_px: float
    brightest_e: float
    wing_error: float
    phases: int


@dataclass(frozen=True)
class ResponsePlan:
    """Everything that drawing needs besides sources and their paths.

    spacing_px : of the wings' grid, 0 where the response has no wings
    reach_px : radius beyond which a source's light is left out; lost_light : that fraction
    spectral_from : stars around a block from which they are drawn together by transforms; 0 never
    streaks : how the stars' common streaks are drawn
    budget_e : error that one approximation may make in one pixel
    """

    blur: Blur
    classes: tuple[CoreClass, ...]
    spacing_px: int
    reach_px: float
    lost_light: float
    streaks: StreakPlan
    budget_e: float
    spectral_from: int = 0


def plan_responses(scene: Scene, facts: Facts, camera: Camera, ends: Geometry) -> ResponsePlan:
    """Choose radii, phases, grid and zones for a scene from some of its frames (`ends`)."""
    blur = facts.blur
    if not (scene.stars or scene.targets):
        return ResponsePlan(blur, (), 0, 0.0, 0.0, STILL, facts.budget_e)
    aberration = scene.star_effects["aberration"]
    path, streaks = POINT, STILL
    if scene.stars is not None:
        streaks = plan_streaks(camera, ends, aberration)
        path = _shortest_piece(camera, ends, streaks, aberration)
    phases = _phases(scene.sensor.psf.oversampling, blur)
    if not blur.has_wings:
        radius = _radius_holding(blur, 1e-8)
        size = _table_phases(phases, radius, path)
        one = CoreClass(radius, math.inf, 0.0, size)
        return ResponsePlan(
            blur, (one,), 0, radius, _lost(blur, radius), streaks, facts.budget_e,
            _spectral_from(scene, blur, one, streaks),
        )  # fmt: skip
    q = blur.optics.scale_px
    if not SMALLEST_Q <= q <= LARGEST_Q:
        raise BadInput(
            "sensor.psf",
            f"{scene.sensor.psf.kind} of a scale (Q = lambda F / (D pitch), or FWHM) of {q:.3g} px",
            f"{SMALLEST_Q} to {LARGEST_Q} px: another pitch, focal length or wavelength, or a "
            "gaussian",
        )
    first = blur.core_px
    spacing = int(2 ** max(1, math.floor(math.log2(first / 5.0))))
    reach = max(_radius_holding(blur, scene.accuracy.flux_fraction) / CUT_FROM, 2.0 * first)
    classes = _classes(blur, first, spacing, path, phases, facts.budget_e)
    return ResponsePlan(
        blur, classes, spacing, reach, _lost(blur, CUT_FROM * reach), streaks,
        facts.budget_e, _spectral_from(scene, blur, classes[0], streaks),
    )  # fmt: skip


def _shortest_piece(camera: Camera, ends: Geometry, streaks: StreakPlan, aberration: bool) -> Path:
    """The shortest piece of a streak in the middle of the frames looked at: the sharpest."""
    found = []
    for f in range(len(ends.frame)):
        one = ends.frame_slice(f)
        at = streaks.zones // 2
        streak = zone_streak(camera, one, at, at, streaks, aberration)
        found += [p.path for p in streak.pieces]
    return min(found, key=lambda p: p.length_px)


def _spectral_from(scene: Scene, blur: Blur, core: CoreClass, streaks: StreakPlan) -> int:
    """Stars in and around a block from which transforms are quicker than stamps; 0 without stars.

    From measured unit costs (benchmarks/drawing.py); a star that no table serves costs a transform
    of its own.
    """
    if scene.stars is None:
        return 0
    piece_px = streaks.longest_px / streaks.pieces
    side = 2.0 * core.radius_px + piece_px
    block = math.prod(min(BLOCK_PX, n) + side for n in scene.sensor.shape)
    if core.phases:
        stamp = math.pi * core.radius_px**2 + 2.0 * core.radius_px * piece_px
        star_s = STAMP_S + STAMP_S_PER_PIXEL * stamp
    else:
        star_s = TRANSFORM_S_PER_SAMPLE * (side * oversampling_for(blur)) ** 2
    if star_s <= 2.0 * SPECTRAL_S:
        return 0
    fixed_s = SPECTRAL_S_PER_PIXEL * block * streaks.shapes
    return math.ceil(fixed_s / (streaks.pieces * (star_s - SPECTRAL_S)))


def _classes(
    blur: Blur, first: float, spacing: int, path: Path, phases: int, budget_e: float
) -> tuple[CoreClass, ...]:
    """Cores of doubling radius; the wing's error is measured for two and falls as told after."""
    largest = LARGEST_CORE_SAMPLES / oversampling_for(blur)
    out: list[CoreClass] = []
    for k in range(MOST_CLASSES):
        radius = first * 2.0**k
        if k < 2:
            error = _measured_wing_error(blur, radius, spacing, path)
        else:
            error = out[-1].wing_error / blur.optics.wing_fall(0.5 * radius)
        last = k == MOST_CLASSES - 1 or 2.0 * radius > largest
        brightest = math.inf if last else budget_e / error
        out.append(CoreClass(radius, brightest, error, _table_phases(phases, radius, path)))
        if last:
            break
    return tuple(out)


@lru_cache(maxsize=64)
def _measured_wing_error(blur: Blur, radius_px: float, spacing_px: int, piece: Path) -> float:
    """The wing's error of a core of some radius, measured once for each response and streak."""
    return wing_error(blur, compact_core(blur, radius_px), spacing_px, piece)


def _phases(asked: int, blur: Blur) -> int:
    """Phases per pixel: as asked, more where the response is too sharp for them."""
    needed = 2 ** math.ceil(math.log2(max(1.0, 16.0 * blur.band_limit(1e-3))))
    return int(min(256, max(asked, needed)))


def _table_phases(phases: int, radius_px: float, path: Path) -> int:
    """Phases that a table of this radius may have within TABLE_BYTES; 0 if fewer than needed.

    A response that is broad against a pixel needs few phases, so halving them costs nothing until
    the interpolation's own bound (checked for each source when it is drawn) says otherwise.
    """
    pixels = math.pi * radius_px**2 + 2.0 * radius_px * path.length_px
    while phases >= 16 and 4.0 * pixels * (phases + 3) ** 2 > TABLE_BYTES:
        phases //= 2
    return phases if 4.0 * pixels * (phases + 3) ** 2 <= TABLE_BYTES else 0


@lru_cache(maxsize=16)
def point_curvature(blur: Blur) -> float:
    """Error of a pixel per unit light and squared radius [px] of a body that is drawn as a point.

    An upper bound for every radius: the bound itself grows at most with the square.
    """
    return point_error(blur, SMALL_RADIUS_PX) / SMALL_RADIUS_PX**2


def _lost(blur: Blur, radius_px: float) -> float:
    """Share of a source's light beyond a radius, or outside of its optics' table altogether."""
    return min(1.0, blur.light_beyond(radius_px) + missing_light(blur.optics))


def _radius_holding(blur: Blur, beyond: float) -> float:
    """Radius outside which no more than `beyond` of the light falls [px]."""
    low, high = 0.1, 4.0
    while blur.light_beyond(high) > beyond and high < 1e6:
        high *= 2.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if blur.light_beyond(middle) > beyond else (low, middle)
    return high
