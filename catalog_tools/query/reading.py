"""Read columns of row groups of shards: every byte is proved before Arrow parses it.

Only the chunks of the columns asked for are fetched, into one buffer in which each column's chunks
follow each other. The length of every file and the crc32c of every chunk are compared with the
manifest; then Arrow decodes the buffer, which with a footer of its own is a Parquet file of one
row group. The crc32c covers all pages, so Parquet's page checksums, which other readers use, are
looked at by `verify` alone, as are the shards' footers.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain, product
from typing import TYPE_CHECKING

import google_crc32c
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from ..catalogue import Leaf
from ..columns import STORED
from ..errors import Damaged, Incomplete
from ..storage.stores import Bytes, Part, Store, Unreachable
from .parquet_footer import MAGIC, footer

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.parquet as pq

END_BYTES = 8  # of a Parquet file: the footer's length, and the magic


def read_row_groups(
    store: Store, leaves: Sequence[Leaf], names: Sequence[str], *, threads: bool = True
) -> pa.Table:
    """Columns of all `row_groups` of some leaves, in that order, in one chunk.

    threads : decoded on all cores. Raises Damaged naming the shard that is missing, of another
    length, or changed in a byte that was read; Incomplete where a remote store gives no answer.
    """
    columns = list(map(STORED.names.index, names))
    groups = [group for leaf in leaves for group in leaf.row_groups]
    rows = sum(group.rows for group in groups)
    held = np.array([group.column_bytes for group in groups], np.int64)
    before = np.cumsum(held, axis=1) - held + np.array([[group.offset] for group in groups])
    sizes = held[:, columns].T
    ends = np.cumsum(sizes).reshape(sizes.shape)
    tail = footer(list(map(STORED.field, names)), rows, [0, *ends[:, -1].tolist()])
    data = np.empty(int(ends[-1, -1]) + len(tail), np.uint8)
    data[data.size - len(tail) :] = np.frombuffer(tail, np.uint8)
    places = np.stack([before[:, columns], (ends - sizes).T, ends.T], axis=-1).tolist()
    first = 0
    for leaf in leaves:
        last = first + len(leaf.row_groups)
        _fetch(store, leaf, columns, places[first:last], data)
        first = last
    try:
        file = pq.ParquetFile(pa.BufferReader(pa.py_buffer(data)), pre_buffer=False)
        table = file.read(use_threads=threads)
    except MemoryError:
        raise  # of Arrow, too: no damage
    except (pa.ArrowException, OSError) as error:
        raise Damaged(_where(store, leaves), f"cannot be read ({error})") from None
    if table.num_rows != rows:
        raise Damaged(_where(store, leaves), "has another number of rows than the manifest says")
    return table


def _fetch(
    store: Store, leaf: Leaf, columns: Sequence[int], places: list[list[list[int]]], data: Bytes
) -> None:
    """Fetch and prove chunks of one shard.

    places : for each of its row groups and each column, where the chunk begins in the file, and
    its start and end in `data`.
    """
    where = f"{store.root}/{leaf.path}"
    # One byte more than there should be proves the length without another request.
    tail = np.empty(END_BYTES + 1, np.uint8)
    chunks = chain.from_iterable(places)
    parts: list[Part] = [(offset, data[start:end]) for offset, start, end in chunks]
    try:
        found = store.fill(leaf.path, [*parts, (leaf.bytes - END_BYTES, tail)])
        if found[-1] != END_BYTES:
            size = store.size(leaf.path)
            reason = f"is {size} bytes long; the manifest says {leaf.bytes}"
            raise Damaged(where, reason if size != leaf.bytes else "cannot be read whole")
    except FileNotFoundError:
        raise Damaged(where, "the shard is missing") from None
    except Unreachable as error:
        raise Incomplete(f"{where}: could not be read ({error}); try again") from None
    except OSError as error:
        raise Damaged(where, f"cannot be read ({error})") from None
    checks = product(leaf.row_groups, columns)
    for (group, column), (_, part) in zip(checks, parts, strict=True):
        if google_crc32c.value(part) != group.column_crc32c[column]:
            raise Damaged(where, f"row group {group.row_group} does not match its checksum")
    if tail[:-1].tobytes() != (leaf.footer_bytes - END_BYTES).to_bytes(4, "little") + MAGIC:
        raise Damaged(where, "its last bytes are not those that the manifest says")


def parse_footer(where: str, leaf: Leaf, footer: Bytes) -> pq.FileMetaData:
    """The metadata in a shard's last bytes; Damaged where it isn't what the manifest says."""
    try:  # a footer alone is a file without row groups' bytes
        metadata = pq.read_metadata(pa.BufferReader(pa.py_buffer(MAGIC + footer.tobytes())))
    except (pa.ArrowException, OSError) as error:
        raise Damaged(where, f"its footer cannot be read ({error})") from None
    if metadata.num_row_groups != leaf.row_group_count or metadata.num_rows != leaf.rows:
        raise Damaged(where, "its row groups are not those of the manifest")
    return metadata


def _where(store: Store, leaves: Sequence[Leaf]) -> str:
    return ", ".join(dict.fromkeys(f"{store.root}/{leaf.path}" for leaf in leaves))
