"""Write one leaf's Parquet file: magnitude bands, bright first, cut along the HEALPix curve.

Row groups hold one band each (or a stretch of it), so that a reader takes those that are bright
enough and near enough. What proves them (lengths, crc32c) and what bounds them goes into the
tables of the manifest; Parquet's own page checksums are written too.
"""

from __future__ import annotations

from pathlib import Path
from typing import BinaryIO

import google_crc32c
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from ..catalogue import LEAVES_DTYPE, ROW_GROUPS_DTYPE, shard_name
from ..columns import ENCODINGS, HEALPIX_COLUMN, HEALPIX_ORDER, STORED
from ..geometry.sphere import cap_of, cap_of_caps, directions
from .judging import Columns

# Faint edges of the bands (the last one is open), and the most rows of a row group of each. Bright
# stars are rare: their row groups are small, so that a cone of a degree takes few rows besides its
# own; every row group costs time of its own, so the faint ones are larger.
BAND_EDGES_G_MAG = np.array([8.0, 10.0, 12.0, 14.0, 16.0, 17.0, 18.0, 19.0, 20.0], np.float32)
BAND_MOST_ROWS = (1024, 1024, 1024, 2048, 4096, 8192, 8192, 8192, 8192, 8192)
MAX_ROW_GROUP_ROWS = max(BAND_MOST_ROWS)
MIN_BAND_ROWS = 1024
ZSTD_LEVEL = 3
PRUNED_BY = [HEALPIX_COLUMN, "ra", "dec", "phot_g_mean_mag"]  # columns with Parquet statistics
CHUNK_BYTES = 1 << 20


def write_shard(root: Path, order: int, pixel: int, rows: Columns) -> tuple[np.ndarray, np.ndarray]:
    """Write the rows of one leaf below `root`; returns its records in the manifest's two tables.

    rows : columns of STORED in any order of rows, NaN for absent values; the dictionary is
    emptied. Rows with equal (`_healpix_29`, source_id) must not occur: the bits of the file depend
    on the set of rows alone.
    """
    path = root / shard_name(order, pixel)
    path.parent.mkdir(parents=True, exist_ok=True)
    places, groups = _arrange(rows)
    rows = {name: rows.pop(name)[places] for name in STORED.names}
    with pq.ParquetWriter(
        path,
        STORED,
        compression="zstd",
        compression_level=ZSTD_LEVEL,
        use_dictionary=False,
        column_encoding=ENCODINGS,
        write_statistics=PRUNED_BY,
        write_page_checksum=True,
        store_schema=False,
    ) as writer:
        for group in groups:
            writer.write_table(_table(rows, group), row_group_size=group.stop - group.start)
    return _records(path, order, pixel, rows, groups)


def band_slices(counts: np.ndarray) -> list[slice]:
    """Join bands of too few rows: slices of bands, each of MIN_BAND_ROWS or more together.

    counts : (bands,) rows in each band, bright first. A band that is too small joins the next
    fainter one; a small last one joins its brighter neighbour.
    """
    slices: list[slice] = []
    start = rows = 0
    for band, count in enumerate(counts.tolist()):
        rows += count
        if rows >= MIN_BAND_ROWS:
            slices.append(slice(start, band + 1))
            start, rows = band + 1, 0
    if rows and slices:
        return [*slices[:-1], slice(slices[-1].start, counts.size)]
    return slices or [slice(0, counts.size)]


def _arrange(rows: Columns) -> tuple[np.ndarray, list[slice]]:
    """The order of the rows in the file, and its row groups as slices of that order."""
    band = np.searchsorted(BAND_EDGES_G_MAG, rows["phot_g_mean_mag"]).astype(np.uint8)
    counts = np.bincount(band, minlength=BAND_EDGES_G_MAG.size + 1)
    joined = band_slices(counts)
    for i, wide in enumerate(joined):
        band[(band >= wide.start) & (band < wide.stop)] = i
    places = _along_the_curve(rows)
    places = places[np.argsort(band[places], kind="stable")]
    pixels = rows[HEALPIX_COLUMN][places]
    groups, start = [], 0
    for wide in joined:
        stop = start + int(counts[wide].sum())
        most = min(BAND_MOST_ROWS[wide.stop - 1], MAX_ROW_GROUP_ROWS)
        groups += _halved(pixels, start, stop, 0, 4 + 2 * HEALPIX_ORDER, most)
        start = stop
    return places, groups


def _halved(
    pixels: np.ndarray, start: int, stop: int, low: int, bits: int, most: int
) -> list[slice]:
    """Cut ascending pixels at the borders of HEALPix pixels, or of halves of them, into slices of
    at most `most` rows. Row groups that keep to such cells are compact: a cone meets a third as
    many of them as of stretches of equal length, which reach over into the next large pixel."""
    if stop - start <= most or bits == 0:
        return [slice(start, stop)] if stop > start else []
    half = low + (1 << (bits - 1))
    middle = start + int(np.searchsorted(pixels[start:stop], half))
    return [
        *_halved(pixels, start, middle, low, bits - 1, most),
        *_halved(pixels, middle, stop, half, bits - 1, most),
    ]


def _along_the_curve(rows: Columns) -> np.ndarray:
    """Places of the rows by (HEALPix index, source_id). Sorted runs are merged, not sorted anew."""
    pixels = rows[HEALPIX_COLUMN]
    places = np.argsort(pixels, kind="stable")
    ordered = pixels[places]
    if (ordered[1:] == ordered[:-1]).any():
        places = np.lexsort((rows["source_id"], pixels))
    return places


def _table(rows: Columns, group: slice) -> pa.Table:
    """Rows of one group; NaN becomes null."""
    arrays = [pa.array(rows[f.name][group], f.type, from_pandas=True) for f in STORED]
    return pa.table(arrays, schema=STORED)


def _records(
    path: Path, order: int, pixel: int, rows: Columns, groups: list[slice]
) -> tuple[np.ndarray, np.ndarray]:
    """The leaf (one element, LEAVES_DTYPE) and its row groups (ROW_GROUPS_DTYPE)."""
    leaf, records = np.zeros((), LEAVES_DTYPE), np.zeros(len(groups), ROW_GROUPS_DTYPE)
    metadata = pq.read_metadata(path)
    with path.open("rb") as file:
        for i, group in enumerate(groups):
            described = metadata.row_group(i)
            chunks = [described.column(c) for c in range(described.num_columns)]
            start, sizes = chunks[0].data_page_offset, [c.total_compressed_size for c in chunks]
            file.seek(start)
            data = [file.read(size) for size in sizes]
            records[i]["offset"], records[i]["bytes"] = start, sum(sizes)
            records[i]["rows"] = group.stop - group.start
            records[i]["column_bytes"] = sizes
            records[i]["column_crc32c"] = [google_crc32c.value(chunk) for chunk in data]
            records[i]["crc32c"] = google_crc32c.value(b"".join(data))
            _bound(records[i], rows, group)
        leaf["bytes"] = length = path.stat().st_size
        leaf["crc32c"] = _crc32c(file, 0, length)
        file.seek(length - 8)
        leaf["footer_bytes"] = footer = int.from_bytes(file.read(4), "little") + 8
        leaf["footer_crc32c"] = _crc32c(file, length - footer, footer)
    leaf["order"], leaf["pixel"] = order, pixel
    leaf["rows"], leaf["row_groups"] = records["rows"].sum(), len(groups)
    for key in ("max_proper_motion_mas_yr", "max_parallax_mas", "faintest_g_mag"):
        leaf[key] = records[key].max()
    leaf["brightest_g_mag"] = records["brightest_g_mag"].min()
    leaf["centre"], leaf["radius_rad"] = cap_of_caps(
        records["centre"], records["radius_rad"], records["rows"]
    )
    return leaf, records


def _bound(record: np.ndarray, rows: Columns, group: slice) -> None:
    """Fill in where the rows of a group lie, how far they move, and how bright they are."""
    record["centre"], record["radius_rad"] = cap_of(
        directions(rows["ra"][group], rows["dec"][group])
    )
    speed = np.hypot(rows["pmra"][group].astype(float), rows["pmdec"][group].astype(float))
    record["max_proper_motion_mas_yr"] = np.fmax.reduce(speed, initial=0.0)
    record["max_parallax_mas"] = np.fmax.reduce(rows["parallax"][group], initial=0.0)
    g_mag = rows["phot_g_mean_mag"][group]
    record["brightest_g_mag"], record["faintest_g_mag"] = g_mag.min(), g_mag.max()


def _crc32c(file: BinaryIO, start: int, size: int) -> int:
    """Checksum of a range of an open file, a chunk at a time."""
    file.seek(start)
    crc = 0
    while size:
        data = file.read(min(size, CHUNK_BYTES))
        crc, size = google_crc32c.extend(crc, data), size - len(data)
    return crc
