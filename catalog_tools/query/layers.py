"""Layers: which stars of a catalogue another one, laid under it, holds already.

Two rows are one star if their places, carried by their own motions to a common epoch, differ by
at most `TOLERANCE_ARCSEC` and `TOLERANCE_ARCSEC_YR` for each year between the catalogues, and
their G by at most `TOLERANCE_G_MAG`. The rule looks at two rows alone, so what is omitted depends
neither on the region asked for nor on how it is cut.

Where the numbers come from (Hipparcos, J1991.25, against Gaia DR2, J2015.5; the tests count it):
half of the common stars agree to 0.02 arcsec at the epoch midway, all to 1.7: where one catalogue
gives a close pair as one star, it lies off by up to half their separation. Motions differ by 0.04
arcsec a year in one star of a hundred (orbits). Two equal stars taken for one are 0.75 mag
brighter; the rest is for variable stars and for G reckoned from other bands. What remains is a
layer's star omitted for a companion of nearly its light of which the main catalogue holds that
one only: 3 in 100 stars brighter than 6.6 have one within 3 arcsec, nearly all closer than 2.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np

from ..catalogue import Catalogue, Leaf
from ..geometry.regions import Cone, Region
from ..geometry.sphere import Floats, cap_of, directions, moved, separation_rad
from .query import read_leaf
from .selection import motion_pad_rad, select

TOLERANCE_ARCSEC = 2.0
TOLERANCE_ARCSEC_YR = 0.04
TOLERANCE_G_MAG = 1.0
ARCSEC_RAD = np.pi / 648_000.0
NEAR_RAD = 0.1  # a leaf of Gaia DR2 is 0.016 to 0.13 rad wide
MOTION = ("ra", "dec", "pmra", "pmdec", "parallax", "radial_velocity")
COLUMNS = ("source_id", *MOTION, "phot_g_mean_mag")
Rows = dict[str, np.ndarray]


def tolerance_arcsec(main: Catalogue, layer: Catalogue) -> float:
    """How far apart the two rows of one star may be at the common epoch."""
    years = abs(main.ref_epoch_jyear - layer.ref_epoch_jyear)
    return TOLERANCE_ARCSEC + TOLERANCE_ARCSEC_YR * years


def already_in(
    main: Catalogue,
    layer: Catalogue,
    regions: Sequence[Region],
    faintest_g_mag: float | None = None,
) -> np.ndarray:
    """Rows of a layer that the main catalogue holds: their source_ids (n,) int64, sorted.

    Looked at are the layer's rows down to `faintest_g_mag` that may be seen in any of the regions
    (widened for each row by its motion and parallax); of the main catalogue only row groups around
    them, and down to `TOLERANCE_G_MAG` below the faintest. Raises Damaged as `read_leaf` does.
    """
    seen = _read(layer, select(layer, regions, faintest_g_mag), faintest_g_mag)
    seen = _pick(seen, _may_be_seen(seen, regions, layer.ref_epoch_jyear))
    if not seen["source_id"].size:
        return seen["source_id"]
    faintest = float(seen["phot_g_mean_mag"].max()) + TOLERANCE_G_MAG
    held = _read(main, select(main, _around(seen, main, layer), faintest), faintest)
    return np.unique(seen["source_id"][_in_both(seen, held, main, layer)])


def _read(catalogue: Catalogue, leaves: Sequence[Leaf], faintest_g_mag: float | None) -> Rows:
    """Columns of the rows of leaves, NaN where a value is absent."""
    tables = [read_leaf(catalogue, leaf, faintest_g_mag, COLUMNS) for leaf in leaves]
    rows = {
        name: np.concatenate(
            [np.empty(0), *(t[name].to_numpy(zero_copy_only=False).astype(float) for t in tables)]
        )
        for name in COLUMNS[1:]
    }
    ids = [np.empty(0, np.int64), *(t["source_id"].to_numpy() for t in tables)]
    return {"source_id": np.concatenate(ids), **rows}


def _pick(rows: Rows, which: np.ndarray) -> Rows:
    return {name: values[which] for name, values in rows.items()}


def _may_be_seen(rows: Rows, regions: Sequence[Region], ref_epoch_jyear: float) -> np.ndarray:
    """Which rows a query for the regions has to return, each widened by its own motion: (n,)."""
    places = directions(rows["ra"], rows["dec"])
    speed = np.hypot(np.nan_to_num(rows["pmra"]), np.nan_to_num(rows["pmdec"]))
    parallax = np.maximum(np.nan_to_num(rows["parallax"]), 0.0)
    seen = np.zeros(len(places), bool)
    for region in regions:
        epoch = ref_epoch_jyear if region.epoch_jyear is None else region.epoch_jyear
        years, distance = epoch - ref_epoch_jyear, region.observer_distance_au
        seen |= region.outside_rad(places) <= motion_pad_rad(speed, parallax, years, distance)
    return seen


def _around(rows: Rows, main: Catalogue, layer: Catalogue) -> list[Cone]:
    """Cones of the main catalogue's sky that hold whatever may be one of the layer's rows.

    A match with a motion of its own lies, at the layer's epoch, within the tolerance and the
    layer's motion over the years between; one without lies there, unmoved. The query adds the
    main catalogue's motions. Neighbouring rows share a cone.
    """
    years = main.ref_epoch_jyear - layer.ref_epoch_jyear
    places = directions(rows["ra"], rows["dec"])
    way = separation_rad(places, _carried(rows, years))
    cones = []
    for near in _neighbours(places):
        (x, y, z), radius = cap_of(places[near])
        radius += float(way[near].max()) + tolerance_arcsec(main, layer) * ARCSEC_RAD
        cones.append(Cone((x, y, z), min(radius, np.pi), layer.ref_epoch_jyear, 0.0))
    return cones


def _neighbours(places: Floats) -> list[np.ndarray]:
    """Indices of unit vectors (n, 3) by the box of NEAR_RAD that they lie in."""
    boxes = np.floor(places / NEAR_RAD).astype(np.int64)
    _, box, count = np.unique(boxes, axis=0, return_inverse=True, return_counts=True)
    return np.split(np.argsort(box.ravel(), kind="stable"), np.cumsum(count)[:-1])


def _carried(rows: Rows, years: float) -> Floats:
    """Barycentric directions (n, 3) after some years; rows without a motion stay."""
    ra, dec, pmra, pmdec, parallax, velocity = (rows[name] for name in MOTION)
    return moved(ra, dec, pmra, pmdec, years, parallax, velocity)


def _in_both(seen: Rows, held: Rows, main: Catalogue, layer: Catalogue) -> np.ndarray:
    """Which of the layer's rows have a match among the main catalogue's: (n,) bool.

    The common epoch is midway: a motion's error then counts over half the years. Where one of two
    rows has no motion, the other's holds for both, and they meet at the epoch of the one without.
    """
    old, new = layer.ref_epoch_jyear, main.ref_epoch_jyear
    meet = {
        (True, True): (old + new) / 2,
        (True, False): new,
        (False, True): old,
        (False, False): old,
    }
    moves = [np.isfinite(rows["pmra"] + rows["pmdec"]) for rows in (seen, held)]
    tolerance = tolerance_arcsec(main, layer) * ARCSEC_RAD
    found = np.zeros(seen["source_id"].size, bool)
    for a, b in product((True, False), repeat=2):
        mine, others = np.flatnonzero(moves[0] == a), np.flatnonzero(moves[1] == b)
        if mine.size and others.size:
            left, right = _pick(seen, mine), _pick(held, others)
            u, v = _carried(left, meet[a, b] - old), _carried(right, meet[a, b] - new)
            i, j = _pairs(u, v, tolerance)
            g = left["phot_g_mean_mag"][i] - right["phot_g_mean_mag"][j]
            found[mine[i[np.abs(g) <= TOLERANCE_G_MAG]]] = True
    return found


def _pairs(u: Floats, v: Floats, tolerance_rad: float) -> tuple[np.ndarray, np.ndarray]:
    """Indices (m,) of all pairs of unit vectors (n, 3) and (k, 3) within a small angle."""
    from scipy.spatial import cKDTree

    near = cKDTree(v).query_ball_point(u, tolerance_rad * (1.0 + 1e-9))  # a chord is no longer
    i = np.repeat(np.arange(len(u)), [len(found) for found in near])
    j = np.fromiter((k for found in near for k in found), np.int64, i.size)
    close = separation_rad(u[i], v[j]) <= tolerance_rad
    return i[close], j[close]
