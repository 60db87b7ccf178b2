"""Frames of a product as files: FITS with WCS and times, PNG."""

from __future__ import annotations

from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

from PIL import Image

from pipeline.errors import BadInput, check_new
from pipeline.export.header import fits_header
from pipeline.export.picture import png_bytes, shrink, stretch
from pipeline.lazily import fits
from pipeline.store.cube import open_cube, read_layer
from pipeline.store.layout import write_atomically

if TYPE_CHECKING:
    import xarray as xr

KINDS = ("fits", "png")


def export_frames(
    product: Path, kind: str, output: Path, frame: int | None = None, layer: str = "dn"
) -> Iterator[Path]:
    """Write frames of a complete product; yields each file.

    One frame goes to `output` itself if that has the kind's suffix, else into the folder `output`
    as frame-00000.fits and so on. Existing files are refused.
    """
    if kind not in KINDS:
        raise BadInput("--to", kind, " or ".join(KINDS))
    cube = open_cube(product)
    frames = frames_of(cube, layers_of(cube), layer, frame)
    single = output.suffix == f".{kind}"
    if single and len(frames) > 1:
        raise BadInput("-o", str(output), "a folder, or --frame N for one file")
    for k in frames:
        path = output if single else output / f"frame-{k:05d}.{kind}"
        check_new(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        content = fits_bytes(product, cube, k, layer) if kind == "fits" else _png(product, k, layer)
        write_atomically(path, content)
        yield path


def layers_of(cube: xr.Dataset) -> list[str]:
    """Names of the layers of a product that hold an image for each frame."""
    return [str(n) for n, v in cube.data_vars.items() if v.dims == ("frame", "y", "x")]


def frames_of(cube: xr.Dataset, layers: list[str], layer: str, frame: int | None) -> list[int]:
    """The frames asked for, all where `frame` is None. BadInput for a layer or frame not there."""
    if layer not in layers:
        raise BadInput("--layer", layer, ", ".join(layers))
    count = cube.sizes["frame"]
    if frame is not None and not 0 <= frame < count:
        raise BadInput("--frame", frame, f"0 to {count - 1}")
    return list(range(count)) if frame is None else [frame]


def _png(product: Path, frame: int, layer: str) -> bytes:
    small, _ = shrink(read_layer(product, layer, frame), 1 << 30)
    return png_bytes(Image.fromarray(stretch(small)[::-1]))


def fits_bytes(product: Path, cube: xr.Dataset, frame: int, layer: str) -> bytes:
    """One frame of a layer as a FITS file with times, WCS and checksums."""
    header = fits().Header(fits_header(cube, frame, layer))
    hdu = fits().PrimaryHDU(read_layer(product, layer, frame), header)
    out = BytesIO()
    hdu.writeto(out, checksum=True)
    return out.getvalue()
