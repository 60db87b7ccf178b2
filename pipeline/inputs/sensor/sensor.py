"""The detector's terms as the scene gives them: numbers, or images from FITS, NPY and Zarr."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pipeline.arrays import Array, SensorMaps, Value
from pipeline.errors import BadInput
from pipeline.spec.scene import Scene
from pipeline.spec.sensor.sensor import NumberOrImage

LIMITS = {  # least and largest value of a pixel, both allowed; a flat's dead pixels are 0
    "flat": (0.0, 1e3),
    "dark_e_per_s": (0.0, 1e12),
    "read_noise_e": (0.0, 1e9),
    "gain_e_per_dn": (1e-9, 1e6),
    "bias_dn": (-1e19, 2e19),
}


def gather_sensor_maps(scene: Scene) -> SensorMaps:
    """Read the images that the sensor names and check shape, finiteness and range."""
    values = {name: _gather(scene, name) for name in LIMITS}
    maps = SensorMaps(
        values["flat"],
        values["dark_e_per_s"],
        values["read_noise_e"],
        values["gain_e_per_dn"],
        values["bias_dn"],
    )
    if scene.sensor.detector is None:
        return maps
    from pipeline.inputs.sensor.detector import with_detector

    return with_detector(maps, scene)


def _gather(scene: Scene, name: str) -> Value:
    given: NumberOrImage = getattr(scene.sensor, name)
    if not isinstance(given, str):
        return float(given)
    field = f"sensor.{name}"
    image = gather_image(given, field, scene.sensor.shape)
    least, most = LIMITS[name]
    if name == "dark_e_per_s":
        image = image * scene.sensor.dark_scale
    for value in (float(image.min()), float(image.max())):
        if not least <= value <= most:
            found = f"{given} with a pixel of {value:g}"
            raise BadInput(field, found, f"pixels from {least:g} to {most:g}")
    if name == "flat" and not image.any():
        raise BadInput(field, f"{given} of zeros", "an image with a pixel above 0")
    return image


def gather_image(given: str, field: str, shape: tuple[int, int]) -> Array:
    """An image file of the focal plane. BadInput for another shape and for NaN or infinity."""
    image = read_image(Path(given), field)
    if image.shape != shape:
        raise BadInput(field, f"{given} of shape {image.shape}", f"an image of shape {shape}")
    if not np.isfinite(image).all():
        count = int(np.size(image) - np.isfinite(image).sum())
        raise BadInput(field, f"{given} with {count} NaN or infinite pixels", "finite pixels only")
    return image


def read_image(path: Path, field: str) -> Array:
    """A 2-D image of a .npy or FITS file or a Zarr array as float64. BadInput where it is none."""
    image: np.ndarray | None
    if path.suffix == ".zarr" and path.is_dir():
        image = _read_zarr(path, field)
    elif not path.is_file():
        raise BadInput(field, str(path), "a number, or an existing .npy, .fits or .zarr image")
    elif path.suffix == ".npy":
        try:
            image = np.load(path, allow_pickle=False)
        except (ValueError, OSError, EOFError) as error:
            raise BadInput(field, str(path), f"a readable .npy image; {error}") from None
    elif path.name.endswith((".fits", ".fits.gz", ".fit")):
        image = _read_fits(path, field)
    else:
        raise BadInput(field, str(path), "an image of kind .npy, .fits, .fits.gz or .zarr")
    if image is None or np.ndim(image) != 2 or np.asarray(image).dtype.kind not in "fiu":
        raise BadInput(field, str(path), "a two-dimensional image of numbers")
    return np.ascontiguousarray(image, dtype=np.float64)


def _read_fits(path: Path, field: str) -> np.ndarray | None:
    from astropy.io import fits

    try:
        with fits.open(path) as hdus:
            return next((h.data for h in hdus if getattr(h, "data", None) is not None), None)
    except (OSError, ValueError, TypeError) as error:
        raise BadInput(field, str(path), f"a readable FITS image; {error}") from None


def _read_zarr(path: Path, field: str) -> np.ndarray:
    import zarr

    try:
        return np.asarray(zarr.open_array(path, mode="r")[...])
    except (OSError, ValueError, TypeError, KeyError, RuntimeError) as error:
        allowed = f"a readable Zarr array; {type(error).__name__}"
        raise BadInput(field, str(path), allowed) from None
