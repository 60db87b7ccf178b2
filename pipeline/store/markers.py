"""Markers: the durable record that a tile's chunks are whole, with their checksums."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path

import google_crc32c
import numpy as np

from catalog_tools.documents import JsonObject
from pipeline.errors import Damaged
from pipeline.plan.tiles import Tile
from pipeline.spec.scene import CELL_PX
from pipeline.store.layout import CUBE, MARKERS, write_atomically


@dataclass(frozen=True)
class Marker:
    """What was stored of one tile of one frame.

    chunks : layer -> (path inside the cube, length in bytes, crc32c)
    cells : layer -> [[row, column, crc32c of the cell's values], ...] for the content digest
    checks : what the reference path found in cells of the tile (execute/check.py)
    coordinates : of the frame, with its first tile (execute/coordinates.py)
    """

    frame: int
    row: int
    column: int
    chunks: dict[str, tuple[str, int, int]]
    cells: dict[str, list[list[int]]]
    checks: list[JsonObject] = field(default_factory=list)
    coordinates: JsonObject | None = None


def marker_path(product: Path, frame: int, row: int, column: int) -> Path:
    return product / MARKERS / f"f{frame:06d}_r{row:03d}_c{column:03d}.json"


def place_of(marker: Path) -> tuple[int, int, int]:
    """Frame, row and column of a marker, from its name; (-1, -1, -1) for another name."""
    numbers = re.fullmatch(r"f(\d+)_r(\d+)_c(\d+)\.json", marker.name)
    return (int(numbers[1]), int(numbers[2]), int(numbers[3])) if numbers else (-1, -1, -1)


def write_marker(product: Path, marker: Marker) -> None:
    """Store a marker whole or not at all."""
    path = marker_path(product, marker.frame, marker.row, marker.column)
    write_atomically(path, marker_content(marker))


def marker_content(marker: Marker) -> bytes:
    """A marker as it is stored; its own checksum is in it."""
    body = json.dumps(marker.__dict__, sort_keys=True)
    return json.dumps({"marker": body, "crc32c": google_crc32c.value(body.encode())}).encode()


def read_marker(path: Path | str, stored: bytes | None = None) -> Marker:
    """A stored marker. Raises Damaged where it is not what was written.

    stored : its bytes, where they do not lie at the path
    """
    try:
        content = json.loads(Path(path).read_bytes() if stored is None else stored)
        body = content["marker"]
        if google_crc32c.value(body.encode()) != content["crc32c"]:
            raise ValueError("checksum")
        return Marker(**json.loads(body))
    except (ValueError, KeyError, TypeError, UnicodeDecodeError, AttributeError) as error:
        raise Damaged(str(path), f"the marker is not what was written ({error})") from None


def chunk_fault(product: Path, marker: Marker) -> str | None:
    """What is wrong with a tile's chunks (path and reason), or None where they are whole."""

    def read(name: str) -> bytes | None:
        path = product / name
        return path.read_bytes() if path.is_file() else None

    return fault_of(read, marker)


def fault_of(read: Callable[[str], bytes | None], marker: Marker) -> str | None:
    """The same for chunks that `read` gives by their name in the product; None where absent."""
    for layer, (relative, length, crc) in marker.chunks.items():
        name = f"{CUBE}/{relative}"
        content = read(name)
        if content is None:
            return f"{name}: the chunk of layer {layer} is missing"
        if len(content) != length:
            return f"{name}: {len(content)} bytes instead of {length}"
        if google_crc32c.value(content) != crc:
            return f"{name}: the checksum differs"
    return None


def cell_checksums(tile: Tile, values: np.ndarray) -> list[list[int]]:
    """[cell row, cell column, crc32c] of each cell of a tile: the same for every tile shape."""
    out = []
    for y in range(0, tile.rows, CELL_PX):
        for x in range(0, tile.columns, CELL_PX):
            cell = np.ascontiguousarray(values[y : y + CELL_PX, x : x + CELL_PX])
            crc = google_crc32c.value(cell.astype(cell.dtype.newbyteorder("<")).tobytes())
            out.append([(tile.y0 + y) // CELL_PX, (tile.x0 + x) // CELL_PX, crc])
    return out


def markers_present(product: Path) -> Iterable[Path]:
    """Paths of all markers of a product, in order."""
    return sorted((product / MARKERS).glob("f*.json"))
