"""Which synthetic stars go into which file: rows counted by cell, files cut on pixel borders.

A catalogue of any number of rows is a sample of one modelled sky. A few numbers for each cell of
the sky are drawn at once; the places in a cell have a random stream of their own, keyed by (seed,
rows, cell). So a file is a pure function of the plan and its number, and files don't overlap.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..columns import HEALPIX_ORDER
from ..geometry.sphere import directions
from ..partition import positions_of
from ..star_counts import EDGES_G_MAG, interval_density
from .clusters import CROWDS, interval_shares, pixels_of

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]

DENSITY_ORDER = 6  # the density of the field is constant over pixels of 0.84 deg2
ID_ORDER = 12  # of the pixel in a source_id: files break on its borders
FINEST_CELLS = 7
ROWS_PER_CELL = 2_000  # on average, in a small catalogue; some 10,000 in a large one
FIELDS = 12 * 4**DENSITY_ORDER
ROWS_PER_FILE = 27_647  # Gaia DR2: 1,692,919,135 rows in 61,234 files


@dataclass(frozen=True)
class SyntheticPlan:
    """How many stars of which origin lie where.

    cell_starts : (cells + 1,) rows before each cell, a HEALPix pixel. Patches, in the order of
    the cells: patch_starts (cells + 1,) patches before each cell; first_pixels, widths (n,) the
    run of ID_ORDER pixels that a patch covers; origins (n,) which row of the magnitudes its stars
    follow, a pixel of DENSITY_ORDER or FIELDS + the number of a crowd; counts (n,) its stars.
    """

    seed: int
    rows: int
    cell_starts: Ints
    patch_starts: Ints
    first_pixels: Ints
    widths: Ints
    origins: Ints
    counts: Ints

    @property
    def files(self) -> int:
        """How many files the rows are meant to fill; one may stay empty where stars crowd."""
        return math.ceil(self.rows / ROWS_PER_FILE)


@dataclass(frozen=True)
class Places:
    """Stars of one file by ID_ORDER pixel, ascending: pixels and origins (n,), and rows before."""

    pixels: Ints
    origins: Ints
    first_row: int


@lru_cache(maxsize=1)
def field_density() -> Floats:
    """Stars of DR2 in each interval of EDGES_G_MAG and each pixel of DENSITY_ORDER (FIELDS, 36)."""
    below = 2 * (HEALPIX_ORDER - DENSITY_ORDER)
    centres = directions(*positions_of((np.arange(FIELDS) << below) + (3 << (below - 2))))
    area_deg2 = 4.0 * math.pi * math.degrees(1.0) ** 2 / FIELDS
    intervals = range(EDGES_G_MAG.size - 1)
    return np.stack([interval_density(i, centres) for i in intervals], axis=1) * area_deg2


@lru_cache(maxsize=1)
def magnitude_steps() -> Floats:
    """Cumulative shares by interval of every origin, flattened; those of origin i are in (i, i+1].

    So `searchsorted(i + u)` with u in [0, 1) draws an interval: the remainder of the index.
    """
    shares = np.concatenate([field_density(), [interval_shares(crowd) for crowd in CROWDS]])
    steps = np.cumsum(shares, axis=1)
    steps /= steps[:, -1:]
    return np.ravel(steps + np.arange(len(steps))[:, None])


@lru_cache(maxsize=2)
def make_plan(seed: int, rows: int) -> SyntheticPlan:
    """Share `rows` stars among the patches of the sky, at random in proportion to DR2's numbers."""
    order = _cell_order(rows)
    below = 2 * max(0, order - DENSITY_ORDER)  # a patch of the field is no larger than a cell
    fields = np.arange(FIELDS << below)
    width = 12 * 4**ID_ORDER // fields.size
    firsts, widths, origins = [fields * width], [np.full(fields.size, width)], [fields >> below]
    expected = [field_density().sum(axis=1)[fields >> below] / (1 << below)]
    for i, crowd in enumerate(CROWDS):
        crowd_order, pixels, shares = pixels_of(crowd)
        width = 4 ** (ID_ORDER - crowd_order)
        firsts.append(pixels * width)
        widths.append(np.full(pixels.size, width))
        origins.append(np.full(pixels.size, FIELDS + i))
        expected.append(crowd.stars * shares)
    first, weight = np.concatenate(firsts), np.concatenate(expected)
    rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence((seed, rows))))
    counts = rng.multinomial(rows, weight / weight.sum())
    cell = first // 4 ** (ID_ORDER - order)
    some = np.flatnonzero(counts)
    some = some[np.argsort(cell[some], kind="stable")]
    patch_starts = np.searchsorted(cell[some], np.arange(12 * 4**order + 1))
    before = np.concatenate([[0], np.cumsum(counts[some])])
    return SyntheticPlan(
        seed,
        rows,
        before[patch_starts],
        patch_starts,
        first[some],
        np.concatenate(widths)[some],
        np.concatenate(origins)[some],
        counts[some],
    )


def _cell_order(rows: int) -> int:
    """HEALPix order of the cells: few where few rows are to be had from each."""
    return min(max(round(math.log(rows / 12 / ROWS_PER_CELL, 4)), 0), FINEST_CELLS)


def stars_in_cell(plan: SyntheticPlan, cell: int) -> tuple[Ints, Ints]:
    """Pixels of ID_ORDER (ascending) and origins of the stars in a cell."""
    rng = np.random.Generator(
        np.random.PCG64(np.random.SeedSequence((plan.seed, plan.rows, 1, cell)))
    )
    patches = slice(plan.patch_starts[cell], plan.patch_starts[cell + 1])
    counts = plan.counts[patches]
    inside = rng.random(counts.sum()) * np.repeat(plan.widths[patches], counts)
    pixels = np.repeat(plan.first_pixels[patches], counts) + inside.astype(np.int64)
    order = np.argsort(pixels, kind="stable")
    return pixels[order], np.repeat(plan.origins[patches], counts)[order]


def places_in_file(plan: SyntheticPlan, number: int) -> Places:
    """The stars of file `number`, from 0 to plan.files - 1: those from one pixel to another.

    A file begins with the pixel of row `number * rows // files`, and ends before the next one's.
    """
    targets = [(number + i) * plan.rows // plan.files for i in (0, 1)]
    last_cell = plan.cell_starts.size - 2
    cells = np.searchsorted(plan.cell_starts, targets, side="right") - 1
    first, last = np.minimum(cells, last_cell).tolist()
    occupied = first + np.flatnonzero(np.diff(plan.cell_starts[first : last + 2]))
    drawn = {cell: stars_in_cell(plan, cell) for cell in occupied.tolist()}
    ends = [0, 12 * 4**ID_ORDER]
    for i, (target, cell) in enumerate(zip(targets, (first, last), strict=True)):
        if 0 < target < plan.rows:
            ends[i] = int(drawn[cell][0][target - plan.cell_starts[cell]])
    pixels, origins = (np.concatenate(parts) for parts in zip(*drawn.values(), strict=True))
    start, stop = np.searchsorted(pixels, ends).tolist()
    return Places(pixels[start:stop], origins[start:stop], int(plan.cell_starts[first]) + start)
