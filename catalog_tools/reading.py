"""Read row groups of shards: every byte is proved against the manifest before Arrow parses it.

A shard's footer and the row groups wanted are fetched in few requests; the file's length and the
crc32c of each part are compared with the manifest, and only then is anything decoded. The crc32c
of a row group covers all its pages, so Parquet's own page checksums, which other readers use, are
looked at by `verify` alone.
"""

from __future__ import annotations

import io
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NoReturn

import numpy as np

from .catalogue import Leaf, RowGroup
from .errors import Damaged, Incomplete
from .stores import Bytes, Store, Unreachable

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.parquet as pq


@dataclass(frozen=True)
class Shard:
    """A shard of which the footer and `leaf.row_groups` are in memory, proved.

    held : the row groups in memory, as (offset, bytes).
    """

    where: str
    leaf: Leaf
    held: tuple[tuple[int, Bytes], ...]
    metadata: pq.FileMetaData

    def read(
        self, row_groups: Sequence[RowGroup], names: Sequence[str], *, threads: bool = True
    ) -> pa.Table:
        """Rows of some of its row groups, in the file's order; threads : decoded on all cores."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        numbers, rows = [g.row_group for g in row_groups], sum(g.rows for g in row_groups)
        try:
            source = pa.PythonFile(Held(self.leaf.bytes, self.held), mode="r")
            file = pq.ParquetFile(source, metadata=self.metadata, pre_buffer=False)
            table = file.read_row_groups(numbers, list(names), use_threads=threads)
        except (pa.ArrowException, OSError) as error:
            raise Damaged(self.where, f"cannot be read ({error})") from None
        if table.num_rows != rows:
            raise Damaged(self.where, "holds another number of rows than the manifest says")
        return table


def open_shard(store: Store, leaf: Leaf) -> Shard:
    """Fetch and prove a shard's footer and `leaf.row_groups`.

    Raises Damaged naming the shard where it is missing, of another length, or changed in a byte
    that was read; Incomplete where a remote store gives no answer.
    """
    import google_crc32c

    where = f"{store.root}/{leaf.path}"
    # One byte more than there should be proves the length without another request.
    parts = [("the footer", leaf.bytes - leaf.footer_bytes, leaf.footer_bytes + 1)]
    parts += [(f"row group {g.row_group}", g.offset, g.bytes) for g in leaf.row_groups]
    ends = np.cumsum([size for _, _, size in parts])
    data = np.split(np.empty(ends[-1], np.uint8), ends[:-1])
    offsets = [offset for _, offset, _ in parts]
    try:
        found = store.fill(leaf.path, list(zip(offsets, data, strict=True)))
        if found[0] != leaf.footer_bytes:
            _refuse_length(store, leaf, where)
    except FileNotFoundError:
        raise Damaged(where, "the shard is missing") from None
    except Unreachable as error:
        raise Incomplete(f"{where}: could not be read ({error}); try again") from None
    except OSError as error:
        raise Damaged(where, f"cannot be read ({error})") from None
    data[0] = data[0][:-1]
    expected = [leaf.footer_crc32c, *(group.crc32c for group in leaf.row_groups)]
    for (what, _, _), part, crc32c in zip(parts, data, expected, strict=True):
        if google_crc32c.value(part) != crc32c:
            raise Damaged(where, f"{what} does not match its checksum")
    held = tuple(zip(offsets[1:], data[1:], strict=True))
    return Shard(where, leaf, held, parse_footer(where, leaf, data[0]))


def parse_footer(where: str, leaf: Leaf, footer: Bytes) -> pq.FileMetaData:
    """The metadata in a shard's last bytes; Damaged where it isn't what the manifest says."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    magic = b"PAR1"  # a footer alone is a file without row groups' bytes
    try:
        metadata = pq.read_metadata(pa.BufferReader(pa.py_buffer(magic + footer.tobytes())))
    except pa.ArrowException as error:
        raise Damaged(where, f"its footer cannot be read ({error})") from None
    if metadata.num_row_groups != leaf.row_group_count or metadata.num_rows != leaf.rows:
        raise Damaged(where, "its row groups are not those of the manifest")
    return metadata


def _refuse_length(store: Store, leaf: Leaf, where: str) -> NoReturn:
    size = store.size(leaf.path)
    reason = f"is {size} bytes long; the manifest says {leaf.bytes}"
    raise Damaged(where, reason if size != leaf.bytes else "cannot be read whole")


class Held:
    """A file, for Arrow, of which only some byte ranges are in memory; other bytes are an error.

    It is asked for every column of every row group, so it does no more than it must.
    """

    closed = False

    def __init__(self, length: int, held: Sequence[tuple[int, Bytes]]) -> None:
        self._length, self._at = length, 0
        ordered = sorted(held, key=lambda part: part[0])
        self._starts = [offset for offset, _ in ordered]
        self._views = [data.data for _, data in ordered]

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def close(self) -> None:
        self.closed = True

    def tell(self) -> int:
        return self._at

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        origin = {io.SEEK_SET: 0, io.SEEK_CUR: self._at, io.SEEK_END: self._length}[whence]
        self._at = origin + offset
        return self._at

    def read(self, size: int) -> memoryview:
        i = bisect_right(self._starts, self._at) - 1
        start = self._at - self._starts[max(i, 0)]
        found = self._views[max(i, 0)][start : start + size]
        if i < 0 or len(found) != size:
            raise OSError(f"bytes {self._at} to {self._at + size} were not read")
        self._at += size
        return found
