"""Parquet files, a batch of rows at a time.

A reader holds a page of each column, and its dictionary: both are small but in files that were
written with options of their own. How large they are stands in their headers, not in the footer.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import pyarrow as pa
import pyarrow.parquet as pq

from ..errors import BadInput, Damaged
from .kinds import Choose, choose_once

ROWS = 32_000
PAGE_SHARE = 2  # a page as it lies on disk, and decoded
HEADER_BYTES = 24
READING = {"pre_buffer": False, "buffer_size": 1 << 20, "page_checksum_verification": True}


def read_parquet(
    path: Path, where: str, choose: Choose, most_bytes: int | None = None
) -> Iterator[pa.Table]:
    """Tables of the chosen columns, of at most ROWS rows.

    Raises Damaged where the file is broken, and BadInput where its pages would take more than
    `most_bytes` of memory.
    """
    try:
        with pq.ParquetFile(path, **READING) as file:
            chosen = list(choose_once(choose, file.schema_arrow.names, {}, where))
            if most_bytes is not None:
                _refuse_large_pages(path, where, file.metadata, set(chosen), most_bytes)
            for batch in file.iter_batches(ROWS, columns=chosen, use_threads=False):
                yield pa.Table.from_batches([batch])
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError, OSError) as error:
        raise Damaged(str(path), f"cannot be read as Parquet ({str(error)[:200]})") from None


def _refuse_large_pages(
    path: Path, where: str, metadata: pq.FileMetaData, chosen: set[str], most_bytes: int
) -> None:
    """The first page of each chosen column, and its dictionary, stand for all of a row group."""
    most = most_bytes // PAGE_SHARE
    with path.open("rb") as file:
        for i in range(metadata.num_row_groups):
            group = metadata.row_group(i)
            columns = [group.column(c) for c in range(group.num_columns)]
            offsets = [
                offset
                for column in columns
                if column.path_in_schema.split(".")[0] in chosen
                for offset in (column.dictionary_page_offset, column.data_page_offset)
                if offset is not None
            ]
            held = sum(_page_bytes(file, offset) for offset in offsets)
            if held > most:
                allowed = f"pages of at most {most} bytes in all columns read, with this --memory"
                raise BadInput(f"{where} row group {i}", f"{held} bytes", allowed)


def _page_bytes(file: BinaryIO, offset: int) -> int:
    """Unpacked size of a page: the second field of its header (Thrift's compact protocol)."""
    file.seek(offset)
    header = iter(file.read(HEADER_BYTES))
    number = 0
    for _ in ("type", "uncompressed_page_size"):
        next(header, 0)  # which field it is
        number = shift = 0
        for byte in header:
            number |= (byte & 0x7F) << shift
            shift += 7
            if byte < 0x80:
                break
    return number >> 1  # zigzag
