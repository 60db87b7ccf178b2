"""What a scene costs at least, told from the scene alone: CPU seconds before any plan is made."""

from __future__ import annotations

import math

from pipeline.plan.tiles import tile_shape
from pipeline.plan.timing import frame_count
from pipeline.spec.scene import CELL_PX, Scene

# CPU seconds on one core of the 2-core reference machine; what was measured of the examples, and
# how far off the forecast was, is in docs/service.md.
START_S = 3.5  # a process that imports, plans, and writes the last of a product
TILE_S = 0.01  # of one tile's task: geometry, light, truth, marker
CHUNK_S = 0.003  # one chunk synced, and its cells' checksums
NOISE_S_PER_PIXEL = 35e-9  # with the packing of `dn`
LAYER_S_PER_PIXEL = 12e-9  # one more layer packed
CHECK_S = 0.3  # a cell's two windows drawn again, each at most execute/check.py's MOST_S


def least_cpu_s(scene: Scene) -> float:
    """CPU seconds that a scene takes without the light of its stars: pixels, tiles, layers.

    Its stars are counted by the plan (`predict`), which needs their catalogue.
    """
    pixels = math.prod(scene.sensor.shape)
    sides = zip(scene.sensor.shape, tile_shape(scene), strict=True)
    tiles = math.prod(-(-length // side) for length, side in sides)
    layers = len({*scene.output.layers} - {"dn"})  # beside `dn`, which is always kept
    frame_s = pixels * (NOISE_S_PER_PIXEL + layers * LAYER_S_PER_PIXEL)
    frame_s += tiles * (TILE_S + (1 + layers) * CHUNK_S)
    return START_S + frame_count(scene) * frame_s + CHECK_S * check_count(scene)


def least_noise_s(pixel_frames: int) -> float:
    """CPU seconds that so many pixels take of which nothing is kept, as those of sweeps."""
    return START_S + pixel_frames * NOISE_S_PER_PIXEL


def check_count(scene: Scene) -> int:
    """How many cells have windows drawn again: none where there are no sources."""
    if not (scene.stars or scene.targets or scene.populations):
        return 0
    cells = math.prod(-(-n // CELL_PX) for n in scene.sensor.shape)
    return min(scene.accuracy.check_cells, cells * frame_count(scene))
