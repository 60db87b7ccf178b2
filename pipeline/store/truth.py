"""Truth tables: every source drawn, with the place, path, light and SNR that were used."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from contextlib import ExitStack
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
    content = out.getvalue()
    return b"".join((content, _checksum(content)))


def write_whole(product: Path, kind: str, table: pa.Table) -> int:
    """Store truth that is the same in all frames as truth/KIND.parquet; returns the rows."""
    with whole_file(product / TRUTH / f"{kind}.parquet") as own:
        arrow().parquet.write_table(table, own, **_options(table.schema))
    return int(table.num_rows)


def read_truth(
    product: Path,
    kind: str,
    columns: Sequence[str] | None = None,
    filters: Sequence[tuple[str, str, object]] | None = None,
) -> pa.Table | None:
    """truth/KIND.parquet; None where the product has none. Damaged where it cannot be read.

    columns : those that are wanted, of which products of earlier versions hold fewer; None: all
    filters : as pyarrow takes them
    """
    path = (product / TRUTH / f"{kind}.parquet").absolute()  # or Arrow takes `run:1` for a URL
    if not path.is_file():
        return None
    pa = arrow()
    try:
        wanted = None
        if columns is not None:
            known = pa.parquet.read_schema(path).names
            wanted = [name for name in columns if name in known]
        return pa.parquet.read_table(
            path, columns=wanted, filters=filters and list(filters), page_checksum_verification=True
        )
    except MemoryError:
        raise  # of Arrow, too: no damage
    except (OSError, pa.ArrowException) as error:
        raise Damaged(str(path), " ".join(str(error).split())) from None


def part_is_whole(product: Path, kind: str, frame: int) -> bool:
    """Whether the truth of a frame is stored as it was written."""
    path = part_path(product, kind, frame)
    return path.is_file() and is_whole(path.read_bytes())


def is_whole(content: bytes) -> bool:
    """Whether a stored part is what was written."""
    return len(content) > CHECKSUM and content[-CHECKSUM:] == _checksum(content[:-CHECKSUM])


def _checksum(content: bytes | pa.Buffer) -> bytes:
    return google_crc32c.value(content).to_bytes(CHECKSUM, "little")


class TruthTable:
    """truth/KIND.parquet, joined frame by frame as the parts of the frames come.

    Frames share a row group as long as it has no more than ROWS. The file takes its name when
    `files` is closed; where that ends with an error, nothing stays of it.
    """

    def __init__(
        self, product: Path, kind: str, frames: int, empty: pa.Table, files: ExitStack
    ) -> None:
        """empty : a table without rows, for the schema"""
        self.rows = 0
        self._parts = (part_path(product, kind, frame) for frame in range(frames))
        self._next = next(self._parts, None)
        self._held, self._group = 0, [empty]
        target = product / TRUTH / f"{kind}.parquet"
        for left in target.parent.glob(f".{target.name}.*.tmp"):  # of a writer that was killed
            left.unlink(missing_ok=True)
        own, schema = files.enter_context(whole_file(target)), empty.schema
        self._writer = files.enter_context(
            arrow().parquet.ParquetWriter(own, schema, **_options(schema))
        )

    def take(self, hear: Callable[[pa.Table], None]) -> None:
        """Take the parts of the next frames, as far as they are there.

        hear : is given each row group that is written
        """
        while self._next is not None and self._next.is_file():
            content = self._next.read_bytes()
            if not is_whole(content):
                return
            table = arrow().ipc.open_stream(content).read_all()
            if self._held and self._held + table.num_rows > ROWS:
                hear(self._written())
            self._group.append(table)
            if len(self._group) == TOGETHER:  # many small tables take far more than their rows
                self._group = [arrow().concat_tables(self._group).combine_chunks()]
            self._held += table.num_rows
            self._next = next(self._parts, None)

    def end(self, hear: Callable[[pa.Table], None]) -> None:
        """Take what is left. Raises Damaged where a part is lacking or is not what was written."""
        self.take(hear)
        if self._next is not None:
            raise Damaged(str(self._next), "not what was written")
        hear(self._written())

    def _written(self) -> pa.Table:
        group = arrow().concat_tables(self._group).combine_chunks()
        self._writer.write_table(group)
        self.rows += group.num_rows
        self._held, self._group = 0, []
        return group


def drop_parts(product: Path) -> None:
    """Remove the parts once the joined tables stand."""
    shutil.rmtree(product / TRUTH / PARTS, ignore_errors=True)


def _options(schema: pa.Schema) -> JsonObject:
    """Dictionaries for names alone: hardly two stars agree in a number, and looking for it would
    cost four times more."""
    names = [field.name for field in schema if str(field.type).startswith("dictionary")]
    return {"compression": "snappy", "use_dictionary": names, "write_page_checksum": True}
