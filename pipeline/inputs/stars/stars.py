"""Stars from the catalogues: which leaves a field needs, and their rows with light attached."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from catalog_tools.catalogue import Catalogue, Leaf
from pipeline.arrays import StarTable
from pipeline.errors import BadInput
from pipeline.physics.colour import ColourFit, star_electron_rate
from pipeline.physics.constants import DEG_RAD, MAS_RAD

if TYPE_CHECKING:
    import pyarrow as pa

    from catalog_tools.geometry.regions import Cone


class Shard(NamedTuple):
    """A leaf of one of the scene's catalogues (0 the main one), with the row groups wanted."""

    catalogue: int
    leaf: Leaf


def cones_of(
    centres: np.ndarray,
    radii_rad: np.ndarray,
    epochs_jyear: np.ndarray,
    observer_distances_au: np.ndarray,
) -> tuple[Cone, ...]:
    """Cones of the catalogues' sky, each once.

    centres : (n, 3) unit vectors; radii_rad : (n,), already widened by aberration and halo;
    epochs_jyear, observer_distances_au : (n,) when and how far from the barycentre.
    """
    from catalog_tools.geometry.regions import Cone

    columns = (centres, radii_rad, epochs_jyear, observer_distances_au)
    found = (
        Cone((x, y, z), radius, epoch, distance)
        for (x, y, z), radius, epoch, distance in zip(*(c.tolist() for c in columns), strict=True)
    )
    return tuple(dict.fromkeys(found))


def gather_shards(
    catalogues: Sequence[Catalogue], cones: Sequence[Cone], faintest_g_mag: float | None
) -> tuple[Shard, ...]:
    """Leaves of all catalogues that may hold a star of any of the cones, with those row groups."""
    from catalog_tools.query.selection import select

    return tuple(
        Shard(i, leaf)
        for i, catalogue in enumerate(catalogues)
        for leaf in select(catalogue, cones, faintest_g_mag)
    )


def brightest_g_mags(catalogue: Catalogue, leaf: Leaf, faintest_g_mag: float | None) -> np.ndarray:
    """Brightest G of each of a whole leaf's row groups that are bright enough (n,)."""
    table = catalogue.leaf_table
    (index,) = np.flatnonzero((table["order"] == leaf.order) & (table["pixel"] == leaf.pixel))
    first, end = catalogue.first_row_groups[index : index + 2]
    found = catalogue.row_group_table["brightest_g_mag"][first:end]
    return found if faintest_g_mag is None else found[found <= faintest_g_mag]


def leaf_pad_rad(leaf: Leaf, years: float, observer_distance_au: float) -> float:
    """How far the stars of a leaf may be seen from their catalogue places [rad]."""
    from catalog_tools.query.selection import motion_pad_rad

    return float(
        motion_pad_rad(
            leaf.max_proper_motion_mas_yr, leaf.max_parallax_mas, years, observer_distance_au
        )
    )


def gather_leaf(
    catalogue: Catalogue,
    leaf: Leaf,
    faintest_g_mag: float | None,
    fit: ColourFit,
    area_m2: float,
    unmoving: bool = False,
    left_out: np.ndarray | None = None,
) -> StarTable:
    """Rows of a leaf that are bright enough, by id, with their electron rate in the sensor's band.

    area_m2 : collecting area of the pupil. `unmoving` leaves space motion out, as asked;
    left_out : sorted source_ids of stars that an earlier catalogue holds.
    """
    from catalog_tools.query.query import read_leaf

    rows = read_leaf(catalogue, leaf, faintest_g_mag)
    if left_out is not None and left_out.size:
        rows = rows.filter(~np.isin(rows["source_id"].to_numpy(), left_out))
    rows = rows.sort_by("source_id")  # once: each tile and each frame's truth list stars by it
    g = _column(rows, "phot_g_mean_mag")
    if not np.isfinite(g).all():
        raise BadInput("stars.catalogue", catalogue.path, "stars with a finite G magnitude")
    rate, flag = star_electron_rate(
        g, _column(rows, "phot_bp_mean_mag"), _column(rows, "phot_rp_mean_mag"), fit
    )
    motion = np.nan if unmoving else 1.0
    return StarTable(
        source_id=rows["source_id"].to_numpy().astype(np.int64),
        ra_rad=_column(rows, "ra") * DEG_RAD,
        dec_rad=_column(rows, "dec") * DEG_RAD,
        pm_ra_cosdec_rad_yr=_column(rows, "pmra") * MAS_RAD * motion,
        pm_dec_rad_yr=_column(rows, "pmdec") * MAS_RAD * motion,
        parallax_rad=_column(rows, "parallax") * MAS_RAD,
        radial_velocity_m_s=_column(rows, "radial_velocity") * 1e3 * motion,
        g_mag=g,
        rate_e_s=rate * area_m2,
        colour_flag=flag,
    )


def _column(rows: pa.Table, name: str) -> np.ndarray:
    """A column as float64, NaN where it is null."""
    return rows[name].to_numpy(zero_copy_only=False).astype(np.float64)
