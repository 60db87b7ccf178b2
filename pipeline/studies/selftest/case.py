"""A case: a limiting case, the right answer and its source, how far ours may be off; running it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from catalog_tools.documents import JsonObject
from pipeline.errors import NightglassError


@dataclass(frozen=True)
class CaseResult:
    """What a case found: the right answer and ours, for people, and how far they are apart."""

    right: str
    ours: str
    error: float


@dataclass(frozen=True)
class LimitingCase:
    """One limiting case.

    source : of the right answer; allowed : largest error in `unit`
    run : from an empty folder to what was found; raises where nothing can be said
    """

    name: str
    what: str
    source: str
    unit: str
    allowed: float
    run: Callable[[Path], CaseResult]


@dataclass(frozen=True)
class Outcome:
    """A case that was run; `found` is None and `fault` says why where it broke."""

    case: LimitingCase
    found: CaseResult | None
    fault: str
    seconds: float

    @property
    def passed(self) -> bool:
        return self.found is not None and bool(self.found.error <= self.case.allowed)  # NaN fails

    def as_dict(self) -> JsonObject:
        """Plain data for JSON and tables."""
        case, found = self.case, self.found
        error = float(found.error) if found and math.isfinite(found.error) else None
        return {
            "name": case.name,
            "what": case.what,
            "source": case.source,
            "unit": case.unit,
            "allowed": case.allowed,
            "right": found.right if found else None,
            "ours": found.ours if found else None,
            "error": error,
            "fault": self.fault,
            "passed": self.passed,
            "seconds": round(self.seconds, 3),
        }


def case(
    name: str, what: str, source: str, allowed: float, unit: str = "relative"
) -> Callable[[Callable[[Path], CaseResult]], LimitingCase]:
    """Make a case of the function below it."""

    def make(run: Callable[[Path], CaseResult]) -> LimitingCase:
        return LimitingCase(name, what, source, unit, allowed, run)

    return make


def run_case(one: LimitingCase, folder: Path) -> Outcome:
    """Run one case in a folder of its own; what breaks is a failed case, no end of the rest."""
    folder.mkdir(parents=True, exist_ok=True)
    began = time.perf_counter()
    found, fault = None, ""
    try:
        found = one.run(folder)
    except NightglassError as e:
        fault = str(e)
    except Exception as e:
        fault = f"{type(e).__name__}: {e}"
    return Outcome(one, found, fault, time.perf_counter() - began)


def every(modules: Iterable[object]) -> tuple[LimitingCase, ...]:
    """The cases of modules, in the order in which they stand there."""
    return tuple(v for m in modules for v in vars(m).values() if isinstance(v, LimitingCase))
