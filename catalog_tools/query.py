"""The stars in a region: as a stream of batches, or as a table; and the rows of one leaf."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .ahead import ahead, cores, threads
from .catalogue import Catalogue, Leaf, RowGroup
from .errors import BadInput
from .regions import Cone, Polygon, Region, cone_of, polygon_of
from .selection import hits, leaves_of, motion_pad_rad, pads_rad, select, years_to
from .sphere import Floats, directions, moved
from .stores import LocalStore

if TYPE_CHECKING:
    import pyarrow as pa

    from .reading import Shard

__all__ = [
    "QueryReport", "cone", "motion_pad_rad", "polygon", "read_leaf", "record_batches", "select",
]  # fmt: skip

THREADS = min(cores(), 8)
ALONE_ROWS = 150_000  # up to these, starting threads costs more than they save
PART_ROWS = 32_768  # of row groups that are decoded together
COSINE_ERROR = 3e-6  # of float32 cosines: 4e-7 by rounded angles, 3e-7 by rounded sines
G_MAG = "phot_g_mean_mag"
PLACE = ("ra", "dec")
MOTION = ("pmra", "pmdec", "parallax", "radial_velocity")


@dataclass(frozen=True)
class QueryReport:
    """What a query cost: leaves and row groups opened, bytes read, rows looked at and returned."""

    leaves: int
    row_groups: int
    bytes_read: int
    rows_read: int
    rows: int


def read_leaf(
    catalogue: Catalogue,
    leaf: Leaf,
    faintest_g_mag: float | None = None,
    columns: Sequence[str] | None = None,
) -> pa.Table:
    """Stars of `leaf.row_groups` down to a limiting magnitude (inclusive).

    columns : names as in `columns.STORED`; None for all but the HEALPix index. Absent values are
    nulls. Row groups that are too faint aren't read. Raises Damaged naming the shard where
    anything read is not as it was written, BadInput for an unknown column.
    """
    import pyarrow as pa

    from .columns import STORED
    from .reading import open_shard

    names = _names(columns)
    leaf = _bright_enough(leaf, faintest_g_mag)
    if not leaf.row_groups:
        return STORED.empty_table().select(names)
    cut = faintest_g_mag is not None and any(
        group.faintest_g_mag > faintest_g_mag for group in leaf.row_groups
    )
    read = names if not cut or G_MAG in names else [*names, G_MAG]
    table = open_shard(catalogue.store, leaf).read(leaf.row_groups, read)
    if cut:
        table = table.filter(pa.array(table[G_MAG].to_numpy().astype(float) <= faintest_g_mag))
    return table.select(names)


def record_batches(
    catalogue: Catalogue,
    region: Cone | Polygon,
    faintest_g_mag: float | None = None,
    columns: Sequence[str] | None = None,
    epoch_jyear: float | None = None,
) -> Iterator[pa.RecordBatch]:
    """Stars within a region, leaf by leaf, bright first: as a stream in bounded memory.

    A star belongs to the region by its barycentric direction at `epoch_jyear` (the region's, or
    the catalogue's own by default), carried there by its space motion; rows are the catalogue's
    own, at its reference epoch. Memory: the compressed bytes of up to three leaves, and a few row
    groups. Raises BadInput and Damaged.
    """
    names = _names(columns)
    region = _barycentric(region, faintest_g_mag, epoch_jyear)
    found = hits(catalogue, [region], faintest_g_mag)
    return _batches(catalogue, region, faintest_g_mag, found, names)


def cone(
    catalogue: Catalogue,
    ra_deg: float,
    dec_deg: float,
    radius_deg: float,
    faintest_g_mag: float | None = None,
    epoch_jyear: float | None = None,
    columns: Sequence[str] | None = None,
) -> tuple[pa.Table, QueryReport]:
    """Stars within a cone, in the order of `record_batches`, and what the query cost.

    ra_deg, dec_deg : centre, ICRS; radius_deg : up to 180. Membership, rows and errors as in
    `record_batches`.
    """
    region = cone_of(ra_deg, dec_deg, radius_deg)
    return _gathered(catalogue, region, faintest_g_mag, epoch_jyear, columns)


def polygon(
    catalogue: Catalogue,
    corners_deg: ArrayLike,
    faintest_g_mag: float | None = None,
    epoch_jyear: float | None = None,
    columns: Sequence[str] | None = None,
) -> tuple[pa.Table, QueryReport]:
    """Stars within a polygon of great-circle arcs, as `cone` gives them.

    corners_deg : (n, 2) right ascension and declination [deg], ICRS, within less than a hemisphere.
    """
    region = polygon_of(corners_deg)
    return _gathered(catalogue, region, faintest_g_mag, epoch_jyear, columns)


def _gathered(
    catalogue: Catalogue,
    region: Cone | Polygon,
    faintest_g_mag: float | None,
    epoch_jyear: float | None,
    columns: Sequence[str] | None,
) -> tuple[pa.Table, QueryReport]:
    import pyarrow as pa

    names = _names(columns)
    region = _barycentric(region, faintest_g_mag, epoch_jyear)
    found = hits(catalogue, [region], faintest_g_mag)
    batches = _batches(catalogue, region, faintest_g_mag, found, names)
    stars = pa.Table.from_batches(batches, _schema(names))
    groups, leaves = catalogue.row_group_table[found], leaves_of(catalogue, found)
    size = int(groups["bytes"].sum()) + sum(leaf.footer_bytes for leaf in leaves)
    rows_read = int(groups["rows"].sum())
    return stars, QueryReport(len(leaves), found.size, size, rows_read, stars.num_rows)


class _Part(NamedTuple):
    """Row groups that a query looks at together; `inside` where all rows are in the region."""

    shard: Shard
    groups: tuple[RowGroup, ...]
    inside: bool
    pad_rad: float


def _batches(
    catalogue: Catalogue,
    region: Cone | Polygon,
    faintest_g_mag: float | None,
    found: NDArray[np.intp],
    names: list[str],
) -> Iterator[pa.RecordBatch]:
    """Open leaves and decode row groups on a few threads, a bounded number ahead."""
    from .reading import open_shard

    store, years = catalogue.store, years_to(region, catalogue.ref_epoch_jyear)
    caps = catalogue.row_group_table[found]
    pads = pads_rad(caps, region, catalogue.ref_epoch_jyear)
    inside = region.outside_rad(caps["centre"]) <= -(caps["radius_rad"] + pads)

    def keep(part: _Part) -> pa.Table:
        return _wanted_rows(part, region, faintest_g_mag, years, names)

    alone = isinstance(store, LocalStore) and caps["rows"].sum() <= ALONE_ROWS
    with threads(0 if alone else THREADS) as pool:
        leaves = leaves_of(catalogue, found)
        shards = ahead(pool, lambda leaf: open_shard(store, leaf), leaves, 2)
        parts = _parts(shards, inside.tolist(), pads.tolist())
        for table in ahead(pool, keep, parts, 2 * THREADS):
            if table.num_rows:
                yield from table.to_batches()


def _parts(
    shards: Iterable[Shard], inside: Sequence[bool], pads: Sequence[float]
) -> Iterator[_Part]:
    """Runs of row groups of up to PART_ROWS, wholly within the region or not."""
    more = zip(inside, pads, strict=True)
    for shard in shards:
        part = None
        for group in shard.leaf.row_groups:
            within, pad = next(more)
            if part and (
                part.inside != within or sum(g.rows for g in part.groups) + group.rows > PART_ROWS
            ):
                yield part
                part = None
            before = part.groups if part else ()
            pad = max(pad, part.pad_rad) if part else pad
            part = _Part(shard, (*before, group), within, pad)
        if part:
            yield part


def _wanted_rows(
    part: _Part, region: Region, faintest_g_mag: float | None, years: float, names: list[str]
) -> pa.Table:
    """The rows of some row groups that are bright enough and within the region after `years`."""
    import pyarrow as pa

    limit = faintest_g_mag
    bright = limit is None or all(group.faintest_g_mag <= limit for group in part.groups)
    needed = () if part.inside else (*PLACE, *MOTION) if years else PLACE
    read = dict.fromkeys((*names, *needed, *(() if bright else (G_MAG,))))
    table = part.shard.read(part.groups, list(read), threads=False)
    rows = np.arange(table.num_rows)
    if not bright:
        rows = np.flatnonzero(table[G_MAG].to_numpy().astype(float) <= limit)
    if not part.inside:
        rows = _within(table, rows, region, years, part.pad_rad)
    table = table.select(names)
    return table if rows.size == table.num_rows else table.take(pa.array(rows))


def _within(
    table: pa.Table, rows: NDArray[np.intp], region: Region, years: float, pad_rad: float
) -> NDArray[np.intp]:
    """Those of some rows that lie within a region after `years`, in which they move by `pad_rad`.

    Most are decided by float32 cosines of their distance from the region's centre.
    """
    ra, dec = (table[name].to_numpy()[rows] for name in PLACE)
    cosine = _cosines(ra, dec, region)
    inner, outer = region.inner_radius_rad - pad_rad, region.radius_rad + pad_rad
    least = math.cos(outer) - COSINE_ERROR if outer < math.pi else -2.0
    surely = math.cos(inner) + COSINE_ERROR if inner > 0.0 else 2.0
    inside = cosine > surely
    doubtful = np.flatnonzero((cosine >= least) & ~inside)
    some = rows[doubtful]
    if years:
        pmra, pmdec, plx, rv = (table[name].to_numpy()[some] for name in MOTION)
        v = moved(ra[doubtful], dec[doubtful], pmra, pmdec, years, plx, rv)
    else:
        v = directions(ra[doubtful], dec[doubtful])
    inside[doubtful] = region.holds(v)
    return rows[inside]


def _cosines(ra_deg: Floats, dec_deg: Floats, region: Region) -> NDArray[np.float32]:
    """Cosines (n,) of places' distances from a region's centre, to COSINE_ERROR."""
    x, y, z = region.centre
    turned = np.radians((ra_deg - math.degrees(math.atan2(y, x))).astype(np.float32))
    dec = np.radians(dec_deg.astype(np.float32))
    cosines: NDArray[np.float32] = np.sin(dec) * np.float32(z)
    cosines += np.cos(dec) * np.cos(turned) * np.float32(math.hypot(x, y))
    return cosines


def _names(columns: Sequence[str] | None) -> list[str]:
    from .columns import NAMES, STORED

    names = list(NAMES if columns is None else dict.fromkeys(columns))
    if not names:
        raise BadInput("columns", columns, "at least one column")
    if unknown := [name for name in names if name not in STORED.names]:
        raise BadInput("columns", unknown[0], ", ".join(STORED.names))
    return names


def _schema(names: Sequence[str]) -> pa.Schema:
    import pyarrow as pa

    from .columns import STORED

    return pa.schema([STORED.field(name) for name in names])


def _bright_enough(leaf: Leaf, faintest_g_mag: float | None) -> Leaf:
    """A leaf without the row groups that hold no star of the limit or brighter."""
    if faintest_g_mag is None:
        return leaf
    groups = tuple(g for g in leaf.row_groups if g.brightest_g_mag <= faintest_g_mag)
    return leaf if len(groups) == len(leaf.row_groups) else leaf._replace(row_groups=groups)


def _barycentric(
    region: Cone | Polygon,
    faintest_g_mag: float | None,
    epoch_jyear: float | None,
) -> Cone | Polygon:
    """The region at the epoch asked for, seen from the barycentre."""
    checks: tuple[tuple[str, Any, bool, str], ...] = (
        ("faintest_g_mag", faintest_g_mag, not math.isnan(faintest_g_mag or 0.0), "a magnitude"),
        ("epoch_jyear", epoch_jyear, 0.0 <= (epoch_jyear or 0.0) <= 4000.0, "a year, 0 to 4000"),
    )
    for field, value, fine, allowed in checks:
        if not fine:
            raise BadInput(field, value, allowed)
    if epoch_jyear is None:
        epoch_jyear = region.epoch_jyear
    return replace(region, epoch_jyear=epoch_jyear, observer_distance_au=0.0)
