"""One leaf's Parquet file: magnitude bands as row groups, written and read with checksums.

Every read is proved: the file's length, its footer's crc32c and each row group's crc32c are
compared with the manifest before Arrow parses a byte, and Arrow verifies the page checksums too,
so that other Parquet readers have them. Only the row groups asked for are read.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

import google_crc32c
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from .catalogue import Band, Leaf
from .columns import ENCODINGS, HEALPIX_COLUMN, STORED
from .errors import Damaged
from .sphere import cap_of, directions

# Faint edges of the bands; the last band is open.
BAND_EDGES_G_MAG = (8.0, 10.0, 12.0, 13.0, 14.0, 15.0, 16.0, 17.0, 18.0, 19.0, 20.0)
MIN_BAND_ROWS = 2048
ZSTD_LEVEL = 3


def shard_name(order: int, pixel: int) -> str:
    """A leaf's place in the HATS layout, relative to the catalogue."""
    folder = pixel // 10_000 * 10_000
    return f"dataset/Norder={order}/Dir={folder}/Npix={pixel}.parquet"


def band_slices(g_mag: np.ndarray) -> list[slice]:
    """Cut ascending magnitudes (n,) into bands: at the edges, each of MIN_BAND_ROWS or more.

    A band that would be too small joins the next fainter one; a small last one joins its brighter
    neighbour.
    """
    cuts = [0]
    for edge in np.searchsorted(g_mag, np.array(BAND_EDGES_G_MAG, np.float32), side="right"):
        if edge - cuts[-1] >= MIN_BAND_ROWS:
            cuts.append(int(edge))
    if g_mag.size - cuts[-1] < MIN_BAND_ROWS and len(cuts) > 1:
        cuts.pop()
    return [slice(a, b) for a, b in zip(cuts, [*cuts[1:], g_mag.size], strict=True) if b > a]


def write_shard(root: Path, order: int, pixel: int, table: pa.Table) -> Leaf:
    """Write the rows of one leaf (schema STORED, any order) below `root`; returns its record.

    Rows with equal keys (`_healpix_29`, source_id) must not occur: the bits of the file depend on
    the set of rows alone.
    """
    path = root / shard_name(order, pixel)
    path.parent.mkdir(parents=True, exist_ok=True)
    bands = _sorted_bands(table)
    with pq.ParquetWriter(
        path,
        STORED,
        compression="zstd",
        compression_level=ZSTD_LEVEL,
        use_dictionary=False,
        column_encoding=ENCODINGS,
        write_statistics=True,
        write_page_checksum=True,
        write_page_index=True,
        store_schema=False,
    ) as writer:
        for band in bands:
            writer.write_table(band, row_group_size=band.num_rows)
    return _record(path, order, pixel, pa.concat_tables(bands), [b.num_rows for b in bands])


def _sorted_bands(table: pa.Table) -> list[pa.Table]:
    by_magnitude = table.sort_by([("phot_g_mean_mag", "ascending"), ("source_id", "ascending")])
    g_mag = by_magnitude["phot_g_mean_mag"].to_numpy()
    keys = [(HEALPIX_COLUMN, "ascending"), ("source_id", "ascending")]
    slices = band_slices(g_mag)
    return [by_magnitude.slice(s.start, s.stop - s.start).sort_by(keys) for s in slices]


def _record(path: Path, order: int, pixel: int, rows: pa.Table, band_rows: list[int]) -> Leaf:
    data = path.read_bytes()
    footer_bytes = int.from_bytes(data[-8:-4], "little") + 8
    metadata = pq.read_metadata(pa.BufferReader(data))
    g_mag = rows["phot_g_mean_mag"].to_numpy()
    ends = np.cumsum(band_rows)
    bands = []
    for i, (end, count) in enumerate(zip(ends, band_rows, strict=True)):
        group = metadata.row_group(i)
        chunks = [group.column(c) for c in range(group.num_columns)]
        start = min(chunk.data_page_offset for chunk in chunks)
        size = sum(chunk.total_compressed_size for chunk in chunks)
        own = g_mag[end - count : end]
        crc = google_crc32c.value(data[start : start + size])
        bands.append(Band(i, float(own.min()), float(own.max()), count, size, start, crc))
    centre, radius_rad = cap_of(directions(rows["ra"].to_numpy(), rows["dec"].to_numpy()))
    speed = np.hypot(_filled(rows, "pmra"), _filled(rows, "pmdec"))
    return Leaf(
        order=order,
        pixel=pixel,
        rows=rows.num_rows,
        path=shard_name(order, pixel),
        bytes=len(data),
        crc32c=google_crc32c.value(data),
        centre=centre,
        radius_rad=radius_rad,
        max_proper_motion_mas_yr=float(speed.max()),
        max_parallax_mas=max(0.0, float(_filled(rows, "parallax").max())),
        footer_bytes=footer_bytes,
        footer_crc32c=google_crc32c.value(data[-footer_bytes:]),
        bands=tuple(bands),
    )


def _filled(rows: pa.Table, name: str) -> np.ndarray:
    return rows[name].fill_null(0.0).to_numpy().astype(float)


def read_row_groups(path: Path, leaf: Leaf, bands: Sequence[Band], names: list[str]) -> pa.Table:
    """Rows of some bands of a shard, in the file's order, after proving every byte read.

    Raises Damaged naming the shard: missing, of another length, or with a changed bit.
    """
    try:
        held = _proved_ranges(path, leaf, bands)
        source = pa.PythonFile(_Ranges(leaf.bytes, held), mode="r")
        file = pq.ParquetFile(source, page_checksum_verification=True, pre_buffer=False)
        if file.metadata.num_row_groups != len(leaf.bands):
            raise Damaged(str(path), "its row groups are not those of the manifest")
        table = file.read_row_groups([b.row_group for b in bands], names, use_threads=False)
    except (pa.ArrowException, OSError) as error:
        raise Damaged(str(path), f"cannot be read ({error})") from None
    if table.num_rows != sum(band.rows for band in bands):
        raise Damaged(str(path), "holds another number of rows than the manifest says")
    return table


def _proved_ranges(path: Path, leaf: Leaf, bands: Sequence[Band]) -> list[tuple[int, bytes]]:
    """The footer and the row groups as (offset, bytes), each matching its checksum."""
    if not path.is_file():
        raise Damaged(str(path), "the shard is missing")
    with path.open("rb") as file:
        length = file.seek(0, io.SEEK_END)
        if length != leaf.bytes:
            raise Damaged(str(path), f"is {length} bytes long; the manifest says {leaf.bytes}")
        held = []
        start = leaf.bytes - leaf.footer_bytes
        wanted = [("footer", start, leaf.footer_bytes, leaf.footer_crc32c)]
        wanted += [(f"row group {b.row_group}", b.offset, b.bytes, b.crc32c) for b in bands]
        for what, offset, size, crc32c in wanted:
            file.seek(offset)
            data = file.read(size)
            if len(data) != size or google_crc32c.value(data) != crc32c:
                raise Damaged(str(path), f"the {what} does not match its checksum")
            held.append((offset, data))
    return held


class _Ranges(io.RawIOBase):
    """A file of which only some byte ranges are in memory; reading any other byte is an error."""

    def __init__(self, length: int, held: list[tuple[int, bytes]]) -> None:
        self._length, self._held, self._at = length, held, 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def tell(self) -> int:
        return self._at

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        origin = {io.SEEK_SET: 0, io.SEEK_CUR: self._at, io.SEEK_END: self._length}[whence]
        self._at = origin + offset
        return self._at

    def read(self, size: int | None = -1) -> bytes:
        end = self._length if size is None or size < 0 else min(self._length, self._at + size)
        for offset, data in self._held:
            if offset <= self._at and end <= offset + len(data):
                start, self._at = self._at, end
                return data[start - offset : end - offset]
        # Arrow asks for a generous tail before it knows the footer's length: pad it with zeros.
        offset, data = self._held[0]
        if end == self._length and self._at < offset:
            padded = bytes(offset - self._at) + data
            self._at = end
            return padded
        raise OSError(f"bytes {self._at} to {end} were not read")
