"""Streaks: the path of a source during an exposure, as weighted straight segments."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Box = tuple[float, float, float, float]  # x0, x1, y0, y1 [px]

RISING_SERIES = 1e-3  # of an angle, below which a series of two terms is exact
LONGEST_PIECE_PX = 96.0
HALVINGS = 3  # of the steps between nodes, at most, where a path bends
SMOOTH = 0.01  # of what a path bends between nodes: what a cubic may miss to follow it there


@dataclass(frozen=True, eq=False)
class Path:
    """A polyline with the share of the light on each segment; equal to one of the same numbers.

    x_px, y_px : (n + 1,) nodes relative to a reference point, pixels
    weight : (n,) share of the source's light on each segment, spread evenly along it
    off_px : how far its segments may be off what they stand for
    """

    x_px: Array
    y_px: Array
    weight: Array
    off_px: float = 0.0

    @property
    def segments(self) -> int:
        return len(self.weight)

    @property
    def length_px(self) -> float:
        return float(np.sum(np.hypot(np.diff(self.x_px), np.diff(self.y_px))))

    def scaled(self, factor: float) -> Path:
        """The path so many times as large about its reference point."""
        return Path(factor * self.x_px, factor * self.y_px, self.weight)

    @property
    def _numbers(self) -> tuple[bytes, bytes, bytes]:
        return self.x_px.tobytes(), self.y_px.tobytes(), self.weight.tobytes()

    def __hash__(self) -> int:
        return hash(self._numbers)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Path) and self._numbers == other._numbers


POINT = Path(np.zeros(2), np.zeros(2), np.ones(1))


def straight(length_px: float, angle_rad: float = 0.0) -> Path:
    """An even streak of a length about its middle, at an angle from the rows."""
    if length_px <= 0.0:
        return POINT
    ends = np.array([-0.5, 0.5]) * length_px
    return Path(ends * np.cos(angle_rad), ends * np.sin(angle_rad), np.ones(1))


def path_through(x_px: Array, y_px: Array, weight: Array, tolerance_px: float) -> Path:
    """Path through nodes at equal steps of time, with straight uniform runs made one segment.

    x_px, y_px : (n + 1,); weight : (n,) light on each step. The nodes of a run are merged when
    none of them is farther than `tolerance_px` from the place that uniform motion along the
    merged segment gives it, so that neither shape nor speed changes by more than that.
    """
    x, y, w = (np.asarray(a, float) for a in (x_px, y_px, weight))
    keep = _ends_of_runs(x, y, w, tolerance_px)
    merged = np.add.reduceat(w, keep[:-1])
    return Path(x[keep], y[keep], merged, tolerance_px)


def curve_through(x_px: Array, y_px: Array, weight: Array, tolerance_px: float) -> Path:
    """As `path_through`, with more nodes where the path bends smoothly by more than the tolerance
    between those it has."""
    x, y = np.ascontiguousarray(x_px, float), np.ascontiguousarray(y_px, float)
    x, y, bend_px = _between(x, y, tolerance_px)
    each = (len(x) - 1) // (len(x_px) - 1)
    made = path_through(x, y, np.repeat(weight / each, each), tolerance_px)
    return replace(made, off_px=max(tolerance_px, bend_px))


@njit(cache=True, nogil=True)
def _between(x, y, tolerance_px):
    """Nodes x and y (k n + 1,) of a bend at so many smaller steps that straight lines between them
    are within the tolerance, or HALVINGS times halved, and how far these are off."""
    halvings, bend_px = 0, _bend_px(x, y)
    while bend_px > tolerance_px and halvings < HALVINGS:
        x, y, halvings, bend_px = _halved(x), _halved(y), halvings + 1, bend_px / 4.0
    return x, y, bend_px


@njit(cache=True, nogil=True)
def _bend_px(x, y):
    """How far a path is from straight lines between nodes (n + 1,), where a cubic is much nearer;
    else 0: random motion and the corners of a table are no bend."""
    if len(x) < 5:
        return 0.0
    bend, rest = 0.0, 0.0
    for i in range(len(x) - 2):
        bend = max(
            bend, math.hypot(x[i] - 2.0 * x[i + 1] + x[i + 2], y[i] - 2.0 * y[i + 1] + y[i + 2])
        )
    for i in range(len(x) - 4):
        rest = max(rest, math.hypot(_fourth(x, i), _fourth(y, i)))
    off_px = bend / 8.0
    return off_px if rest * 3.0 / 128.0 < SMOOTH * off_px else 0.0


@njit(cache=True, nogil=True)
def _fourth(v, i):
    """The fourth difference of the nodes from the i-th on."""
    return v[i] - 4.0 * v[i + 1] + 6.0 * v[i + 2] - 4.0 * v[i + 3] + v[i + 4]


@njit(cache=True, nogil=True)
def _halved(v):
    """Nodes (2 n + 1,) at half the steps: those between lie on the cubic of the four around them
    (Abramowitz and Stegun, 25.2.13), the outermost on that of the four beside them."""
    n = len(v)
    out = np.empty(2 * n - 1)
    out[::2] = v
    for i in range(1, n - 2):
        out[2 * i + 1] = (9.0 * (v[i] + v[i + 1]) - v[i - 1] - v[i + 2]) / 16.0
    out[1] = (5.0 * v[0] + 15.0 * v[1] - 5.0 * v[2] + v[3]) / 16.0
    out[2 * n - 3] = (5.0 * v[n - 1] + 15.0 * v[n - 2] - 5.0 * v[n - 3] + v[n - 4]) / 16.0
    return out


def densest_share(x_px: Array, y_px: Array, weight: Array) -> float:
    """Largest part of a path's light that lies on one px of it: 1 where it is at rest.

    x_px, y_px : (n + 1,) nodes; weight : (n,) light of each step, sum 1
    """
    return float(_densest(*(np.ascontiguousarray(v, float) for v in (x_px, y_px, weight))))


@njit(cache=True, nogil=True)
def _densest(x, y, weight):
    """`densest_share` of nodes and weights as they lie in memory."""
    most = 0.0
    for k in range(len(weight)):
        length_px = math.hypot(x[k + 1] - x[k], y[k + 1] - y[k])
        most = max(most, weight[k] / max(length_px, weight[k], 1e-300))
    return most


def light_near(path: Path, radius_px: float) -> tuple[float, float]:
    """Largest parts of a path's light within a radius of a pixel, and on one px of the path.

    What is outside of a circle is at least as long as it is from there to the path's ends.
    """
    share = densest_share(path.x_px, path.y_px, path.weight)
    ends_px = math.hypot(path.x_px[-1] - path.x_px[0], path.y_px[-1] - path.y_px[0])
    return min(1.0, share * (2.0 * radius_px + path.length_px - ends_px)), share


def in_few_runs(path: Path, tolerance_px: float) -> Path:
    """The path in as few straight runs as leave nothing farther off than a tolerance.

    Each run is moved to the centroid of its light, so that what it misses is of second order. For
    light as smooth as wings; between the runs are segments without light.
    """
    runs = 1
    while runs < path.segments:
        ends = np.linspace(0, path.segments, runs + 1).round().astype(np.int64)
        light = np.add.reduceat(path.weight, ends[:-1])
        if not (light > 0.0).all():
            return path
        share = (np.cumsum(path.weight) - 0.5 * path.weight) / light.repeat(np.diff(ends))
        share -= ((np.cumsum(light) - light) / light).repeat(np.diff(ends)) + 0.5
        (x, off_x), (y, off_y) = (
            _through_centroids(v, path.weight, ends, share) for v in (path.x_px, path.y_px)
        )
        if np.hypot(off_x, off_y).max() <= tolerance_px:
            weight = np.zeros(2 * runs - 1)
            weight[::2] = light
            return Path(x, y, weight)
        runs *= 2
    return path


def _through_centroids(
    v: Array, weight: Array, ends: NDArray[np.int64], share: Array
) -> tuple[Array, Array]:
    """Nodes of runs along one axis, and how far the middle of each segment is from them.

    share : (k,) of its run's light up to the middle of each segment, from -1/2 to 1/2
    """
    middle = 0.5 * (v[:-1] + v[1:])
    light = np.add.reduceat(weight, ends[:-1])
    centroid = np.add.reduceat(weight * middle, ends[:-1]) / light
    length = np.diff(v[ends])
    nodes = np.stack([centroid - 0.5 * length, centroid + 0.5 * length], axis=1).ravel()
    of_run = np.repeat(np.arange(len(length)), np.diff(ends))
    return nodes, middle - centroid[of_run] - share * length[of_run]


@njit(cache=True, nogil=True)
def _ends_of_runs(x, y, w, tolerance_px):
    """Nodes that are kept: from each the last that one segment may reach, tried by halving."""
    n = len(w)
    keep, lights = [0], np.zeros(n + 1)
    lights[1:] = np.cumsum(w)
    while keep[-1] < n:
        start, stop = keep[-1], n
        while stop > start + 1:
            half = start + (stop - start) // 2
            # The middle of a run is looked at before all of it.
            straight = _off_run(x, y, lights, start, stop, half) <= tolerance_px
            i = start + 1
            while straight and i < stop:
                straight = _off_run(x, y, lights, start, stop, i) <= tolerance_px
                i += 1
            if straight:
                break
            stop = max(half, start + 1)
        keep.append(stop)
    return np.array(keep)


@njit(cache=True, nogil=True)
def _off_run(x, y, lights, start, stop, i):
    """How far the i-th node, of a run, is from where uniform motion has it [px]."""
    total = lights[stop] - lights[start]
    share = (lights[i] - lights[start]) / total if total > 0.0 else (i - start) / (stop - start)
    off_x = x[start] + share * (x[stop] - x[start]) - x[i]
    off_y = y[start] + share * (y[stop] - y[start]) - y[i]
    return math.hypot(off_x, off_y)


def pieces(
    path: Path, longest_px: float = LONGEST_PIECE_PX, near: Box | None = None
) -> list[tuple[float, float, Path, float]]:
    """Cut a path into pieces short enough to draw from one small table.

    Returns (x0_px, y0_px, piece, share): the piece is relative to (x0, y0), its weights sum to
    one, and `share` is its part of the light. A straight uniform streak gives equal pieces, so
    that one table serves all of them.

    near : (x0, x1, y0, y1) from the path's origin [px]: of the equal pieces of a long segment those
        alone that touch this box, however long the path is
    """
    out: list[tuple[float, float, Path, float]] = []
    for run, count in _runs(path, longest_px):
        out += _flush(path, run) if count == 1 else _cut(path, run[0], count, near)
    return out


def in_steps(path: Path, longest_px: float) -> Path:
    """The same path in even steps of each segment, none longer than so many px."""
    x, y = np.diff(path.x_px), np.diff(path.y_px)
    counts = np.maximum(1, np.ceil(np.hypot(x, y) / longest_px)).astype(np.intp)
    if (counts == 1).all():
        return path
    of = np.repeat(np.arange(path.segments), counts)
    within = (np.arange(len(of)) - (np.cumsum(counts) - counts)[of]) / counts[of]
    at_x, at_y = path.x_px[of] + within * x[of], path.y_px[of] + within * y[of]
    nodes = np.append(at_x, path.x_px[-1]), np.append(at_y, path.y_px[-1])
    return Path(*nodes, (path.weight / counts)[of], path.off_px)


def cut_at(path: Path, places: Array) -> Path:
    """The same path in parts that end at places (m,): numbers of segments, with fractions."""
    ends = np.arange(path.segments + 1.0)
    at = np.unique(np.concatenate([ends, places]))
    x, y = np.interp(at, ends, path.x_px), np.interp(at, ends, path.y_px)
    return Path(x, y, path.weight[at[:-1].astype(np.intp)] * np.diff(at), path.off_px)


def half_extent_px(parts: Iterable[Path]) -> tuple[float, float]:
    """How far (y, x) the nodes of paths lie from their reference points, at most [px]."""
    sizes = [(float(np.abs(p.y_px).max()), float(np.abs(p.x_px).max())) for p in parts]
    return max((y for y, _ in sizes), default=0.0), max((x for _, x in sizes), default=0.0)


def piece_counts(path: Path) -> list[tuple[Path, float, int]]:
    """The different pieces of a path: (piece, part of the light, how many are equal)."""
    out = []
    for run, count in _runs(path, LONGEST_PIECE_PX):
        if count == 1:
            out += [(piece, share, 1) for _, _, piece, share in _flush(path, run)]
        else:
            out.append((_piece_of(path, run[0], count), float(path.weight[run[0]]) / count, count))
    return out


def _runs(path: Path, longest_px: float) -> Iterator[tuple[list[int], int]]:
    """Segments that are one piece together, count 1; or one that is cut into `count` pieces."""
    group: list[int] = []
    used = 0.0
    for k in range(path.segments):
        dx, dy = path.x_px[k + 1] - path.x_px[k], path.y_px[k + 1] - path.y_px[k]
        length = float(np.hypot(dx, dy))
        if length > longest_px or (group and used + length > longest_px):
            yield group, 1
            group, used = [], 0.0
        if length > longest_px:
            yield [k], int(np.ceil(length / longest_px))
            continue
        group.append(k)
        used += length
    yield group, 1


def within(x0: Array, y0: Array, dx: Array, dy: Array, box: Box) -> tuple[Array, Array]:
    """From which to which part (0 to 1) segments (n,) lie in a box; the first is larger if never.

    x0, y0 : their beginnings; dx, dy : their ways. Slabs (Kay & Kajiya 1986, SIGGRAPH 20, 269).
    """
    first, last = np.zeros(np.shape(x0)), np.ones(np.shape(x0))
    for at, way, low, high in ((x0, dx, *box[:2]), (y0, dy, *box[2:])):
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            one, other = (low - at) / way, (high - at) / way
        still = way == 0.0
        inside = (low <= at) & (at <= high)
        one = np.where(still, np.where(inside, 0.0, 2.0), one)
        other = np.where(still, np.where(inside, 1.0, 2.0), other)
        first = np.maximum(first, np.minimum(one, other))
        last = np.minimum(last, np.maximum(one, other))
    return first, last


def part_within(path: Path, box: Box) -> tuple[Path, float] | None:
    """A path from where it first enters a box to where it last leaves it, and its part of the
    light; None for one that does not come there."""
    x, y = np.diff(path.x_px), np.diff(path.y_px)
    first, last = within(path.x_px[:-1], path.y_px[:-1], x, y, box)
    inside = np.flatnonzero(first <= last)
    if not inside.size:
        return None
    i, k = int(inside[0]), int(inside[-1])
    start, end = float(first[i]), float(last[k])
    if (i, k, start, end) == (0, path.segments - 1, 0.0, 1.0):
        return path, 1.0
    xs, ys = path.x_px[i : k + 2].copy(), path.y_px[i : k + 2].copy()
    weight = path.weight[i : k + 1].copy()
    xs[-1], ys[-1] = path.x_px[k] + end * x[k], path.y_px[k] + end * y[k]
    weight[-1] *= end
    xs[0], ys[0] = path.x_px[i] + start * x[i], path.y_px[i] + start * y[i]
    weight[0] *= (end - start) / end if i == k and end > 0.0 else 1.0 - start
    share = float(weight.sum())
    return (Path(xs, ys, weight / share), share) if share > 0.0 else None


def _piece_of(path: Path, k: int, count: int) -> Path:
    dx, dy = (path.x_px[k + 1] - path.x_px[k]) / count, (path.y_px[k + 1] - path.y_px[k]) / count
    return Path(np.array([-dx / 2, dx / 2]), np.array([-dy / 2, dy / 2]), np.ones(1))


def _cut(
    path: Path, k: int, count: int, near: Box | None
) -> list[tuple[float, float, Path, float]]:
    dx, dy = (path.x_px[k + 1] - path.x_px[k]) / count, (path.y_px[k + 1] - path.y_px[k]) / count
    first, last = 0, count
    if near is not None:
        whole = np.array([path.x_px[k], path.y_px[k], dx * count, dy * count])
        start, end = (float(t) for t in within(whole[0], whole[1], whole[2], whole[3], near))
        if start > end:
            return []
        first, last = max(0, int(start * count) - 1), min(count, int(end * count) + 2)
    piece, share = _piece_of(path, k, count), float(path.weight[k]) / count
    return [
        (path.x_px[k] + (i + 0.5) * dx, path.y_px[k] + (i + 0.5) * dy, piece, share)
        for i in range(first, last)
    ]


def _flush(path: Path, group: list[int]) -> list[tuple[float, float, Path, float]]:
    share = float(np.sum(path.weight[group])) if group else 0.0
    if share <= 0:
        return []
    nodes = slice(group[0], group[-1] + 2)
    x, y = path.x_px[nodes], path.y_px[nodes]
    x0, y0 = 0.5 * (x.min() + x.max()), 0.5 * (y.min() + y.max())
    return [(float(x0), float(y0), Path(x - x0, y - y0, path.weight[group] / share), share)]


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def sinc_of(half, sine):
    """sin(half) / half, given the sine; by its series near zero."""
    square = half * half
    series = 1.0 - square * (1 / 6) * (1.0 - square * (1 / 20) * (1.0 - square * (1 / 42)))
    ratio = sine / half
    return series if square < 2.5e-3 else ratio


def transfer(
    fy: Array,
    fx: Array,
    x: Array,
    y: Array,
    weight: Array,
    columns: NDArray[np.int64] | None = None,
) -> NDArray[np.complex128]:
    """Transfer function of a path: sum of w sinc(f.d) exp(-2 pi i f.m) over its segments.

    fy (n,), fx (m,) in cycles per pixel; x, y (k + 1,) nodes in pixels; weight (k,); columns (n,):
    how many of each row are wanted, where not all are: the others are 0.
    Returns (n, m). Exact for motion that is uniform along each segment: the time average of a
    uniformly moving point is a box along its segment, whose transform is the sinc. Sines and
    cosines of sums come from those of their parts, so that each frequency needs its own alone.
    """
    columns = np.full(len(fy), len(fx)) if columns is None else columns
    return _transfer(fy, fx, x, y, weight, columns)


@njit(cache=True, nogil=True, error_model="numpy")
def _transfer(fy, fx, x, y, weight, columns):
    out = np.zeros((fy.size, fx.size), np.complex128)
    for k in range(len(weight)):
        if weight[k] == 0.0:
            continue
        dx, dy = np.pi * (x[k + 1] - x[k]), np.pi * (y[k + 1] - y[k])
        mx, my = np.pi * (x[k + 1] + x[k]), np.pi * (y[k + 1] + y[k])
        across, sines, cosines = fx * dx, np.sin(fx * dx), np.cos(fx * dx)
        turns = np.cos(fx * mx) - 1j * np.sin(fx * mx)
        for i in range(len(fy)):
            if columns[i] == 0:
                continue
            half_y = fy[i] * dy
            sin_y, cos_y = np.sin(half_y), np.cos(half_y)
            turn = weight[k] * complex(np.cos(fy[i] * my), -np.sin(fy[i] * my))
            if dx == 0.0 and dy == 0.0:
                for j in range(columns[i]):
                    out[i, j] += turn * turns[j]
                continue
            for j in range(columns[i]):
                sinc = sinc_of(half_y + across[j], sin_y * cosines[j] + cos_y * sines[j])
                out[i, j] += sinc * (turn * turns[j])
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def add_rising(out, fy, fx, x, y, weight, rise):
    """Add the transfer function of a path whose light rises evenly along each segment: the sum of
    (w sinc(f.d) - i r j1(pi f.d)) exp(-2 pi i f.m), with j1 the spherical Bessel function.

    out (n, m) complex; fy (n,), fx (m,), x, y (k + 1,), weight (k,) as for `transfer`; rise (k,).
    A segment of uniform motion sends (w + r u) du / 2 from each place u in (-1, 1) of it.
    """
    for k in range(len(weight)):
        dx, dy = np.pi * (x[k + 1] - x[k]), np.pi * (y[k + 1] - y[k])
        mx, my = np.pi * (x[k + 1] + x[k]), np.pi * (y[k + 1] + y[k])
        across, sines, cosines = fx * dx, np.sin(fx * dx), np.cos(fx * dx)
        turns = np.cos(fx * mx) - 1j * np.sin(fx * mx)
        for i in range(len(fy)):
            half_y = fy[i] * dy
            sin_y, cos_y = np.sin(half_y), np.cos(half_y)
            turn = complex(np.cos(fy[i] * my), -np.sin(fy[i] * my))
            for j in range(len(fx)):
                z = half_y + across[j]
                sinc = sinc_of(z, sin_y * cosines[j] + cos_y * sines[j])
                near = z / 3.0 * (1.0 - z * z / 10.0)
                far = (sinc - cos_y * cosines[j] + sin_y * sines[j]) / z
                j1 = near if abs(z) < RISING_SERIES else far
                out[i, j] += complex(weight[k] * sinc, -rise[k] * j1) * (turn * turns[j])
