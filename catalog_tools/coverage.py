"""Which part of the sky a catalogue covers, and how deep: stated by its sources, or from its rows.

A region without a star is one of two things: empty, or never looked at. Only the sources can say
which: the cones or files that were fetched, a whole release, a synthetic sky. Where they say
nothing, the rows are all there is: a place is covered if rows are as near to it as they are to each
other. Kept as nested HEALPix ranges (IVOA MOC 2.0, in pixels of one order) and cones.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .catalogue import MANIFEST_NAME, Catalogue
from .documents import JsonObject, JsonValue
from .errors import Damaged
from .geometry.healpix import FINEST_ORDER, neighbours_of, pixels_of
from .geometry.sphere import angles_deg, directions, separation_rad

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

ROWS = "its rows"
LEAVES = "its leaves (it was ingested before coverage was kept)"
FEWEST_ROWS = 100  # that tell where a catalogue ends
SEVERAL = 8  # rows of a pixel that is covered by itself
AROUND = 16  # rows of a pixel and the eight around it that are covered together: e**-16 by chance
MOST_RANGES = 4096
SPIRAL = 2000  # directions in each cone, by which overlaps are measured


@dataclass(frozen=True, eq=False)
class Coverage:
    """Parts of the sky, each complete down to a G magnitude (inf: no limit is known).

    source : what says so; known : whether it can be known at all: if not, everywhere counts as
    covered. order, ranges : (n, 2) half-open ranges of nested pixels, ascending and apart, complete
    to `faintest_g_mag`. caps : (n, 4) None, or centre and radius [rad] of the cap to which each
    range is cut. cones : (m, 4) right ascension, declination, radius [deg], faintest G.
    """

    source: str
    known: bool = True
    order: int = 0
    ranges: Ints = field(default_factory=lambda: np.empty((0, 2), np.int64))
    faintest_g_mag: float = math.inf
    cones: Floats = field(default_factory=lambda: np.empty((0, 4)))
    caps: Floats | None = None

    def limits_g_mag(self, ra_deg: ArrayLike, dec_deg: ArrayLike) -> Floats:
        """G to which directions (n,) [deg] are covered: inf without limit, -inf for not at all."""
        ra, dec = (np.atleast_1d(np.asarray(angle, float)) for angle in (ra_deg, dec_deg))
        if not self.known:
            return np.full(ra.shape, math.inf)
        v = directions(ra, dec)
        limits = np.where(self._in_ranges(ra, dec, v), self.faintest_g_mag, -math.inf)
        for cone_ra, cone_dec, radius_deg, faintest in self.cones.tolist():
            inside = separation_rad(v, directions(cone_ra, cone_dec)) <= math.radians(radius_deg)
            limits = np.where(inside, np.maximum(limits, faintest), limits)
        return limits

    def _in_ranges(self, ra_deg: Floats, dec_deg: Floats, v: Floats) -> NDArray[np.bool_]:
        """Which directions lie within the ranges, and the caps to which these are cut."""
        if not len(self.ranges):
            return np.zeros(ra_deg.shape, bool)
        pixels = pixels_of(self.order, ra_deg, dec_deg)
        at = np.searchsorted(self.ranges[:, 0], pixels, side="right") - 1
        inside: NDArray[np.bool_] = (at >= 0) & (pixels < self.ranges[at, 1])
        if self.caps is not None:
            inside &= separation_rad(v, self.caps[at, :3]) <= self.caps[at, 3]
        return inside

    @property
    def from_rows(self) -> bool:
        """Whether only the rows say so: then a field may end some spacings of its rows earlier."""
        return self.source.startswith((ROWS, LEAVES))

    @property
    def sky_fraction(self) -> float | None:
        """Fraction of the whole sky that is covered; None where it can't be known.

        Areas of ranges are exact, those of cones but for overlaps, which SPIRAL directions measure.
        """
        if not self.known:
            return None
        areas = (self.ranges[:, 1] - self.ranges[:, 0]) / (12.0 * 4.0**self.order)
        if self.caps is not None:
            areas = np.minimum(areas, np.sin(0.5 * np.minimum(self.caps[:, 3], math.pi)) ** 2)
        covered = float(areas.sum())
        for i, cone in enumerate(self.cones):
            before = Coverage("", True, self.order, self.ranges, cones=self.cones[:i])
            new = np.mean(np.isneginf(before.limits_g_mag(*_spiral(cone))))
            covered += math.sin(0.5 * math.radians(cone[2])) ** 2 * float(new)
        return min(covered, 1.0)

    def fraction_of_cone(self, ra_deg: float, dec_deg: float, radius_deg: float) -> float:
        """Covered fraction of a cone, by SPIRAL directions; 1 where it can't be known."""
        limits = self.limits_g_mag(*_spiral(np.array([ra_deg, dec_deg, radius_deg])))
        return float(np.mean(~np.isneginf(limits)))

    def describe(self) -> JsonObject:
        """What `catalog info` and reports say."""
        fraction = self.sky_fraction
        return {
            "source": self.source,
            "sky_fraction": None if fraction is None else float(f"{fraction:.6g}"),
        }

    def to_json(self) -> JsonObject:
        """Plain values for a manifest; `from_json` gives the same coverage."""
        return {
            "source": self.source,
            "known": self.known,
            "order": self.order,
            "ranges": self.ranges.tolist(),
            "faintest_g_mag": _or_none(self.faintest_g_mag),
            "cones": [[*cone[:3], _or_none(cone[3])] for cone in self.cones.tolist()],
        }


def from_json(values: JsonValue) -> Coverage:
    """The coverage that a manifest or a fetch's record holds; ValueError for anything else."""
    try:
        cones = [[*map(float, cone[:3]), _or_inf(cone[3])] for cone in values["cones"]]
        found = Coverage(
            str(values["source"]),
            bool(values["known"]),
            int(values["order"]),
            np.array(values["ranges"], np.int64).reshape(-1, 2),
            _or_inf(values["faintest_g_mag"]),
            np.array(cones, float).reshape(-1, 4),
        )
    except (KeyError, TypeError, IndexError, OverflowError) as error:
        raise ValueError(f"no coverage ({type(error).__name__}: {error})") from None
    ends = found.ranges.ravel()
    if not 0 <= found.order <= FINEST_ORDER or (np.diff(ends) <= 0).any():
        raise ValueError("ranges of pixels that are not ascending and apart")
    if ends.size and not (ends[0] >= 0 and ends[-1] <= 12 << (2 * found.order)):
        raise ValueError("ranges of pixels that do not exist")
    ra_deg, dec_deg, radius_deg, _ = found.cones.T
    if not (
        (np.abs(ra_deg) <= 360.0)
        & (np.abs(dec_deg) <= 90.0)
        & (radius_deg > 0.0)
        & (radius_deg <= 180.0)
    ).all():
        raise ValueError("cones that are not on the sky")
    return found


def all_sky(source: str, faintest_g_mag: float = math.inf, cones: Iterable[Any] = ()) -> Coverage:
    """The whole sky to a magnitude, and cones (ra, dec, radius, G) [deg, mag] to others."""
    deeper = np.array([list(map(float, cone)) for cone in cones], float).reshape(-1, 4)
    return Coverage(source, True, 0, np.array([[0, 12]]), faintest_g_mag, deeper)


def of_pixels(source: str, order: int, starts: ArrayLike, ends: ArrayLike) -> Coverage:
    """Half-open ranges (n,) of nested pixels, in any order, also overlapping."""
    starts, ends = np.asarray(starts, np.int64), np.asarray(ends, np.int64)
    by_start = np.argsort(starts, kind="stable")
    starts, ends = starts[by_start], np.maximum.accumulate(ends[by_start])
    first = np.flatnonzero(np.concatenate([[True], starts[1:] > ends[:-1]])[: starts.size])
    last = np.concatenate([first[1:] - 1, [starts.size - 1]]).astype(int)[: first.size]
    return Coverage(source, True, order, np.stack([starts[first], ends[last]], axis=1))


def united(parts: Sequence[Coverage]) -> Coverage:
    """The sky that any of some coverages covers; none of them with caps, or with limits of ranges
    that differ."""
    order = max(part.order for part in parts)
    ranges = np.concatenate([p.ranges << (2 * (order - p.order)) for p in parts])
    whole = of_pixels("; ".join(dict.fromkeys(p.source for p in parts)), order, *ranges.T)
    limit = min(part.faintest_g_mag for part in parts)
    cones = np.unique(np.concatenate([part.cones for part in parts]), axis=0)
    return Coverage(whole.source, True, order, whole.ranges, limit, cones)


def of_rows(counts: Ints) -> Coverage:
    """What rows cover; counts : (12 * 4**order,) rows in each nested pixel of an order.

    Where rows are dense a pixel with SEVERAL of them is covered. Where they are sparse, it is each
    pixel (of the finest order that will do) that holds AROUND together with the eight around it,
    and these: evenly spread rows leave no gap, and a field ends up to two such pixels, 3 to 6
    spacings of its rows, beyond its last one. Fewer rows than AROUND, left alone far from all
    others, count for nothing.
    """
    pixels, finest = np.flatnonzero(counts), (counts.size // 12).bit_length() // 2
    rows, left = counts[pixels], np.ones(pixels.size, bool)
    total = int(rows.sum())
    if total < FEWEST_ROWS:
        return Coverage(f"{ROWS} ({total} are too few to tell)", known=False)
    covered = np.zeros(counts.size, bool)
    for order in range(finest, -1, -1):
        shift = 2 * (finest - order)
        first = np.flatnonzero(np.diff(pixels >> shift, prepend=-1))  # of each cell's pixels
        cell, held = pixels[first] >> shift, np.add.reduceat(rows, first)
        wanted = np.logical_or.reduceat(left, first)
        done = wanted & (held >= SEVERAL)
        sparse = np.flatnonzero(wanted & ~done)
        around = neighbours_of(order, cell[sparse])
        everywhere = np.zeros(12 << (2 * order), np.int64)
        everywhere[cell] = held
        enough = held[sparse] + (everywhere[around] * (around >= 0)).sum(axis=0) >= AROUND
        together = around[:, enough].ravel()
        done[sparse[enough]] = True
        left &= ~np.repeat(done, np.diff(first, append=pixels.size))
        new = np.concatenate([cell[done], together[together >= 0]])
        covered.reshape(-1, 1 << shift)[new] = True
        if rows[left].sum() < AROUND:
            break
    return _of_map(covered, finest)


def _of_map(covered: NDArray[np.bool_], order: int) -> Coverage:
    """Ranges of the pixels of a map; coarser ones, never fewer, where they would be too many."""
    while True:
        edges = np.flatnonzero(np.diff(covered.astype(np.int8), prepend=0, append=0))
        if edges.size <= 2 * MOST_RANGES:
            return Coverage(ROWS, True, order, edges.reshape(-1, 2).astype(np.int64))
        covered, order = np.logical_or.reduce(covered.reshape(-1, 4), axis=1), order - 1


def coverage_of(catalogue: Catalogue) -> Coverage:
    """What a catalogue says it covers; of one that says nothing, its leaves within their caps.

    Raises Damaged where what it says can't be understood.
    """
    if catalogue.coverage is not None:
        try:
            return from_json(catalogue.coverage)
        except ValueError as error:
            raise Damaged(f"{catalogue.path}/{MANIFEST_NAME}", f"its coverage: {error}") from None
    leaves = catalogue.leaf_table
    if catalogue.rows < FEWEST_ROWS:
        return Coverage(f"{LEAVES}; {catalogue.rows} rows are too few to tell", known=False)
    shift = 2 * (FINEST_ORDER - leaves["order"].astype(np.int64))
    ranges = np.stack([leaves["pixel"] << shift, (leaves["pixel"] + 1) << shift], axis=1)
    # Rows end about one spacing of theirs before the field does.
    radius = leaves["radius_rad"] * (1.0 + 4.0 / np.sqrt(np.maximum(leaves["rows"], 1)))
    caps = np.column_stack([leaves["centre"], np.minimum(radius, math.pi)])
    return Coverage(LEAVES, True, FINEST_ORDER, ranges, caps=caps)


def _spiral(cone: Floats) -> tuple[Floats, Floats]:
    """SPIRAL directions [deg] spread evenly over a cone (ra, dec, radius, ...) [deg]."""
    axis = directions(cone[0], cone[1])
    across = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    across /= math.sqrt(across @ across)
    steps = np.arange(SPIRAL) + 0.5
    turn = steps * math.pi * (3.0 - math.sqrt(5.0))
    half = np.arcsin(np.sqrt(steps / SPIRAL) * math.sin(0.5 * math.radians(cone[2])))
    side = np.cos(turn)[:, None] * across + np.sin(turn)[:, None] * np.cross(axis, across)
    v = np.cos(2.0 * half)[:, None] * axis + np.sin(2.0 * half)[:, None] * side
    return angles_deg(v)


def _or_none(limit: float) -> float | None:
    return limit if math.isfinite(limit) else None


def _or_inf(limit: float | None) -> float:
    return math.inf if limit is None else float(limit)
