"""The footer of a Parquet file of one row group, whose columns' chunks lie in a buffer.

Written in Thrift's compact protocol after Parquet's own `parquet.thrift` (FileMetaData); the
numbers below are that file's. A writer proper would need the rows; here they are packed already.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pyarrow as pa

MAGIC = b"PAR1"
I32, I64, BINARY, LIST, STRUCT = 5, 6, 8, 9, 12  # of the compact protocol
TYPES = {"int64": 2, "float": 4, "double": 5}
ENCODING_NUMBERS = {"DELTA_BINARY_PACKED": 5, "BYTE_STREAM_SPLIT": 9}
RLE, ZSTD, FORMAT_VERSION = 3, 6, 2


def footer(fields: Sequence[pa.Field], rows: int, starts: Sequence[int]) -> bytes:
    """The footer with its length and the magic, to be put after the chunks.

    fields : some of `columns.STORED`; starts : where the chunk of each begins, and the last ends.
    """
    chunks = []
    for field, start, end in zip(fields, starts, starts[1:], strict=False):
        size = _integer(end - start)
        metadata = _column(field) + b"".join(
            [b"\x16", _integer(rows), b"\x16", size, b"\x16", size, b"\x26", _integer(start), b"\0"]
        )  # fields 5, 6, 7 and 9: values, bytes unpacked (not used), bytes, place
        chunks.append(_struct((2, I64, _integer(0)), (3, STRUCT, metadata)))
    total = _integer(starts[-1] - starts[0])
    group = _struct((1, LIST, _list(STRUCT, chunks)), (2, I64, total), (3, I64, _integer(rows)))
    content = _struct(
        (1, I32, _integer(FORMAT_VERSION)),
        (2, LIST, _schema(tuple(fields))),
        (3, I64, _integer(rows)),
        (4, LIST, _list(STRUCT, [group])),
    )
    return content + len(content).to_bytes(4, "little") + MAGIC


@lru_cache(maxsize=256)
def _schema(fields: tuple[pa.Field, ...]) -> bytes:
    """The root and the columns: type, optional or not, name."""
    elements = [_struct((4, BINARY, _text("schema")), (5, I32, _integer(len(fields))))]
    for field in fields:
        kind, optional = _integer(TYPES[str(field.type)]), _integer(int(field.nullable))
        elements.append(_struct((1, I32, kind), (3, I32, optional), (4, BINARY, _text(field.name))))
    return _list(STRUCT, elements)


@lru_cache(maxsize=256)
def _column(field: pa.Field) -> bytes:
    """The first four fields of a column's metadata: type, encodings, path and codec."""
    from ..columns import ENCODINGS

    encodings = [_integer(RLE), _integer(ENCODING_NUMBERS[ENCODINGS[field.name]])]
    return _struct(
        (1, I32, _integer(TYPES[str(field.type)])),
        (2, LIST, _list(I32, encodings)),
        (3, LIST, _list(BINARY, [_text(field.name)])),
        (4, I32, _integer(ZSTD)),
    )[:-1]


def _struct(*fields: tuple[int, int, bytes]) -> bytes:
    """Fields as (number, type, content), ascending, and the end."""
    numbers = [0, *(number for number, _, _ in fields)]
    heads = [
        bytes([(n - before) << 4 | kind])
        for before, (n, kind, _) in zip(numbers, fields, strict=False)
    ]
    return b"".join(h + content for h, (_, _, content) in zip(heads, fields, strict=True)) + b"\0"


def _list(kind: int, items: Sequence[bytes]) -> bytes:
    count = len(items)
    head = bytes([count << 4 | kind]) if count < 15 else bytes([0xF0 | kind]) + _varint(count)
    return head + b"".join(items)


def _text(text: str) -> bytes:
    return _varint(len(text.encode())) + text.encode()


def _integer(value: int) -> bytes:
    """A number from 0 up, in zigzag form."""
    return _varint(value << 1)


def _varint(value: int) -> bytes:
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)
