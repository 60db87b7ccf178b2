"""Images of the focal plane, from FITS, NPY and Zarr."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pipeline.arrays import Array
from pipeline.errors import BadInput
from pipeline.inputs.npy import read_npy
from pipeline.lazily import fits, open_fits

FITS_ENDINGS = (".fits", ".fits.gz", ".fit")


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
            image = read_npy(path)
        except (ValueError, OSError) as error:
            raise BadInput(field, str(path), f"a readable .npy image; {error}") from None
    elif path.name.endswith(FITS_ENDINGS):
        image = _read_fits(path, field)
    else:
        raise BadInput(field, str(path), "an image of kind .npy, .fits, .fits.gz or .zarr")
    if image is None or np.ndim(image) != 2 or np.asarray(image).dtype.kind not in "fiu":
        raise BadInput(field, str(path), "a two-dimensional image of numbers")
    return np.ascontiguousarray(image, dtype=np.float64)


def declared_unit(given: str) -> str:
    """The unit that a FITS file declares for its image; empty where there is none."""
    if not Path(given).name.endswith(FITS_ENDINGS):
        return ""
    with fits().open(given) as hdus:
        units = (h.header.get("BUNIT") for h in hdus if h.header.get("NAXIS"))  # none is decoded
        return str(next(units, None) or "").strip()


def _read_fits(path: Path, field: str) -> np.ndarray | None:
    try:
        with open_fits(path) as hdus:
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
