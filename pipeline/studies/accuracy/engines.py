"""Our own drawing engines at a ladder of settings, as functions from stars to an image."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from itertools import groupby
from operator import attrgetter
from typing import NamedTuple

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from pipeline.physics.drawing.along import swept_spectrum
from pipeline.physics.drawing.products import draw_products
from pipeline.physics.drawing.spectral import Sources, draw_spectral, transfer_table
from pipeline.physics.drawing.spectral_band import peak_light
from pipeline.physics.drawing.spectral_plan import plan_spectral
from pipeline.physics.drawing.stamps import draw_stamps
from pipeline.physics.drawing.wings import (
    add_wings,
    convolve,
    grid_frequencies,
    spread,
    wing_grid,
    wing_kernel,
)
from pipeline.physics.motion.streak import Path, pieces, transfer
from pipeline.physics.psf.product import is_product, product_table
from pipeline.physics.psf.pupil import Airy, Blur, Gaussian
from pipeline.physics.psf.response import (
    Core,
    PixelResponse,
    compact_core,
    phase_table,
    window,
)
from pipeline.studies.accuracy.reference import AiryStar, GaussianStar, Shape, Track

Array = NDArray[np.float64]
Draw = Callable[[Array, Array, Array], NDArray[np.floating]]

GAUSSIAN_RADIUS = 6.1  # sigmas: 1e-8 of the light is beyond
FIRST_CORE_Q = 24.0  # radius of an airy core in the phase ladder, in units of Q
WING_REACH = 8.0  # of the core's radius, at most REACH_PX
REACH_PX = 512.0


@dataclass(frozen=True, eq=False)
class EngineCase:
    """What is drawn: a star's shape, its motion, and the frame (rows, columns)."""

    shape: Shape
    track: Track
    streak_px: float
    frame: tuple[int, int]
    curved: bool = False

    @property
    def name(self) -> str:
        bent = " curved" if self.curved else ""
        return f"{self.shape.name}, {self.streak_px:g} px{bent}"


class Drawn(NamedTuple):
    """A prepared engine: draw(x_px, y_px, light_e) -> (rows, columns) electrons; its tables."""

    draw: Draw
    table_bytes: int | None = None


class Setting(NamedTuple):
    """One level of a ladder: make(case) prepares it, at a cost that is timed apart."""

    engine: str
    setting: str
    make: Callable[[EngineCase], Drawn]
    ours: bool = True


def blur_of(shape: Shape) -> Blur:
    """The product's response of a reference shape."""
    if isinstance(shape, GaussianStar):
        return Blur(Gaussian(shape.sigma_px))
    return Blur(Airy(shape.q_px, shape.obscuration))


def path_of(track: Track) -> Path:
    """The product's path of a track of contiguous parts."""
    x, y = (np.append(a[:, 0], a[-1, 1]) for a in (track.x_px, track.y_px))
    return Path(x, y, track.weight)


def our_settings(case: EngineCase, quick: bool) -> list[Setting]:
    """Every ladder that applies to a case; `quick` keeps two levels of each."""
    out = [] if case.curved else [*_phases(case), *_spectral(case)]
    if isinstance(case.shape, AiryStar):
        out += _wings(case)
    elif case.curved:
        out += [_polyline(n) for n in (1, 2, 4, 8, 16, 32, 64, 128)]
    else:
        out += _straight(case)
    if not quick:
        return out
    ladders = (list(levels) for _, levels in groupby(out, attrgetter("engine")))
    return [levels[k] for levels in ladders for k in (0, len(levels) // 2)]


def _straight(case: EngineCase) -> list[Setting]:
    """Ladders of Gaussian stars and their straight streaks alone."""
    out: list[Setting] = []
    if is_product(blur_of(case.shape), case.streak_px):
        out += [_product(phases) for phases in (4, 8, 16, 32, 64)]
    out += [_tiled(case, side) for side in (128, 256, 512)]
    if case.streak_px:
        densities = (0.5, 1.0, 2.0, 4.0) if case.streak_px <= 100 else (0.5, 1.0)
        out += [_sampled(case, per_px) for per_px in densities]
    return out


def _radius(case: EngineCase) -> float:
    if isinstance(case.shape, GaussianStar):
        return GAUSSIAN_RADIUS * case.shape.sigma_px
    return FIRST_CORE_Q * case.shape.q_px


def _phases(case: EngineCase) -> list[Setting]:
    ladder = [(8, False), (16, False), (32, False), (64, False), (128, False)]
    ladder += [(8, True), (16, True), (32, True), (64, True)]
    if isinstance(case.shape, AiryStar):
        ladder = [level for level in ladder if level[0] <= 64 and case.streak_px <= 60]
    return [
        Setting(
            f"stamps, {'cubic' if cubic else 'linear'}",
            f"{phases} phases",
            partial(_stamps, phases=phases, cubic=cubic, radius_px=_radius(case), spacing_px=2),
        )
        for phases, cubic in ladder
    ]


def _wings(case: EngineCase) -> list[Setting]:
    """Core radii with the finest grid, and grid spacings with one core."""
    phases = 32 if case.streak_px <= 60 else 16
    assert isinstance(case.shape, AiryStar)
    q = case.shape.q_px
    levels = [("core radius", r * q, 2) for r in (6.0, 12.0, 24.0, 48.0)]
    levels += [("wing grid", FIRST_CORE_Q * q, h) for h in (16, 8, 4, 2)]
    return [
        Setting(
            engine,
            f"core {radius:g} px, grid {spacing} px",
            partial(_stamps, phases=phases, cubic=True, radius_px=radius, spacing_px=spacing),
        )
        for engine, radius, spacing in levels
    ]


def _spectral(case: EngineCase) -> list[Setting]:
    """The transforms by the error asked of them; diffraction's light is cut off the farther out."""
    if isinstance(case.shape, GaussianStar):
        ladder = [(e, _radius(case)) for e in (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7)]
    else:
        far = 16.0 if case.streak_px else 8.0  # a streak's peak is fainter, its wings are not
        wider = (1e-2, 4.0), (1e-3, 4.0), (1e-4, 4.0), (1e-5, 8.0), (1e-6, far)
        ladder = [(e, times * _radius(case)) for e, times in wider]
    return [
        Setting("spectral", f"asked {e:.0e}", partial(_spectral_of, error=e, radius_px=radius))
        for e, radius in ladder
    ]


def _tiled(case: EngineCase, side: int) -> Setting:
    make = partial(_stamps, phases=32, cubic=True, radius_px=_radius(case), spacing_px=2, tile=side)
    return Setting("tiles", f"{side} px", make)


def _sampled(case: EngineCase, per_px: float) -> Setting:
    count = max(1, round(case.streak_px * per_px))
    make = partial(_points, count=count, radius_px=_radius(case))
    return Setting("streak as points", f"{count} points", make)


def _polyline(parts: int) -> Setting:
    return Setting("path", f"{parts} segments", partial(_chords, parts=parts))


def _table(core: Core, path: Path, phases: int) -> PixelResponse:
    """Phase table of a core swept along one piece."""
    sweep = float(np.abs(path.y_px).max()), float(np.abs(path.x_px).max())
    half_y, half_x, *period = window(core, *sweep)
    spectrum = swept_spectrum(core, path, (period[0], period[1]))
    return phase_table(core, spectrum, (half_y, half_x), (period[0], period[1]), phases)


def _product(phases: int) -> Setting:
    return Setting("products", f"{phases} phases", partial(_products, phases=phases))


def _products(case: EngineCase, phases: int) -> Drawn:
    """Stamps as column times row."""
    table = product_table(blur_of(case.shape), _radius(case), phases)

    def draw(x: Array, y: Array, light: Array) -> Array:
        image = np.zeros(case.frame)
        draw_products(image, (0, 0), table, x, y, light)
        return image

    return Drawn(draw, table.nbytes)


def _stamps(
    case: EngineCase,
    phases: int,
    cubic: bool,
    radius_px: float,
    spacing_px: int,
    tile: int | None = None,
    path: Path | None = None,
) -> Drawn:
    """Stamps of the core, and the wings of what it leaves out; a spacing of 0 draws no wings."""
    blur, path = blur_of(case.shape), path_of(case.track) if path is None else path
    core = compact_core(blur, radius_px)
    table = cache(partial(_table, core, phases=phases))
    parts = [(x, y, table(p), share) for x, y, p, share in pieces(path)]
    size = sum({id(t): t.values.nbytes for _, _, t, _ in parts}.values())
    wings = None
    if blur.has_wings and spacing_px:
        wings = _wing_drawer(case, blur, core, path, spacing_px)

    def draw(x: Array, y: Array, light: Array) -> Array:
        image = np.zeros(case.frame)
        for oy, ox, view in _tiles(image, tile):
            for x0, y0, t, share in parts:
                px, py, e = x + x0, y + y0, light * share
                if tile is not None:
                    near = _near(px, py, ox, oy, tile, t.reach_px)
                    px, py, e = px[near], py[near], e[near]
                draw_stamps(view, (oy, ox), t, px, py, e, np.full(e.size, cubic))
        if wings is not None:
            wings(image, x, y, light)
        return image

    return Drawn(draw, size)


def _tiles(image: Array, side: int | None) -> list[tuple[int, int, Array]]:
    step = max(image.shape) if side is None else side
    return [
        (y, x, image[y : y + step, x : x + step])
        for y in range(0, image.shape[0], step)
        for x in range(0, image.shape[1], step)
    ]


def _near(x: Array, y: Array, x0: int, y0: int, side: int, reach: float) -> NDArray[np.bool_]:
    inside = (x > x0 - reach) & (x < x0 + side + reach)
    return inside & (y > y0 - reach) & (y < y0 + side + reach)


def _wing_drawer(
    case: EngineCase, blur: Blur, core: Core, path: Path, spacing_px: int
) -> Callable[[Array, Array, Array, Array], None]:
    reach = min(REACH_PX, WING_REACH * core.radius_px)
    sweep = float(np.hypot(path.x_px, path.y_px).max())
    grid = wing_grid(case.frame, (0, 0), spacing_px, reach + sweep)
    kernel = wing_kernel(blur, core, grid, reach)
    kernel = kernel * transfer(*grid_frequencies(grid), path.x_px, path.y_px, path.weight)

    def add(image: Array, x: Array, y: Array, light: Array) -> None:
        spectrum = scipy.fft.rfft2(spread(grid, x, y, light), workers=1) * kernel
        add_wings(image, (0, 0), grid, convolve(spectrum, grid))

    return add


def _spectral_of(case: EngineCase, error: float, radius_px: float) -> Drawn:
    """The spectral engine as it plans itself for an error of a star's peak, light cut at a core."""
    core, path = compact_core(blur_of(case.shape), radius_px), path_of(case.track)
    plan = plan_spectral(case.frame, core, path, error * peak_light(core, path), sources=2e4)
    table = transfer_table(core, plan)

    def draw(x: Array, y: Array, light: Array) -> NDArray[np.floating]:
        return draw_spectral(plan, table, [Sources(x, y, light, path)], (0, 0))

    return Drawn(draw, plan.bytes)


def _points(case: EngineCase, count: int, radius_px: float) -> Drawn:
    """A streak as points along it: what the exact sweep of a table saves and avoids."""
    point = EngineCase(
        case.shape, Track(np.zeros((1, 2)), np.zeros((1, 2)), np.ones(1)), 0.0, case.frame
    )
    still = _stamps(point, 64, True, radius_px, 2)
    at = (np.arange(count) + 0.5) / count
    (x0, x1), (y0, y1) = case.track.x_px[0], case.track.y_px[0]
    dx, dy = x0 + at * (x1 - x0), y0 + at * (y1 - y0)

    def draw(x: Array, y: Array, light: Array) -> NDArray[np.floating]:
        many_x, many_y = ((a[:, None] + d).ravel() for a, d in ((x, dx), (y, dy)))
        return still.draw(many_x, many_y, np.repeat(light / count, count))

    return Drawn(draw, still.table_bytes)


def _chords(case: EngineCase, parts: int) -> Drawn:
    """A curved streak as a polyline of equal steps of time."""
    x, y = arc(case.streak_px, np.linspace(0.0, 1.0, parts + 1))
    path = Path(x, y, np.full(parts, 1.0 / parts))
    return _stamps(case, 32, True, _radius(case), 2, path=path)


def arc(length_px: float, t: Array) -> tuple[Array, Array]:
    """Place at time t in 0 ... 1 on a uniform arc of 60 degrees about the origin."""
    radius = length_px / (np.pi / 3.0)
    angle = (t - 0.5) * np.pi / 3.0
    return radius * np.sin(angle), radius * (np.cos(angle) - np.cos(np.pi / 6.0))
