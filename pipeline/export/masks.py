"""Segmentation masks: which pixels belong to which source, by a threshold on its own light."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np
import scipy
from numpy.typing import NDArray

from pipeline.errors import BadInput
from pipeline.export.labels import STAR, TARGET, Labels
from pipeline.export.response import SourceLight, path_between
from pipeline.lazily import fits
from pipeline.store.cube import read_layer

FULL_DISC = 1.0  # px of radius from which a body's disc is drawn
RULE = (
    "a pixel belongs to a source whose expected light in it is at least THRESH electrons, or, of a "
    "source fainter than that everywhere, at least half of its own brightest pixel; the light of a "
    f"body of more than {FULL_DISC:g} px of radius counts as spread over its whole disc"
)
LAYERS = {TARGET: "targets_e", STAR: "stars_e"}


@dataclass(frozen=True)
class Mask:
    """The pixels of one source: a window of the frame.

    y0, x0 : its first row and column, within the frame; light_e : electrons a pixel; pixels : bool
    """

    y0: int
    x0: int
    light_e: NDArray[np.float64]
    pixels: NDArray[np.bool_]

    @property
    def box(self) -> tuple[int, int, int, int] | None:
        """First row, first column, rows and columns of its pixels; None without any."""
        rows, columns = np.flatnonzero(self.pixels.any(1)), np.flatnonzero(self.pixels.any(0))
        if not rows.size:
            return None
        height, width = int(rows[-1] - rows[0]) + 1, int(columns[-1] - columns[0]) + 1
        return self.y0 + int(rows[0]), self.x0 + int(columns[0]), height, width


def source_masks(
    labels: Labels, light: SourceLight, shape: tuple[int, int], threshold_e: float
) -> Iterator[Mask]:
    """The mask of each label in turn, cut to the frame.

    The light is the source's response swept along the arc through start, middle and end of its
    path, evenly lit (export/response.py); a body of more than FULL_DISC px is a full disc.
    """
    for i in range(len(labels)):
        start, middle, end = labels.path_px(i)
        path = path_between(start, middle, end)
        e = float(labels.electrons[i])
        y0, x0, image = light.image(path, middle[0], middle[1], e, threshold_e)
        if labels.radius_px[i] > FULL_DISC:
            y0, x0, image = _as_disc(y0, x0, image, float(labels.radius_px[i]))
        yield _cut(y0, x0, image, shape, threshold_e)


def _as_disc(
    y0: int, x0: int, image: NDArray[np.float64], radius_px: float
) -> tuple[int, int, NDArray[np.float64]]:
    """The light spread over a full disc."""
    n = int(np.ceil(radius_px))
    at = np.arange(-n, n + 1)
    disc = (np.hypot(at[:, None], at[None, :]) <= radius_px).astype(float)
    return y0 - n, x0 - n, scipy.signal.fftconvolve(image, disc / disc.sum())


def _cut(
    y0: int, x0: int, image: NDArray[np.float64], shape: tuple[int, int], threshold_e: float
) -> Mask:
    least = min(threshold_e, 0.5 * float(image.max(initial=0.0)))
    top, left = max(0, -y0), max(0, -x0)
    bottom, right = min(image.shape[0], shape[0] - y0), min(image.shape[1], shape[1] - x0)
    inside = image[top : max(top, bottom), left : max(left, right)]
    return Mask(y0 + top, x0 + left, inside, (inside >= least) & (inside > 0))


def paint(labels: Labels, masks: Iterator[Mask], shape: tuple[int, int]) -> NDArray[np.int32]:
    """Every pixel's source: the number of the label from 1, 0 for none; the brightest wins."""
    owner, most = np.zeros(shape, np.int32), np.zeros(shape)
    for number, mask in enumerate(masks, start=1):
        at = np.s_[
            mask.y0 : mask.y0 + mask.pixels.shape[0], mask.x0 : mask.x0 + mask.pixels.shape[1]
        ]
        wins = mask.pixels & (mask.light_e > most[at])
        owner[at][wins], most[at][wins] = number, mask.light_e[wins]
    assert len(labels) >= owner.max(initial=0)
    return owner


def classes_from_light(
    product: Path, frame: int, present: list[str], threshold_e: float
) -> NDArray[np.uint8]:
    """Each pixel's class from the noise-free layers: 1 target, 2 star, 0 neither; targets win."""
    missing = [name for name in LAYERS.values() if name not in present]
    if len(missing) == len(LAYERS):
        raise BadInput(
            "--light", "layers", "a product with output.layers targets_e or stars_e; or `response`"
        )
    out: NDArray[np.uint8] | None = None
    for kind in (STAR, TARGET):
        if LAYERS[kind] in present:
            lit = read_layer(product, LAYERS[kind], frame) >= threshold_e
            out = np.zeros(lit.shape, np.uint8) if out is None else out
            out[lit] = kind
    assert out is not None
    return out


def mask_fits(
    labels: Labels,
    owner: NDArray[np.int32],
    classes: NDArray[np.uint8],
    cards: list[tuple[str, object, str]],
) -> bytes:
    """A FITS file: CLASS (also the primary's header), SOURCE numbers, and the table of SOURCES."""
    fits_io = fits()
    object_name = np.char.encode(labels.object_name, "ascii", "backslashreplace")
    wide = f"{max(80, object_name.itemsize)}A"
    table = fits_io.BinTableHDU.from_columns(
        [
            fits_io.Column("number", "J", array=np.arange(1, len(labels) + 1)),
            fits_io.Column("class", "B", array=labels.kind),
            fits_io.Column("name", "64A", array=labels.name),
            fits_io.Column("x", "D", unit="pixel", array=labels.x_px),
            fits_io.Column("y", "D", unit="pixel", array=labels.y_px),
            fits_io.Column("object_name", wide, array=object_name),
            fits_io.Column("magnitude", "D", array=labels.magnitude),
            fits_io.Column("electrons", "D", array=labels.electrons),
            fits_io.Column("snr", "D", array=labels.snr),
        ],
        name="SOURCES",
    )
    primary = fits_io.PrimaryHDU(header=fits_io.Header(cards))
    hdus = [
        primary,
        fits_io.CompImageHDU(classes, name="CLASS"),
        fits_io.CompImageHDU(owner, name="SOURCE"),
        table,
    ]
    out = BytesIO()
    fits_io.HDUList(hdus).writeto(out, checksum=True)
    return out.getvalue()
