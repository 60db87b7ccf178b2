"""A calibrated copy of a product: less bias and dark, divided by the flat, bad pixels masked."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from catalog_tools.documents import JsonObject
from catalog_tools.storage.durable import MAKE_ROOM, full_disk_told
from pipeline.arrays import SensorMaps
from pipeline.errors import BadInput, check_new
from pipeline.execute.detector import tile_chain
from pipeline.export.files import layers_of
from pipeline.export.picture import frame_picture, png_bytes
from pipeline.inputs.sensor.sensor import gather_sensor_maps
from pipeline.physics.noise.chain import calibrated_e
from pipeline.plan.tiles import cut_up
from pipeline.plan.timing import frame_count, integration_s
from pipeline.spec.load import parse_scene, parse_yaml
from pipeline.spec.scene import Scene
from pipeline.store import layout
from pipeline.store.cube import (
    CubeWriter,
    finish_cube,
    open_layer,
    open_raw_cube,
    read_layer,
)
from pipeline.store.product import (
    begin_copy,
    check_same_images,
    content_digest,
    tiles_of,
    with_images_of,
)
from pipeline.store.seal import check_sealed, seal

if TYPE_CHECKING:
    import xarray as xr

LAYER = "calibrated_e"


def calibrate(product: Path, output: Path, images: Path | None = None) -> JsonObject:
    """Write a calibrated copy of a complete product; returns its report.

    The copy is a product of its own, with the one layer `calibrated_e` [e-, float32], the
    coordinates, truth and scene of the first. The sensor's images are read again from the files
    that the scene names, and generated patterns drawn again from its seed. Raises BadInput for a
    path that exists or a file that is gone or has changed, Incomplete and Damaged for the product.

    images : folder that has those of the files which are gone from their places, by any names
    """
    cube = open_raw_cube(product)
    check_sealed(product)  # the copy would take over, and seal as whole, what is not as written
    check_new(output)
    if output.resolve().is_relative_to(product.resolve()):
        raise BadInput("-o", str(output), "a path outside of the product")
    scene = parse_scene(parse_yaml(str(cube.attrs["scene"]), f"{product}: scene"))
    found = with_images_of(product, scene.as_dict(), images)
    check_same_images(product, found)
    maps = gather_sensor_maps(parse_scene(found))
    partial = output.with_name(f"{output.name}.partial")
    try:
        partial.mkdir(parents=True)  # by one of two that run: what is begun is removed by who began
    except FileExistsError:
        allowed = "no such path: it is left of a calibration cut off"
        raise BadInput("-o", str(partial), allowed) from None
    except OSError:
        pass  # what makes its folders says what is wrong
    try:
        with full_disk_told(output, MAKE_ROOM):
            report = _write(product, partial, cube, scene, maps)
        partial.rename(output)
    except BaseException:
        shutil.rmtree(partial, ignore_errors=True)
        raise
    return report


def _write(
    product: Path, output: Path, cube: xr.Dataset, scene: Scene, maps: SensorMaps
) -> JsonObject:
    writer = begin_copy(output, product, (LAYER,), scene)
    masked = [
        _write_frame(product, writer, scene, maps, frame) for frame in range(frame_count(scene))
    ]
    layers = set(layers_of(cube))
    coordinates = {
        name: _stored(product, name) for name in sorted(set(map(str, cube.variables)) - layers)
    }
    finish_cube(output, coordinates, dict(cube.attrs) | {"calibrated": True})
    picture = frame_picture(output, 0, mark=bool(scene.targets), layer=LAYER)
    layout.write_atomically(output / layout.PREVIEW, png_bytes(picture))
    report = layout.read_json(product / layout.REPORT) | {
        "content_digest": content_digest(output),
        "calibrated_from": str(product),
        "masked_pixels": int(max(masked, default=0)),
    }
    layout.write_atomically(output / layout.REPORT, layout.to_json(report))
    seal(output, report["content_digest"])
    return report


def _write_frame(
    product: Path, writer: CubeWriter, scene: Scene, maps: SensorMaps, frame: int
) -> int:
    """Calibrate one frame, tile by tile; returns how many pixels are masked."""
    dn, masked = read_layer(product, "dn", frame), 0
    for tile in cut_up(scene.sensor.shape, tiles_of(product)):
        part = dn[tile.y0 : tile.y0 + tile.rows, tile.x0 : tile.x0 + tile.columns]
        chain = tile_chain(scene, maps, tile, integration_s(scene, frame))
        values = calibrated_e(part, chain).astype(np.float32)
        masked += int(np.isnan(values).sum())
        writer.write(frame, tile, {LAYER: values})
    return masked


def _stored(product: Path, name: str) -> tuple[tuple[str, ...], np.ndarray, JsonObject]:
    """A coordinate as it is stored: dimensions, numbers (times not decoded), attributes."""
    array = open_layer(product, name)
    dimensions = tuple(str(d) for d in getattr(array.metadata, "dimension_names", None) or ())
    return dimensions, np.asarray(array[...]), dict(array.attrs)
