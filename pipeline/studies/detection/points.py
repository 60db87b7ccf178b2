"""Points of light, found by sep (SExtractor's algorithm as a library) with its plain settings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import Missing, why_broken

Array = NDArray[np.float64]

MESH_PX = 64
LEAST_PX = 5
ROUND = 1.5  # a point is at most so many times longer than wide


@dataclass(frozen=True)
class Detections:
    """Detections: x_px, y_px of their middles; snr; length_px and angle_rad (0 for points)."""

    x_px: Array
    y_px: Array
    snr: Array
    length_px: Array
    angle_rad: Array

    def __len__(self) -> int:
        return len(self.x_px)

    def take(self, index: NDArray[np.bool_]) -> Detections:
        """Some of them."""
        return Detections(
            self.x_px[index],
            self.y_px[index],
            self.snr[index],
            self.length_px[index],
            self.angle_rad[index],
        )


def flattened(frame: NDArray[np.generic]) -> tuple[Array, float]:
    """A raw frame less its smooth background (sep's mesh of 64 px), and the noise about it [DN]."""
    sep = _sep()
    image = np.ascontiguousarray(frame, dtype=np.float64)
    side = max(8, min(MESH_PX, *image.shape))
    back = sep.Background(image, bw=side, bh=side)
    return image - back.back(), max(float(back.globalrms), 1e-12)


def find_points(image: Array, noise: float, threshold_sigma: float) -> Detections:
    """Round sources of LEAST_PX pixels or more above the threshold, after sep's 3 x 3 filter.

    image, noise : from `flattened`. `snr` is that of the pixels above the threshold.
    """
    sep = _sep()
    sep.set_extract_pixstack(max(300_000, image.size))
    sep.set_sub_object_limit(10_000)
    rows = sep.extract(image, threshold_sigma, err=noise, minarea=LEAST_PX)
    rows = rows[(rows["a"] < ROUND * rows["b"]) & (rows["flux"] > 0)]
    snr = rows["flux"] / (noise * np.sqrt(rows["npix"]))
    none = np.zeros(len(rows))
    return Detections(rows["x"].astype(float), rows["y"].astype(float), snr, none, none)


def _sep():
    try:
        import sep
    except ImportError as error:
        broken = why_broken(error, "sep")
        raise Missing("finders of sources", "sep", "detection", broken=broken) from None
    return sep
