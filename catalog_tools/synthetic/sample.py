"""A sample of the modelled sky to G = 21, of any number of rows: its stars, part by part.

The parts are the files of `synthetic_csv`; a catalogue can be made of them with or without writing
these. About 1% of the stars have left the pixel of their source_id, as in Gaia DR2.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from ..columns import HEALPIX_ORDER, INCOMING
from ..coverage import all_sky
from ..documents import JsonObject
from ..engine.schedulers import LocalScheduler
from ..errors import BadInput
from ..geometry.sphere import MAS_RAD, angles_deg, directions
from ..ingest.build import About, IngestReport, Progress, build, silent
from ..partition import ROWS_PER_LEAF, positions_of
from ..star_counts import EDGES_G_MAG
from .plan import (
    ID_ORDER,
    Places,
    SyntheticPlan,
    magnitude_steps,
    make_plan,
    places_in_file,
)
from .stars import draw_stars
from .text import DOUBLE, SINGLE, as_printed

MOST_ROWS = 2_000_000_000
YEARS_SINCE_DETECTION = 15.5  # ids were given by ground-based places of about 2000
DETECTION_ERROR_MAS = 250.0
ID_STEP_BITS = 7
SOURCE_BYTES = 10 << 20  # what a part counts for when parts are put into batches
Columns = dict[str, np.ndarray]


@dataclass(frozen=True)
class SyntheticFile:
    """A source for `build`: one part of a sample."""

    plan: SyntheticPlan
    number: int

    @property
    def label(self) -> str:
        return f"synthetic sample, part {self.number}"

    def identity(self) -> list[object]:
        return [self.label, self.plan.seed, self.plan.rows]

    def tables(self, record: JsonObject) -> Iterator[pa.Table]:  # noqa: ARG002
        yield table_of_file(self.plan, self.number)


def make_sample(
    destination: str | Path,
    rows: int,
    *,
    seed: int = 2,
    rows_per_leaf: int = ROWS_PER_LEAF,
    workers: int = 2,
    progress: Progress | None = None,
    overwrite: bool = False,
) -> IngestReport:
    """Write a catalogue of exactly `rows` synthetic stars of the whole sky, G = 3 to 21.

    rows : 1 to 2e9. It holds, bit for bit, the rows that an ingest of `write_csv_files` with the
    same rows and seed gives. Raises BadInput (rows, seed, workers, destination).
    """
    check_sample(rows, seed, workers)
    plan = make_plan(seed, rows)
    parts = [SyntheticFile(plan, number) for number in range(plan.files)]
    about = About(
        name="synthetic_sample",
        description=f"SYNTHETIC: no row is a real star. {rows} stars drawn from published star "
        f"counts, colours and motions in the form of Gaia DR2 (seed {seed}).",
        synthetic=True,
        ref_epoch_jyear=2015.5,
        facts={"seed": seed, "sample_rows": rows},
        coverage=all_sky("a sample of a synthetic sky").to_json(),
    )
    return build(
        parts,
        Path(destination),
        about,
        rows_per_leaf=rows_per_leaf,
        sizes=[SOURCE_BYTES] * len(parts),
        scheduler=LocalScheduler("threads", workers),
        progress=progress or silent,
        overwrite=overwrite,
    )


def check_sample(rows: int, seed: int, workers: int) -> None:
    """Raises BadInput for arguments that no sample has."""
    if not 1 <= rows <= MOST_ROWS:
        raise BadInput("rows", rows, f"1 to {MOST_ROWS}")
    if not 0 <= seed < 2**32:
        raise BadInput("seed", seed, "0 to 2**32 - 1")
    if workers < 1:
        raise BadInput("workers", workers, "at least 1")


def stars_of_file(plan: SyntheticPlan, number: int) -> tuple[Columns, np.random.Generator, int]:
    """Columns of one file's stars in its order, its random stream, and the rows before it.

    Values are not yet rounded as they are printed.
    """
    key = np.random.SeedSequence((plan.seed, plan.rows, 2, number))
    rng = np.random.Generator(np.random.PCG64(key))
    places = places_in_file(plan, number)
    shuffle = rng.permutation(places.pixels.size)
    pixels, origins = places.pixels[shuffle], places.origins[shuffle]
    steps = magnitude_steps()
    interval = np.searchsorted(steps, origins + rng.random(origins.size), side="right")
    interval = np.minimum(interval - origins * (EDGES_G_MAG.size - 1), EDGES_G_MAG.size - 2)
    inside = 2 * (HEALPIX_ORDER - ID_ORDER)
    pixels_29 = (pixels << inside) | rng.integers(0, 1 << inside, pixels.size)
    stars: Columns = dict(draw_stars(rng, interval, pixels_29))
    stars["source_id"] = _source_ids(rng, places)[shuffle]
    stars["ra"], stars["dec"] = angles_deg(_moved_since_detection(rng, pixels_29, stars))
    return stars, rng, places.first_row


def table_of_file(plan: SyntheticPlan, number: int) -> pa.Table:
    """What a reader of one file gets (schema INCOMING), to the bit, without the text."""
    stars, _, _ = stars_of_file(plan, number)
    arrays = []
    for field in INCOMING:
        values = stars[field.name]
        if pa.types.is_floating(field.type):
            values = as_printed(values, SINGLE if "_mean_mag" in field.name else DOUBLE)
        arrays.append(pa.array(values, from_pandas=True).cast(field.type, safe=False))
    return pa.table(arrays, schema=INCOMING)


def _source_ids(rng: np.random.Generator, places: Places) -> NDArray[np.int64]:
    """Unique ids: the pixel above bit 35, below it a running number in steps of 128 (as DR2's)."""
    pixels = places.pixels
    first = np.flatnonzero(np.diff(pixels, prepend=-1))
    counts = np.diff(first, append=pixels.size)
    rank = np.arange(pixels.size) - np.repeat(first, counts)
    step = (1 << (35 - ID_STEP_BITS)) // max(int(counts.max(initial=1)), 1)
    running = rank * step + rng.integers(0, step, pixels.size)
    return np.asarray((pixels << 35) | (running << ID_STEP_BITS))


def _moved_since_detection(
    rng: np.random.Generator, pixels_29: NDArray[np.int64], stars: Columns
) -> NDArray[np.float64]:
    """Directions (n, 3) at the catalogue's epoch of stars that were detected in given pixels."""
    ra_deg, dec_deg = positions_of(pixels_29)
    ra, dec = np.radians(ra_deg), np.radians(dec_deg)
    shift = DETECTION_ERROR_MAS * rng.standard_normal((2, ra.size))
    for i, name in enumerate(("pmra", "pmdec")):
        shift[i] += YEARS_SINCE_DETECTION * np.nan_to_num(stars[name])
    x, y = shift * MAS_RAD
    v = directions(ra_deg, dec_deg)
    v[:, 0] -= x * np.sin(ra) + y * np.sin(dec) * np.cos(ra)
    v[:, 1] += x * np.cos(ra) - y * np.sin(dec) * np.sin(ra)
    v[:, 2] += y * np.cos(dec)
    return v / np.sqrt(np.einsum("ij,ij->i", v, v))[:, None]
