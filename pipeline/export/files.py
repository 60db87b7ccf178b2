"""Frames of a product as files: FITS with WCS and times, PNG; tables as CSV or Parquet."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.errors import BadInput, shorten
from pipeline.export.picture import png_bytes, shrink, stretch
from pipeline.store.cube import open_cube, read_layer
from pipeline.store.layout import write_atomically

if TYPE_CHECKING:
    import pyarrow as pa
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
    layers = [str(n) for n in cube.data_vars if cube[n].dims == ("frame", "y", "x")]
    if layer not in layers:
        raise BadInput("--layer", layer, ", ".join(layers))
    count = cube.sizes["frame"]
    if frame is not None and frame >= count:
        raise BadInput("--frame", frame, f"0 to {count - 1}")
    frames = range(count) if frame is None else [frame]
    single = output.suffix == f".{kind}"
    if single and len(frames) > 1:
        raise BadInput("-o", str(output), "a folder, or --frame N for one file")
    for k in frames:
        path = output if single else output / f"frame-{k:05d}.{kind}"
        if path.exists():
            raise BadInput("-o", str(path), "a path that does not exist yet")
        path.parent.mkdir(parents=True, exist_ok=True)
        content = _fits(product, cube, k, layer) if kind == "fits" else _png(product, k, layer)
        write_atomically(path, content)
        yield path


def _png(product: Path, frame: int, layer: str) -> bytes:
    from PIL import Image

    small, _ = shrink(read_layer(product, layer, frame), 1 << 30)
    return png_bytes(Image.fromarray(stretch(small)[::-1]))


def _fits(product: Path, cube: xr.Dataset, frame: int, layer: str) -> bytes:
    from io import BytesIO

    from astropy.io import fits

    header = fits.Header(fits_header(cube, frame, layer))
    hdu = fits.PrimaryHDU(read_layer(product, layer, frame), header)
    out = BytesIO()
    hdu.writeto(out, checksum=True)
    return out.getvalue()


def fits_header(cube: xr.Dataset, frame: int, layer: str) -> list[tuple[str, Any, str]]:
    """FITS cards of a frame: provenance, times, and two WCS.

    The primary WCS is astrometric ICRS (where the catalogue's stars are drawn); the alternate
    `A` gives apparent directions, which are exactly TAN about the boresight. A product of a
    distorted camera has the primary one alone: SIP terms cannot be given twice.
    """
    one = cube.isel(frame=frame)
    stamps = {k: _iso(one[f"time_{k}"].values) for k in ("start", "mid", "end")}
    scene = str(cube.attrs["title"])
    exposed = one.get("integration_s", cube.attrs["integration_s"])  # its own, or all frames'
    cards = [
        ("OBJECT", scene[:68], "scene"),
        ("CREATOR", str(cube.attrs["source"]), "software"),
        ("BUNIT", "adu" if layer == "dn" else "electron", cube[layer].attrs["long_name"]),
        ("FRAME", frame, "frame number, from 0"),
        ("TIMESYS", "UTC", "time scale"),
        ("DATE-OBS", stamps["start"], "start of the exposure"),
        ("DATE-AVG", stamps["mid"], "middle of the exposure (WCS, truth)"),
        ("DATE-END", stamps["end"], "end of the exposure"),
        ("MJD-OBS", _mjd(one["time_start"].values), "[d] start of the exposure, UTC"),
        ("MJD-AVG", _mjd(one["time_mid"].values), "[d] middle of the exposure, UTC"),
        ("MJD-END", _mjd(one["time_end"].values), "[d] end of the exposure, UTC"),
        ("EXPTIME", float(exposed), "[s] integration time"),
        ("SYNTHSTR", bool(cube.attrs["synthetic_stars"]), "stars are synthetic, none is real"),
    ]
    apparent = [] if cube.attrs.get("distorted") else _apparent_cards(one)
    return cards + _astrometric_cards(one) + apparent


def _iso(stamp: Any) -> str:
    return str(np.datetime_as_string(np.datetime64(stamp, "us")))


def _mjd(stamp: Any) -> float:
    """Modified Julian date (UTC) of a stored time; good to 1 us in a float64."""
    since = np.datetime64(stamp, "us") - np.datetime64("1858-11-17T00:00:00", "us")
    return float(since / np.timedelta64(1, "us")) / 86_400e6


def _astrometric_cards(one: xr.Dataset) -> list[tuple[str, Any, str]]:
    from pipeline.physics.positions.focal_plane import WcsFit, wcs_header

    order = int(one["wcs_sip_order"])
    size = order + 1
    fit = WcsFit(
        one["wcs_crval_deg"].values, one["wcs_crpix_px"].values, one["wcs_cd_deg"].values, order,
        one["wcs_sip_a"].values[:size, :size], one["wcs_sip_b"].values[:size, :size],
        float(one["wcs_residual_px"]),
    )  # fmt: skip
    return [(key, value, "") for key, value in wcs_header(fit).items()]


def _apparent_cards(one: xr.Dataset) -> list[tuple[str, Any, str]]:
    from pipeline.physics.positions.focal_plane import Camera, apparent_wcs_header

    rows, columns = one.sizes["y"], one.sizes["x"]
    camera = Camera(rows, columns, float(one.attrs["ifov_rad"]), 1.0)
    header = apparent_wcs_header(camera, one["attitude"].values)
    cards = [(f"{key}A", value, "") for key, value in header.items()]
    return cards


def write_table(rows: pa.Table, output: Path | None) -> None:
    """A table to a .csv or .parquet file, or as CSV to the screen."""
    import pyarrow.csv
    import pyarrow.parquet

    if output is None:
        pyarrow.csv.write_csv(rows, sys.stdout.buffer)
    elif output.exists():
        raise BadInput("-o", shorten(str(output)), "a path that does not exist yet")
    elif output.suffix == ".csv":
        pyarrow.csv.write_csv(rows, output)
    elif output.suffix == ".parquet":
        pyarrow.parquet.write_table(rows, output)
    else:
        raise BadInput("-o", str(output), "a path ending in .csv or .parquet")
