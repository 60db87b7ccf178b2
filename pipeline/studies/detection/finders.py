"""The finders of the study: what each is run on, and which sources it is asked for."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from pipeline.export.labels import STAR, TARGET, Labels
from pipeline.studies.detection.judge import POINT_PX
from pipeline.studies.detection.points import Detections, find_points
from pipeline.studies.detection.streaks import Line, all_lines, find_lines, without_streaks

Array = NDArray[np.float64]
Finder = Callable[[Array, float, float], Detections]

EDGE_PX = 4.0  # sources nearer to the edge are not asked for
TITLES = {
    "sep": "sep on the frame",
    "sep_cleaned": "sep, star streaks taken off",
    "drift": "line filter of the known drift",
    "lines": "blind bank of line filters",
}


@dataclass(frozen=True)
class Task:
    """One finder on one frame: its key in TITLES, the image, and the labels that it should find."""

    kind: str
    image: Array
    sought: NDArray[np.bool_]
    find: Finder


def tasks(labels: Labels, image: Array) -> list[Task]:
    """The finders that a frame is given to.

    Where the stars stand, sep looks for points and the blind bank for streaks. Where they drift,
    the drift is taken as known, as any telescope's pointing tells it (here: the median of the
    stars' paths): one filter looks for the stars, the star streaks are taken off by a top-hat
    along the drift, and what is left is searched for points and for other streaks.
    """
    inside = np.ones(len(labels), bool)
    for place, side in ((labels.x_light_px, image.shape[1]), (labels.y_light_px, image.shape[0])):
        inside &= (place >= EDGE_PX) & (place <= side - 1 - EDGE_PX)
    short = labels.length_px <= POINT_PX
    drift = drift_of(labels)
    found: list[Task] = [Task("sep", image, inside & short, find_points)]
    blind = partial(find_lines, lines=all_lines())
    if drift is None:
        return [*found, Task("lines", image, inside & ~short, blind)]
    cleaned = without_streaks(image, drift)
    known = partial(find_lines, lines=[drift])
    targets = labels.kind == TARGET
    return [
        *found,
        Task("sep_cleaned", cleaned, inside & short, find_points),
        Task("drift", image, inside & ~short & ~targets, known),
        Task("lines", cleaned, inside & ~short & targets, blind),
    ]


def drift_of(labels: Labels) -> Line | None:
    """Length and direction of the stars' common streak; None where they are points or none is."""
    stars = labels.kind == STAR
    if not stars.any():
        return None
    dx, dy = (
        float(np.median((getattr(labels, f"{a}_end_px") - getattr(labels, f"{a}_start_px"))[stars]))
        for a in "xy"
    )
    length = math.hypot(dx, dy)
    return (length, math.atan2(dy, dx) % math.pi) if length > POINT_PX else None
