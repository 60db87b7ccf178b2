"""Truth tables: every source drawn, with the place, path, light and SNR that were used."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import TYPE_CHECKING

import google_crc32c

from catalog_tools.documents import JsonObject
from catalog_tools.storage.durable import whole_file
from pipeline.errors import Damaged
from pipeline.lazily import arrow
from pipeline.store.layout import PARTS, TRUTH

if TYPE_CHECKING:
    import pyarrow as pa

ROWS = 1 << 16  # of a row group that several frames share
TOGETHER = 64
CHECKSUM = 4  # bytes, at the end of a part


def part_path(product: Path, kind: str, frame: int) -> Path:
    return product / TRUTH / PARTS / f"{kind}-{frame:06d}.arrow"


def write_part(product: Path, kind: str, frame: int, table: pa.Table) -> None:
    """Store the truth of one frame, whole or not at all."""
    with whole_file(part_path(product, kind, frame)) as own:
        own.write_bytes(part_content(table))


def part_content(table: pa.Table) -> bytes:
    """The truth of one frame as it is stored: an Arrow stream, then its checksum."""
    pa = arrow()
    out = pa.BufferOutputStream()
    with pa.ipc.new_stream(out, table.schema) as stream:
        stream.write_table(table)
    content = bytes(out.getvalue())
    return content + _checksum(content)


def write_whole(product: Path, kind: str, table: pa.Table) -> int:
    """Store truth that is the same in all frames as truth/KIND.parquet; returns the rows."""
    with whole_file(product / TRUTH / f"{kind}.parquet") as own:
        arrow().parquet.write_table(table, own, **_options(table.schema))
    return int(table.num_rows)


def part_is_whole(product: Path, kind: str, frame: int) -> bool:
    """Whether the truth of a frame is stored as it was written."""
    path = part_path(product, kind, frame)
    return path.is_file() and is_whole(path.read_bytes())


def is_whole(content: bytes) -> bool:
    """Whether a stored part is what was written."""
    return len(content) > CHECKSUM and content[-CHECKSUM:] == _checksum(content[:-CHECKSUM])


def _checksum(content: bytes) -> bytes:
    return google_crc32c.value(content).to_bytes(CHECKSUM, "little")


def join_parts(product: Path, kind: str, frames: int, empty: pa.Table) -> int:
    """Join the frames' parts into truth/KIND.parquet; returns the rows.

    Frames share a row group as long as it has no more than ROWS.
    """
    pa = arrow()
    target = product / TRUTH / f"{kind}.parquet"
    rows, held, group = 0, 0, [empty]
    schema = empty.schema
    with (
        whole_file(target) as own,
        pa.parquet.ParquetWriter(own, schema, **_options(schema)) as writer,
    ):
        for frame in range(frames):
            content = part_path(product, kind, frame).read_bytes()
            if not is_whole(content):
                raise Damaged(str(part_path(product, kind, frame)), "not what was written")
            table = pa.ipc.open_stream(content).read_all()
            if held + table.num_rows > ROWS and held:
                writer.write_table(pa.concat_tables(group).combine_chunks())
                held, group = 0, []
            group.append(table)
            if len(group) == TOGETHER:  # many small tables take far more than their rows
                group = [pa.concat_tables(group).combine_chunks()]
            held += table.num_rows
            rows += table.num_rows
        writer.write_table(pa.concat_tables(group).combine_chunks())
    return rows


def drop_parts(product: Path) -> None:
    """Remove the parts once the joined tables stand."""
    shutil.rmtree(product / TRUTH / PARTS, ignore_errors=True)


def _options(schema: pa.Schema) -> JsonObject:
    """Dictionaries for names alone: hardly two stars agree in a number, and looking for it would
    cost four times more."""
    names = [field.name for field in schema if str(field.type).startswith("dictionary")]
    return {"compression": "snappy", "use_dictionary": names, "write_page_checksum": True}
