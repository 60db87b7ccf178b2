"""What the spectral engine needs for a response, a streak and an error: grid, memory, bound."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import BadInput
from pipeline.physics.drawing.spectral_band import TransferBand, band_of
from pipeline.physics.drawing.spectral_spread import Kernel
from pipeline.physics.fast_sizes import fast_size
from pipeline.physics.motion.streak import Path, half_extent_px, pieces
from pipeline.physics.psf.response import Core

Array = NDArray[np.float64]
Pair = tuple[int, int]

MOST_BYTES = 400e6
LEAST_MODES = 16  # that are kept: what fewer cut off, the cells of a band hardly bound
LIGHT_ERROR = 1e-6  # of a source's light that the grid may gain or lose
WIDTHS = range(4, 13)
DENSITIES = 24  # grid densities that are tried
EDGES = (1.0, 0.85, 0.7, 0.6, 0.5, 0.4)  # of the band: where the kernel's aliases may begin
BETA_STEP = 0.05  # of the shape parameter over the width: few kernels serve all plans
CUT_PART = 0.1  # of the error: what the frequencies omitted make where the grid holds more
LONGEST_PX = (math.inf, 1024.0, 512.0, 256.0)  # pieces of streak that are tried
PAD_STEP_PX = 8  # pads are rounded up, so that alike streaks share their tables
ROUNDING = 4.0  # units of precision of a source's peak that the transforms err by (measured: 3)
CROWD_PX = 4.0  # px^2 about a source over which it errs by no more than `error`, rms (measured)
CROWDED = 100.0  # weights that a grid point may add up in float32, on average

# Seconds per grid point, mode, mode and segment, pixel, source, weight: one core of 2.4 GHz
# (benchmarks/drawing.py).
POINT_S, MODE_S, SEGMENT_S, PIXEL_S, SOURCE_S, WEIGHT_S = 8e-9, 2e-9, 2e-9, 8e-9, 3e-8, 0.9e-9


@dataclass(frozen=True)
class SpectralPlan:
    """How one block is drawn.

    shape : (rows, columns) of the block; pad : pixels before it on the period
    period : pixels of the periodic image; points : grid points on it; keep : largest mode kept
    kernel, single : spreading kernel, and whether the arithmetic is in float32
    longest_px : streaks are cut into pieces of at most this length
    spread_error, cut_error, rounding : largest error of a pixel per unit light of a source: of the
        grid, of the frequencies omitted, of the arithmetic. They fade with the distance from the
        source, but for the rounding
    light_error : largest part of a source's light that the grid gains or loses
    """

    shape: Pair
    pad: Pair
    period: Pair
    points: Pair
    keep: Pair
    kernel: Kernel
    single: bool
    longest_px: float
    spread_error: float
    cut_error: float
    light_error: float
    rounding: float

    @property
    def error(self) -> float:
        """Largest error of a pixel per unit light of a source; errors of several add up."""
        return self.spread_error + self.cut_error + self.rounding

    @property
    def real_type(self) -> np.dtype[np.floating]:
        return np.dtype(np.float32 if self.single else np.float64)

    @property
    def complex_type(self) -> np.dtype[np.complexfloating]:
        return np.dtype(np.complex64 if self.single else np.complex128)

    @property
    def limit(self) -> float:
        """Band limit of what is drawn, on either axis [cycles/px]."""
        return min(k / p for k, p in zip(self.keep, self.period, strict=True))

    @property
    def modes(self) -> int:
        """Modes that the transfer table holds."""
        return (2 * self.keep[0] + 1) * (self.keep[1] + 1)

    @property
    def halo_px(self) -> int:
        """How far beyond the block sources may count, their paths' own reach apart."""
        after = (p - n - a for p, n, a in zip(self.period, self.shape, self.pad, strict=True))
        return max(*self.pad, *after)

    @property
    def bytes(self) -> int:
        """Memory of drawing one block: grid, table, spectrum, image; the sources' own apart."""
        grid = self.points[0] * (self.points[1] + 2)
        pixels = self.period[0] * (self.period[1] + 2)
        return (4 if self.single else 8) * (grid + self.modes + 2 * pixels)

    def seconds(self, sources: float, segments: int = 1, transforms: int = 1) -> float:
        """Predicted time: pieces count as sources, unequal pieces take a transform each."""
        return (
            POINT_S * self.points[0] * self.points[1] * transforms
            + (MODE_S + SEGMENT_S * segments) * self.modes * transforms
            + PIXEL_S * self.period[0] * self.period[1]
            + (SOURCE_S + WEIGHT_S * self.kernel.width**2) * sources
        )


def brightest_for(plan: SpectralPlan, budget_e: float, near: float = 1.0) -> float:
    """Light of the brightest source that the plan draws to `budget_e` in every pixel [e-].

    near : part of its light that is as near to a pixel as the core reaches; what the rest errs by
        has faded there, but for the rounding
    Brighter ones belong to the stamps engine.
    """
    return budget_e / (near * (plan.spread_error + plan.cut_error) + plan.rounding)


def plan_spectral(
    shape: Pair,
    core: Core,
    path: Path,
    error: float,
    *,
    sources: float = 1e5,
    single: bool | None = None,
    most_bytes: float = MOST_BYTES,
) -> SpectralPlan:
    """The quickest plan whose predicted error is at most `error`.

    shape : (rows, columns) of the block; path : the longest streak that will be drawn
    error : largest error of a pixel per unit light of a source; for a part of a source's peak,
        that part of `spectral_band.peak_light`
    sources : how many are expected, to weigh their cost against the grid's
    single : float32 or float64; None takes float32 where it reaches the error
    most_bytes : memory that one block may take; longer streaks are cut into pieces to keep to it
    Raises BadInput where no grid within the memory reaches the error: a response too sharp for the
    pixels, or an error below what the core's own samples hold (about 1e-8 of the peak).
    """
    if not (error > 0 and math.isfinite(error)):
        raise BadInput("error", error, "a positive number")
    best: list[tuple[float, SpectralPlan]] = []
    precisions = (True, False) if single is None else (single,)
    for longest in LONGEST_PX:
        if longest < math.inf and path.length_px <= longest:
            continue
        band, reach = band_of(core, path, longest), _reach_px(core, path, longest)
        timed: list[tuple[float, SpectralPlan]] = []
        for precision in precisions:
            need = _Need(shape, reach, band, longest, precision)
            timed = timed or _timed_plans(need, error, path, sources, bool(single), most_bytes)
        best = sorted([*timed, *best], key=lambda plan: plan[0])[:1]
    if not best:
        raise BadInput(
            "error",
            error,
            f"an error that a grid of at most {most_bytes / 1e6:.0f} MB reaches with this "
            "response: a larger one, a smaller block, or the stamps engine",
        )
    return best[0][1]


def _timed_plans(
    need: _Need, error: float, path: Path, sources: float, crowded: bool, most_bytes: float
) -> list[tuple[float, SpectralPlan]]:
    """Predicted seconds of the plans within the memory, and they; `crowded`: also such as are."""
    parts = [piece for _, _, piece, _ in pieces(path, need.longest_px)]
    count, segments = len(parts) * sources, max((p.segments for p in parts), default=1)
    return [
        (p.seconds(count, segments, len(set(parts))), p)
        for p in _plans(need, error)
        if p.bytes <= most_bytes and (crowded or not _crowded(p, count))
    ]


def _crowded(plan: SpectralPlan, sources: float) -> bool:
    """Whether grid points add up so many weights that float32 loses digits."""
    weights = sources * plan.kernel.width**2
    return plan.single and weights > CROWDED * plan.points[0] * plan.points[1]


def _reach_px(core: Core, path: Path, longest_px: float) -> tuple[float, float]:
    """How far (y, x) the light of a piece falls from its middle: core, half its length, a pixel."""
    half_y, half_x = half_extent_px(piece for _, _, piece, _ in pieces(path, longest_px))
    return core.radius_px + 1.0 + half_y, core.radius_px + 1.0 + half_x


@dataclass(frozen=True, eq=False)
class _Need:
    """What all plans of one search share."""

    shape: Pair
    reach: tuple[float, float]
    band: TransferBand
    longest_px: float
    single: bool

    @property
    def eps(self) -> float:
        return float(np.finfo(np.float32 if self.single else np.float64).eps)


def _plans(need: _Need, error: float) -> Iterator[SpectralPlan]:
    """For each kernel width, the coarsest grid that reaches the error, found by halving."""
    least = LEAST_MODES / min(n + 2.0 * r for n, r in zip(need.shape, need.reach, strict=True))
    widest = need.band.limit_for(CUT_PART * error, least)
    narrow = need.band.limit_for(0.9 * error, least)
    densities = np.geomspace(2.0 * narrow, 5.0 * widest, DENSITIES)
    for width in WIDTHS:
        best, low, high = None, 0, DENSITIES
        while low < high:
            k = (low + high) // 2
            plan = _plan(need, densities[k], min(widest, 0.5 * densities[k]), width)
            good = plan.error <= error and plan.light_error <= LIGHT_ERROR
            best, low, high = (plan, low, k) if good else (best, k + 1, high)
        if best is not None:
            yield best


def _plan(need: _Need, density: float, limit: float, width: int) -> SpectralPlan:
    """The plan of one grid density [points/px], band limit [cycles/px] and kernel width."""
    (pad_y, py), (pad_x, px) = (
        _period(n, r, width, density) for n, r in zip(need.shape, need.reach, strict=True)
    )
    ny, nx = (fast_size(int(np.ceil(density * p)), real=True) for p in (py, px))
    keep = min(int(limit * py), (ny - 1) // 2), min(int(limit * px), (nx - 1) // 2)
    limit = min(keep[0] / py, keep[1] / px)
    kept, cut = need.band.kept(limit), need.band.cut(limit)
    found = []
    for edge in EDGES:
        steepness = math.pi * (1.0 - edge * keep[0] / ny)
        kernel = Kernel(width, width * round(steepness / BETA_STEP) * BETA_STEP)
        spread, light = _grid_errors(need, kernel, (py / ny, px / nx), kept)
        rounding = ROUNDING * need.eps * float(need.band.weight.sum())
        found.append(
            SpectralPlan(
                need.shape,
                (pad_y, pad_x),
                (py, px),
                (ny, nx),
                keep,
                kernel,
                need.single,
                need.longest_px,
                spread,
                cut,
                light,
                rounding,
            )
        )
    return min(found, key=lambda p: (p.light_error > LIGHT_ERROR, p.error))


def _period(pixels: int, reach_px: float, width: int, density: float) -> Pair:
    """Pad before the block and length of the period [px].

    No light of a source on the period comes round to the block: the reach fits twice beside it.
    The kernel fits beyond the outermost sources whose light reaches the block.
    """
    reach = int(np.ceil(reach_px / PAD_STEP_PX)) * PAD_STEP_PX
    margin = int(np.ceil((0.5 * width + 1.0) / density))
    period = fast_size(pixels + 2 * (reach + margin), real=True)
    return reach + margin, int(period)


def _grid_errors(
    need: _Need, kernel: Kernel, spacing_px: tuple[float, float], kept: tuple[Array, Array]
) -> tuple[float, float]:
    """Errors per unit light that the grid makes: of a pixel, and of all light together.

    A pixel is an integral over frequencies, so the integral of what each may err by bounds it:
    keep (1 + r_y) (1 + r_x) - keep.
    """
    band, (keep_y, keep_x) = need.band, kept
    r_y = kernel.alias_ratio(band.fy * spacing_px[0], need.single)
    r_x = kernel.alias_ratio(band.fx * spacing_px[1], need.single)
    spread = band.integral(keep_y * r_y, keep_x * (1.0 + r_x))
    spread += band.integral(keep_y, keep_x * r_x)
    light = float(kernel.alias_ratio(np.zeros(1), need.single)[0])
    return spread, 2.0 * light + light**2
