"""Pictures of a frame: an asinh stretch between robust limits, targets and cosmic rays marked."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from pipeline.store.cube import read_layer
from pipeline.store.layout import PREVIEW, write_atomically
from pipeline.store.truth import read_truth

if TYPE_CHECKING:
    from pipeline.plan.plan import Plan

LARGEST_SIDE_PX = 1024
GREEN, CYAN = (80, 255, 120), (80, 220, 255)
MOST_MARKED = 60  # cosmic rays with the most charge


class GreyLimits(NamedTuple):
    """Grey levels of a picture: black, the softening (scatter of the sky), white."""

    low: float
    scatter: float
    top: float


def limits_of(
    image: np.ndarray, low_percent: float = 1.0, high_percent: float = 99.7
) -> GreyLimits:
    """Limits between the sky and a bright percentile of an image."""
    values = seen(image)
    sample = values.ravel()[:: max(1, values.size // 400_000)]
    low, middle, high = np.percentile(sample, [low_percent, 50.0, high_percent])
    scatter = 1.4826 * float(np.median(np.abs(sample - middle))) or 1.0
    top = max(float(high), middle + 12.0 * scatter, np.nextafter(low, np.inf))
    return GreyLimits(low, scatter, top)


def stretch(image: np.ndarray, limits: GreyLimits | None = None) -> NDArray[np.uint8]:
    """Grey levels 0 to 255 of an image: asinh between limits, by default its own.

    The softening is the robust scatter of the sky, so that noise stays visible beside bright
    stars (Lupton et al. 2004, PASP 116, 133).
    """
    values = seen(image)
    low, scatter, top = limits or limits_of(values)
    scaled = np.arcsinh((values - low) / (3.0 * scatter)) / np.arcsinh(
        (top - low) / (3.0 * scatter)
    )
    return (255.0 * np.clip(scaled, 0.0, 1.0)).astype(np.uint8)


def shrink(image: np.ndarray, side_px: int = LARGEST_SIDE_PX) -> tuple[np.ndarray, int]:
    """An image binned by whole factors until it fits; faint stars survive as block maxima do not
    raise the sky (mean of the block and its maximum). Returns it and the factor."""
    image = seen(image)
    factor = -(-max(image.shape) // side_px)
    if factor == 1:
        return np.asarray(image, np.float64), 1
    ny, nx = (n // factor * factor for n in image.shape)
    if ny == 0 or nx == 0:
        return np.asarray(image, np.float64), 1
    blocks = np.asarray(image[:ny, :nx], np.float64).reshape(
        ny // factor, factor, nx // factor, factor
    )
    return 0.5 * (blocks.mean(axis=(1, 3)) + blocks.max(axis=(1, 3))), factor


def seen(image: np.ndarray) -> NDArray[np.float64]:
    """An image as float64; pixels that are no number (masked ones) are as dark as the darkest."""
    values = np.asarray(image, np.float64)
    masked = np.isnan(values)
    if not masked.any():
        return values
    return np.where(masked, 0.0 if masked.all() else np.nanmin(values), values)


def frame_picture(
    product: Path, frame: int = 0, mark: bool = True, layer: str = "dn"
) -> Image.Image:
    """A picture of one frame of a layer, north as the pointing has it (row 0 at the bottom)."""
    small, factor = shrink(read_layer(product, layer, frame))
    grey = stretch(small)[::-1]
    picture = Image.fromarray(np.stack([grey] * 3, axis=-1))
    if mark:
        _mark_cosmic_rays(picture, product, frame, factor)
        _mark_targets(picture, product, frame, factor)
    return picture


def write_preview(product: Path, plan: Plan) -> None:
    """preview.png of the first frame; of its calibrated copy where the scene asks for one."""
    layer = "calibrated_e" if "calibrated_e" in plan.scene.output.layers else "dn"
    picture = frame_picture(product, 0, mark=bool(plan.scene.targets), layer=layer)
    write_atomically(product / PREVIEW, png_bytes(picture))


def png_bytes(picture: Image.Image) -> bytes:
    """A picture as PNG."""
    out = BytesIO()
    picture.save(out, format="PNG", compress_level=2)
    return out.getvalue()


def _mark_targets(picture: Image.Image, product: Path, frame: int, factor: int) -> None:
    """Green circles round the targets in view that the Earth does not hide."""
    wanted = ("x_px", "y_px", "name", "visible_fraction")
    shown = [("frame", "=", frame), ("in_frame", "=", True)]
    rows = read_truth(product, "targets", wanted, shown)
    if rows is None:
        return
    draw = ImageDraw.Draw(picture)
    for row in rows.to_pylist():
        if row.get("visible_fraction", 1.0) <= 0.0:  # not in products of earlier versions
            continue
        x, y, name = row["x_px"], row["y_px"], row["name"]
        cx, cy = (x + 0.5) / factor, picture.height - (y + 0.5) / factor
        draw.ellipse([cx - 12, cy - 12, cx + 12, cy + 12], outline=GREEN)
        draw.text((cx + 14, cy - 6), str(name), fill=GREEN)


def _mark_cosmic_rays(picture: Image.Image, product: Path, frame: int, factor: int) -> None:
    """Cyan ellipses round the cosmic rays with the most charge, as long as their tracks."""
    rows = read_truth(product, "cosmic_rays", filters=[("frame", "=", frame)])
    if rows is None:
        return
    rows = rows.sort_by([("electrons", "descending")]).slice(0, MOST_MARKED)
    draw = ImageDraw.Draw(picture)
    names = ("x_in_px", "y_in_px", "x_out_px", "y_out_px")
    for x0, y0, x1, y1 in zip(*(rows[c].to_pylist() for c in names), strict=True):
        half_x, half_y = 8 + 0.5 * abs(x1 - x0) / factor, 8 + 0.5 * abs(y1 - y0) / factor
        cx = (0.5 * (x0 + x1) + 0.5) / factor
        cy = picture.height - (0.5 * (y0 + y1) + 0.5) / factor
        draw.ellipse([cx - half_x, cy - half_y, cx + half_x, cy + half_y], outline=CYAN)
