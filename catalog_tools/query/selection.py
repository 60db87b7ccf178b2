"""Which leaves and row groups of a catalogue may hold a star seen in some regions: none missed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..catalogue import Catalogue, Leaf
from ..geometry.regions import Bools, Region
from ..geometry.sphere import AU_KM_YR_S, MAS_RAD, Floats

# A star that comes nearer gains proper motion and parallax: by 1 / (1 - |v_r| parallax t / A_v).
# Gaia DR2 gives none above 1000 km/s (Katz et al. 2019, A&A 622, A205); no star known is faster.
MAX_RADIAL_VELOCITY_KM_S = 2500.0
AU_LIGHT_YR = 1.58125e-5  # light time of one au in Julian years
ROUNDING_RAD = 1e-9  # 0.2 mas: far above the rounding of separations and caps
COSINE_ROUNDING_RAD = 1e-7  # of an angle from its cosine


def select(
    catalogue: Catalogue, regions: Sequence[Region], faintest_g_mag: float | None = None
) -> tuple[Leaf, ...]:
    """Every leaf, with just those of its row groups, that may hold a star seen in any region.

    Seen: at the region's epoch, from within its distance off the barycentre. Regions are widened
    for each row group by how far its own rows may have moved (`motion_pad_rad`). The caller widens
    by aberration and by the halo of the drawing. Only row groups with a star of `faintest_g_mag`
    or brighter count. Reads nothing; leaves come in the catalogue's order.
    """
    return leaves_of(catalogue, hits(catalogue, regions, faintest_g_mag))


def hits(
    catalogue: Catalogue, regions: Sequence[Region], faintest_g_mag: float | None
) -> NDArray[np.intp]:
    """Places in `row_group_table` of the row groups of `select`, ascending."""
    leaves, groups = catalogue.leaf_table, catalogue.row_group_table
    undecided = np.ones(groups.size, bool)
    if faintest_g_mag is not None:
        undecided = groups["brightest_g_mag"] <= faintest_g_mag
    hit = np.zeros(groups.size, bool)
    centres, first = np.ascontiguousarray(leaves["centre"]), catalogue.first_row_groups
    for region in regions:
        near = np.flatnonzero(_may_touch(centres, leaves, region, catalogue.ref_epoch_jyear))
        some = _runs(first[near], first[near + 1])
        some = some[undecided[some]]
        caps = groups[some]
        reach = caps["radius_rad"] + pads_rad(caps, region, catalogue.ref_epoch_jyear)
        some = some[region.outside_rad(caps["centre"]) <= reach]
        hit[some], undecided[some] = True, False
        if not undecided.any():
            break
    return np.flatnonzero(hit)


def leaves_of(catalogue: Catalogue, row_groups: NDArray[np.intp]) -> tuple[Leaf, ...]:
    """The leaves of some row groups, each with those of its own."""
    first = catalogue.first_row_groups
    indices, starts = np.unique(np.searchsorted(first, row_groups, "right") - 1, return_index=True)
    own = np.split(row_groups, starts[1:])
    return tuple(
        catalogue.leaf(i, (mine - first[i]).tolist())
        for i, mine in zip(indices.tolist(), own, strict=False)
    )


def _runs(starts: NDArray[np.int64], ends: NDArray[np.int64]) -> NDArray[np.int64]:
    """The numbers from each start up to its end, one run after the other."""
    counts = ends - starts
    before = np.cumsum(counts) - counts
    return np.repeat(starts - before, counts) + np.arange(counts.sum())


def _may_touch(centres: Floats, caps: np.ndarray, region: Region, ref_epoch_jyear: float) -> Bools:
    """Which caps come near the cap around a region: quick, and on the safe side."""
    apart = np.arccos(np.clip(centres @ np.array(region.centre), -1.0, 1.0))
    reach = caps["radius_rad"] + pads_rad(caps, region, ref_epoch_jyear)
    near: Bools = apart <= reach + (region.radius_rad + COSINE_ROUNDING_RAD)
    return near


def pads_rad(caps: np.ndarray, region: Region, ref_epoch_jyear: float) -> Floats:
    """`motion_pad_rad` of leaves or row groups (records of the manifest's tables) for a region."""
    return motion_pad_rad(
        caps["max_proper_motion_mas_yr"],
        caps["max_parallax_mas"],
        years_to(region, ref_epoch_jyear),
        region.observer_distance_au,
    )


def years_to(region: Region, ref_epoch_jyear: float) -> float:
    """Julian years from a catalogue's reference epoch to when a region is looked at."""
    return 0.0 if region.epoch_jyear is None else region.epoch_jyear - ref_epoch_jyear


def motion_pad_rad(
    max_proper_motion_mas_yr: ArrayLike,
    max_parallax_mas: ArrayLike,
    years: float,
    observer_distance_au: float,
) -> Floats:
    """How far stars may be seen from their catalogue places [rad], aberration apart.

    years : from the catalogue's epoch; observer_distance_au : from the barycentre. Of rows with at
    most these motions and parallaxes, and radial velocities to MAX_RADIAL_VELOCITY_KM_S. A star
    that may come nearer than the observer is may be seen anywhere: pi.
    """
    parallax = np.asarray(max_parallax_mas, float) * MAS_RAD
    time = abs(years) + AU_LIGHT_YR * observer_distance_au
    nearing = 1.0 - (MAX_RADIAL_VELOCITY_KM_S / AU_KM_YR_S) * parallax * time
    passes = nearing <= 0.0
    grown = 1.0 / np.where(passes, 1.0, nearing)
    motion = np.asarray(max_proper_motion_mas_yr, float) * (MAS_RAD * time) * grown
    shift = np.minimum(parallax * observer_distance_au * grown, 1.0)
    pad = motion + np.arcsin(shift) + ROUNDING_RAD
    return np.where(passes | (shift >= 1.0) | ~np.isfinite(pad), np.pi, pad)
