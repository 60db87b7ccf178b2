"""Detections against the truth: what was found of each magnitude, and what was not there."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from catalog_tools.documents import JsonObject
from pipeline.export.labels import TARGET, Labels
from pipeline.studies.detection.points import Detections

Array = NDArray[np.float64]

POINT_PX = 3.0  # longest path of what is sought as a point
NEAR_PX = 2.5  # a detection is that of a source whose middle or line is so near
ALONG = 0.6  # of a streak's length, from its middle
SEEN_SNR = 3.0  # sources of that signal-to-noise can explain a detection
STEP_PX = 1.0


@dataclass(frozen=True)
class DetectionVerdict:
    """What the detections of one frame are.

    found : (n,) of the labels; explained : (m,) detections that lie on some source of SEEN_SNR or
    more, right : those that stand for one of the sources sought
    """

    found: NDArray[np.bool_]
    right: NDArray[np.bool_]
    explained: NDArray[np.bool_]

    @property
    def fragments(self) -> int:
        """Detections on a source of the other kind, or again on one: no false light."""
        return int(np.sum(self.explained & ~self.right))

    @property
    def false(self) -> int:
        """Detections where there is nothing."""
        return int(np.sum(~self.explained & ~self.right))


def judge(labels: Labels, sought: NDArray[np.bool_], found: Detections) -> DetectionVerdict:
    """Match detections with the sources sought, one to one, brightest detections first.

    A point matches within NEAR_PX of the centroid of a source's light, a streak within NEAR_PX
    across and ALONG times its length along; of several sources the one of most signal-to-noise.
    Other detections are explained if any source's path of SEEN_SNR or more passes within NEAR_PX.
    """
    which = np.zeros(len(labels), bool)
    right = np.zeros(len(found), bool)
    places = np.flatnonzero(sought)
    if places.size and len(found):
        reach = NEAR_PX + ALONG * labels.length_px[places]
        tree = cKDTree(np.stack([labels.x_light_px[places], labels.y_light_px[places]], axis=-1))
        for i in np.argsort(-found.snr, kind="stable"):
            at = (found.x_px[i], found.y_px[i])
            near = places[tree.query_ball_point(at, float(reach.max()))]
            near = near[~which[near]]
            along, across = _along_across(labels, near, *at)
            fits = (np.abs(across) < NEAR_PX) & (
                np.abs(along) < np.maximum(NEAR_PX, ALONG * labels.length_px[near])
            )
            if fits.any():
                gap = np.hypot(along[fits], across[fits])
                best = near[fits][np.lexsort((gap, -labels.snr[near[fits]]))[0]]
                which[best], right[i] = True, True
    return DetectionVerdict(which, right, _explained(labels, found))


def _along_across(
    labels: Labels, which: NDArray[np.intp], x: float, y: float
) -> tuple[Array, Array]:
    """Offsets of a place from sources' middles, along and across their paths."""
    dx, dy = x - labels.x_light_px[which], y - labels.y_light_px[which]
    turn = np.radians(labels.angle_deg[which])
    return dx * np.cos(turn) + dy * np.sin(turn), dy * np.cos(turn) - dx * np.sin(turn)


def _explained(labels: Labels, found: Detections) -> NDArray[np.bool_]:
    """Whether a source's straight path passes near each detection; bright ones reach farther."""
    seen = np.flatnonzero(labels.snr >= SEEN_SNR)
    if not len(found) or not seen.size:
        return np.zeros(len(found), bool)
    count = np.ceil(labels.length_px[seen] / STEP_PX).astype(int) + 1
    ends = np.cumsum(count)
    step = np.arange(ends[-1]) - np.repeat(ends - count, count)
    part = step / np.repeat(np.maximum(count - 1, 1), count)
    source = np.repeat(seen, count)
    # The wings of a source 100 times brighter are as bright some times farther out.
    far = NEAR_PX * np.maximum(1.0, (labels.snr[source] / 100.0) ** 0.5)
    x, y = (
        start[source] + part * (end - start)[source]
        for start, end in (
            (labels.x_start_px, labels.x_end_px),
            (labels.y_start_px, labels.y_end_px),
        )
    )
    places = np.stack([found.x_px, found.y_px], axis=-1)
    out = np.zeros(len(found), bool)
    size = np.floor(np.log2(far))
    for one in np.unique(size):
        alike = size == one
        out |= _within(np.stack([x, y], axis=-1)[alike], far[alike], places)
    return out


def _within(discs: Array, radii: Array, places: Array) -> NDArray[np.bool_]:
    """Whether each place lies in one of the discs, by the nearest neighbour alone.

    A disc stands so high over the plane that the sphere of the largest radius cuts it out there.
    """
    most = float(radii.max())
    height = np.sqrt(most**2 - radii**2)
    tree = cKDTree(np.column_stack([discs, height]))
    gap, _ = tree.query(np.column_stack([places, np.zeros(len(places))]))
    return np.asarray(gap < most)


def by_magnitude(
    labels: Labels, sought: NDArray[np.bool_], found: NDArray[np.bool_], edges: Array
) -> list[JsonObject]:
    """Stars sought and found in bins of G: [{faint, bright, sought, found}]."""
    stars = sought & (labels.kind != TARGET)
    out = []
    for low, high in itertools.pairwise(edges):
        bin_ = stars & (labels.g_mag >= low) & (labels.g_mag < high)
        out.append(
            {
                "bright_mag": float(low),
                "faint_mag": float(high),
                "sought": int(bin_.sum()),
                "found": int((bin_ & found).sum()),
            }
        )
    return out
