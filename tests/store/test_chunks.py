"""A tile's chunk is, byte for byte, what Zarr writes of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import zarr

from pipeline.store.cube import _codecs, chunk_content


@pytest.mark.parametrize("compression", ["blosc-zstd", "zstd", "none"])
@pytest.mark.parametrize("dtype", ["uint8", "uint16", "uint32", "uint64", "float32"])
@pytest.mark.parametrize("shape", [(48, 40), (48, 7), (1, 40), (1, 1)])
def test_chunks_are_those_of_zarr(
    tmp_path: Path, compression: str, dtype: str, shape: tuple[int, int]
) -> None:
    """Of whole tiles and of those at the edges, which fill a part of their chunk."""
    values = np.random.default_rng(7).normal(100.0, 9.0, shape).astype(dtype)
    values[0] = 0
    array = zarr.create_array(
        store=tmp_path / "layer", shape=(2, 48 + shape[0], 40 + shape[1]), chunks=(1, 48, 40),
        dtype=dtype, fill_value=0, compressors=_codecs(compression),
        config={"write_empty_chunks": True},
    )  # fmt: skip
    array[1, 48:, 40:] = values
    path = tmp_path / "layer" / "c/1/1/1"
    theirs = path.read_bytes()
    ours = chunk_content(values, (48, 40), compression)
    assert ours == theirs
    path.write_bytes(ours)
    np.testing.assert_array_equal(array[1, 48:, 40:], values)


def test_big_endian_and_cut_out_values(tmp_path: Path) -> None:
    """Values need not lie in memory as they are stored."""
    values = np.arange(80 * 90, dtype=np.uint16).reshape(80, 90)
    whole = chunk_content(values[3:51, 5:45].copy(), (48, 40), "blosc-zstd")
    assert chunk_content(values[3:51, 5:45], (48, 40), "blosc-zstd") == whole
    assert chunk_content(values[3:51, 5:45].astype(">u2"), (48, 40), "blosc-zstd") == whole
