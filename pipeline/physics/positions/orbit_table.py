"""Ephemeris tables: polynomials through the nearest rows; their error, measured on the rows."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pipeline.errors import BadInput

Array = NDArray[np.float64]

FEWEST_NODES, MOST_NODES = 2, 16
HOLE = 3.0  # neighbours: rows beside a longer stretch lie too near its edge to tell its error
ROOM = 4.0  # of what is found in a hole: what it is compared with errs, too
# Of a stretch between rows times what omitted rows show of velocities that err alike: places are
# off by 0.064 of it through two rows, by less through more.
ALIKE = 0.1
WITHIN = np.array([[0.25], [0.5], [0.75]])  # where a hole is looked at


def interpolate(
    time_s: Array, place_m: Array, speed_m_s: Array | None, at_s: ArrayLike, nodes: int
) -> tuple[Array, Array]:
    """Positions and velocities (n, 3) at times (n,), from rows (k,), (k, 3), (k, 3) or None.

    Each time takes the polynomial through the `nodes` rows around it: Lagrange's, or Hermite's
    where the rows have velocities (degree 2 nodes - 1), both in Newton's form of divided
    differences (Stoer & Bulirsch 2002, section 2.1.5); the velocity is its derivative.
    """
    at = np.atleast_1d(np.asarray(at_s, float))
    count = len(time_s)
    nodes = min(nodes, count)
    first = np.clip(np.searchsorted(time_s, at, side="right") - (nodes + 1) // 2, 0, count - nodes)
    windows, of = np.unique(first, return_inverse=True)
    rows = windows[:, None] + np.arange(nodes)
    knots, terms = _newton(
        time_s[rows], place_m[rows], None if speed_m_s is None else speed_m_s[rows]
    )
    return _evaluate(knots[of], terms[of], at)


def left_out_error(
    time_s: Array,
    place_m: Array,
    speed_m_s: Array | None,
    nodes: int,
    wanted: NDArray[np.bool_] | None = None,
) -> float:
    """Largest error [m] of inner rows interpolated from their neighbours without them.

    It bounds the error between even rows of a smooth orbit, with room: the gap is twice as wide.
    Velocities that all err alike (another frame's, another unit's) move no place midway between two
    rows: the velocity there tells them.
    wanted : (k,) which rows to judge by; default: all but the first and the last
    """
    count = len(time_s)
    inner = np.arange(1, count - 1)
    if wanted is not None:
        inner = inner[wanted[1:-1]]
    nodes = min(nodes, count - 1)
    if not len(inner):
        return float("nan")
    first = np.clip(inner - nodes // 2, 0, count - 1 - nodes)
    rows = first[:, None] + np.arange(nodes)
    rows = rows + (rows >= inner[:, None])  # the judged row itself is passed over
    knots, terms = _newton(
        time_s[rows], place_m[rows], None if speed_m_s is None else speed_m_s[rows]
    )
    place, slope = _evaluate(knots, terms, time_s[inner])
    off_m = _farthest(place, place_m[inner])
    if speed_m_s is None:
        return off_m
    gaps_s = np.sort([np.diff(time_s)[inner - 1], np.diff(time_s)[inner]], axis=0)
    reach_s = ALIKE * np.minimum(gaps_s[1], HOLE * gaps_s[0])[:, None]
    return max(off_m, _farthest(reach_s * slope, reach_s * speed_m_s[inner]))


def hole_error(
    time_s: Array,
    place_m: Array,
    speed_m_s: Array | None,
    nodes: int,
    wanted: NDArray[np.bool_] | None = None,
) -> float:
    """Largest error [m] where rows are missing: what a row less changes, or rows more; 0 without.

    A row left out beside a hole does not tell it: near its edge errors are small. The lesser of the
    two counts, as more rows are worse where rounded ones close together are followed far.
    wanted : (k,) the rows between which it counts; default: all
    """
    gap, count = np.diff(time_s), len(time_s)
    hole = gap > HOLE * np.maximum(np.append(0.0, gap[:-1]), np.append(gap[1:], 0.0))
    if wanted is not None:
        hole &= wanted[:-1] & wanted[1:]
    at = (time_s[:-1] + WITHIN * gap)[:, hole].ravel()
    less, here, more, most = (
        interpolate(time_s, place_m, speed_m_s, at, n)[0] for n in range(nodes - 1, nodes + 3)
    )
    found = [_farthest(less, here), max(_farthest(more, here), _farthest(most, here))]
    return ROOM * min(found if nodes < count else found[:1])


def table_error(
    time_s: Array,
    place_m: Array,
    speed_m_s: Array | None,
    nodes: int,
    wanted: NDArray[np.bool_] | None = None,
) -> float:
    """Largest error [m] between rows: of rows left out and in holes; NaN of too few to judge."""
    table = time_s, place_m, speed_m_s, nodes, wanted
    return float(np.maximum(left_out_error(*table), hole_error(*table)))


def best_nodes(
    time_s: Array, place_m: Array, speed_m_s: Array | None, wanted: NDArray[np.bool_] | None = None
) -> tuple[int, float]:
    """How many rows to pass through, even, for the least `table_error`, and that error [m].

    Two rows without velocities, or a table too short to leave a row out: error NaN.
    """
    most = min(MOST_NODES if speed_m_s is None else MOST_NODES // 2, len(time_s))
    tried = [
        (table_error(time_s, place_m, speed_m_s, n, wanted), n)
        for n in range(FEWEST_NODES, most + 1, 2)
    ]
    known = [pair for pair in tried if np.isfinite(pair[0])]
    if not known:
        return min(len(time_s), FEWEST_NODES), float("nan")
    error, nodes = min(known)
    return nodes, error


def check_covered(first_s: float, last_s: float, at_s: Array, field: str, epoch: str) -> None:
    """BadInput naming both ranges unless all times lie within a table's."""
    low, high = float(np.min(at_s)), float(np.max(at_s))
    if low < first_s or high > last_s:
        raise BadInput(
            field,
            f"times {low:.3f} to {high:.3f} s after {epoch}",
            f"times that the table covers: {first_s:.3f} to {last_s:.3f} s after {epoch} (light "
            "leaves a target before it arrives)",
        )


def _farthest(one: Array, other: Array) -> float:
    """Largest distance between places (n, 3); 0 of none."""
    return float(np.sqrt(np.max(np.sum((one - other) ** 2, axis=-1), initial=0.0)))


def _newton(time: Array, place: Array, speed: Array | None) -> tuple[Array, Array]:
    """Knots (w, d) and divided differences (w, d, 3) of windows; knots twice with velocities."""
    if speed is None:
        knots, column = time, place.copy()
    else:
        knots, column = np.repeat(time, 2, axis=1), np.repeat(place, 2, axis=1)
    terms = np.empty_like(column)
    terms[:, 0] = column[:, 0]
    for k in range(1, knots.shape[1]):
        gap = (knots[:, k:] - knots[:, :-k])[..., None]
        rise = column[:, 1:] - column[:, :-1]
        if k == 1 and speed is not None:
            same = gap == 0.0
            twice = np.repeat(speed, 2, axis=1)[:, 1:]
            column = np.where(same, twice, rise / np.where(same, 1.0, gap))
        else:
            column = rise / gap
        terms[:, k] = column[:, 0]
    return knots, terms


def _evaluate(knots: Array, terms: Array, at: Array) -> tuple[Array, Array]:
    """Newton polynomials (n, d), (n, d, 3) and their derivatives at times (n,)."""
    value = terms[:, -1].copy()
    slope = np.zeros_like(value)
    for k in range(terms.shape[1] - 2, -1, -1):
        gap = (at - knots[:, k])[:, None]
        slope = slope * gap + value
        value = value * gap + terms[:, k]
    return value, slope
