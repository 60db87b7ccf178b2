"""Recorded cosmic-ray events set into a frame: at random places, or whole frames, cut or tiled.

The recorded charge is used pixel by pixel, whatever the sizes of the pixels; only the rate follows
the area.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pipeline.physics.cosmic_rays.tracks import COUNT_PLACE
from pipeline.physics.noise.streams import philox, poisson, uniform

Array = NDArray[np.float64]
Whole = NDArray[np.int64]


@dataclass(frozen=True)
class Library:
    """Events of a stack of dark frames; the pixels of event n are start[n] to start[n + 1].

    start : (n + 1,); x, y : (m,) recorded pixels; electrons : (m,) charge in them
    exposure_s : of the whole stack; pixels : of one of its frames
    pixel_pitch_um, shape (rows, columns), frames : None where not recorded
    frame : (n,) the frame of each event; zeros where not recorded
    """

    start: Whole
    x: Whole
    y: Whole
    electrons: Array
    exposure_s: float
    pixels: int
    pixel_pitch_um: float | None
    shape: tuple[int, int] | None
    frames: int | None
    frame: Whole

    def __len__(self) -> int:
        return len(self.start) - 1

    @property
    def rate_per_px_s(self) -> float:
        """Recorded events per pixel and second."""
        return len(self) / (self.pixels * self.exposure_s)

    def boxes(self) -> tuple[Whole, Whole, Whole, Whole]:
        """First and last column and row of each event: x0, x1, y0, y1 (n,)."""
        s = self.start[:-1]
        if not len(s):
            none = np.empty(0, np.int64)
            return none, none, none, none
        return (
            np.minimum.reduceat(self.x, s),
            np.maximum.reduceat(self.x, s),
            np.minimum.reduceat(self.y, s),
            np.maximum.reduceat(self.y, s),
        )


@dataclass(frozen=True)
class Recorded:
    """How a library's events come onto frames of (rows, columns).

    rate_scale : relative to the recorded rate; arrival : "poisson" or "frames"
    """

    library: Library
    rows: int
    columns: int
    pixel_pitch_um: float
    integration_s: float
    rate_scale: float = 1.0
    arrival: str = "poisson"


@dataclass(frozen=True)
class PlacedEvents:
    """Library events on a frame, (n,): which one, and by how much it is moved [px]."""

    number: Whole
    dx: Whole
    dy: Whole

    def __len__(self) -> int:
        return len(self.number)


def mean_count(r: Recorded) -> float:
    """Expected events on the frame's own area, as long as each touches it."""
    pitch = r.library.pixel_pitch_um or r.pixel_pitch_um
    rate = r.rate_scale * r.library.rate_per_px_s * (r.pixel_pitch_um / pitch) ** 2
    return rate * r.rows * r.columns * r.integration_s


def expected_count(r: Recorded) -> float:
    """Expected events that are placed on a frame or beside it, copies of the tiling included."""
    lib = r.library
    if not len(lib):
        return 0.0
    if r.arrival == "frames":
        assert lib.shape is not None
        copies = len(_offsets(lib.shape[0], r.rows)) * len(_offsets(lib.shape[1], r.columns))
        return r.rate_scale * r.integration_s * len(lib) / lib.exposure_s * copies
    left, right, top, bottom = lib.boxes()
    width, height = int((right - left).max()), int((bottom - top).max())
    return mean_count(r) * (r.rows + height) * (r.columns + width) / (r.rows * r.columns)


def place_events(r: Recorded, frame: int, key: tuple[int, int]) -> PlacedEvents:
    """The library events of a frame, from its stream alone."""
    if not len(r.library):
        none = np.empty(0, np.int64)
        return PlacedEvents(none, none, none)
    return _whole_frames(r, frame, key) if r.arrival == "frames" else _singly(r, frame, key)


def _singly(r: Recorded, frame: int, key: tuple[int, int]) -> PlacedEvents:
    """A Poisson number of events, each any of the library, anywhere it touches the frame."""
    left, right, top, bottom = r.library.boxes()
    width, height = int((right - left).max()), int((bottom - top).max())
    count = int(poisson(expected_count(r), COUNT_PLACE, COUNT_PLACE, frame, *key))
    u = _three_uniforms(count, frame, *key)
    number = np.floor(u[0] * len(r.library)).astype(np.int64)
    x = np.floor(u[1] * (r.columns + width)).astype(np.int64) - width
    y = np.floor(u[2] * (r.rows + height)).astype(np.int64) - height
    touch = (x + (right - left)[number] >= 0) & (y + (bottom - top)[number] >= 0)
    return PlacedEvents(number[touch], (x - left[number])[touch], (y - top[number])[touch])


def _whole_frames(r: Recorded, frame: int, key: tuple[int, int]) -> PlacedEvents:
    """Whole frames: recorded frames drawn at random, with all of their events or none.

    Their number is rate_scale times the exposure over that of a recorded frame; a fraction is one
    more frame with that probability. Needs `shape` and `frames`.
    """
    lib = r.library
    assert lib.shape is not None
    assert lib.frames is not None
    wanted = r.rate_scale * r.integration_s * lib.frames / lib.exposure_s
    (extra,) = _three_uniforms(1, frame, *key)[0]
    count = math.floor(wanted) + int(extra < wanted % 1.0)
    chosen = np.floor(_three_uniforms(count + 1, frame, *key)[1, 1:] * lib.frames).astype(np.int64)
    order = np.argsort(lib.frame, kind="stable")
    first = np.searchsorted(lib.frame[order], np.arange(lib.frames + 1))
    number = np.concatenate(
        [np.empty(0, np.int64), *(order[first[c] : first[c + 1]] for c in chosen)]
    )
    dx = _offsets(lib.shape[1], r.columns)
    dy = _offsets(lib.shape[0], r.rows)
    gx, gy = (g.ravel() for g in np.meshgrid(dx, dy))
    return PlacedEvents(
        np.repeat(number, len(gx)), np.tile(gx, len(number)), np.tile(gy, len(number))
    )


def _offsets(recorded: int, wanted: int) -> Whole:
    """Moves along one axis: the cut-out from the centre, or as many copies as it takes."""
    if wanted <= recorded:
        return np.array([-((recorded - wanted) // 2)], dtype=np.int64)
    return np.arange(0, wanted, recorded, dtype=np.int64)


def add_events(
    image_e: Array | None, placed: PlacedEvents, r: Recorded, place: tuple[int, int, int, int]
) -> Array:
    """Add placed events to an image in place; electrons (n,) of each inside the rectangle.

    place : (y0, x0, rows, columns) of the rectangle in the frame; image_e : (rows, columns) or
    None.
    """
    sums = np.zeros(len(placed))
    if not len(placed):
        return sums
    y0, x0, rows, columns = place
    left, right, top, bottom = (b[placed.number] for b in r.library.boxes())
    touch = (right + placed.dx >= x0) & (left + placed.dx < x0 + columns)
    touch &= (bottom + placed.dy >= y0) & (top + placed.dy < y0 + rows)
    which = np.flatnonzero(touch)
    lib = r.library
    _add(
        np.empty((0, 0)) if image_e is None else image_e,
        np.array(place),
        sums,
        which,
        placed.number,
        placed.dx,
        placed.dy,
        lib.start,
        lib.x,
        lib.y,
        lib.electrons,
    )
    return sums


@njit(cache=True, nogil=True)
def _add(image, place, sums, which, number, dx, dy, start, x, y, electrons):
    y0, x0, rows, columns = place
    for n in which:
        for k in range(start[number[n]], start[number[n] + 1]):
            j, i = y[k] + dy[n] - y0, x[k] + dx[n] - x0
            if 0 <= j < rows and 0 <= i < columns:
                sums[n] += electrons[k]
                if image.size:
                    image[j, i] += electrons[k]


@njit(cache=True, nogil=True)
def _three_uniforms(count, frame, k0, k1):
    """(3, count) uniforms of the events of a frame."""
    out = np.empty((3, count))
    for event in range(count):
        a, b, c, d = philox(event, 0, frame, 0, k0, k1)
        out[0, event], out[1, event] = uniform(a, b), uniform(c, d)
        a, b, c, d = philox(event, 0, frame, 1, k0, k1)
        out[2, event] = uniform(a, b)
    return out
