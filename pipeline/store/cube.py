"""The Zarr cube: metadata made once, whole chunks written by tile tasks, opened when complete."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import google_crc32c
import numpy as np
import zarr
from numcodecs import blosc
from numcodecs.zstd import Zstd
from zarr.abc.codec import BytesBytesCodec
from zarr.codecs import BloscCodec, Crc32cCodec, ZstdCodec
from zarr.errors import ZarrUserWarning
from zarr.storage import LocalStore

from catalog_tools.documents import Arguments, JsonObject
from pipeline.errors import BadInput, Damaged
from pipeline.physics.noise.converter import dn_type
from pipeline.plan.plan import Plan
from pipeline.plan.tiles import Tile, tile_shape
from pipeline.plan.timing import frame_count
from pipeline.spec.scene import Scene
from pipeline.store.layout import CUBE, LONG_NAMES, sync_folder, write_atomically
from pipeline.store.markers import Marker, cell_checksums, write_marker
from pipeline.store.seal import check_complete
from pipeline.store.truth import write_part
from pipeline.store.whole_chunks import WholeChunks, open_whole

if TYPE_CHECKING:
    import pyarrow as pa
    import xarray as xr
    import zarr

BLOSC: JsonObject = {"cname": "zstd", "clevel": 1, "shuffle": "bitshuffle"}
ZSTD_LEVEL = 1


@dataclass(frozen=True)
class CubeWriter:
    """What a tile task needs to store its layers: small, and sent with every task.

    chunk : rows and columns of a chunk, as of the largest tile; compression : how chunks are stored
    """

    product: str
    layers: tuple[str, ...]
    chunk: tuple[int, int] = (0, 0)
    compression: str = "none"

    def write(
        self,
        frame: int,
        tile: Tile,
        values: dict[str, np.ndarray],
        checks: list[JsonObject] | None = None,
        coordinates: JsonObject | None = None,
    ) -> Marker:
        """Store one tile of one frame as whole chunks, then its marker. Idempotent.

        coordinates : of the frame, with its first tile
        """
        chunks: dict[str, tuple[str, int, int]] = {}
        cells = {}
        for name in self.layers:
            relative = f"{name}/c/{frame}/{tile.row}/{tile.column}"
            content = chunk_content(values[name], self.chunk, self.compression)
            self.write_chunk(relative, content)
            chunks[name] = (relative, len(content), google_crc32c.value(content))
            cells[name] = cell_checksums(tile, values[name])
        marker = Marker(frame, tile.row, tile.column, chunks, cells, checks or [], coordinates)
        self.write_marker(marker)
        return marker

    def write_chunk(self, relative: str, content: bytes) -> None:
        """Store the chunk `relative` of the cube, whole and durable."""
        path = Path(self.product) / CUBE / relative
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, content)

    def write_marker(self, marker: Marker) -> None:
        """Store a marker whole or not at all."""
        write_marker(Path(self.product), marker)

    def write_truth(self, kind: str, frame: int, table: pa.Table) -> None:
        """Store the truth of one frame."""
        write_part(Path(self.product), kind, frame, table)


def layers_of(plan: Plan) -> tuple[str, ...]:
    """The layers of a cube: `dn` first, then what the scene asks for."""
    return ("dn", *(n for n in plan.scene.output.layers if n != "dn"))


def create_arrays(product: Path, plan: Plan) -> None:
    """Make the metadata of all layers. The group itself comes last, in `finish_cube`.

    Until then the cube is no Zarr group, so that no reader takes it for a whole one.
    """
    for name in layers_of(plan):
        create_layer(product, name, plan.scene, tile_shape(plan.scene))


def create_layer(product: Path, name: str, scene: Scene, chunk: tuple[int, int]) -> None:
    """Make the metadata of one layer of a scene's product."""
    long_name, unit = LONG_NAMES[name]
    zarr.create_array(
        store=product / CUBE / name,
        shape=(frame_count(scene), *scene.sensor.shape),
        chunks=(1, *chunk),
        dtype=dn_type(scene.sensor.adc_bits) if name == "dn" else np.dtype("float32"),
        fill_value=0,
        dimension_names=("frame", "y", "x"),
        compressors=_codecs(scene.output.compression),
        attributes={"long_name": long_name, "units": unit},
        config={"write_empty_chunks": True},
    )


def _codecs(compression: str) -> list[BytesBytesCodec]:
    """Compression, then a checksum: without it a flipped bit may read as a wrong number."""
    codec: dict[str, list[BytesBytesCodec]] = {
        "blosc-zstd": [BloscCodec(**BLOSC)],
        "zstd": [ZstdCodec(level=ZSTD_LEVEL)],
        "none": [],
    }
    return [*codec[compression], Crc32cCodec()]


def chunk_content(values: np.ndarray, chunk: tuple[int, int], compression: str) -> bytes:
    """The chunk (1, *chunk) that Zarr would write of a tile, which may be smaller: filled up with
    zeros, compressed, with its checksum. Zarr's own way there takes 2 ms of CPU time, by way of
    an event loop and three threads; this is its stored form, which is a standard."""
    whole = np.ascontiguousarray(values, values.dtype.newbyteorder("<"))
    if values.shape != chunk:
        whole = np.zeros(chunk, whole.dtype)
        whole[: values.shape[0], : values.shape[1]] = values
    if compression == "blosc-zstd":
        codec = blosc.Blosc(BLOSC["cname"], BLOSC["clevel"], blosc.BITSHUFFLE)
        content = codec.encode(whole)
    elif compression == "zstd":
        content = Zstd(ZSTD_LEVEL).encode(whole)
    else:
        content = whole.tobytes()
    return b"".join((content, _crc(content)))


def finish_cube(
    product: Path,
    coordinates: dict[str, tuple[tuple[str, ...], np.ndarray, dict[str, str]]],
    attributes: JsonObject,
) -> None:
    """Write the coordinates, then the group's own metadata, which makes the cube readable."""
    for name, (dimensions, values, attrs) in coordinates.items():
        _write_coordinate(product / CUBE / name, name, dimensions, values, attrs)
    zarr.create_group(store=product / CUBE, attributes=attributes, overwrite=False)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ZarrUserWarning)  # consolidation is not in the v3 standard
        zarr.consolidate_metadata(product / CUBE)
    sync_folder(product / CUBE)


def _write_coordinate(
    path: Path, name: str, dimensions: tuple[str, ...], values: np.ndarray, attrs: dict[str, str]
) -> None:
    """Write one coordinate as one file.

    Whatever has a value a frame is chunked a frame at a time, as the layers are, so that xarray and
    Dask find one chunking along `frame`; its chunks lie in one shard. An axis itself is read whole.
    """
    options: Arguments = {"chunks": values.shape, "compressors": _codecs("zstd")}
    sharded = dimensions[0] == "frame" and name != "frame" and len(values) > 1
    if sharded:
        options = {
            "chunks": (1, *values.shape[1:]),
            "shards": values.shape,
            "compressors": _codecs("none"),
        }
    array = zarr.create_array(
        store=path,
        shape=values.shape,
        dtype=values.dtype,
        fill_value=None,
        dimension_names=dimensions,
        attributes=dict(attrs),
        config={"write_empty_chunks": True},
        overwrite=True,
        **options,
    )
    if sharded:
        shard = path.joinpath("c", *("0" * values.ndim))
        shard.parent.mkdir(parents=True)
        shard.write_bytes(_shard(values))
    else:
        array[...] = values


def _shard(values: np.ndarray) -> bytes:
    """The shard that Zarr would write, whose chunks are one value of the first axis each, stored
    plain with a checksum; Zarr's own codec takes 90 us for each chunk."""
    rows = np.ascontiguousarray(values.astype(values.dtype.newbyteorder("<")))
    chunks = [row.tobytes() for row in rows]
    each = len(chunks[0]) + 4
    index = np.empty((len(chunks), 2), "<u8")
    index[:, 0], index[:, 1] = np.arange(len(chunks)) * each, each
    return b"".join(c + _crc(c) for c in chunks) + index.tobytes() + _crc(index.tobytes())


def _crc(content: bytes) -> bytes:
    return google_crc32c.value(content).to_bytes(4, "little")


def open_cube(product: Path) -> xr.Dataset:
    """A complete product's cube as an xarray Dataset; reading a lost chunk raises Damaged.

    Raises as `check_complete`.
    """
    check_complete(product)
    return open_whole(LocalStore(product / CUBE, read_only=True))


def open_raw_cube(product: Path) -> xr.Dataset:
    """`open_cube` of a product that has raw frames. BadInput for one without, as of calibrated."""
    cube = open_cube(product)
    if "dn" not in cube.data_vars:
        raise BadInput("PRODUCT", str(product), "a product with raw frames (`dn`)")
    return cube


def read_layer(product: Path, name: str, frame: int) -> np.ndarray:
    """One frame of one layer; Damaged where a chunk is lost or does not match its checksum."""
    try:
        return np.asarray(open_layer(product, name)[frame])
    except FileNotFoundError as error:
        raise Damaged(f"{CUBE}/{name}", str(error)) from None
    except (ValueError, RuntimeError) as error:
        raise Damaged(f"{CUBE}/{name}", f"frame {frame}: {error}") from None


def open_layer(product: Path, name: str) -> zarr.Array:
    """A layer or coordinate of a finished cube, as stored. Its lost chunks raise Damaged."""
    store = LocalStore(product / CUBE / name, read_only=True)
    return zarr.open_array(store=WholeChunks(store), mode="r")
