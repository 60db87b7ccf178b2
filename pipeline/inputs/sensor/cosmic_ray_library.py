"""Libraries of recorded cosmic rays: read and written.

A library is a FITS file with a table COSMIC_RAYS, a row for each run of pixels along x: fp_id (the
event), x0, y0 (its first pixel), pixel_values (electrons), frame; header EXPTIME (seconds of the
whole stack) and NUM_PIX (pixels of a frame). Ours also says ROWS, COLUMNS, FRAMES, PITCH_UM.
LSST's harvested events (imSim) have the same columns, without `frame` and those keys.
"""

from __future__ import annotations

import io
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from astropy.io import fits
from numpy.typing import NDArray

from catalog_tools.documents import JsonObject
from catalog_tools.storage.durable import write_atomically
from pipeline.errors import BadInput
from pipeline.lazily import open_fits
from pipeline.physics.cosmic_rays.library import Library

Ints = NDArray[np.int64]

FIELD = "cosmic_rays.path"
TABLE = "COSMIC_RAYS"
COLUMNS = ("fp_id", "x0", "y0", "pixel_values")
LARGEST_BYTES = 1_000_000_000
LARGEST_PLACE = 1_000_000


def read_library(path: Path, field: str = FIELD) -> Library:
    """Read a library; BadInput names what is missing or wrong."""
    if not path.is_file():
        raise BadInput(field, str(path), "an existing library (FITS table COSMIC_RAYS)")
    if path.stat().st_size > LARGEST_BYTES:
        raise BadInput(field, str(path), f"a file of at most {LARGEST_BYTES} bytes")
    try:
        with open_fits(path) as hdus:
            if TABLE not in hdus:
                raise BadInput(field, str(path), f"a FITS file with a table {TABLE}")
            table = hdus[TABLE].data
            names = set(table.names)
            lacking = [name for name in COLUMNS if name not in names]
            if lacking:
                raise BadInput(field, str(path), f"a table with a column {lacking[0]}")
            whole = [name for name in (*COLUMNS[:3], "frame") if name in names]
            event, x0, y0, *frame = (np.asarray(table[n]).astype(np.int64) for n in whole)
            spans = [np.atleast_1d(np.asarray(s, np.float64)) for s in table["pixel_values"]]
            _check_dimensions([event, x0, y0, *frame, *spans])
            header = dict(hdus[TABLE].header)
    except (OSError, ValueError, TypeError, KeyError, IndexError, AttributeError) as error:
        raise BadInput(field, str(path), f"a readable FITS table; {error}") from None
    return _library(path, field, header, event, next(iter(frame), None), x0, y0, spans)


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
    shape = _shape(path, field, header)
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


def _check_dimensions(arrays: Iterable[np.ndarray]) -> None:
    """ValueError unless columns hold a number in each row, and spans of pixels are runs."""
    if any(array.ndim != 1 for array in arrays):
        raise ValueError("a row holds more than one number, or more than a run of pixels")


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


def _shape(path: Path, field: str, header: JsonObject) -> tuple[int, int] | None:
    """The rows and columns of its frames; None where it does not say."""
    if "ROWS" not in header or "COLUMNS" not in header:
        return None
    rows, columns = (int(_positive(path, field, header, name)) for name in ("ROWS", "COLUMNS"))
    return rows, columns


def write_library(path: Path, library: Library) -> None:
    """Write a library that says its shape, whole or not at all."""
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
