"""Prove one shard: its bytes against the checksums, its rows against what the manifest says."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import google_crc32c
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from ..catalogue import Catalogue, Leaf, RowGroup
from ..columns import HEALPIX_COLUMN, HEALPIX_ORDER, NAMES, STORED
from ..errors import Damaged, Incomplete
from ..geometry.sphere import directions
from ..ingest.judging import COLOURS, without_colour
from ..partition import COUNT_ORDER, coarser, healpix_29
from ..query.reading import Bytes, parse_footer
from ..storage.stores import Unreachable

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.parquet as pq

ROUNDING_RAD = 1e-12


class Finding(NamedTuple):
    """A problem: where, and what."""

    path: str
    what: str

    def __str__(self) -> str:
        return f"{self.path}: {self.what}"


class ShardCheck(NamedTuple):
    """What a shard holds, and what is wrong with it.

    pixels, counts : pixels of COUNT_ORDER that occur, and their rows; source_ids : of all rows
    that could be read; without_colour : rows without a BP or RP magnitude.
    """

    findings: list[Finding]
    rows: int
    pixels: NDArray[np.int64]
    counts: NDArray[np.int64]
    source_ids: NDArray[np.int64]
    without_colour: int


def check_shard(catalogue: Catalogue, index: int) -> ShardCheck:
    """Read a whole shard and check all of it. Raises Incomplete where a store gives no answer."""
    leaf = catalogue.leaf(index)
    data, wrong = _fetch(catalogue, leaf)
    if data is None:
        return _summary(leaf, wrong, [])
    metadata = None
    try:
        metadata = _metadata(data, leaf)
    except Damaged as error:
        wrong.append(error.reason)
    sound: list[RowGroup] = []
    for group in leaf.row_groups:
        part = data[group.offset : group.offset + group.bytes]
        if google_crc32c.value(part) == group.crc32c:
            sound.append(group)
        else:
            wrong.append(f"row group {group.row_group} does not match its checksum")
    if not wrong and google_crc32c.value(data) != leaf.crc32c:
        wrong.append("bytes outside its row groups and its footer do not match the checksum")
    tables = []
    for group in sound if metadata is not None else []:
        try:
            tables.append(_decode(data, metadata, leaf, group))
        except Damaged as error:
            wrong.append(error.reason)
        else:
            wrong += _check_rows(catalogue, index, leaf, group, tables[-1])
    return _summary(leaf, wrong, tables)


def _fetch(catalogue: Catalogue, leaf: Leaf) -> tuple[Bytes | None, list[str]]:
    """All bytes of a shard, or what is wrong with the file."""
    data = np.empty(leaf.bytes + 1, np.uint8)
    store = catalogue.store
    try:
        (found,) = store.fill(leaf.path, [(0, data)])
        size = found if found < leaf.bytes else store.size(leaf.path)
    except FileNotFoundError:
        return None, ["the shard is missing"]
    except Unreachable as error:
        raise Incomplete(f"{store.root}/{leaf.path}: could not be read ({error})") from None
    except OSError as error:
        return None, [f"cannot be read ({error})"]
    if size != leaf.bytes:
        return None, [f"is {size} bytes long; the manifest says {leaf.bytes}"]
    return data[: leaf.bytes], []


def _metadata(data: Bytes, leaf: Leaf) -> pq.FileMetaData:
    footer = data[leaf.bytes - leaf.footer_bytes :]
    if google_crc32c.value(footer) != leaf.footer_crc32c:
        raise Damaged(leaf.path, "the footer does not match its checksum")
    return parse_footer(leaf.path, leaf, footer)


def _decode(data: Bytes, metadata: pq.FileMetaData, leaf: Leaf, group: RowGroup) -> pa.Table:
    """A row group's rows, with Parquet's page checksums."""
    what = f"row group {group.row_group}"
    try:
        file = pq.ParquetFile(
            pa.BufferReader(pa.py_buffer(data)),
            metadata=metadata,
            page_checksum_verification=True,
        )
        if not file.schema_arrow.equals(STORED):
            raise Damaged(leaf.path, "its columns are not those of a catalogue")
        table = file.read_row_group(group.row_group, use_threads=False)
    except MemoryError:
        raise  # of Arrow, too: no damage
    except (pa.ArrowException, OSError) as error:
        raise Damaged(leaf.path, f"{what} cannot be read ({error})") from None
    if table.num_rows != group.rows:
        raise Damaged(leaf.path, f"{what} has {table.num_rows} rows; the manifest: {group.rows}")
    return table


def _check_rows(
    catalogue: Catalogue, index: int, leaf: Leaf, group: RowGroup, table: pa.Table
) -> list[str]:
    """What is wrong with the rows of a row group, each kind of problem once with its number."""
    first = int(catalogue.first_row_groups[index])
    bounds = catalogue.row_group_table[first + group.row_group]
    columns = {name: table[name].to_numpy() for name in (HEALPIX_COLUMN, *NAMES)}
    pixels, ra, dec = columns[HEALPIX_COLUMN], columns["ra"], columns["dec"]
    g_mag = columns["phot_g_mean_mag"]
    with np.errstate(invalid="ignore"):
        placed = (ra >= 0.0) & (ra < 360.0) & (np.abs(dec) <= 90.0)
        v = directions(ra, dec)
        own = np.where(placed, healpix_29(np.where(placed, ra, 0.0), np.where(placed, dec, 0)), -1)
        speed = np.hypot(columns["pmra"].astype(float), columns["pmdec"].astype(float))
        checks = {
            "outside ra 0 to 360 or dec -90 to 90": ~placed,
            f"outside the HEALPix pixel of the shard ({leaf.order}, {leaf.pixel})": pixels
            >> (2 * (HEALPIX_ORDER - leaf.order))
            != leaf.pixel,
            f"whose {HEALPIX_COLUMN} is not that of their ra and dec": placed & (own != pixels),
            "out of HEALPix order": np.concatenate([[False], pixels[1:] < pixels[:-1]]),
            "outside the magnitude range that the manifest says": ~(
                (g_mag >= bounds["brightest_g_mag"]) & (g_mag <= bounds["faintest_g_mag"])
            ),
            "outside the cap that the manifest says": placed
            & (_outside(v, bounds) | _outside(v, catalogue.leaf_table[index])),
            "that move faster than the manifest says": speed
            > min(float(bounds["max_proper_motion_mas_yr"]), leaf.max_proper_motion_mas_yr),
            "with a parallax above what the manifest says": columns["parallax"]
            > min(float(bounds["max_parallax_mas"]), leaf.max_parallax_mas),
        }
    return [
        f"row group {group.row_group}: {np.count_nonzero(bad)} rows {what}"
        for what, bad in checks.items()
        if bad.any()
    ]


def _outside(v: NDArray[np.float64], cap: np.void) -> NDArray[np.bool_]:
    chord = v - cap["centre"]
    most = 2.0 * math.sin(0.5 * float(cap["radius_rad"])) + ROUNDING_RAD
    far: NDArray[np.bool_] = np.einsum("ij,ij->i", chord, chord) > most * most
    return far


def _summary(leaf: Leaf, wrong: list[str], tables: list[pa.Table]) -> ShardCheck:
    none = np.empty(0, np.int64)
    pixels = np.concatenate([none, *(t[HEALPIX_COLUMN].to_numpy() for t in tables)])
    ids = np.concatenate([none, *(t["source_id"].to_numpy() for t in tables)])
    pixels, counts = np.unique(coarser(pixels, COUNT_ORDER), return_counts=True)
    findings = [Finding(leaf.path, what) for what in wrong]
    colourless = sum(without_colour(t[name].to_numpy() for name in COLOURS) for t in tables)
    return ShardCheck(findings, ids.size, pixels, counts.astype(np.int64), ids, colourless)
