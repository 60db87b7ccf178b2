"""What the drawing of sources errs by at most, where the light of all of them is known.

Before it is, each approximation may err by its part of the accuracy: limits of light see to that.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Array
from pipeline.physics.drawing.crowds import pixel_numbers
from pipeline.physics.drawing.quadrature import affordable
from pipeline.physics.motion.streak import Path
from pipeline.physics.psf.product import product_table
from pipeline.plan.accuracy import UNSEEN, crowd_error_e
from pipeline.plan.response.responses import (
    PLACES,
    ResponsePlan,
    core_end_e,
    cut_share,
    first_above,
    point_curvature,
    table_error,
)

WINGS, TABLES = "wings_on_a_coarse_grid", "table_band"
STATED = 9  # digits: the last ones of light depend on how a processor adds
CELL_PX = 1.0  # sources of one cell err alike


@dataclass(frozen=True)
class KnownSources:
    """Stars (n,), or targets, of some frames: all whose light reaches them.

    frame, x_px, y_px : where each is at mid-exposure; light_e : of each [e-]
    wing_error : what its wings' grid errs by, of its light
    size_px : radius of a sphere that is drawn as a point, 0 of all others
    """

    frame: NDArray[Any]
    x_px: Array
    y_px: Array
    light_e: Array
    wing_error: Array
    size_px: Array


@dataclass(frozen=True)
class SourceBounds:
    """What follows from the light of all sources of some frames.

    brightest_e : of all; errors_e : by component, what a pixel at the noise floor errs by [e-]
    """

    brightest_e: float = 0.0
    errors_e: Mapping[str, float] = field(default_factory=dict)

    def worst(self, other: SourceBounds) -> SourceBounds:
        """The larger bounds: those of both, where they are of different frames."""
        names = {*self.errors_e, *other.errors_e}
        errors = {n: max(b.errors_e.get(n, 0.0) for b in (self, other)) for n in names}
        return SourceBounds(max(self.brightest_e, other.brightest_e), errors)

    def together(self, other: SourceBounds) -> SourceBounds:
        """Those of other sources of the same frames, whose wings may lie in one pixel."""
        both = self.worst(other)
        if WINGS not in both.errors_e:
            return both
        wings_e = sum(b.errors_e.get(WINGS, 0.0) for b in (self, other))
        return replace(both, errors_e={**both.errors_e, WINGS: wings_e})


def known_of_frames(parts: Sequence[KnownSources]) -> KnownSources:
    """Those of several frames; none of none."""

    def column(name: str) -> Array:
        return np.concatenate([np.empty(0), *(getattr(part, name) for part in parts)])

    placed = column("frame"), column("x_px"), column("y_px")
    return KnownSources(*placed, column("light_e"), column("wing_error"), column("size_px"))


def stars_known(
    r: ResponsePlan, frame: NDArray[Any], x_px: Array, y_px: Array, light_e: Array
) -> KnownSources:
    """Stars (n,) of some frames, each drawn by its core class, or by quadrature beyond the last."""
    error = _of_class(r, [c.wing_error for c in r.classes], light_e)
    return KnownSources(frame, x_px, y_px, light_e, error, np.zeros(len(light_e)))


def targets_known(
    r: ResponsePlan,
    shape: tuple[int, int],
    frame: NDArray[Any],
    ends_px: NDArray[np.float64],
    light_e: Array,
    radius_px: Array,
    extended: NDArray[np.bool_],
) -> KnownSources:
    """Targets (n,) of some frames.

    ends_px : (4, n) x and y where each is first, then last; extended : drawn with its size. Those
    brighter than the core classes serve are drawn by quadrature if they are points on a path that
    it serves, else by the last class.
    """
    errors = np.array([c.target_error for c in r.classes])
    k = first_above(light_e, [c.target_e for c in r.classes])
    error = errors[np.minimum(k, len(errors) - 1)]
    for i in np.flatnonzero((k == len(errors)) & ~extended):
        x0, y0, x1, y1 = ends_px[:, i]
        path = Path(np.array([0.0, x1 - x0]), np.array([0.0, y1 - y0]), np.ones(1))
        if all(affordable(b, path, shape) for b in r.blurs):
            error[i] = 0.0
    middle, radius = 0.5 * (ends_px[:2] + ends_px[2:]), np.nan_to_num(radius_px)
    size = np.where(extended, 0.0, radius)
    error = error / _spread_over(r, np.where(extended, radius, 0.0))
    return KnownSources(frame, middle[0], middle[1], light_e, error, size)


def _spread_over(r: ResponsePlan, radius_px: Array) -> Array:
    """How much less the wings of bodies (n,) with a size err by than a point's at its worst place.

    As those of as many sources in cells of half the grid's spacing, without relation, none of
    which is at its worst.
    """
    cell_px = max(CELL_PX, 0.5 * r.spacing_px)
    cells = math.pi * (radius_px / cell_px) ** 2
    return np.where(cells > PLACES, PLACES * np.sqrt(cells), 1.0)


def bounds_of(r: ResponsePlan, stars: KnownSources, targets: KnownSources) -> SourceBounds:
    """What drawing all sources of some frames errs by at most, to STATED digits."""
    found = of_stars(r, stars).together(of_targets(r, targets))
    stated = {name: float(f"{e:.{STATED}g}") for name, e in found.errors_e.items()}
    return SourceBounds(found.brightest_e, stated)


def of_stars(r: ResponsePlan, s: KnownSources) -> SourceBounds:
    """What drawing the stars of some frames errs by at most."""
    cell = _cells(s)
    errors = _of_all(r, s, cell)
    points_e = _of_class(r, [c.point_error for c in r.classes], s.light_e) * s.light_e
    errors["common_streak"] = _within(r, cell, r.streaks.errors_e(s.light_e, points_e))
    beyond_e = np.maximum(0.0, r.streaks.rounded_e(s.light_e) - r.budget_e)
    errors["common_streak"] += _together(cell, beyond_e)
    if r.products and not r.spectral_from:
        errors["phase_interpolation"] = _within(r, cell, _products_e(r, s.light_e))
    return SourceBounds(float(s.light_e.max(initial=0.0)), errors)


def of_targets(r: ResponsePlan, s: KnownSources) -> SourceBounds:
    """What drawing the targets of some frames errs by at most."""
    cell = _cells(s)
    curvature = max(map(point_curvature, r.blurs)) if s.size_px.any() else 0.0
    points_e = curvature * s.light_e * s.size_px**2
    errors = _of_all(r, s, cell) | {"targets.point_sources": _within(r, cell, points_e)}
    return SourceBounds(float(s.light_e.max(initial=0.0)), errors)


def _of_class(r: ResponsePlan, values: Sequence[float], light_e: Array) -> Array:
    """Of stars (n,) the value of the core class that draws each; 0 beyond the last."""
    return np.array([*values, 0.0])[first_above(light_e, [c.brightest_e for c in r.classes])]


def _products_e(r: ResponsePlan, light_e: Array) -> Array:
    """Of stars (n,) drawn as column times row: a fixed share of their light, where that is within
    the part; brighter ones stand at their exact places."""
    if not len(light_e):
        return light_e
    share = max(product_table(b, c.radius_px).cubic_error for b in r.blurs for c in r.classes)
    return share * light_e


def _of_all(r: ResponsePlan, s: KnownSources, cell: NDArray[np.int64]) -> dict[str, float]:
    """By tables, which the wings' grid has part of, by this grid, and where wings or cores end.

    Sources whose wings err by less than UNSEEN of the largest error are omitted.
    """
    light_e, table = _together(cell, s.light_e), max(map(table_error, r.blurs))
    if not r.spacing_px:
        ends_e = core_end_e(r, s.light_e)
        beyond_e = _together(cell, np.maximum(0.0, ends_e - r.budget_e))  # of coarse tables alone
        return {"core_ends": _within(r, cell, ends_e) + beyond_e, TABLES: table * light_e}
    error_e = (s.wing_error + table) * s.light_e
    seen = error_e > UNSEEN * error_e.max(initial=0.0)
    place = s.frame[seen], s.x_px[seen], s.y_px[seen]
    return {
        WINGS: crowd_error_e(*place, error_e[seen], *r.crowd_sides_px),
        "wings_cut_off": cut_share(r.blurs, r.reach_px) * light_e,
    }


def _cells(s: KnownSources) -> NDArray[np.int64]:
    """Numbers (n,) of the cells of CELL_PX in which sources stand, frame by frame."""
    number = pixel_numbers(s.x_px / CELL_PX, s.y_px / CELL_PX)
    number += s.frame.astype(np.int64) * (number.max(initial=0) + 1)
    return np.unique(number, return_inverse=True)[1]


def _together(cell: NDArray[np.int64], value: Array) -> float:
    """The most that values of sources (n,) add up to in a cell."""
    return float(np.bincount(cell, weights=value).max(initial=0.0))


def _within(r: ResponsePlan, cell: NDArray[np.int64], error_e: Array) -> float:
    """What errors of sources (n,) add up to in a cell, or one approximation's part.

    Each errs by a part at most. More than that, of bright sources in one pixel, their noise hides,
    if light has any: it adds up, too.
    """
    together = _together(cell, np.minimum(error_e, r.budget_e))
    return min(together, r.budget_e) if r.streaks.photons else together
