"""Unit stars at random phases, and what every engine must draw around them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.studies.accuracy.engines import EngineCase
from pipeline.studies.accuracy.reference import AiryStar, GaussianStar, exact_pixels
from pipeline.studies.worst import worst_of

Array = NDArray[np.float64]

NEAR_PX = 10  # around a place of the path every pixel is looked at, and further out some:
FAR_PX = (13, 17, 23, 31, 43, 61, 81)
EDGE_PX = ((1.3, 0.4), (-0.7, 0.5))  # probes at the frame's edges: (from the edge, along it)
SIDE_PX = 48  # beside a star's path: the square whose light is added up


@dataclass(frozen=True, eq=False)
class ProbeWindow:
    """Pixels of one probe and their exact light (rows, columns)."""

    rows: NDArray[np.int64]
    columns: NDArray[np.int64]
    exact: Array


@dataclass(frozen=True, eq=False)
class Probes:
    """Probe stars (n,) of unit light with their windows; the square [px] of their light.

    peak : light of a star's brightest pixel when it stands on a pixel's centre
    boxed : exact light in a square of `side_px` about the pixel of each probe, NaN at edges
    """

    x_px: Array
    y_px: Array
    windows: tuple[tuple[ProbeWindow, ...], ...]
    peak: float
    side_px: int
    boxed: Array

    def errors(self, k: int, image: NDArray[np.floating]) -> tuple[float, float | None]:
        """(largest error of a pixel over the peak, of the light or None at edges) of probe k."""
        worst = worst_of(
            *(np.abs(image[np.ix_(w.rows, w.columns)] - w.exact).max() for w in self.windows[k])
        )
        if np.isnan(self.boxed[k]):
            return worst / self.peak, None
        y0, x0 = self._corner(k)
        light = float(np.sum(image[y0 : y0 + self.side_px, x0 : x0 + self.side_px], dtype=float))
        return worst / self.peak, abs(light - float(self.boxed[k]))

    def _corner(self, k: int) -> tuple[int, int]:
        half = self.side_px // 2
        return round(float(self.y_px[k])) - half, round(float(self.x_px[k])) - half


def make_probes(case: EngineCase, count: int, seed: int = 1) -> Probes:
    """Probes on a loose grid, so that one image may hold all of them, and two at the edges."""
    rng = np.random.default_rng(seed)
    reach = 0.5 * case.streak_px + SIDE_PX
    x, y = _places(case, count, 2.0 * reach, rng)
    inside = x.size - len(EDGE_PX)
    windows = tuple(
        tuple(_window(case, t, float(x[k]), float(y[k])) for t in _parts(case, k, k < inside))
        for k in range(x.size)
    )
    side = 2 * int(np.ceil(reach)) + 1
    boxed = np.array([_boxed(case, float(a), float(b), side) for a, b in zip(x, y, strict=True)])
    dx, dy = _place(case, 0.5)
    at = np.arange(-3.0, 4.0)
    peak = float(exact_pixels(case.shape, case.track, -dx, -dy, at, at).max())
    return Probes(x, y, windows, peak, side, boxed)


def _places(
    case: EngineCase, count: int, apart_px: float, rng: np.random.Generator
) -> tuple[Array, Array]:
    rows, columns = case.frame
    down, across = (max(1, int(n // (apart_px + 2.0))) for n in case.frame)
    cells = rng.permutation(down * across)[:count]
    y = (cells // across + 0.5) * rows / down + rng.uniform(-0.5, 0.5, cells.size)
    x = (cells % across + 0.5) * columns / across + rng.uniform(-0.5, 0.5, cells.size)
    (off_a, along_a), (off_b, along_b) = EDGE_PX
    x = np.append(x, [off_a, columns // 3 + along_b])
    y = np.append(y, [rows // 3 + along_a, rows - 1.0 - off_b])
    return x, y


def _window(case: EngineCase, t: float, x: float, y: float) -> ProbeWindow:
    """Pixels about the place at time t of the path."""
    far = np.array(FAR_PX)
    offsets = np.concatenate([-far[::-1], np.arange(-NEAR_PX, NEAR_PX + 1), far])
    if isinstance(case.shape, GaussianStar):
        offsets = np.arange(-NEAR_PX, NEAR_PX + 1)
    dx, dy = _place(case, t)
    columns, rows = round(x + dx) + offsets, round(y + dy) + offsets
    columns = columns[(columns >= 0) & (columns < case.frame[1])]
    rows = rows[(rows >= 0) & (rows < case.frame[0])]
    exact = exact_pixels(case.shape, case.track, x, y, columns, rows)
    return ProbeWindow(rows, columns, exact)


def _parts(case: EngineCase, k: int, whole: bool) -> tuple[float, ...]:
    """Where on the path a probe's windows stand: its middle, and one end after the other."""
    if not (whole and case.streak_px):
        return (0.5,)
    return (0.5, float(k % 2))


def _place(case: EngineCase, t: float) -> tuple[float, float]:
    """(x, y) at time t in 0 ... 1 of the path."""
    track = case.track
    part = min(int(np.searchsorted(np.cumsum(track.weight), t)), track.weight.size - 1)
    u = (t - float(track.weight[:part].sum())) / float(track.weight[part])
    (x0, x1), (y0, y1) = track.x_px[part], track.y_px[part]
    return float(x0 + u * (x1 - x0)), float(y0 + u * (y1 - y0))


def _boxed(case: EngineCase, x: float, y: float, side: int) -> float:
    half = side // 2
    cx, cy = round(x), round(y)
    if min(cx, cy) < half or cx + half >= case.frame[1] or cy + half >= case.frame[0]:
        return float("nan")
    middle = np.array([float(cx)]), np.array([float(cy)])
    return float(exact_pixels(case.shape, case.track, x, y, *middle, width=float(side))[0, 0])


def probe_count(case: EngineCase, quick: bool) -> int:
    """How many interior probes: fewer where the exact values take long."""
    if quick:
        return 2
    return 7 if isinstance(case.shape, AiryStar) else 14
