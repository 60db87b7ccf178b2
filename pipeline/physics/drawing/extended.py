"""Extended bodies: their image convolved with the response, block by block of the body.

A body's points of light (physics/targets/disc.py) are spread onto a grid at least twice as fine as
the core needs; the grid's transform over the spreading kernel's own is the body's (a non-uniform
FFT, error 1e-8), and times the core's it is drawn like a star at an exact place. Blocks are cut
from the body, never from the image, so that a pixel is the same in whatever tile it lies. What
the core leaves out goes with the wings' grid, like that of a star (`spread_body`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from pipeline.physics.drawing.spectral_spread import Kernel, spread_onto
from pipeline.physics.drawing.wings import WingGrid, spread
from pipeline.physics.motion.streak import POINT, Path, half_extent_px, pieces, transfer
from pipeline.physics.psf.pupil import Blur
from pipeline.physics.psf.response import Core, core_spectrum, frequencies, stamp_at, window
from pipeline.physics.targets.disc import EVERYWHERE, SPHERE_VARIANCE, Appearance, Box

Array = NDArray[np.float64]
Spectrum = NDArray[np.complex128]

KERNEL = Kernel(10, 23.0)
BLOCK_SAMPLES = 256  # core samples across a block, unless the core itself is wider
WHOLE_BLOCKS = 2  # bodies up to so many blocks across are drawn as one
FILL_WAVES = 128.0  # finest waves across a piece whose points are held at once
NEAR_PX = 16.0  # more than what a stamp's window adds to its core and path
CORE_FLOOR = 1e-8  # where the band of a core ends, over its value at zero
BAND_STEP = 0.0625  # cycles/px that a band is rounded up to
BAND_FLOOR = 1e-9
ERROR_STEPS = 256  # of the frequency integral of `point_error`, along each half axis


@dataclass(frozen=True)
class BodyBlock:
    """A square of the body: its first row and column and its sides, whole pixels."""

    y0_px: int
    x0_px: int
    rows: int
    columns: int

    @property
    def box(self) -> Box:
        y, x = float(self.y0_px), float(self.x0_px)
        return (y, y + self.rows, x, x + self.columns)

    @property
    def middle(self) -> tuple[float, float]:
        return self.y0_px + 0.5 * self.rows, self.x0_px + 0.5 * self.columns


def block_side(core: Core) -> int:
    """Side [px] of a block: a power of two, no smaller than the core's radius."""
    least = max(BLOCK_SAMPLES / core.oversampling, core.radius_px, 1.0)
    return int(2 ** np.ceil(np.log2(least)))


def body_blocks(body: Appearance, side_px: int, near: Box = EVERYWHERE) -> tuple[BodyBlock, ...]:
    """The blocks that a body is drawn in: one of its own size if small, else squares of a side.

    Those that do not touch `near` are omitted; the others do not depend on it.
    """
    whole = _around(body)
    if max(whole.rows, whole.columns) <= WHOLE_BLOCKS * side_px:
        return (whole,)
    return _squares(whole, side_px, near)


def _around(body: Appearance) -> BodyBlock:
    """Whole pixels around a body."""
    y0, y1, x0, x1 = body.box
    top, left = int(np.floor(y0)), int(np.floor(x0))
    return BodyBlock(top, left, int(np.ceil(y1)) - top, int(np.ceil(x1)) - left)


def _squares(whole: BodyBlock, side: int, near: Box = EVERYWHERE) -> tuple[BodyBlock, ...]:
    """A block cut into squares from its first corner on."""
    top, bottom = _steps(whole.y0_px, whole.rows, side, near[0], near[1])
    left, right = _steps(whole.x0_px, whole.columns, side, near[2], near[3])
    return tuple(
        BodyBlock(whole.y0_px + i * side, whole.x0_px + j * side, side, side)
        for i in range(top, bottom)
        for j in range(left, right)
    )


def _steps(start: int, length: int, side: int, low: float, high: float) -> tuple[int, int]:
    """First and last-plus-one step of a side that touches low ... high."""
    count = -(-length // side)
    first = int(np.clip(np.floor((low - start) / side), 0, count))
    return first, int(np.clip(np.floor((high - start) / side) + 1, first, count))


def core_band(spectrum: Spectrum, core: Core, period: tuple[int, int]) -> float:
    """Frequency [cycles/px] beyond which a `core_spectrum` is below CORE_FLOOR."""
    fy, fx = frequencies(core, *period)
    size = np.abs(spectrum)
    bright = np.hypot(fy[:, None], fx[None, :])[size > CORE_FLOOR * size[0, 0]]
    band = np.ceil(float(bright.max(initial=0.0)) / BAND_STEP) * BAND_STEP
    return float(min(max(band, BAND_STEP), 0.5 * core.oversampling))


def block_spectrum(
    body: Appearance,
    block: BodyBlock,
    oversampling: int,
    period: tuple[int, int],
    band_per_px: float,
) -> Spectrum | None:
    """Fourier transform of a block of a body about the block's middle; None where it is dark.

    On the frequencies of `core_spectrum` for a period [px] that leaves 2 px around the block at
    least, right up to `band_per_px` [cycles/px]; light in shares of the whole body's.
    """
    per_px = oversampling if 4.0 * band_per_px <= oversampling else 2 * oversampling
    per_px = max(per_px, 4)
    ny, nx = period[0] * per_px, period[1] * per_px
    grid: Array | None = None
    middle = block.middle
    _, last_y, _, last_x = block.box
    for part in _squares(block, int(np.ceil(FILL_WAVES / band_per_px))):
        top, bottom, left, right = part.box
        y, x, share = body.points(band_per_px, (top, min(bottom, last_y), left, min(right, last_x)))
        if not share.size:
            continue
        grid = np.zeros((ny, nx)) if grid is None else grid
        spread_onto(
            grid,
            nx,
            KERNEL,
            (y - middle[0]) * per_px + ny // 2,
            (x - middle[1]) * per_px + nx // 2,
            share,
        )
    return None if grid is None else _cut(grid, oversampling, period)


def _cut(grid: Array, oversampling: int, period: tuple[int, int]) -> Spectrum:
    """Transform of a spread grid about its middle, without the kernel, at the core's band."""
    rows, columns = period[0] * oversampling, period[1] * oversampling
    ky = scipy.fft.fftfreq(rows, 1.0 / rows).round().astype(np.int64)
    kx = np.arange(columns // 2 + 1)
    # Along x first, so that only the columns that are kept are transformed along y.
    along = scipy.fft.rfft(grid, axis=1)[:, : kx.size]
    spectrum = scipy.fft.fft(along, axis=0)[ky]
    down = (1.0 - 2.0 * (ky % 2)) / KERNEL.transform(ky / grid.shape[0])
    across = (1.0 - 2.0 * (kx % 2)) / KERNEL.transform(kx / grid.shape[1])
    spectrum *= down[:, None]
    spectrum *= across[None, :]
    return spectrum


def draw_body(
    image_e: Array,
    origin: tuple[int, int],
    body: Appearance,
    core: Core,
    place_px: tuple[float, float],
    light_e: float,
    path: Path = POINT,
    side_px: int | None = None,
    spectrum_of: Callable[..., Spectrum | None] = block_spectrum,
) -> None:
    """Add the core's part of a body swept along a path to an image, in place.

    image_e : (ny, nx) float64, electrons; its first pixel is frame pixel `origin` (y, x)
    place_px : frame position (y, x) of the body's reference point at the path's zero
    light_e : of the whole body; side_px : of the blocks (`block_side` when omitted)
    spectrum_of : `block_spectrum`, or one that remembers what it has made
    """
    cut = pieces(path)
    reach_y, reach_x = half_extent_px(piece for _, _, piece, _ in cut)
    swept: dict[Path, Spectrum] = {}
    fixed: Spectrum | None = None
    band = 0.0
    near_image = _near(image_e, origin, place_px, core.radius_px + NEAR_PX, path)
    for block in body_blocks(body, side_px or block_side(core), near_image):
        half_y, half_x, *fast = window(
            core, 0.5 * block.rows + reach_y, 0.5 * block.columns + reach_x
        )
        period = (fast[0], fast[1])
        y, x = place_px[0] + block.middle[0], place_px[1] + block.middle[1]
        near = [
            piece
            for piece in cut
            if _touches(image_e, origin, y + piece[1], x + piece[0], half_y, half_x)
        ]
        if not near:
            continue
        if fixed is None:
            fixed = core_spectrum(core, *period)
            band = core_band(fixed, core, period)
        image = spectrum_of(body, block, core.oversampling, period, band)
        if image is None:
            continue
        image = image * fixed
        for x0, y0, piece, share in near:
            if piece not in swept:
                f = frequencies(core, *period)
                swept[piece] = transfer(*f, piece.x_px, piece.y_px, piece.weight)
            stamp = stamp_at(core, image * swept[piece], (half_y, half_x), period, y + y0, x + x0)
            _add(image_e, origin, stamp, light_e * share)


def _near(
    image: Array, origin: tuple[int, int], place: tuple[float, float], reach: float, path: Path
) -> Box:
    """The part of a body, relative to its reference point, that may send light into an image."""
    y, x = origin[0] - place[0], origin[1] - place[1]
    down, along = (reach + 2.0 * float(np.abs(a).max(initial=0.0)) for a in (path.y_px, path.x_px))
    return (y - down, y + image.shape[0] + down, x - along, x + image.shape[1] + along)


def _touches(
    image: Array, origin: tuple[int, int], y: float, x: float, half_y: int, half_x: int
) -> bool:
    """Whether a stamp around (y, x) has pixels in an image."""
    top, left = int(np.floor(y)) - half_y - origin[0], int(np.floor(x)) - half_x - origin[1]
    inside_y = top < image.shape[0] and top + 2 * half_y + 2 > 0
    return inside_y and left < image.shape[1] and left + 2 * half_x + 2 > 0


def _add(
    image: Array, origin: tuple[int, int], stamp: tuple[int, int, Array], light_e: float
) -> None:
    top, left, values = stamp[0] - origin[0], stamp[1] - origin[1], stamp[2]
    r0, r1 = max(0, -top), min(values.shape[0], image.shape[0] - top)
    c0, c1 = max(0, -left), min(values.shape[1], image.shape[1] - left)
    if r1 > r0 and c1 > c0:
        image[top + r0 : top + r1, left + c0 : left + c1] += light_e * values[r0:r1, c0:c1]


def spread_body(
    grid: WingGrid, body: Appearance, place_px: tuple[float, float], light_e: float
) -> Array:
    """A body's light on the wings' grid, like `spread` for stars: (rows, columns), electrons.

    Points as fine as the grid sees. Its transform times the wing kernel (and the path's transfer
    function on `grid_frequencies`) gives the wing; points off the grid are omitted.
    """
    out = np.zeros((grid.rows, grid.columns))
    h = grid.spacing_px
    low_y, low_x = grid.y0_px - place_px[0], grid.x0_px - place_px[1]
    near = (low_y, low_y + grid.rows * h, low_x, low_x + grid.columns * h)
    for part in _squares(_around(body), int(FILL_WAVES) * h, near):
        y, x, share = body.points(1.0 / h, part.box)
        if share.size:
            out += spread(grid, x + place_px[1], y + place_px[0], light_e * share)
    return out


def point_error(blur: Blur, radius_px: float, offset_px: float = 0.0) -> float:
    """Upper bound of a pixel's error, per unit light, when a sphere is drawn as a point.

    The point stands at the photocentre (`photocentre_offset` from the centre, towards the Sun);
    `offset_px` is how far it stands from there, e.g. that offset where the centre is used. With S
    the body's transform about the photocentre, the error is at most the integral of |T| |S - 1|,
    and |S - 1| <= min(2, 2 pi^2 f^2 v + 2 pi f offset), v the largest variance of the light along
    a line: r^2/5 for a Lambertian sphere of radius r at every phase (exact across the Sun's
    direction, less along it). For any other body give radius_px = sqrt(5 v).
    """
    band = blur.band_limit(BAND_FLOOR)
    step = band / ERROR_STEPS
    fy = np.linspace(-band + 0.5 * step, band - 0.5 * step, 2 * ERROR_STEPS)
    fx = fy[ERROR_STEPS:]
    f = np.hypot(fy[:, None], fx[None, :])
    square = 2.0 * np.pi**2 * SPHERE_VARIANCE * radius_px**2 * f * f
    differs = np.minimum(2.0, square + 2.0 * np.pi * f * abs(offset_px))
    size = np.abs(blur.transfer(fy[:, None], fx[None, :]))
    return float(2.0 * step * step * np.sum(size * differs))
