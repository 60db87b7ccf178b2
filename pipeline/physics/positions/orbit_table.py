"""Ephemeris tables: polynomials through the nearest rows, their error measured on left-out rows."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pipeline.errors import BadInput

Array = NDArray[np.float64]

FEWEST_NODES, MOST_NODES = 2, 16


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

    It bounds the error between rows of a smooth orbit, with room: the gap is twice as wide.
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
    place, _ = _evaluate(knots, terms, time_s[inner])
    return float(np.sqrt(np.max(np.sum((place - place_m[inner]) ** 2, axis=-1))))


def best_nodes(
    time_s: Array, place_m: Array, speed_m_s: Array | None, wanted: NDArray[np.bool_] | None = None
) -> tuple[int, float]:
    """How many rows to pass through, even, for the least `left_out_error`, and that error [m].

    Two rows without velocities, or a table too short to leave a row out: error NaN.
    """
    most = min(MOST_NODES if speed_m_s is None else MOST_NODES // 2, len(time_s) - 1)
    tried = [
        (left_out_error(time_s, place_m, speed_m_s, n, wanted), n)
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
