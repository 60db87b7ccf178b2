"""Events of cosmic rays, extracted from stacks of dark frames into a library."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from catalog_tools.documents import JsonObject
from pipeline.errors import BadInput
from pipeline.inputs.npy import read_npy
from pipeline.lazily import fits, open_fits
from pipeline.physics.cosmic_rays.detect import (
    bad_pixels,
    find_events,
    residual,
    stack_levels,
    steady_sigma,
)
from pipeline.physics.cosmic_rays.library import Library

if TYPE_CHECKING:
    from astropy.io.fits import Header

BAND_BYTES = 256_000_000  # of the stack that is held at once
FEWEST_FRAMES = 3
EXPOSURE_SHARE = 0.01  # by which the time that a file gives may differ from that of the command
UNREADABLE = (OSError, ValueError, EOFError, TypeError, AttributeError)
DIGITAL_SIGMA = 12.0**-0.5  # noise of a frame whose pixels all hold one digital number


@dataclass(frozen=True)
class DarkStack:
    """Dark frames in files, each of one frame or of several (frames, rows, columns).

    exposures_s : what each file gives as the integration time of a frame (EXPTIME), if any
    """

    files: tuple[Path, ...]
    counts: tuple[int, ...]
    shape: tuple[int, int]
    exposures_s: tuple[float | None, ...]

    @property
    def frames(self) -> int:
        return sum(self.counts)

    def band(self, start: int, stop: int) -> NDArray[np.float32]:
        """Rows start to stop of all frames, (frames, stop - start, columns)."""
        return np.concatenate([_rows(path, start, stop) for path in self.files])


def open_darks(paths: Sequence[Path]) -> DarkStack:
    """Look at the files of a stack; BadInput where they do not fit together."""
    places = [path.resolve() for path in paths]
    if len(set(places)) < len(places):
        again = next(path for i, path in enumerate(paths) if places[i] in places[:i])
        raise BadInput("DARK_FRAMES", f"{again} twice", "each file once")
    counts: list[int] = []
    shapes: list[tuple[int, int]] = []
    exposures_s: list[float | None] = []
    for path in paths:
        shape, exposure_s = _stored(path)
        if len(shape) not in (2, 3) or min(shape) < 1:
            raise BadInput("DARK_FRAMES", f"{path} of shape {shape}", "frames of rows x columns")
        counts.append(1 if len(shape) == 2 else shape[0])
        shapes.append((shape[-2], shape[-1]))
        exposures_s.append(exposure_s)
        if shapes[-1] != shapes[0]:
            raise BadInput(
                "DARK_FRAMES",
                f"{path} of shape {shapes[-1]}",
                f"frames of one shape: {paths[0]} has {shapes[0]}",
            )
    if sum(counts) < FEWEST_FRAMES:
        raise BadInput("DARK_FRAMES", f"{sum(counts)} frame(s)", f"at least {FEWEST_FRAMES}")
    return DarkStack(tuple(paths), tuple(counts), shapes[0], tuple(exposures_s))


def _stored(path: Path) -> tuple[tuple[int, ...], float | None]:
    """Shape of the numbers in a file, and the integration time that it gives."""
    allowed = "an existing .npy or .fits file of dark frames"
    if not path.is_file():
        raise BadInput("DARK_FRAMES", str(path), allowed)
    kind, exposure_s = "f", None
    try:
        if path.suffix == ".npy":
            stored = read_npy(path, mapped=True)
            shape, kind = stored.shape, stored.dtype.kind
        elif path.name.endswith((".fits", ".fits.gz", ".fit", ".fits.fz")):
            shape, exposure_s = _stored_in_fits(path)
        else:
            raise BadInput("DARK_FRAMES", str(path), allowed)
    except UNREADABLE as error:
        raise BadInput("DARK_FRAMES", str(path), f"a readable image; {error}") from None
    if kind not in "fiu":
        raise BadInput("DARK_FRAMES", f"{path} of type {kind!r}", "numbers")
    return tuple(int(n) for n in shape), exposure_s


def _stored_in_fits(path: Path) -> tuple[tuple[int, ...], float | None]:
    """The same of a FITS file: of its first image."""
    with open_fits(path) as hdus:
        images = [h for h in hdus if h.is_image and h.shape][:1]
        shape = images[0].shape if images else ()
        return shape, _exposure_s([h.header for h in (*images, hdus[0])])


def _exposure_s(headers: Sequence[Header]) -> float | None:
    """EXPTIME of the first header that has it, where it is a number."""
    try:
        return float(next(header["EXPTIME"] for header in headers if "EXPTIME" in header))
    except (StopIteration, TypeError, ValueError, fits().VerifyError):
        return None


def _check_exposures(darks: DarkStack, exposure_s: float) -> None:
    """BadInput for a file whose own integration time is another: rates would be wrong by both."""
    for path, own_s in zip(darks.files, darks.exposures_s, strict=True):
        if own_s is not None and not math.isclose(own_s, exposure_s, rel_tol=EXPOSURE_SHARE):
            raise BadInput(
                "DARK_FRAMES",
                f"{path} with EXPTIME {own_s:g}",
                f"frames of --exposure-s, {exposure_s:g}, or without EXPTIME",
            )


def _rows(path: Path, start: int, stop: int) -> NDArray[np.float32]:
    """Some rows of all frames of a file, (frames, rows, columns)."""
    try:
        if path.suffix == ".npy":
            part = read_npy(path, mapped=True)[..., start:stop, :]
        else:
            with open_fits(path) as hdus:
                hdu = next(h for h in hdus if h.is_image and h.shape)
                part = hdu.section[..., start:stop, :]
        part = np.asarray(part, dtype=np.float32)
    except UNREADABLE as error:
        raise BadInput("DARK_FRAMES", str(path), f"a readable image; {error}") from None
    if not np.isfinite(part).all():
        raise BadInput("DARK_FRAMES", f"{path} with NaN or infinite pixels", "finite pixels only")
    return part.reshape(-1, *part.shape[-2:])


def extract_library(
    darks: DarkStack,
    exposure_s: float,
    pixel_pitch_um: float,
    gain_e_per_dn: float = 1.0,
    seed_sigma: float = 6.0,
    grow_sigma: float = 2.5,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[Library, JsonObject]:
    """The events of a stack of dark frames of equal exposure, and what was found on the way.

    The median over the frames takes out bias, dark and hot pixels; pixels that stand out in more
    than a tenth of the frames (and more than twice) are omitted. Reads the stack four times,
    in frames and in bands. BadInput where a file says that its exposure is another.
    """
    _check_exposures(darks, exposure_s)
    level, sigma = _levels(darks)
    frames = darks.frames
    hits = np.zeros(darks.shape, np.int32)
    for rest in _residuals(darks, level):
        hits += rest > seed_sigma * sigma
    bad = bad_pixels(hits, frames)
    found: list[tuple[np.ndarray, ...]] = []
    for number, rest in enumerate(_residuals(darks, level)):
        event, y, x = find_events(rest, sigma, bad, seed_sigma, grow_sigma)
        found.append((event, y, x, rest[y, x] * gain_e_per_dn))
        if progress is not None:
            progress(number + 1, frames)
    library = _joined(found, darks, exposure_s, pixel_pitch_um)
    noise_e = float(np.median(sigma)) * gain_e_per_dn
    return library, {
        "frames": frames,
        "shape": list(darks.shape),
        "events": len(library),
        "pixels": len(library.electrons),
        "events_per_cm2_s": library.rate_per_px_s / (pixel_pitch_um * 1e-4) ** 2,
        "noise_e": noise_e,
        "threshold_e": seed_sigma * noise_e,
        "pixels_left_out": int(bad.sum()),
    }


def _levels(darks: DarkStack) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Median and sigma of each pixel over the stack, read band by band."""
    rows, columns = darks.shape
    step = max(1, BAND_BYTES // (4 * darks.frames * columns))
    offset = _offsets(darks)[:, None, None]
    parts = [
        stack_levels(darks.band(s, min(s + step, rows)) - offset) for s in range(0, rows, step)
    ]
    level, sigma = (np.concatenate(part) for part in zip(*parts, strict=True))
    return level, steady_sigma(sigma, DIGITAL_SIGMA)


def _offsets(darks: DarkStack) -> NDArray[np.float32]:
    """How much each frame as a whole lies above the first one, (frames,): a bias that drifts."""
    first = _rows(darks.files[0], 0, darks.shape[0])[0]
    return np.array(
        [
            np.median(image - first)
            for path in darks.files
            for image in _rows(path, 0, darks.shape[0])
        ],
        dtype=np.float32,
    )


def _residuals(darks: DarkStack, level: NDArray[np.float32]) -> Iterator[NDArray[np.float32]]:
    """The frames one by one, without the stack's level."""
    for path in darks.files:
        for image in _rows(path, 0, darks.shape[0]):
            yield residual(image, level)


def _joined(
    found: list[tuple[np.ndarray, ...]],
    darks: DarkStack,
    exposure_s: float,
    pixel_pitch_um: float,
) -> Library:
    """Events of all frames as a library."""
    start, frame, before = [0], [], 0
    for number, (event, _, _, _) in enumerate(found):
        count = np.bincount(event) if len(event) else np.empty(0, np.int64)
        start += (before + np.cumsum(count)).tolist()
        frame += [number] * len(count)
        before += len(event)
    y, x, electrons = (np.concatenate([f[i] for f in found]) for i in (1, 2, 3))
    rows, columns = darks.shape
    return Library(
        np.array(start, np.int64),
        x,
        y,
        electrons.astype(np.float64),
        exposure_s * darks.frames,
        rows * columns,
        pixel_pitch_um,
        darks.shape,
        darks.frames,
        np.array(frame, np.int64),
    )
