"""Truth tables: every source drawn, with the place, path, light and SNR that were used."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from catalog_tools.durable import whole_file
from pipeline.store.layout import PARTS, TRUTH

if TYPE_CHECKING:
    import pyarrow as pa


def part_path(product: Path, kind: str, frame: int) -> Path:
    return product / TRUTH / PARTS / f"{kind}-{frame:06d}.parquet"


def write_part(product: Path, kind: str, frame: int, table: pa.Table) -> None:
    """Store the truth of one frame, whole or not at all."""
    _write(part_path(product, kind, frame), table)


def part_content(table: pa.Table) -> bytes:
    """The truth of one frame as it is stored."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    out = pa.BufferOutputStream()
    pq.write_table(table, out, **_OPTIONS)
    return bytes(out.getvalue())


def write_whole(product: Path, kind: str, table: pa.Table) -> int:
    """Store truth that is the same in all frames as truth/KIND.parquet; returns the rows."""
    _write(product / TRUTH / f"{kind}.parquet", table)
    return int(table.num_rows)


def part_is_whole(product: Path, kind: str, frame: int) -> bool:
    """Whether the truth of a frame is stored and readable."""
    path = part_path(product, kind, frame)
    return path.is_file() and is_whole(path)


def is_whole(table: Any) -> bool:
    """Whether a Parquet file, or its bytes in a buffer, can be read to the end."""
    import pyarrow.parquet as pq
    from pyarrow import ArrowException

    try:
        pq.read_table(table, page_checksum_verification=True)
    except (ArrowException, OSError):
        return False
    return True


def join_parts(product: Path, kind: str, frames: int, empty: Any) -> int:
    """Join the frames' parts into truth/KIND.parquet, a row group a frame; returns the rows."""
    import pyarrow.parquet as pq

    target = product / TRUTH / f"{kind}.parquet"
    rows = 0
    with whole_file(target) as own, pq.ParquetWriter(own, empty.schema, **_OPTIONS) as writer:
        for frame in range(frames):
            path = part_path(product, kind, frame)
            table = pq.read_table(path, page_checksum_verification=True)
            writer.write_table(table)
            rows += table.num_rows
    return rows


def drop_parts(product: Path) -> None:
    """Remove the parts once the joined tables stand."""
    import shutil

    shutil.rmtree(product / TRUTH / PARTS, ignore_errors=True)


_OPTIONS: dict[str, Any] = {
    "compression": "zstd",
    "compression_level": 3,
    "write_page_checksum": True,
}


def _write(path: Path, table: pa.Table) -> None:
    import pyarrow.parquet as pq

    with whole_file(path) as own:
        pq.write_table(table, own, **_OPTIONS)
