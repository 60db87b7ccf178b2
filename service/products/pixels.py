"""What a viewer needs of a frame: tiles as values or pictures, WCS, truth, a FITS file."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from PIL import Image

from catalog_tools.documents import JsonObject
from pipeline.errors import BadInput, Damaged
from pipeline.export.files import fits_bytes, fits_header
from pipeline.export.picture import png_bytes, seen
from pipeline.store import layout
from pipeline.store.cube import open_cube
from pipeline.store.markers import marker_path
from pipeline.store.truth import read_truth
from service.problems import NotReady, NotThere
from service.products.frames import array_of, check_frame, describe, grid_of

MAX_PIXELS = 1 << 24  # of one answer
MAX_READ = 1 << 27  # of one tile, whatever is left of it after binning
PLACE_COLUMNS = (
    *("x_px", "y_px", "x_start_px", "y_start_px", "x_end_px", "y_end_px"),
    *("ra_deg", "dec_deg", "hidden_by", "visible_fraction"),
)
STAR_COLUMNS = ("source_id", *PLACE_COLUMNS, "g_mag", "electrons", "snr")
TARGET_COLUMNS = (
    *("name", *PLACE_COLUMNS, "range_m", "phase_deg", "sunlit_fraction"),
    *("electrons", "snr", "v_mag", "mag_ab", "object_name"),
)


def frame_facts(product: Path, frame: int) -> JsonObject:
    """One frame: which tiles are drawn; for a complete product its times and FITS WCS, too."""
    about = describe(product)
    check_frame(frame, about["frames"])
    tile_rows, tile_columns = grid_of(about)
    drawn = [
        [row, column]
        for row in range(tile_rows)
        for column in range(tile_columns)
        if about["complete"] or marker_path(product, frame, row, column).is_file()
    ]
    facts = {"frame": frame, "tiles": [tile_rows, tile_columns], "drawn": drawn}
    return facts | (_world(product, frame) if about["complete"] else {"wcs": None, "times": None})


def _world(product: Path, frame: int) -> JsonObject:
    with open_cube(product) as cube:
        cards = {key: value for key, value, _ in fits_header(cube, frame, "dn")}
        residual = float(cube["wcs_residual_px"][frame])
    names = ("CTYPE", "CRVAL", "CRPIX", "CD", "A_", "B_", "RADESYS")
    wcs = {k: v for k, v in cards.items() if k.startswith(names) and not _alternate(k)}
    times = {
        name: cards[key]
        for name, key in (("start", "DATE-OBS"), ("mid", "DATE-AVG"), ("end", "DATE-END"))
    }
    return {"wcs": wcs, "wcs_residual_px": residual, "times": times}


def _alternate(key: str) -> bool:
    """A card of the second WCS (`CRVAL1A`), not a SIP one (`A_1_1`)."""
    return key.endswith("A") and not key.startswith(("A_", "B_"))


def tile_values(
    product: Path, frame: int, row: int, column: int, layer: str = "dn", bin_px: int = 1
) -> np.ndarray:
    """Values of one drawn tile, (rows, columns) in its own type; binned: float32.

    A binned pixel is the mean of its block's mean and maximum, so that faint stars stay visible;
    blocks at the far edges may be smaller. NotThere for what the product has not, NotReady for
    a tile that is not drawn yet, BadInput for a tile too large to be shown at this binning.
    """
    about = describe(product)
    check_frame(frame, about["frames"])
    if layer not in about["layers"]:
        raise NotThere(f"the product has the layers {', '.join(about['layers'])}")
    grid = grid_of(about)
    if not (0 <= row < grid[0] and 0 <= column < grid[1]):
        raise NotThere(f"the frame has {grid[0]} x {grid[1]} tiles")
    if not (about["complete"] or marker_path(product, frame, row, column).is_file()):
        raise NotReady("this tile is not drawn yet")
    (ny, nx), (rows, columns) = about["tile_shape"], about["shape"]
    y, x = slice(row * ny, min((row + 1) * ny, rows)), slice(column * nx, (column + 1) * nx)
    size = (y.stop - y.start) * (min(x.stop, columns) - x.start)
    if size > MAX_READ or size > MAX_PIXELS * bin_px**2:
        raise BadInput(
            "?bin",
            bin_px,
            f"a factor that leaves at most {MAX_PIXELS} pixels of a "
            f"tile ({size} here; over {MAX_READ} none is shown)",
        )
    try:
        values = np.asarray(array_of(product, layer)[frame, y, x])
    except (OSError, ValueError, RuntimeError) as error:
        raise Damaged(f"{layout.CUBE}/{layer}", f"frame {frame}: {type(error).__name__}") from None
    return binned(values, bin_px)


def binned(values: np.ndarray, factor: int) -> np.ndarray:
    """Blocks of factor x factor as the mean of their mean and maximum, float32; 1: as it is.

    Pixels that are no number (masked ones) do not count; a block of them alone is none.
    """
    if factor == 1:
        return values
    y, x = (np.arange(0, n, factor) for n in values.shape)
    values = values.astype(np.float32)
    known = ~np.isnan(values)
    count = np.add.reduceat(np.add.reduceat(known, y, axis=0, dtype=np.int64), x, axis=1)
    total = np.add.reduceat(np.add.reduceat(np.where(known, values, 0), y, axis=0), x, axis=1)
    highest = np.fmax.reduceat(np.fmax.reduceat(values, y, axis=0), x, axis=1)
    with np.errstate(invalid="ignore"):  # nothing by nothing
        return (0.5 * (total / count + highest)).astype(np.float32)


def tile_picture(values: np.ndarray, stretch: str, low: float | None, high: float | None) -> bytes:
    """A tile as PNG, its first row at the bottom; black at `low`, white at `high` (by percentiles
    of the tile where absent). BadInput where they are no interval."""
    values = seen(values)
    ends = np.percentile(values, [1.0, 99.7])
    low = float(ends[0]) if low is None else low
    high = max(float(ends[1]), math.nextafter(low, math.inf)) if high is None else high
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise BadInput("?low", low, f"a number below high ({high:g})")
    share = np.clip((values - low) / (high - low), 0.0, 1.0)
    if stretch == "asinh":
        share = np.arcsinh(20.0 * share) / math.asinh(20.0)
    elif stretch == "log":
        share = np.log1p(1000.0 * share) / math.log1p(1000.0)
    return png_bytes(Image.fromarray((255.0 * share + 0.5).astype(np.uint8)[::-1]))


def truth_of(product: Path, frame: int, limit: int) -> JsonObject:
    """Targets and the brightest `limit` stars inside a frame, as plain values; `hidden_by` says
    what stands before one, and `stars_in_frame` leaves out those that it hides all the time."""
    about = describe(product)
    check_frame(frame, about["frames"])
    out: JsonObject = {"targets": [], "stars": [], "stars_in_frame": 0, "stars_hidden": 0}
    shown = [("frame", "=", frame), ("in_frame", "=", True)]
    targets = read_truth(product, "targets", TARGET_COLUMNS, shown)
    if targets is not None:
        out["targets"] = _plain(targets)
    stars = read_truth(product, "stars", STAR_COLUMNS, shown)
    if stars is not None:
        if "visible_fraction" in stars.column_names:
            out["stars_hidden"] = pc.sum(pc.equal(stars["visible_fraction"], 0.0)).as_py() or 0
        out["stars_in_frame"] = stars.num_rows - out["stars_hidden"]
        keys = [("electrons", "descending"), ("source_id", "ascending")]
        brightest = pc.select_k_unstable(stars, k=min(limit, stars.num_rows), sort_keys=keys)
        out["stars"] = _plain(stars.take(brightest))
        for star in out["stars"]:
            star["source_id"] = str(star["source_id"])  # beyond the whole numbers of JavaScript
    return out


def _plain(table: pa.Table) -> list[JsonObject]:
    return [
        {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in row.items()}
        for row in table.to_pylist()
    ]


def frame_fits(product: Path, frame: int, layer: str) -> bytes:
    """A frame of a complete product as a FITS file."""
    about = describe(product)
    check_frame(frame, about["frames"])
    if layer not in about["layers"]:
        raise NotThere(f"the product has the layers {', '.join(about['layers'])}")
    if math.prod(about["shape"]) > MAX_READ:
        raise BadInput("frame", about["shape"], f"at most {MAX_READ} pixels; fetch the Zarr cube")
    with open_cube(product) as cube:
        return fits_bytes(product, cube, frame, layer)
