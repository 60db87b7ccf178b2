"""How fast the light of a body changes by its tables and turns, and its means between moments."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from pipeline.plan.bodies.attitudes import since_s
from pipeline.spec.targets.body import (
    Attitude,
    Body,
    CompositeBody,
    LightCurveBody,
    SphereBody,
    SpinAttitude,
    TableAttitude,
)
from pipeline.spec.targets.mesh import MeshBody, SpinJoint

Array = NDArray[np.float64]

LOOKS = 4.0  # at least, from a row of a table to the next
LOOKS_A_TURN = 32.0  # in a period or a turn: a box shows four faces in one
MOST_LOOKS = 1024  # in an exposure: of geometry
MOST_LIGHT_NODES = 257  # light that asks for more is the mean around each node
FINER, MOST_FINE = 4.0, 2**17  # so many times as often as asked, and so often at most, for its mean
MESH_FINER, MESH_MOST_FINE = 1.0, 2**12  # a mesh's light is dear
JUMP = 1e-3  # of a period
CLOSE = 0.125  # of `flux_fraction`: how closely the mean of an exposure is known


def is_changing(body: Body | MeshBody, epoch: tuple[float, float]) -> bool:
    """True where a table or a turn of its own changes a body."""
    return any(_tables(body, epoch)) or any(_turns_s(body))


def looks_asked(
    body: Body | MeshBody, epoch: tuple[float, float], first_s: Array, last_s: Array, span_s: Array
) -> Array:
    """How many times (F,) a body is to be looked at in exposures of `span_s`.

    first_s, last_s : (F,) when its light leaves it, after the scene's epoch
    """
    own = np.full(len(span_s), min(_turns_s(body), default=np.inf) * LOOKS * _least_turn(body))
    for times_s, period_s in _tables(body, epoch):
        own = np.minimum(own, apart_s(times_s, period_s, first_s, last_s))
    return np.asarray(LOOKS * span_s / own)


def most_looks(body: Body | MeshBody) -> float:
    """How many of these looks there are at most."""
    return MOST_LOOKS if isinstance(body, MeshBody) else MOST_FINE / FINER


def has_means(body: Body | MeshBody, asked: Array) -> NDArray[np.bool_]:
    """Exposures (F,) in which a body's light at the nodes is its mean around each of them: not
    that of a mesh which is too fast, as each look is dear."""
    most = MOST_LOOKS if isinstance(body, MeshBody) else math.inf
    return (asked > MOST_LIGHT_NODES - 1) & (asked <= most)


def looks_for_means(body: Body | MeshBody, asked: float) -> tuple[float, int]:
    """How many times an exposure is looked at for the means of a body's light, at least and at
    most."""
    dear = isinstance(body, MeshBody)
    finer, most = (MESH_FINER, MESH_MOST_FINE) if dear else (FINER, MOST_FINE)
    return min(finer * asked, most), most


def mean_light(
    light: Callable[[Array], Array], nodes: int, least: float, most: int, share: float
) -> Array:
    """Means of light around the nodes of an exposure, whose sum by the trapezium rule is the light
    of the whole: (nodes,).

    light : of places (n,) in the exposure, 0 to 1; a node's mean is weighted by a hat that falls
    to zero at the next nodes. Looked at some `least` times, and oftener until the whole changes by
    `share` of itself at most; some `most` times at most.
    """
    each = 2 * int(np.ceil(0.5 * least / (nodes - 1)))
    while True:
        fine = light(np.linspace(0.0, 1.0, each * (nodes - 1) + 1))
        whole, half = (float(np.trapezoid(v)) / (len(v) - 1) for v in (fine, fine[::2]))
        if abs(whole - half) <= share * whole or 2 * each * (nodes - 1) > most:
            break
        each *= 2
    between, part = fine[:-1].reshape(nodes - 1, each), np.arange(each) / each
    out = np.zeros(nodes)
    out[:-1] += np.sum(between * (1.0 - part), axis=-1)  # not a product of matrices: its bits
    out[1:] += np.sum(between * part, axis=-1)  # may follow how many threads share it
    out[[0, -1]] += -0.5 * fine[0], 0.5 * fine[-1]
    out[[0, -1]] *= 2.0
    return out / each


def apart_s(times_s: Array, period_s: float | None, start_s: Array, end_s: Array) -> Array:
    """How far apart rows are (F,) that fall into some times, at least [s]; inf where none do."""
    apart = np.diff(times_s)
    if period_s is not None:
        return np.full(len(start_s), apart.min())
    first, last = (np.searchsorted(times_s, v) for v in (start_s, end_s))
    out = np.full(len(start_s), np.inf)
    for k in np.flatnonzero(last > first):
        out[k] = apart[max(first[k] - 1, 0) : last[k]].min(initial=np.inf)
    return out


def _tables(
    body: Body | MeshBody, epoch: tuple[float, float]
) -> Iterator[tuple[Array, float | None]]:
    """Times of a body's tables, after the scene's epoch [s], and the period of each."""
    if isinstance(body, LightCurveBody):
        times = np.array(body.times_s)
        if body.period_s is not None:
            times = np.append(times, times[-1] + _to_next_s(body, body.period_s))
        yield times - since_s(body.epoch, epoch, "body"), body.period_s
    for law in _laws(body):
        if isinstance(law, TableAttitude):
            yield np.array(law.times_s) - since_s(law.epoch, epoch, "body.attitude"), None


def _to_next_s(body: LightCurveBody, period_s: float) -> float:
    """Time from a table's last row to the first of its next period [s]; where both are at one time,
    how closely a jump between them is looked at."""
    apart = period_s - (body.times_s[-1] - body.times_s[0])
    if apart > 1e-9 * period_s:
        return apart
    values = body.magnitudes or body.intensities_m2_sr or ()
    return period_s * (JUMP if values[0] != values[-1] else 1.0)


def _turns_s(body: Body | MeshBody) -> Iterator[float]:
    """How long each turn of what spins takes [s]."""
    laws: list[object] = list(_laws(body))
    if isinstance(body, MeshBody):
        laws += [part.joint for part in body.parts]
    for law in laws:
        if isinstance(law, SpinAttitude | SpinJoint) and law.rate_deg_s:
            yield 360.0 / abs(law.rate_deg_s)


def _least_turn(body: Body | MeshBody) -> float:
    """Which part of a turn is looked at once: less of what has narrow highlights."""
    highlight_rad = body.highlight_rad if isinstance(body, MeshBody) else math.inf
    return min(1.0 / LOOKS_A_TURN, highlight_rad / (2.0 * math.pi))


def _laws(body: Body | MeshBody) -> Iterator[Attitude | None]:
    """The attitudes of a body and its parts."""
    if isinstance(body, LightCurveBody | SphereBody):
        return
    yield body.attitude
    if isinstance(body, CompositeBody):
        yield from (part.attitude for part in body.parts if not isinstance(part, SphereBody))
