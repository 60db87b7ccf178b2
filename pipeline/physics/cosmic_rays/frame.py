"""Cosmic rays of one frame, generated or recorded: charge in any rectangle, and the truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from catalog_tools.documents import JsonObject
from pipeline.physics.cosmic_rays.deposit import add_tracks
from pipeline.physics.cosmic_rays.library import (
    PlacedEvents,
    Recorded,
    add_events,
    expected_count,
    place_events,
)
from pipeline.physics.cosmic_rays.tracks import Flux, draw_tracks, mean_count
from pipeline.physics.noise.streams import stream_key

Array = NDArray[np.float64]
CosmicRays = Flux | Recorded
COMPONENT = "cosmic_rays"


def events_a_frame(rays: CosmicRays) -> float:
    """Expected events that one frame draws."""
    return expected_count(rays) if isinstance(rays, Recorded) else mean_count(rays)


def exposed_for(rays: CosmicRays, integration_s: float) -> CosmicRays:
    """The same cosmic rays in an exposure of another length."""
    if rays.integration_s == integration_s:
        return rays
    return replace(rays, integration_s=integration_s)


def charge_e(
    rays: CosmicRays, seed: int, frame: int, y0: int, x0: int, rows: int, columns: int
) -> Array:
    """Electrons (rows, columns) that the cosmic rays of a frame leave in a rectangle of it.

    Drawn charge, no mean: nothing is to be drawn from it again. The bits of a pixel do not depend
    on the rectangle. Fractions of an electron are kept.
    """
    image, key = np.zeros((rows, columns)), stream_key(seed, COMPONENT)
    place = (y0, x0, rows, columns)
    if isinstance(rays, Recorded):
        add_events(image, place_events(rays, frame, key), rays, place)
    else:
        add_tracks(image, draw_tracks(rays, frame, key), rays, frame, key, place)
    return image


def truth_columns(rays: CosmicRays, seed: int, frame: int) -> JsonObject:
    """Columns of truth/cosmic_rays.parquet of one frame: the events that left charge in it.

    event : index in the frame's stream; x_in_px ... y_out_px : where it went into and came out of
    the silicon, also beside the frame (pixel (0, 0) is the centre of the first; a recorded event:
    corners of its box); length_um : its path in the silicon, masked where recorded; electrons :
    what the frame holds of it before the flat; kind : proton, muon, helium or recorded;
    library_event : which one, masked where generated
    """
    key, place = stream_key(seed, COMPONENT), (0, 0, rays.rows, rays.columns)
    if isinstance(rays, Recorded):
        placed = place_events(rays, frame, key)
        return _recorded(rays, placed, frame, add_events(None, placed, rays, place))
    t = draw_tracks(rays, frame, key)
    electrons = add_tracks(None, t, rays, frame, key, place)
    seen = electrons > 0.0
    t, back = t.taken(seen), t.enters_back[seen]
    single = "muon" if rays.zenith_power else "proton"
    return {
        "frame": np.full(len(t), frame, np.int32),
        "event": t.event,
        "x_in_px": np.where(back, t.x_back, t.x_front),
        "y_in_px": np.where(back, t.y_back, t.y_front),
        "x_out_px": np.where(back, t.x_front, t.x_back),
        "y_out_px": np.where(back, t.y_front, t.y_back),
        "length_um": t.path_um,
        "electrons": electrons[seen],
        "kind": np.where(t.charge_number > 1.0, "helium", single),
        "library_event": np.ma.masked_all(len(t), np.int64),
    }


def no_truth() -> JsonObject:
    """The same columns without rows."""
    none = Flux(1, 1, 10.0, 10.0, 0.0, 1.0)
    return truth_columns(none, 0, 0)


def _recorded(rays: Recorded, placed: PlacedEvents, frame: int, electrons: Array) -> JsonObject:
    seen = np.flatnonzero(electrons > 0.0)
    number = placed.number[seen]
    left, right, top, bottom = (b[number] for b in rays.library.boxes())
    dx, dy = placed.dx[seen], placed.dy[seen]
    return {
        "frame": np.full(len(seen), frame, np.int32),
        "event": seen.astype(np.int64),
        "x_in_px": (left + dx).astype(np.float64),
        "y_in_px": (top + dy).astype(np.float64),
        "x_out_px": (right + dx).astype(np.float64),
        "y_out_px": (bottom + dy).astype(np.float64),
        "length_um": np.ma.masked_all(len(seen), np.float64),
        "electrons": electrons[seen],
        "kind": np.full(len(seen), "recorded"),
        "library_event": number,
    }
