"""Which leaves and row groups a region needs, and the stars in a cone: no star missed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from .catalogue import Band, Catalogue, Leaf
from .errors import BadInput
from .sphere import MAS_RAD, directions, moved, separation_rad

if TYPE_CHECKING:
    import pyarrow as pa

# A star that comes nearer gains proper motion: mu / (1 - |mu_r| t). No known star has a radial
# motion mu_r above this (Barnard's star, the fastest: 6.1e-5 rad/yr).
MAX_RADIAL_MOTION_RAD_YR = 2e-4


@dataclass(frozen=True)
class QueryReport:
    """What a query cost: leaves and row groups opened, bytes read, rows looked at and returned."""

    leaves: int
    row_groups: int
    bytes_read: int
    rows_read: int
    rows: int


def leaves_in_cone(
    catalogue: Catalogue,
    centre: ArrayLike,
    radius_rad: float,
    epoch_jyear: float | None = None,
    observer_distance_au: float = 1.1,
) -> tuple[Leaf, ...]:
    """Leaves that may hold a star seen within a cone, at an epoch.

    centre : (3,) unit vector, ICRS; radius_rad : the cone's radius. The cone is widened for each
    leaf by its rows' largest proper motion over the years from the reference epoch, and by its
    largest parallax for an observer at most `observer_distance_au` from the barycentre. The caller
    widens by aberration and by the halo of the drawing.
    """
    caps = catalogue.caps
    epoch = catalogue.ref_epoch_jyear if epoch_jyear is None else epoch_jyear
    pad = motion_pad_rad(
        caps.proper_motions_mas_yr, caps.parallaxes_mas, epoch - catalogue.ref_epoch_jyear,
        observer_distance_au,
    )  # fmt: skip
    apart = separation_rad(caps.centres, np.asarray(centre, float))
    near = apart <= radius_rad + caps.radii_rad + pad
    return tuple(leaf for leaf, hit in zip(catalogue.leaves, near, strict=True) if hit)


def motion_pad_rad(
    max_proper_motion_mas_yr: ArrayLike,
    max_parallax_mas: ArrayLike,
    years: float,
    observer_distance_au: float,
) -> np.ndarray:
    """How far the stars of leaves may be seen from their catalogue places [rad], aberration apart.

    years : from the catalogue's epoch; observer_distance_au : from the barycentre. A star nearer
    than the observer may be seen anywhere: pi.
    """
    nearing = max(1.0 - MAX_RADIAL_MOTION_RAD_YR * abs(years), 0.1)
    motion = np.asarray(max_proper_motion_mas_yr, float) * (abs(years) / nearing) * MAS_RAD
    parallax = np.asarray(max_parallax_mas, float) * observer_distance_au * MAS_RAD
    shift = np.where(parallax < 1.0, np.arcsin(np.minimum(parallax, 1.0)), np.pi)
    return np.asarray(motion + shift + 1e-9, float)


def bands_to_read(leaf: Leaf, faintest_g_mag: float | None) -> tuple[Band, ...]:
    """Row groups of a leaf that hold a star of the limiting magnitude or brighter."""
    if faintest_g_mag is None:
        return leaf.bands
    return tuple(band for band in leaf.bands if band.brightest_g_mag <= faintest_g_mag)


def read_leaf(
    catalogue: Catalogue,
    leaf: Leaf,
    faintest_g_mag: float | None = None,
    columns: Sequence[str] | None = None,
) -> pa.Table:
    """Stars of a leaf down to a limiting magnitude (inclusive), only the row groups needed.

    columns : names as in `columns.STORED`; None for all but the HEALPix index. Absent values are
    nulls. Raises Damaged naming the shard where anything read is not as it was written, BadInput
    for an unknown column.
    """
    import pyarrow.compute as pc

    from .columns import NAMES, STORED
    from .shards import read_row_groups

    names = list(NAMES if columns is None else columns)
    if unknown := [name for name in names if name not in STORED.names]:
        raise BadInput("columns", unknown[0], ", ".join(STORED.names))
    bands = bands_to_read(leaf, faintest_g_mag)
    if not bands:
        return STORED.empty_table().select(names)
    cut = faintest_g_mag is not None and bands[-1].faintest_g_mag > faintest_g_mag
    read = names if not cut or "phot_g_mean_mag" in names else [*names, "phot_g_mean_mag"]
    table = read_row_groups(catalogue.shard_path(leaf), leaf, bands, read)
    if cut:
        bright = pc.less_equal(pc.cast(table["phot_g_mean_mag"], "double"), faintest_g_mag)
        table = table.filter(bright)
    return table.select(names)


def cone(
    catalogue: Catalogue,
    ra_deg: float,
    dec_deg: float,
    radius_deg: float,
    faintest_g_mag: float | None = None,
    epoch_jyear: float | None = None,
) -> tuple[pa.Table, QueryReport]:
    """Stars within a cone, sorted by source_id, and what the query cost.

    ra_deg, dec_deg : centre, ICRS; radius_deg : up to 180. A star belongs to the cone by its
    barycentric direction at `epoch_jyear` (Julian year, the catalogue's own by default), carried
    there by its space motion; the rows returned are the catalogue's own, at its reference epoch.
    """
    import pyarrow as pa

    from .columns import CANONICAL

    _check_cone(ra_deg, dec_deg, radius_deg, faintest_g_mag, epoch_jyear)
    centre, radius_rad = directions(ra_deg, dec_deg), math.radians(radius_deg)
    epoch = catalogue.ref_epoch_jyear if epoch_jyear is None else epoch_jyear
    found, groups, size, rows_read = [CANONICAL.empty_table()], 0, 0, 0
    leaves = leaves_in_cone(catalogue, centre, radius_rad, epoch, observer_distance_au=0.0)
    leaves = tuple(leaf for leaf in leaves if bands_to_read(leaf, faintest_g_mag))
    for leaf in leaves:
        bands = bands_to_read(leaf, faintest_g_mag)
        table = read_leaf(catalogue, leaf, faintest_g_mag)
        inside = _within(table, centre, radius_rad, epoch - catalogue.ref_epoch_jyear)
        found.append(table.filter(pa.array(inside)))
        groups += len(bands)
        size += leaf.footer_bytes + sum(band.bytes for band in bands)
        rows_read += sum(band.rows for band in bands)
    stars = pa.concat_tables(found).sort_by("source_id")
    return stars, QueryReport(len(leaves), groups, size, rows_read, stars.num_rows)


def _within(table: pa.Table, centre: np.ndarray, radius_rad: float, years: float) -> np.ndarray:
    """Which rows lie within the cone after `years`: (n,) bool."""
    names = ("ra", "dec", "pmra", "pmdec")
    ra, dec, pmra, pmdec, plx, rv = (
        table[name].to_numpy() for name in (*names, "parallax", "radial_velocity")
    )
    if years == 0.0:
        return separation_rad(directions(ra, dec), centre) <= radius_rad
    return separation_rad(moved(ra, dec, pmra, pmdec, years, plx, rv), centre) <= radius_rad


def _check_cone(
    ra_deg: float,
    dec_deg: float,
    radius_deg: float,
    faintest_g_mag: float | None,
    epoch_jyear: float | None,
) -> None:
    checks = (
        ("ra_deg", ra_deg, math.isfinite(ra_deg), "a finite angle in degrees"),
        ("dec_deg", dec_deg, -90.0 <= dec_deg <= 90.0, "-90 to 90 degrees"),
        ("radius_deg", radius_deg, 0.0 < radius_deg <= 180.0, "above 0, up to 180 degrees"),
        ("faintest_g_mag", faintest_g_mag, not math.isnan(faintest_g_mag or 0.0), "a magnitude"),
        ("epoch_jyear", epoch_jyear, 0.0 <= (epoch_jyear or 0.0) <= 4000.0, "a year, 0 to 4000"),
    )
    for field, value, fine, allowed in checks:
        if not fine:
            raise BadInput(field, value, allowed)
