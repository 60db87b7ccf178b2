"""Parquet files, a batch of rows at a time."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pyarrow as pa

from ..errors import Damaged
from .kinds import Choose

ROWS = 32_000
READING = {"pre_buffer": False, "buffer_size": 1 << 20, "page_checksum_verification": True}


def read_parquet(path: Path, choose: Choose) -> Iterator[pa.Table]:
    """Tables of the chosen columns, of at most ROWS rows; Damaged where the file is broken."""
    import pyarrow.parquet as pq

    try:
        with pq.ParquetFile(path, **READING) as file:
            chosen = list(choose(file.schema_arrow.names))
            for batch in file.iter_batches(ROWS, columns=chosen, use_threads=False):
                yield pa.Table.from_batches([batch])
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError, OSError) as error:
        raise Damaged(str(path), f"cannot be read as Parquet ({str(error)[:200]})") from None
