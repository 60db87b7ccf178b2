"""The stars in a region: as a stream of batches, or as a table; and the rows of one leaf."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import ArrayLike, NDArray

from ..catalogue import Catalogue, Leaf
from ..columns import NAMES, STORED
from ..engine.ahead import ahead, cores, threads
from ..errors import BadInput
from ..geometry.regions import Cone, Polygon, Region, cone_of, polygon_of
from ..geometry.sphere import Floats, directions, moved
from .reading import END_BYTES, read_row_groups
from .selection import hits, leaves_of, pads_rad, years_to

THREADS = min(cores(), 8)
PART_ROWS = 32_768  # decoded together, or a quarter of all, up to MOST_PART_ROWS
MOST_PART_ROWS = 131_072
ARROW_THREADS_ROWS = 16_384  # up to these, waking Arrow's threads costs more than they save
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

    names = _names(columns)
    leaf = _bright_enough(leaf, faintest_g_mag)
    if not leaf.row_groups:
        return STORED.empty_table().select(names)
    cut = faintest_g_mag is not None and any(
        group.faintest_g_mag > faintest_g_mag for group in leaf.row_groups
    )
    read = names if not cut or G_MAG in names else [*names, G_MAG]
    table = read_row_groups(catalogue.store, [leaf], read)
    if cut:
        bright = table[G_MAG].to_numpy().astype(float) <= faintest_g_mag
        table = _taken(table, np.flatnonzero(bright))
    return table.select(names)


def record_batches(
    catalogue: Catalogue,
    region: Cone | Polygon,
    faintest_g_mag: float | None = None,
    columns: Sequence[str] | None = None,
    epoch_jyear: float | None = None,
) -> Iterator[pa.RecordBatch]:
    """Stars within a region, leaf by leaf, about bright first: as a stream in bounded memory.

    A star belongs to the region by its barycentric direction at `epoch_jyear` (the region's, or
    the catalogue's own by default), carried there by its space motion; rows are the catalogue's
    own, at its reference epoch. Memory: a few times MOST_PART_ROWS rows. Raises BadInput and
    Damaged.
    """
    region = _barycentric(region, faintest_g_mag, epoch_jyear)
    query = _Query(catalogue, region, faintest_g_mag, _names(columns))
    return _batches(query, _parts(query, hits(catalogue, [region], faintest_g_mag)))


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

    ra_deg, dec_deg : centre, ICRS; radius_deg : up to 180. epoch_jyear : when a star must lie in
    the cone; its `ra` and `dec` stay those of the catalogue's own epoch. Errors as in
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
    region = _barycentric(region, faintest_g_mag, epoch_jyear)
    query = _Query(catalogue, region, faintest_g_mag, _names(columns))
    found = hits(catalogue, [region], faintest_g_mag)
    parts = _parts(query, found)
    stars = pa.Table.from_batches(_batches(query, parts), _schema(query.names))
    return stars, QueryReport(
        leaves=_files(catalogue, found),
        row_groups=found.size,
        bytes_read=sum(_bytes_read(query, part) for part in parts),
        rows_read=sum(part.rows for part in parts),
        rows=stars.num_rows,
    )


class _Query(NamedTuple):
    """What is asked: `names` are the columns of the result."""

    catalogue: Catalogue
    region: Cone | Polygon
    faintest_g_mag: float | None
    names: list[str]

    @property
    def years(self) -> float:
        return years_to(self.region, self.catalogue.ref_epoch_jyear)


class _Part(NamedTuple):
    """Row groups (places in the catalogue's table) that are read together.

    sure : all their rows belong to the result; doubtful : each row is looked at, which moves by
    `pad_rad` at most, and where `cut` is true some are too faint.
    """

    sure: NDArray[np.intp]
    doubtful: NDArray[np.intp]
    sure_rows: int
    rows: int
    cut: bool
    pad_rad: float


def _parts(query: _Query, found: NDArray[np.intp]) -> list[_Part]:
    """Cut a query's row groups into parts of about equal size. They depend on nothing else."""
    region, epoch = query.region, query.catalogue.ref_epoch_jyear
    caps = query.catalogue.row_group_table[found]
    pads = pads_rad(caps, region, epoch)
    inside = region.outside_rad(caps["centre"]) <= -(caps["radius_rad"] + pads)
    limit = math.inf if query.faintest_g_mag is None else query.faintest_g_mag
    cut = caps["faintest_g_mag"].astype(float) > limit
    sure, rows = inside & ~cut, caps["rows"].astype(np.int64)
    before = np.cumsum(rows) - rows
    size = min(max(int(rows.sum()) // 4, PART_ROWS), MOST_PART_ROWS)
    starts = np.unique(before // size, return_index=True)[1]
    parts = []
    for start, stop in zip(starts, [*starts[1:], found.size], strict=False):
        own = np.arange(start, stop)
        yes, no = own[sure[own]], own[~sure[own]]
        parts.append(
            _Part(
                found[yes],
                found[no],
                int(rows[yes].sum()),
                int(rows[own].sum()),
                bool(cut[no].any()),
                float(pads[no].max(initial=0.0)),
            )
        )
    return parts


def _columns_read(query: _Query, part: _Part) -> list[str]:
    """The columns of the result, and those that the doubtful rows are judged by."""
    judged = (*PLACE, *(MOTION if query.years else ())) if part.doubtful.size else ()
    return list(dict.fromkeys((*query.names, *judged, *((G_MAG,) if part.cut else ()))))


def _bytes_read(query: _Query, part: _Part) -> int:
    columns = [STORED.names.index(name) for name in _columns_read(query, part)]
    table, size = query.catalogue.row_group_table, 0
    for groups in (part.sure, part.doubtful):
        size += int(table["column_bytes"][groups][:, columns].sum())
        size += END_BYTES * _files(query.catalogue, groups)
    return size


def _files(catalogue: Catalogue, groups: NDArray[np.intp]) -> int:
    """How many shards hold some row groups."""
    return np.unique(np.searchsorted(catalogue.first_row_groups, groups, "right")).size


def _batches(query: _Query, parts: Sequence[_Part]) -> Iterator[pa.RecordBatch]:
    """Read, prove and decode the parts on a few threads, a bounded number ahead."""
    with threads(THREADS if len(parts) > 1 else 0) as pool:
        for table in ahead(pool, lambda part: _wanted_rows(query, part), parts, 2 * THREADS):
            if table.num_rows:
                yield from table.to_batches()


def _wanted_rows(query: _Query, part: _Part) -> pa.Table:
    """The rows of a part that are bright enough and within the region: the sure ones first."""
    catalogue = query.catalogue
    leaves = (*leaves_of(catalogue, part.sure), *leaves_of(catalogue, part.doubtful))
    table = read_row_groups(
        catalogue.store,
        leaves,
        _columns_read(query, part),
        threads=ARROW_THREADS_ROWS < part.rows <= PART_ROWS,
    )
    if not part.doubtful.size:
        return table.select(query.names)
    doubtful, rows = table.slice(part.sure_rows), None
    if part.cut:
        rows = np.flatnonzero(_values(doubtful, G_MAG).astype(float) <= query.faintest_g_mag)
    rows = _within(doubtful, rows, query.region, query.years, part.pad_rad)
    table, doubtful = (
        table.slice(0, part.sure_rows).select(query.names),
        doubtful.select(query.names),
    )
    return pa.concat_tables([table, _taken(doubtful, rows)])


def _taken(table: pa.Table, rows: NDArray[np.intp]) -> pa.Table:
    """Some rows of a table. `pa.array` of numbers would load pandas first, a sixth of a second."""
    places = pa.py_buffer(np.ascontiguousarray(rows, np.int64))
    return table.take(pa.Array.from_buffers(pa.int64(), len(rows), [None, places]))


def _values(table: pa.Table, name: str) -> np.ndarray:
    """A column of one chunk; NaN where it is null."""
    values: np.ndarray = table[name].chunk(0).to_numpy(zero_copy_only=False)
    return values


def _within(
    table: pa.Table, rows: NDArray[np.intp] | None, region: Region, years: float, pad_rad: float
) -> NDArray[np.intp]:
    """Those of some rows (None: of all) that lie within a region after `years`, in which they move
    by `pad_rad` at most. Most are decided by float32 cosines of their distance from its centre."""
    ra, dec = (_values(table, name) for name in PLACE)
    if rows is not None:
        ra, dec = ra[rows], dec[rows]
    cosine = _cosines(ra, dec, region)
    inner, outer = region.inner_radius_rad - pad_rad, region.radius_rad + pad_rad
    least = math.cos(outer) - COSINE_ERROR if outer < math.pi else -2.0
    surely = math.cos(inner) + COSINE_ERROR if inner > 0.0 else 2.0
    inside = cosine > surely
    doubtful = np.flatnonzero((cosine >= least) & ~inside)
    if years:
        some = doubtful if rows is None else rows[doubtful]
        pmra, pmdec, plx, rv = (_values(table, name)[some] for name in MOTION)
        v = moved(ra[doubtful], dec[doubtful], pmra, pmdec, years, plx, rv)
    else:
        v = directions(ra[doubtful], dec[doubtful])
    inside[doubtful] = region.holds(v)
    return np.flatnonzero(inside) if rows is None else rows[inside]


def _cosines(ra_deg: Floats, dec_deg: Floats, region: Region) -> NDArray[np.float32]:
    """Cosines (n,) of places' distances from a region's centre, to COSINE_ERROR."""
    x, y, z = region.centre
    turned = np.radians((ra_deg - math.degrees(math.atan2(y, x))).astype(np.float32))
    dec = np.radians(dec_deg.astype(np.float32))
    cosines: NDArray[np.float32] = np.sin(dec) * np.float32(z)
    cosines += np.cos(dec) * np.cos(turned) * np.float32(math.hypot(x, y))
    return cosines


def _names(columns: Sequence[str] | None) -> list[str]:
    names = list(NAMES if columns is None else dict.fromkeys(columns))
    if not names:
        raise BadInput("columns", columns, "at least one column")
    if unknown := [name for name in names if name not in STORED.names]:
        raise BadInput("columns", unknown[0], ", ".join(STORED.names))
    return names


def _schema(names: Sequence[str]) -> pa.Schema:
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
    checks: tuple[tuple[str, object, bool, str], ...] = (
        ("faintest_g_mag", faintest_g_mag, not math.isnan(faintest_g_mag or 0.0), "a magnitude"),
        ("epoch_jyear", epoch_jyear, 0.0 <= (epoch_jyear or 0.0) <= 4000.0, "a year, 0 to 4000"),
    )
    for field, value, fine, allowed in checks:
        if not fine:
            raise BadInput(field, value, allowed)
    if epoch_jyear is None:
        epoch_jyear = region.epoch_jyear
    return replace(region, epoch_jyear=epoch_jyear, observer_distance_au=0.0)
