"""How an observer sees targets at any moments: places, ranges, and what lights them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import BadInput
from pipeline.physics.positions.apparent import TargetSight, apparent_sun_m, target_apparent
from pipeline.physics.positions.earth import EarthState
from pipeline.physics.positions.times import Instants
from pipeline.plan.bodies.attitudes import View, needs_velocity
from pipeline.plan.bodies.orbits import Movers
from pipeline.plan.bodies.sizes import radius_m
from pipeline.spec.scene import Scene

Array = NDArray[np.float64]

LEAST_RANGE_M = 0.01  # nearer than that a target is where the observer is


@dataclass(frozen=True)
class Moments:
    """The n moments at which targets are looked at, and who looks.

    offset_s : (n,) after the scene's epoch (two-part UTC); times : the same instants
    observer_m : (n, 3) geocentric GCRS; observer_m_s : (n, 3) barycentric
    elsewhere : from other offsets (m,) to the same of them
    """

    epoch: tuple[float, float]
    offset_s: Array
    times: Instants
    earth: EarthState
    observer_m: Array
    observer_m_s: Array
    elsewhere: Callable[[Array], Moments] | None = None


def sights(scene: Scene, which: Sequence[int], at: Moments) -> tuple[TargetSight, View]:
    """How the observer sees m of the targets at each moment, and what lights them: (m, n, ...)."""
    targets = [scene.targets[i] for i in which]
    movers = Movers(
        [t.orbit for t in targets], [f"targets.{i}.orbit" for i in which], at.epoch, at.times
    )
    offsets = np.broadcast_to(at.offset_s, (len(targets), len(at.offset_s)))
    seen = target_apparent(
        lambda at_s: movers.states(at_s)[0], at.observer_m, at.observer_m_s, at.earth, offsets
    )
    _check_ranges(scene, which, seen.range_m)
    at_s, place = offsets - seen.light_time_s, seen.target_geocentric_m
    moves = [needs_velocity(t.body) for t in targets]
    speed = movers.states(at_s)[1] if any(moves) else np.zeros_like(place)
    sun = np.broadcast_to(apparent_sun_m(at.earth), place.shape)
    return seen, View(at_s, place, speed, sun, np.broadcast_to(at.observer_m, place.shape))


def _check_ranges(scene: Scene, which: Sequence[int], range_m: Array) -> None:
    """Refuse an observer inside of a target, or at its place. range_m : (m, n)"""
    for i, nearest in zip(which, range_m.min(axis=-1), strict=True):
        least = max(radius_m(scene.targets[i].body), LEAST_RANGE_M)
        if nearest > least:
            continue
        where, name = "at one place with", scene.targets[i].name
        where = where if nearest < LEAST_RANGE_M else "inside of"
        field, told = f"targets.{i}", f"the observer {where} {name}, {nearest:.3g} m from it"
        allowed = f"a target farther from it than its own radius ({least:.3g} m) at all times"
        for k, population in enumerate(scene.populations):
            number = name.removeprefix(f"{population.name}-")
            if number != name and number.replace("-", "").isdigit():  # as its members are named
                field, allowed = f"populations.{k}.path", "a file without the observer's own orbit"
        raise BadInput(field, told, allowed)
