"""Libraries of recorded cosmic rays: read, written, and extracted from stacks of dark frames.

A library is a FITS file with a table COSMIC_RAYS, a row for each run of pixels along x: fp_id (the
event), x0, y0 (its first pixel), pixel_values (electrons), frame; header EXPTIME (seconds of the
whole stack) and NUM_PIX (pixels of a frame). Ours also says ROWS, COLUMNS, FRAMES, PITCH_UM.
LSST's harvested events (imSim) have the same columns, without `frame` and those keys.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from catalog_tools.documents import JsonObject
from catalog_tools.storage.durable import write_atomically
from pipeline.errors import BadInput
from pipeline.physics.cosmic_rays.frame import CosmicRays, events_a_frame
from pipeline.physics.cosmic_rays.library import Library, Recorded
from pipeline.physics.cosmic_rays.tracks import Flux
from pipeline.spec.sensor import cosmic_rays as spec
from pipeline.spec.sensor.sensor import Sensor

Ints = NDArray[np.int64]

FIELD = "cosmic_rays.path"
TABLE = "COSMIC_RAYS"
COLUMNS = ("fp_id", "x0", "y0", "pixel_values")
LARGEST_BYTES = 1_000_000_000
LARGEST_PLACE = 1_000_000
MOST_EVENTS = 2_000_000  # a frame: 130 MB of tracks
BAND_BYTES = 256_000_000  # of the stack that is held at once
FEWEST_FRAMES = 3
DIGITAL_SIGMA = 12.0**-0.5  # noise of a frame whose pixels all hold one digital number


def gather_cosmic_rays(
    request: spec.CosmicRays | None, sensor: Sensor, integration_s: float
) -> CosmicRays | None:
    """What draws the cosmic rays of a scene; None where there are none (absent, or rate 0).

    BadInput where a library cannot be read, or lacks what the arrival asks for.
    """
    if request is None:
        return None
    if isinstance(request, spec.GeneratedCosmicRays):
        flux = _flux(request, sensor, integration_s)
        return flux and _few_enough("rate_per_cm2_s", flux.rate_per_cm2_s, flux)
    if request.rate_scale == 0.0:
        return None
    library = read_library(Path(request.path))
    if request.arrival == "frames" and (library.shape is None or library.frames is None):
        allowed = "poisson: the library does not say which frame an event is of"
        raise BadInput("cosmic_rays.arrival", request.arrival, allowed)
    recorded = Recorded(
        library,
        *sensor.shape,
        sensor.pixel_pitch_um,
        integration_s,
        request.rate_scale,
        request.arrival,
    )
    return _few_enough("rate_scale", request.rate_scale, recorded)


def _flux(request: spec.GeneratedCosmicRays, sensor: Sensor, integration_s: float) -> Flux | None:
    """The particles that are generated, defaults filled in; None of rate 0."""
    defaults = (spec.GROUND_RATE_PER_CM2_S, 0.0, spec.MUON_ZENITH_POWER)
    if request.source == "space":
        defaults = (spec.SPACE_RATE_PER_CM2_S, spec.SPACE_HELIUM_SHARE, 0.0)
    rate = defaults[0] if request.rate_per_cm2_s is None else request.rate_per_cm2_s
    helium = defaults[1] if request.helium_share is None else request.helium_share
    if rate == 0.0:
        return None
    return Flux(
        *sensor.shape,
        sensor.pixel_pitch_um,
        request.thickness_um,
        rate,
        integration_s,
        defaults[2],
        helium,
        request.diffusion_um,
        request.delta_electrons,
    )


def _few_enough(key: str, value: float, rays: CosmicRays) -> CosmicRays:
    events = events_a_frame(rays)
    if events > MOST_EVENTS:
        allowed = f"at most {value * MOST_EVENTS / events:.3g} ({MOST_EVENTS:.0e} events a frame)"
        raise BadInput(f"cosmic_rays.{key}", value, allowed)
    return rays


def read_library(path: Path, field: str = FIELD) -> Library:
    """Read a library; BadInput names what is missing or wrong."""
    if not path.is_file():
        raise BadInput(field, str(path), "an existing library (FITS table COSMIC_RAYS)")
    if path.stat().st_size > LARGEST_BYTES:
        raise BadInput(field, str(path), f"a file of at most {LARGEST_BYTES} bytes")
    from astropy.io import fits

    try:
        with fits.open(path) as hdus:
            if TABLE not in hdus:
                raise BadInput(field, str(path), f"a FITS file with a table {TABLE}")
            table = hdus[TABLE].data
            names = set(table.names)
            lacking = [name for name in COLUMNS if name not in names]
            if lacking:
                raise BadInput(field, str(path), f"a table with a column {lacking[0]}")
            event, x0, y0 = (np.asarray(table[n]).astype(np.int64) for n in COLUMNS[:3])
            frame = np.asarray(table["frame"]).astype(np.int64) if "frame" in names else None
            spans = [np.asarray(span, dtype=np.float64) for span in table["pixel_values"]]
            header = dict(hdus[TABLE].header)
    except (OSError, ValueError, TypeError, KeyError, IndexError, AttributeError) as error:
        raise BadInput(field, str(path), f"a readable FITS table; {error}") from None
    return _library(path, field, header, event, frame, x0, y0, spans)


def _library(
    path: Path,
    field: str,
    header: JsonObject,
    event: Ints,
    frame: Ints | None,
    x0: Ints,
    y0: Ints,
    spans: list[NDArray[np.float64]],
) -> Library:
    """Rows of the table, checked, as events of pixels."""
    exposure_s, pixels = (_positive(path, field, header, n) for n in ("EXPTIME", "NUM_PIX"))
    lengths = np.array(list(map(len, spans)), dtype=np.int64)
    electrons = np.concatenate([np.empty(0), *spans])
    _check_rows(path, field, electrons, x0, y0)
    row = np.repeat(np.arange(len(spans)), lengths)
    along = np.arange(len(row)) - np.repeat(np.cumsum(lengths) - lengths, lengths)
    order = np.argsort(event[row], kind="stable")
    row = row[order]
    _, first = np.unique(event[row], return_index=True)
    start = np.append(first, len(row)).astype(np.int64)
    x, y = x0[row] + along[order], y0[row]
    shape = _shape(header)
    if shape and len(x) and (y.max() >= shape[0] or x.max() >= shape[1]):
        raise BadInput(
            field,
            f"{path.name} with a pixel at {x.max()}, {y.max()}",
            f"places in its {shape[0]} rows and {shape[1]} columns",
        )
    pitch = header.get("PITCH_UM")
    frames, of_event = _frames_of(path, field, header.get("FRAMES"), frame, row[start[:-1]])
    return Library(
        start,
        x,
        y,
        electrons[order],
        exposure_s,
        pixels,
        float(pitch) if isinstance(pitch, int | float) and pitch > 0 else None,
        shape,
        frames,
        of_event,
    )


def _check_rows(path: Path, field: str, electrons: NDArray[np.float64], x0: Ints, y0: Ints) -> None:
    """BadInput for charges that are none, and for pixels at impossible places."""
    if not np.isfinite(electrons).all() or (electrons < 0).any():
        raise BadInput(field, f"{path.name} with a negative or NaN charge", "electrons, 0 or more")
    if len(x0) and (min(x0.min(), y0.min()) < 0 or max(x0.max(), y0.max()) > LARGEST_PLACE):
        raise BadInput(
            field,
            f"{path.name} with a pixel at {x0.min()}, {y0.min()} to {x0.max()}, {y0.max()}",
            f"places from 0 to {LARGEST_PLACE}",
        )


def _frames_of(
    path: Path, field: str, frames: object, frame: Ints | None, rows: Ints
) -> tuple[int | None, Ints]:
    """How many frames there are, and that of each event, by its row; None, 0 where not said."""
    if frame is None or not isinstance(frames, int) or frames < 1:
        return None, np.zeros(len(rows), np.int64)
    of_event = frame[rows]
    if len(of_event) and not 0 <= of_event.min() <= of_event.max() < frames:
        raise BadInput(
            field,
            f"{path.name} with an event of frame {of_event.max()}",
            f"frames 0 to {frames - 1}",
        )
    return frames, of_event


def _positive(path: Path, field: str, header: JsonObject, name: str) -> Any:
    value = header.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float) or not value > 0:
        raise BadInput(field, f"{path.name} with {name} = {value}", f"{name} above 0")
    return value


def _shape(header: JsonObject) -> tuple[int, int] | None:
    rows, columns = header.get("ROWS"), header.get("COLUMNS")
    return (int(rows), int(columns)) if rows and columns else None


def write_library(path: Path, library: Library) -> None:
    """Write a library that says its shape, whole or not at all."""
    from astropy.io import fits

    event = np.repeat(np.arange(len(library)), np.diff(library.start))
    new = np.ones(len(event), bool)
    new[1:] = (np.diff(event) != 0) | (np.diff(library.y) != 0) | (np.diff(library.x) != 1)
    first = np.flatnonzero(new)
    spans = np.empty(len(first), dtype=object)
    for n, span in enumerate(np.split(library.electrons.astype(np.float32), first[1:])):
        spans[n] = span if len(first) else np.empty(0, np.float32)
    columns = [
        fits.Column("fp_id", "J", array=event[first]),
        fits.Column("x0", "J", array=library.x[first]),
        fits.Column("y0", "J", array=library.y[first]),
        fits.Column("pixel_values", "PE()", array=spans, unit="electron"),
        fits.Column("frame", "J", array=library.frame[event[first]]),
    ]
    table = fits.BinTableHDU.from_columns(columns, name=TABLE)
    keys = {
        "EXPTIME": library.exposure_s,
        "NUM_PIX": library.pixels,
        "FRAMES": library.frames,
        "PITCH_UM": library.pixel_pitch_um,
    }
    if library.shape is not None:
        keys |= {"ROWS": library.shape[0], "COLUMNS": library.shape[1]}
    table.header.update({name: value for name, value in keys.items() if value is not None})
    content = io.BytesIO()
    fits.HDUList([fits.PrimaryHDU(), table]).writeto(content)
    write_atomically(path, content.getvalue())


@dataclass(frozen=True)
class DarkStack:
    """Dark frames in files, each of one frame or of several (frames, rows, columns)."""

    files: tuple[Path, ...]
    counts: tuple[int, ...]
    shape: tuple[int, int]

    @property
    def frames(self) -> int:
        return sum(self.counts)

    def band(self, start: int, stop: int) -> NDArray[np.float32]:
        """Rows start to stop of all frames, (frames, stop - start, columns)."""
        return np.concatenate([_rows(path, start, stop) for path in self.files])


def open_darks(paths: Sequence[Path]) -> DarkStack:
    """Look at the files of a stack; BadInput where they do not fit together."""
    counts: list[int] = []
    shapes: list[tuple[int, int]] = []
    for path in paths:
        shape = _stored_shape(path)
        if len(shape) not in (2, 3) or min(shape) < 1:
            raise BadInput("DARK_FRAMES", f"{path} of shape {shape}", "frames of rows x columns")
        counts.append(1 if len(shape) == 2 else shape[0])
        shapes.append((shape[-2], shape[-1]))
        if shapes[-1] != shapes[0]:
            raise BadInput(
                "DARK_FRAMES",
                f"{path} of shape {shapes[-1]}",
                f"frames of one shape: {paths[0]} has {shapes[0]}",
            )
    if sum(counts) < FEWEST_FRAMES:
        raise BadInput("DARK_FRAMES", f"{sum(counts)} frame(s)", f"at least {FEWEST_FRAMES}")
    return DarkStack(tuple(paths), tuple(counts), shapes[0])


def _stored_shape(path: Path) -> tuple[int, ...]:
    """Shape of the numbers in a file."""
    allowed = "an existing .npy or .fits file of dark frames"
    if not path.is_file():
        raise BadInput("DARK_FRAMES", str(path), allowed)
    try:
        if path.suffix == ".npy":
            stored = np.load(path, mmap_mode="r", allow_pickle=False)
            shape, kind = stored.shape, stored.dtype.kind
        elif path.name.endswith((".fits", ".fits.gz", ".fit", ".fits.fz")):
            from astropy.io import fits

            with fits.open(path) as hdus:
                hdu = next((h for h in hdus if h.is_image and h.shape), None)
                shape, kind = (hdu.shape if hdu is not None else ()), "f"
        else:
            raise BadInput("DARK_FRAMES", str(path), allowed)
    except (OSError, ValueError, EOFError, TypeError) as error:
        raise BadInput("DARK_FRAMES", str(path), f"a readable image; {error}") from None
    if kind not in "fiu":
        raise BadInput("DARK_FRAMES", f"{path} of type {kind!r}", "numbers")
    return tuple(int(n) for n in shape)


def _rows(path: Path, start: int, stop: int) -> NDArray[np.float32]:
    """Some rows of all frames of a file, (frames, rows, columns)."""
    try:
        if path.suffix == ".npy":
            part = np.load(path, mmap_mode="r", allow_pickle=False)[..., start:stop, :]
        else:
            from astropy.io import fits

            with fits.open(path) as hdus:
                hdu = next(h for h in hdus if h.is_image and h.shape)
                part = hdu.section[..., start:stop, :]
        part = np.asarray(part, dtype=np.float32)
    except (OSError, ValueError, EOFError, TypeError) as error:
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
    in frames and in bands.
    """
    from pipeline.physics.cosmic_rays.detect import bad_pixels, find_events

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
    from pipeline.physics.cosmic_rays.detect import stack_levels, steady_sigma

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
    from pipeline.physics.cosmic_rays.detect import residual

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
