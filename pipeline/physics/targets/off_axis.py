"""A resolved body off the axis of a camera: its picture through the camera's perspective."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from pipeline.physics.targets.disc import EVERYWHERE, Appearance, Box, Points

Array = NDArray[np.float64]
Places = tuple[Array, Array]  # x_px, y_px from the reference point
Place = TypeVar("Place", float, Array)
ROOM = 1e-9  # beside a box, over its size, for rounding


@dataclass(frozen=True)
class Perspective:
    """The map of places from a body's reference point: of a plane across the line of sight to the
    focal plane, both in pixels of the middle of the field.

    x' = (xx x + xy y) / w and y' = (yx x + yy y) / w, with w = 1 + wx x + wy y: a gnomonic camera's
    is of this form (Calabretta & Greisen 2002, section 5.1.3), and with its distortion nearly so.
    """

    xx: float
    xy: float
    yx: float
    yy: float
    wx: float
    wy: float

    def forward(self, x: Place, y: Place) -> tuple[Place, Place]:
        """Places on the focal plane."""
        w = 1.0 + self.wx * x + self.wy * y
        return (self.xx * x + self.xy * y) / w, (self.yx * x + self.yy * y) / w

    def back(self, x: Array, y: Array) -> Places:
        """Places across the line of sight: the inverse of `forward`."""
        a, b = self.xx - x * self.wx, self.xy - x * self.wy
        c, d = self.yx - y * self.wx, self.yy - y * self.wy
        size = a * d - b * c
        return (d * x - b * y) / size, (a * y - c * x) / size

    def stretch(self, box: Box) -> float:
        """The largest factor by which it stretches any length within a box; infinite where that
        reaches behind the camera."""
        x, y = _corners(box)
        w = 1.0 + self.wx * x + self.wy * y
        if w.min() <= 0.0:
            return np.inf
        u, v = self.forward(x, y)
        each = [[self.xx - u * self.wx, self.xy - u * self.wy],
                [self.yx - v * self.wx, self.yy - v * self.wy]]  # fmt: skip
        return float(np.linalg.norm(np.moveaxis(np.array(each) / w, 2, 0), 2, axis=(1, 2)).max())


@dataclass(frozen=True)
class OffAxis:
    """A body seen off the axis; its light stays, and so its brightness falls where it grows."""

    body: Appearance
    perspective: Perspective

    @property
    def box(self) -> Box:
        return _around(*self.perspective.forward(*_corners(self.body.box)))

    def points(self, finest_per_px: float, box: Box = EVERYWHERE) -> Points:
        """The body's points, as fine as the stretch makes the waves across it at most."""
        finer = finest_per_px * self.perspective.stretch(self.body.box)
        y, x, share = self.body.points(finer, self._before(box))
        x, y = self.perspective.forward(x, y)
        inside = (y >= box[0]) & (y < box[1]) & (x >= box[2]) & (x < box[3])
        return y[inside], x[inside], share[inside]

    def _before(self, box: Box) -> Box:
        """A box that holds all of the body that a box of the picture shows."""
        own = self.box
        y0, y1 = np.clip(box[:2], own[0], own[1]).tolist()
        x0, x1 = np.clip(box[2:], own[2], own[3]).tolist()
        y0, y1, x0, x1 = _around(*self.perspective.back(*_corners((y0, y1, x0, x1))))
        room = ROOM * max(abs(v) for v in self.body.box)
        return y0 - room, y1 + room, x0 - room, x1 + room


def _corners(box: Box) -> Places:
    x, y = np.meshgrid(box[2:], box[:2])
    return x.ravel(), y.ravel()


def _around(x: Array, y: Array) -> Box:
    return float(y.min()), float(y.max()), float(x.min()), float(x.max())
