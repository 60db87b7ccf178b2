"""A synthetic DR2-like catalogue: the embedded default, and any depth where a scene looks.

One seed is one sky. It is cut into magnitude intervals and HEALPix cells, and each has its own
random stream, keyed by (seed, interval, cell), for its field stars, and one for each cluster or
galaxy in it. A catalogue is a choice of these stars: all down to a limit, and more inside deep
fields. So fields agree with each other and with the rest of the sky, without duplicates or seams,
whatever else was asked for.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa

from ..columns import HEALPIX_ORDER, INCOMING
from ..coverage import all_sky
from ..documents import JsonObject
from ..engine.schedulers import LocalScheduler
from ..errors import BadInput
from ..geometry.sphere import directions, separation_rad
from ..ingest.build import About, IngestReport, Progress, build, silent
from ..partition import positions_of
from ..star_counts import EDGES_G_MAG, interval_density
from .clusters import CROWDS, interval_shares, pixels_of
from .stars import draw_stars

DENSITY_ORDER = 6  # the density is constant over pixels of 0.84 deg2, or over smaller cells
ROWS_PER_LEAF = 25_000
TABLE_ROWS = 200_000
BLOCK_ORDER = 5  # crowds are drawn in cells of 1.8 deg
# Cells by magnitude: (fainter than, HEALPix order), some thousand stars or fewer in each.
CELL_ORDERS = ((17.0, 7), (15.0, 5), (13.0, 4), (11.0, 3), (8.0, 1), (-9.0, 0))

DESCRIPTION = (
    "SYNTHETIC: no row is a real star. Drawn from published star counts, colours and motions in "
    "the form of Gaia DR2 (seed {seed}); complete to G = {limit:g} over the whole sky{fields}."
)


@dataclass(frozen=True)
class DeepField:
    """A cone that is complete to its own limiting magnitude."""

    ra_deg: float
    dec_deg: float
    radius_deg: float
    faintest_g_mag: float


@dataclass(frozen=True)
class Sky:
    """Which stars of the sky of one seed are wanted."""

    seed: int
    faintest_g_mag: float
    fields: tuple[DeepField, ...]

    def wanted(self, v: np.ndarray, g_mag: np.ndarray) -> np.ndarray:
        """Which stars, at unit vectors (n, 3) with magnitudes (n,), belong to it: (n,) bool."""
        limit = np.full(g_mag.size, self.faintest_g_mag)
        for field in self.fields:
            centre = directions(field.ra_deg, field.dec_deg)
            inside = separation_rad(v, centre) <= math.radians(field.radius_deg)
            limit = np.where(inside, np.maximum(limit, field.faintest_g_mag), limit)
        return g_mag <= limit

    def cells(self, interval: int, order: int) -> list[int]:
        """Cells of an order in which stars of an interval are wanted, ascending."""
        import healpy

        bright = EDGES_G_MAG[interval]
        if bright < self.faintest_g_mag:
            return list(range(12 * 4**order))
        cells: set[int] = set()
        for field in self.fields:
            if bright < field.faintest_g_mag:
                centre = directions(field.ra_deg, field.dec_deg)
                radius = math.radians(field.radius_deg)
                disc = healpy.query_disc(1 << order, centre, radius, inclusive=True, nest=True)
                cells.update(disc.tolist())
        return sorted(cells)


@dataclass(frozen=True)
class SyntheticPart:
    """A source for `build`: one magnitude interval of a synthetic sky, in some cells.

    cells : of the field's stars; crowds : (number in CROWDS, cell of BLOCK_ORDER).
    """

    sky: Sky
    interval: int
    cells: tuple[int, ...]
    crowds: tuple[tuple[int, int], ...]

    @property
    def label(self) -> str:
        bright, faint = EDGES_G_MAG[self.interval : self.interval + 2]
        return f"synthetic G {bright:g} to {faint:g}, seed {self.sky.seed}"

    def identity(self) -> list[object]:
        return [self.label]

    def tables(self, record: JsonObject) -> Iterator[pa.Table]:  # noqa: ARG002
        held: list[pa.Table] = []
        for table in self._draws():
            held.append(table)
            if sum(table.num_rows for table in held) >= TABLE_ROWS:
                yield pa.concat_tables(held)
                held = []
        if held:
            yield pa.concat_tables(held)

    def _draws(self) -> Iterator[pa.Table]:
        for cell in self.cells:
            yield stars_in_cell(self.sky, self.interval, cell)
        for number, block in self.crowds:
            yield stars_of_crowd(self.sky, self.interval, block, number)


def cell_order(interval: int) -> int:
    """HEALPix order of the cells of a magnitude interval."""
    bright = EDGES_G_MAG[interval]
    return next(order for limit, order in CELL_ORDERS if bright >= limit)


def stars_in_cell(sky: Sky, interval: int, cell: int) -> pa.Table:
    """The wanted stars of one interval in one cell (schema INCOMING): a pure function."""
    order = cell_order(interval)
    rng = _stream(sky.seed, interval, cell)
    fine = max(order, DENSITY_ORDER)
    shift = 2 * (fine - order)
    pixels = np.arange(cell << shift, (cell + 1) << shift)
    below = 2 * (HEALPIX_ORDER - fine)
    centres = directions(*positions_of((pixels << below) + (3 << (below - 2))))
    area_deg2 = 4.0 * math.pi * math.degrees(1.0) ** 2 / (12 * 4**fine)
    counts = rng.poisson(interval_density(interval, centres) * area_deg2)
    inside = rng.integers(0, 1 << below, counts.sum())
    pixels_29 = (np.repeat(pixels, counts) << below) | inside
    return _wanted_stars(sky, rng, interval, pixels_29)


def stars_of_crowd(sky: Sky, interval: int, block: int, number: int) -> pa.Table:
    """The wanted stars of one interval of a crowd in one cell of BLOCK_ORDER (schema INCOMING)."""
    rng = _stream(sky.seed, interval, block, 1 + number)
    order, pixels, shares = pixels_of(CROWDS[number])
    inside = pixels >> (2 * (order - BLOCK_ORDER)) == block
    stars = CROWDS[number].stars * interval_shares(CROWDS[number])[interval]
    counts = rng.poisson(stars * shares[inside])
    below = 2 * (HEALPIX_ORDER - order)
    places = rng.integers(0, 1 << below, counts.sum())
    pixels_29 = (np.repeat(pixels[inside], counts) << below) | places
    return _wanted_stars(sky, rng, interval, pixels_29)


def _stream(*key: int) -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(key)))


def _wanted_stars(
    sky: Sky, rng: np.random.Generator, interval: int, pixels_29: np.ndarray
) -> pa.Table:
    """Stars at given order-29 pixels (n,), without those that the sky does not want."""
    stars = draw_stars(rng, interval, pixels_29)
    ra_deg, dec_deg = positions_of(pixels_29)
    keep = sky.wanted(directions(ra_deg, dec_deg), stars["phot_g_mean_mag"])
    columns = {**stars, "ra": ra_deg, "dec": dec_deg}
    arrays = [
        pa.array(columns[f.name][keep], from_pandas=True).cast(f.type, safe=False) for f in INCOMING
    ]
    return pa.table(arrays, schema=INCOMING)


def _parts(sky: Sky) -> Iterator[SyntheticPart]:
    """A part for each interval in which stars are wanted."""
    blocks: list[tuple[int, int]] = []
    for number, crowd in enumerate(CROWDS):
        order, pixels, _ = pixels_of(crowd)
        found = np.unique(pixels >> (2 * (order - BLOCK_ORDER)))
        blocks += [(number, block) for block in found.tolist()]
    shares = [interval_shares(crowd) for crowd in CROWDS]
    for interval in range(EDGES_G_MAG.size - 1):
        if cells := sky.cells(interval, cell_order(interval)):
            near = set(sky.cells(interval, BLOCK_ORDER))
            crowds = (b for b in blocks if b[1] in near and shares[b[0]][interval])
            yield SyntheticPart(sky, interval, tuple(cells), tuple(crowds))


def make_demo(
    destination: str | Path,
    *,
    faintest_g_mag: float = 10.0,
    deep_fields: Sequence[tuple[float, float, float, float]] = (),
    seed: int = 2,
    rows_per_leaf: int = ROWS_PER_LEAF,
    workers: int = 2,
    progress: Progress | None = None,
    overwrite: bool = False,
) -> IngestReport:
    """Write a synthetic all-sky catalogue, complete to `faintest_g_mag`.

    deep_fields : (ra_deg, dec_deg, radius_deg, faintest_g_mag) of cones that are complete to
    limits of their own, at most G = 21. The same arguments give the same bits.
    """
    fields = tuple(DeepField(*field) for field in deep_fields)
    _check(faintest_g_mag, fields, seed)
    sky = Sky(seed, float(faintest_g_mag), fields)
    parts = list(_parts(sky))
    depths = "".join(
        f", to G = {f.faintest_g_mag:g} within {f.radius_deg:g} deg of RA {f.ra_deg:g} "
        f"Dec {f.dec_deg:g}"
        for f in fields
    )
    about = About(
        name="synthetic_sky",
        description=DESCRIPTION.format(seed=seed, limit=faintest_g_mag, fields=depths),
        synthetic=True,
        ref_epoch_jyear=2015.5,
        facts={
            "seed": seed,
            "complete_to_g_mag": float(faintest_g_mag),
            "deep_fields": [list(map(float, field)) for field in deep_fields],
        },
        coverage=all_sky("a synthetic sky", faintest_g_mag, deep_fields).to_json(),
    )
    return build(
        parts,
        Path(destination),
        about,
        rows_per_leaf=rows_per_leaf,
        scheduler=LocalScheduler("threads", workers),
        progress=progress or silent,
        overwrite=overwrite,
        restart=True,
    )


def _check(faintest_g_mag: float, fields: Sequence[DeepField], seed: int) -> None:
    bright, faint = float(EDGES_G_MAG[0]), float(EDGES_G_MAG[-1])
    if not bright < faintest_g_mag <= 16.0:
        allowed = f"above {bright:g}, up to 16 (deep fields go to {faint:g})"
        raise BadInput("faintest_g_mag", faintest_g_mag, allowed)
    if not 0 <= seed < 2**32:
        raise BadInput("seed", seed, "0 to 2**32 - 1")
    for i, field in enumerate(fields):
        checks = (
            ("ra_deg", field.ra_deg, 0.0 <= field.ra_deg <= 360.0, "0 to 360 degrees"),
            ("dec_deg", field.dec_deg, -90.0 <= field.dec_deg <= 90.0, "-90 to 90 degrees"),
            ("radius_deg", field.radius_deg, 0.0 < field.radius_deg <= 30.0, "above 0, up to 30"),
            ("faintest_g_mag", field.faintest_g_mag, field.faintest_g_mag <= faint, "up to 21"),
        )
        for name, value, fine, allowed in checks:
            if not fine:
                raise BadInput(f"deep_fields.{i}.{name}", value, allowed)
