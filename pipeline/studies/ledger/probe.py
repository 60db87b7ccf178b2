"""What a probe is: one rule of the ledger in a small scene, its error against the bound stated."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np

from pipeline.arrays import Array
from pipeline.errors import NightglassError
from pipeline.plan.decision import Decision
from pipeline.plan.plan import Plan


@dataclass(frozen=True)
class ProbeResult:
    """One measurement.

    component : as in the plan; how : scene and reference, in words
    bound : what the plan states, in `unit`; error : what was measured against the reference
    seconds_out, seconds_in : CPU, with the omission or approximation, and with it undone
    """

    component: str
    how: str
    bound: float
    error: float
    unit: str
    seconds_out: float
    seconds_in: float

    @property
    def holds(self) -> bool:
        return bool(np.isfinite(self.error) and self.error <= self.bound)


Probe = Callable[["Bench"], Iterator[ProbeResult]]
PROBES: dict[str, list[Probe]] = {}


@dataclass(frozen=True)
class Bench:
    """What probes share: a folder for their files, and a catalogue of a few hundred stars."""

    folder: Path
    catalogue: str


def probe(rule: str) -> Callable[[Probe], Probe]:
    """Register a probe under the first component of its rule."""

    def keep(work: Probe) -> Probe:
        PROBES.setdefault(rule, []).append(work)
        return work

    return keep


Result = TypeVar("Result")


def timed(work: Callable[[], Result], times: int = 1) -> tuple[float, Result]:
    """CPU seconds of the quickest run, and its result."""
    best = np.inf
    for _ in range(times):
        began = time.process_time()
        out = work()
        best = min(best, time.process_time() - began)
    return best, out


def decision(plan: Plan, component: str) -> Decision:
    """The one decision of a plan about a component."""
    for d in plan.decisions:
        if d.component == component:
            return d
    raise NightglassError(f"{plan.scene.name}: the plan has no decision about {component}")


def stated(plan: Plan, component: str) -> tuple[float, str]:
    """The bound that a plan states of a component, and its unit."""
    d = decision(plan, component)
    if d.bound is not None:
        return d.bound, d.unit or ""
    if d.error_bound_e is None:
        raise NightglassError(f"{plan.scene.name}: the plan states no bound of {component}")
    return d.error_bound_e, "e-"


def most(values: Array) -> float:
    """The largest magnitude; 0 of none."""
    return float(np.abs(values).max(initial=0.0))
