"""The sources of a frame as labels: one list from the truth tables, for every format."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import seen_ends
from pipeline.export.response import STEP_PX, arc_nodes, arc_segments
from pipeline.physics.motion.streak import Box, within
from pipeline.store.truth import read_truth

Array = NDArray[np.float64]

MOST_NODES = 1_000_000  # of paths that are looked at together
TARGET, STAR = 1, 2  # class numbers, as SatNet counts them
CLASS_NAMES = {TARGET: "Satellite", STAR: "Star"}
_COLUMNS = (
    "x_px",
    "y_px",
    "x_start_px",
    "y_start_px",
    "x_end_px",
    "y_end_px",
    "x_light_px",
    "y_light_px",
    "ra_deg",
    "dec_deg",
    "electrons",
    "snr",
)
_LATER = ("g_mag", "v_mag", "mag_ab", "radius_px", "visible_fraction")


@dataclass(frozen=True)
class Labels:
    """Sources of one frame, targets first, each part brightest first; arrays of length n.

    kind : TARGET or STAR; name : a target's name, a star's catalogue id. Masks carry the place in
    the list, from 1
    x_px, y_px : at mid-exposure (pixel (0, 0) is the centre of the first); start and end of the
    path; x_light_px, y_light_px : the centroid of the light as drawn
    ra_deg, dec_deg : astrometric ICRS, what the WCS gives; electrons in the exposure
    snr : matched filter; g_mag : of stars, NaN for targets; v_mag, mag_ab : of targets, NaN for
    stars (V of Vega's system, AB in the sensor's band); radius_px : of bodies with a disc
    object_name : what a catalogue calls a target; a star's catalogue id
    visible_fraction : the part of the exposure in which nothing hides it
    """

    kind: NDArray[np.int64]
    name: NDArray[np.str_]
    x_px: Array
    y_px: Array
    x_start_px: Array
    y_start_px: Array
    x_end_px: Array
    y_end_px: Array
    x_light_px: Array
    y_light_px: Array
    ra_deg: Array
    dec_deg: Array
    electrons: Array
    snr: Array
    g_mag: Array
    v_mag: Array
    mag_ab: Array
    radius_px: Array
    object_name: NDArray[np.str_]
    visible_fraction: Array

    def __len__(self) -> int:
        return len(self.kind)

    @cached_property
    def length_px(self) -> Array:
        """From the start to the end of each path, straight."""
        return np.hypot(self.x_end_px - self.x_start_px, self.y_end_px - self.y_start_px)

    @cached_property
    def angle_deg(self) -> Array:
        """Direction from start to end, from +x (columns) towards +y (rows); 0 where it stands."""
        return np.degrees(
            np.arctan2(self.y_end_px - self.y_start_px, self.x_end_px - self.x_start_px)
        )

    @property
    def magnitude(self) -> Array:
        """G of stars, V of targets."""
        return np.where(self.kind == STAR, self.g_mag, self.v_mag)

    def path_px(self, i: int) -> tuple[Array, Array, Array]:
        """Start, middle and end (x, y) of the path that one sends light from.

        Of one that is hidden for a part of the exposure the place at mid-exposure need not lie on
        it: it is straight.
        """
        start, middle, end = (
            np.array([getattr(self, f"{axis}{which}_px")[i] for axis in "xy"])
            for which in ("_start", "", "_end")
        )
        return start, middle if self.visible_fraction[i] >= 1.0 else 0.5 * (start + end), end

    def take(self, index: object) -> Labels:
        """Some of them."""
        return Labels(**{f.name: getattr(self, f.name)[index] for f in fields(self)})


def frame_labels(
    product: Path, frame: int, shape: tuple[int, int], stars_snr: float | None = None
) -> Labels:
    """Labels of a frame of a complete product.

    shape : (rows, columns) of the frame; sources no part of whose path lies in it are omitted
    stars_snr : stars of this signal-to-noise and more are labelled; None: targets alone
    """
    parts = [_part(product, TARGET, frame, shape, 0.0)]
    if stars_snr is not None:
        parts.append(_part(product, STAR, frame, shape, stars_snr))
    return Labels(
        **{f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Labels)}
    )


def _part(product: Path, kind: int, frame: int, shape: tuple[int, int], least_snr: float) -> Labels:
    """One truth table's rows of a frame that send light and come into it; empty where there is no
    table."""
    table, *names = {
        TARGET: ("targets", "name", "radius_px", "object_name", "v_mag", "mag_ab"),
        STAR: ("stars", "source_id", "g_mag"),
    }[kind]
    wanted = (*_COLUMNS, *names, "visible_fraction")
    rows = read_truth(product, table, wanted, [("frame", "=", frame)])
    if rows is None:
        empty = {f.name: np.empty(0) for f in fields(Labels)}
        return Labels(
            **{
                **empty,
                "kind": np.empty(0, np.int64),
                "name": np.empty(0, "U64"),
                "object_name": np.empty(0, "U80"),
            }
        )
    got = {c: rows[c].to_numpy() for c in rows.column_names}
    # products of earlier versions hold none of these
    got.setdefault("radius_px", np.zeros(rows.num_rows))
    got.setdefault("visible_fraction", np.ones(rows.num_rows))
    got.setdefault("object_name", got[names[0]])
    for name in ("g_mag", "v_mag", "mag_ab"):
        got.setdefault(name, np.full(rows.num_rows, np.nan))
    for axis in "xy":
        got.setdefault(f"{axis}_light_px", got[f"{axis}_px"])
        names_of = [f"{axis}_{at}px" for at in ("start_", "", "end_")]
        start, end = seen_ends(*(got[n] for n in names_of))
        middle = np.where(np.isnan(got[names_of[1]]), 0.5 * (start + end), got[names_of[1]])
        got |= dict(zip(names_of, (start, middle, end), strict=True))
    kept = np.flatnonzero((got["electrons"] > 0) & (got["snr"] >= least_snr))
    kept = kept[np.argsort(-got["electrons"][kept], kind="stable")]
    n = len(kept)
    labels = Labels(
        kind=np.full(n, kind, np.int64),
        name=got[names[0]][kept].astype("U64"),
        object_name=got["object_name"][kept].astype("U80"),
        **{c: got[c][kept].astype(float) for c in (*_COLUMNS, *_LATER)},
    )
    return labels.take(_crosses(labels, shape, labels.visible_fraction >= 1.0))


def _crosses(
    labels: Labels, shape: tuple[int, int], seen: NDArray[np.bool_] | None = None
) -> NDArray[np.bool_]:
    """Whether some part of each path lies within the frame: the arc that masks are drawn along.

    seen : all the while, where not all are. The path of others begins and ends where they come
    out or hide, their place at mid-exposure need not lie on it, and it is taken as straight.
    """
    start, middle, end = (
        getattr(labels, f"x{w}_px") + 1j * getattr(labels, f"y{w}_px")
        for w in ("_start", "", "_end")
    )
    box = (-0.5, shape[1] - 0.5, -0.5, shape[0] - 0.5)
    out = _enters(np.stack([start, end], axis=-1), box)
    bend_px = np.abs(0.5 * (start + end) - middle)
    bent = np.isfinite(bend_px) & (bend_px > 0.5 * STEP_PX)
    bent &= True if seen is None else seen
    order = np.flatnonzero(bent)[np.argsort(bend_px[bent])]
    while order.size:
        segments = arc_segments(float(bend_px[order[-1]]))
        many = max(1, MOST_NODES // segments)
        order, some = order[:-many], order[-many:]
        ways = middle[some] - start[some], end[some] - middle[some]
        out[some] = _enters(middle[some, None] + arc_nodes(*ways, segments), box)
    return out


def _enters(nodes: NDArray[np.complex128], box: Box) -> NDArray[np.bool_]:
    """Whether polylines through nodes (n, k), x + iy, come into a box."""
    at, way = nodes[:, :-1], np.diff(nodes, axis=1)
    first, last = within(at.real, at.imag, way.real, way.imag, box)
    return np.asarray((first <= last).any(axis=1))
