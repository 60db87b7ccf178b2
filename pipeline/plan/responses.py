"""How sources are drawn: core radii by brightness, phases, the coarse grid of the wings, zones."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from pipeline.arrays import Array, Geometry
from pipeline.errors import BadInput
from pipeline.physics.drawing.wings import CUT_FROM, wing_error
from pipeline.physics.motion.streak import POINT, Path, path_through, pieces
from pipeline.physics.positions.focal_plane import Camera
from pipeline.physics.psf.pupil import Blur
from pipeline.physics.psf.response import compact_core, oversampling_for
from pipeline.plan.facts import Facts
from pipeline.plan.geometry import star_path
from pipeline.plan.optics import missing_light
from pipeline.spec.scene import CELL_PX, Scene

PATH_STEP_PX = 2.0**-7  # streaks of stars are rounded to it, so that alike ones share their tables
MERGE_TOLERANCE_PX = 2e-3
SPREAD_TOLERANCE_PX = 1e-2
TABLE_BYTES = 48e6
MOST_CLASSES = 5
SMALLEST_Q, LARGEST_Q = 0.02, 64.0
LARGEST_CORE_SAMPLES = 1024  # radius times samples a pixel: what one transform may hold
BLOCK_PX = 2048  # wings are convolved in fixed blocks of the focal plane


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
    zones : the focal plane is cut into zones x zones, each with one streak for all its stars
    spread_px : largest difference between a star's own streak and its zone's
    budget_e : error that one approximation may make in one pixel
    """

    blur: Blur
    classes: tuple[CoreClass, ...]
    spacing_px: int
    reach_px: float
    lost_light: float
    zones: int
    spread_px: float
    budget_e: float


def plan_responses(scene: Scene, facts: Facts, camera: Camera, ends: Geometry) -> ResponsePlan:
    """Choose radii, phases, grid and zones for a scene from some of its frames (`ends`)."""
    blur = facts.blur
    if not (scene.stars or scene.targets):
        return ResponsePlan(blur, (), 0, 0.0, 0.0, 1, 0.0, facts.budget_e)
    aberration = scene.star_effects["aberration"]
    zones, spread = (1, 0.0)
    path = POINT
    if scene.stars is not None:
        zones, spread = plan_zones(camera, ends, aberration)
        frames = range(len(ends.frame))
        paths = [zone_streak(camera, ends, f, 0, 0, 1, aberration).path for f in frames]
        path = min(paths, key=lambda p: p.length_px)
    phases = _phases(scene.sensor.psf.oversampling, blur)
    if not blur.has_wings:
        radius = _radius_holding(blur, 1e-8)
        size = _table_phases(phases, radius, path)
        one = CoreClass(radius, math.inf, 0.0, size)
        return ResponsePlan(blur, (one,), 0, radius, _lost(blur, radius), zones, spread,
                            facts.budget_e)  # fmt: skip
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
        blur, classes, spacing, reach, _lost(blur, CUT_FROM * reach), zones, spread,
        facts.budget_e,
    )  # fmt: skip


def _classes(
    blur: Blur, first: float, spacing: int, path: Path, phases: int, budget_e: float
) -> tuple[CoreClass, ...]:
    """Cores of doubling radius; the wing's error is measured for two and falls as told after."""
    largest = LARGEST_CORE_SAMPLES / oversampling_for(blur)
    piece = max((p for _, _, p, _ in pieces(path)), key=lambda p: p.length_px)
    out: list[CoreClass] = []
    for k in range(MOST_CLASSES):
        radius = first * 2.0**k
        if k < 2:
            error = _measured_wing_error(blur, radius, spacing, piece)
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
    longest = max(p.length_px for _, _, p, _ in pieces(path))
    pixels = math.pi * radius_px**2 + 2.0 * radius_px * longest
    while phases >= 16 and 4.0 * pixels * (phases + 3) ** 2 > TABLE_BYTES:
        phases //= 2
    return phases if 4.0 * pixels * (phases + 3) ** 2 <= TABLE_BYTES else 0


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


def plan_zones(camera: Camera, ends: Geometry, aberration: bool) -> tuple[int, float]:
    """Fewest zones per axis whose stars streak alike, and the largest difference left [px]."""
    most = max(1, math.ceil(max(camera.rows, camera.columns) / CELL_PX))
    zones = 1
    while True:
        spread = _spread_px(camera, ends, zones, aberration)
        if spread <= SPREAD_TOLERANCE_PX or zones >= most:
            return zones, spread
        zones = min(2 * zones, most)


def _spread_px(camera: Camera, ends: Geometry, zones: int, aberration: bool) -> float:
    """Largest difference between the paths at a zone's corners and its centre [px].

    Looked at in the zones of the frame's corners and of its middle, where it is largest and least.
    """
    worst = 0.0
    for row in {0, zones // 2, zones - 1}:
        for column in {0, zones // 2, zones - 1}:
            y0, y1, x0, x1 = zone_edges(camera, row, column, zones)
            middle = _offsets(camera, ends, 0.5 * (x0 + x1), 0.5 * (y0 + y1), aberration)
            for x, y in ((x0, y0), (x0, y1), (x1, y0), (x1, y1)):
                corner = _offsets(camera, ends, x, y, aberration)
                worst = max(worst, float(np.hypot(*(corner - middle)).max()))
    return worst


def zone_edges(
    camera: Camera, row: int, column: int, zones: int
) -> tuple[float, float, float, float]:
    """(y0, y1, x0, x1) of a zone in pixels."""
    y, x = camera.rows / zones, camera.columns / zones
    return row * y - 0.5, (row + 1) * y - 0.5, column * x - 0.5, (column + 1) * x - 0.5


def _offsets(camera: Camera, g: Geometry, x: float, y: float, aberration: bool) -> Array:
    """(2, F, K) path of the star at (x, y) relative to its place at mid-exposure."""
    px, py = star_path(camera, g, x, y, aberration)
    if not np.isfinite(px).all():
        raise BadInput(
            "exposure.integration_s", "a boresight that turns away from its field in one exposure",
            "a shorter exposure or a slower pointing",
        )  # fmt: skip
    return np.stack([px - px[:, [g.middle]], py - py[:, [g.middle]]])


@dataclass(frozen=True)
class Streak:
    """The common streak of a zone: a path on the PATH_STEP_PX grid, moved by a small shift [px].

    The shift puts the light's centroid where the exact path has it; the path without it is the
    same for frames and zones whose streaks differ by less than the step.
    """

    path: Path
    shift_x_px: float
    shift_y_px: float


def zone_streak(
    camera: Camera, g: Geometry, frame: int, row: int, column: int, zones: int, aberration: bool
) -> Streak:
    """The common streak of a zone's stars in one frame, relative to mid-exposure."""
    y0, y1, x0, x1 = zone_edges(camera, row, column, zones)
    one = g.frame_slice(frame)
    dx, dy = _offsets(camera, one, 0.5 * (x0 + x1), 0.5 * (y0 + y1), aberration)[:, 0]
    path = path_through(dx, dy, np.full(g.nodes - 1, 1.0 / (g.nodes - 1)), MERGE_TOLERANCE_PX)
    x, y = (np.round(a / PATH_STEP_PX) * PATH_STEP_PX + 0.0 for a in (path.x_px, path.y_px))
    rounded = Path(x, y, path.weight)
    exact, moved = centroid(path), centroid(rounded)
    return Streak(rounded, exact[0] - moved[0], exact[1] - moved[1])


def centroid(path: Path) -> tuple[float, float]:
    """Mean place of the light of a path (x, y)."""
    middle_x = 0.5 * (path.x_px[1:] + path.x_px[:-1])
    middle_y = 0.5 * (path.y_px[1:] + path.y_px[:-1])
    return float(path.weight @ middle_x), float(path.weight @ middle_y)
