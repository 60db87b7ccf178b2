"""The rows of a file of any kind, with the file's own columns and values."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pyarrow as pa

from ..forms import Layout
from .bytes_in import digest
from .kinds import Choose
from .parquet import read_parquet
from .sqlite import read_sqlite
from .text import read_text


def raw_tables(
    path: Path,
    kind: str,
    layout: Layout,
    choose: Choose,
    where: str,
    md5: object = None,
    most_bytes: int | None = None,
    doubts: list[str] | None = None,
) -> Iterator[pa.Table]:
    """Tables of the columns that `choose` picks from the file's own, with the file's own values.

    most_bytes : of memory; a file that can't be read in so much is refused. doubts : gets what the
    file says of rows that it lacks.
    """
    zipped = kind.endswith(".gz")
    plain_kind = kind.removesuffix(".gz")
    if plain_kind == "csv":
        yield from read_text(path, where, layout, choose, zipped=zipped, md5=md5)
    elif plain_kind == "fits":
        from .fits import read_fits

        yield from read_fits(path, where, layout, choose, zipped=zipped, md5=md5)
    elif plain_kind == "votable":
        from .votable import read_votable

        yield from read_votable(
            path, where, choose, zipped=zipped, md5=md5, most_bytes=most_bytes, doubts=doubts
        )
    else:
        if plain_kind == "parquet":
            yield from read_parquet(path, where, choose, most_bytes)
        else:
            yield from read_sqlite(path, where, layout, choose)
        if md5 is not None:
            digest(path, md5)
