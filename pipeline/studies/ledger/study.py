"""Every probe, one after another; of each rule the measurement nearest to its bound."""

from __future__ import annotations

import math
import os
import platform
import tempfile
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path

from catalog_tools.documents import JsonObject
from pipeline.errors import BadInput
from pipeline.plan.ledger import LEDGER, rule_of
from pipeline.plan.rule import Rule
from pipeline.studies.ledger import (  # noqa: F401  (each module registers its probes)
    air,
    drawing,
    meshes,
    pointing,
    sections,
    stars,
    targets,
)
from pipeline.studies.ledger.probe import PROBES, Bench, ProbeResult
from pipeline.studies.ledger.scenes import make_stars

Progress = Callable[[str, int, int], None]
Row = JsonObject


def checked_rules(names: tuple[str, ...]) -> tuple[Rule, ...]:
    """The rules of these components, all where none is given; BadInput for a name that is none."""
    if not names:
        return LEDGER
    found = [rule_of(name) or rule_of(f"{name}.x") for name in names]
    for name, rule in zip(names, found, strict=True):
        if rule is None:
            raise BadInput("--rule", name, ", ".join(r.components[0] for r in LEDGER))
    return tuple(dict.fromkeys(rule for rule in found if rule is not None))


def run_ledger(names: tuple[str, ...] = (), progress: Progress | None = None) -> Row:
    """Measure rules of the ledger; everything found, as plain data.

    names : of components, all rules where there is none. Every row of `rules` has rule, test,
    component, how, bound, error, unit, seconds_saved, holds and `all`: every measurement of it.
    """
    chosen, rows = checked_rules(names), []
    began = time.process_time()
    with tempfile.TemporaryDirectory(prefix="nightglass-ledger-") as folder:
        bench = Bench(Path(folder), make_stars(Path(folder)))
        for k, rule in enumerate(chosen):
            if progress is not None:
                progress("rules", k, len(chosen))
            works = PROBES[rule.components[0]]
            rows.append(_row(rule, [found for work in works for found in work(bench)]))
    if progress is not None:
        progress("rules", len(chosen), len(chosen))
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else None
    machine = {
        "processor": platform.machine(),
        "cores": os.cpu_count(),
        "load": load,
        "python": platform.python_version(),
    }
    return {
        "schema": "nightglass/ledger-report/1",
        "nightglass": version("nightglass"),
        "machine": machine,
        "cpu_s": time.process_time() - began,
        "rules": rows,
    }


def _row(rule: Rule, found: list[ProbeResult]) -> Row:
    """A rule's row: the measurement that uses most of its bound, and all of them."""
    worst = max(found, key=lambda f: (not f.holds, f.error / f.bound if f.bound else f.error))
    head = {"rule": rule.components[0], "test": rule.test}
    return head | told(worst) | {"all": [told(f) for f in found]}


def told(f: ProbeResult) -> Row:
    """One measurement as plain data."""
    return {
        "component": f.component,
        "how": f.how,
        "bound": float(f.bound),
        "error": float(f.error) if math.isfinite(f.error) else None,
        "unit": f.unit,
        "seconds_saved": f.seconds_in - f.seconds_out,
        "holds": f.holds,
    }
