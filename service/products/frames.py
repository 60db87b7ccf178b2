"""The frames of a product: how many, of which shape, tiles and layers, and which are drawn."""

from __future__ import annotations

import math
import os
import re
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

from catalog_tools.documents import JsonObject
from pipeline.store import layout
from service.problems import NotReady, NotThere

if TYPE_CHECKING:
    import zarr

MARKER = re.compile(r"f\d{6}_r\d+_c\d+\.json")


def describe(product: Path) -> JsonObject:
    """Frames, shape, tiles and layers of a product, finished or being drawn.

    Raises NotReady for one without any array yet.
    """
    array = array_of(product, "dn")
    frames, rows, columns = array.shape
    told = ("long_name", "units")
    layers = {
        name: dict(zip(told, layout.LONG_NAMES[name], strict=True))
        for name in layout.layers_in(product)
    }
    return {
        "frames": frames,
        "shape": [rows, columns],
        "tile_shape": list(array.chunks[1:]),
        "layers": layers,
        "complete": (product / layout.COMPLETE).is_file(),
    }


def frame_to_watch(product: Path, about: JsonObject) -> int:
    """The frame of an unfinished product that most can be seen of: the fullest that is not whole,
    else the last that is. Tiles are drawn in the scheduler's order, not frame by frame."""
    if about["complete"]:
        return 0
    with os.scandir(product / layout.MARKERS) as entries:
        names = [entry.name for entry in entries]
    counts = Counter(int(name[1:7]) for name in names if MARKER.fullmatch(name))
    whole = math.prod(grid_of(about))
    begun = [(count, -frame) for frame, count in counts.items() if count < whole]
    return -max(begun)[1] if begun else max(counts, default=0)


def check_frame(frame: int, frames: int) -> None:
    """NotThere for a frame that a product of so many has not."""
    if not 0 <= frame < frames:
        raise NotThere(f"the product has the frames 0 to {frames - 1}")


def grid_of(about: JsonObject) -> tuple[int, int]:
    """Rows and columns of tiles in a frame."""
    rows, columns = (-(-n // t) for n, t in zip(about["shape"], about["tile_shape"], strict=True))
    return rows, columns


def array_of(product: Path, layer: str) -> zarr.Array:
    """A layer of a product. NotReady where nothing is drawn yet."""
    import zarr

    try:
        return zarr.open_array(store=product / layout.CUBE / layer, mode="r")
    except (FileNotFoundError, KeyError):
        raise NotReady("nothing of this job is drawn yet") from None
