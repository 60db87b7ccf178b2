"""Columns of row groups in one read: the same as Parquet's own reader gives, footer included."""

from __future__ import annotations

from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from catalog_tools.columns import ENCODINGS, STORED
from catalog_tools.errors import Damaged
from catalog_tools.query.parquet_footer import footer
from catalog_tools.query.reading import read_row_groups
from catalog_tools.verify.verify import verify


@settings(deadline=None, max_examples=40)
@given(data=st.data())
def test_same_rows_as_parquets_own_reader(catalogue, data):
    """Any row groups of any leaves, in any order, and any columns."""
    chosen = data.draw(st.lists(st.sampled_from(catalogue.leaves), min_size=1, max_size=4))
    names = data.draw(st.lists(st.sampled_from(STORED.names), min_size=1, unique=True))
    leaves, expected = [], []
    for leaf in chosen:
        groups = data.draw(st.lists(st.sampled_from(leaf.row_groups), min_size=1, unique=True))
        leaves.append(leaf._replace(row_groups=tuple(groups)))
        file = pq.ParquetFile(Path(catalogue.path) / leaf.path)
        expected += [file.read_row_group(g.row_group).select(names) for g in groups]
    found = read_row_groups(catalogue.store, leaves, names, threads=data.draw(st.booleans()))
    assert found.equals(pa.concat_tables(expected))
    assert all(column.num_chunks == 1 for column in found.columns)


def test_columns_lie_where_the_manifest_says(catalogue):
    for leaf in catalogue.leaves[:5]:
        metadata = pq.read_metadata(Path(catalogue.path) / leaf.path)
        for group in leaf.row_groups:
            described = metadata.row_group(group.row_group)
            chunks = [described.column(i) for i in range(described.num_columns)]
            starts = group.offset + np.cumsum([0, *group.column_bytes])
            assert [c.data_page_offset for c in chunks] == starts[:-1].tolist()
            assert tuple(c.total_compressed_size for c in chunks) == group.column_bytes
            assert starts[-1] == group.offset + group.bytes


def test_only_the_columns_read_are_proved(catalogue, tmp_path):
    """A changed column stops who asks for it, by name of the shard; not who asks for another."""
    leaf = max(catalogue.leaves, key=lambda leaf: leaf.rows)
    good = (Path(catalogue.path) / leaf.path).read_bytes()

    class Changed:
        root = "there"

        def fill(self, name, parts):
            for offset, part in parts:
                part[: len(data[offset:][: part.size])] = np.frombuffer(data, np.uint8)[
                    offset : offset + part.size
                ]
            return [min(part.size, len(data) - offset) for offset, part in parts]

    for i, name in enumerate(STORED.names):
        data = bytearray(good)
        group = leaf.row_groups[-1]
        data[group.offset + sum(group.column_bytes[: i + 1]) - 1] ^= 16
        others = [other for other in STORED.names if other != name]
        assert read_row_groups(Changed(), [leaf], others).num_rows == leaf.rows
        with pytest.raises(Damaged, match=f"row group {group.row_group} does not match") as caught:
            read_row_groups(Changed(), [leaf], [name])
        assert leaf.path in str(caught.value)


def test_too_little_memory_is_no_damage(catalogue, monkeypatch):
    """Of bytes that are proved nothing else is said than what there is."""
    full = Mock(side_effect=pa.ArrowMemoryError("malloc of size 64 failed"))
    monkeypatch.setattr("catalog_tools.query.reading.pq.ParquetFile", full)
    monkeypatch.setattr("catalog_tools.verify.shards.pq.ParquetFile", full)
    with pytest.raises(MemoryError):
        read_row_groups(catalogue.store, catalogue.leaves[:1], STORED.names)
    with pytest.raises(MemoryError):
        verify(catalogue)


@pytest.mark.parametrize("rows", [0, 1, 63, 64, 8191, 8192, 1 << 31, 1 << 40])
def test_footer_is_what_parquet_reads(rows):
    """Numbers of every length in the compact protocol, and lists below and above 15 items."""
    fields = [STORED.field(i) for i in range(len(STORED))]
    for some in (fields[:1], fields, [f.with_name(f"{f.name}") for f in fields[1:]]):
        starts = [(rows + 5) * i for i in range(len(some) + 1)]
        tail = footer(some, rows, starts)
        metadata = pq.read_metadata(pa.BufferReader(b"PAR1" + tail))
        assert (metadata.num_rows, metadata.num_row_groups) == (rows, 1)
        assert metadata.schema.to_arrow_schema().equals(pa.schema(some))
        group = metadata.row_group(0)
        assert group.num_rows == rows
        assert group.total_byte_size == starts[-1]
        for i, field in enumerate(some):
            chunk = group.column(i)
            assert chunk.path_in_schema == field.name
            assert chunk.compression == "ZSTD"
            assert chunk.data_page_offset == starts[i]
            assert chunk.num_values == rows
            assert chunk.total_compressed_size == rows + 5
            assert ENCODINGS[field.name] in chunk.encodings
