"""The study: every scene at every level in a process of its own, one after another."""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

from catalog_tools.documents import JsonObject
from catalog_tools.engine.code import own_version
from catalog_tools.synthetic.synthetic import make_demo
from pipeline.errors import BadInput, NightglassError
from pipeline.studies.scenes.scenes import (
    ALL_SKY_G_MAG,
    QUICK_ALL_SKY_G_MAG,
    ReportScene,
    deep_fields,
    requests,
    with_accuracy,
)

Progress = Callable[[str, int, int], None]

LEVELS, QUICK_LEVELS = (0.5, 0.2, 0.05, 0.0125), (0.5, 0.05)
USUAL = 0.05  # the default of a scene, at which approximations are switched off one by one
FLUX_OF_NOISE = 0.02  # accuracy.flux_fraction of a level, over its noise_fraction
FINER = 0.25  # accuracy of the reference, of the finest level's
MOST_LEVELS, LEAST_LEVEL = 12, 1e-4
WINDOWS, QUICK_WINDOWS = 12, 5
QUICK_SCENES = ("sidereal-sparse", "rate-track", "many-targets")
CHILD_S = 3600.0


def checked_levels(text: str | None, quick: bool) -> tuple[float, ...]:
    """Accuracy targets from "0.5,0.05", coarsest first; BadInput for what is none."""
    if text is None:
        return QUICK_LEVELS if quick else LEVELS
    allowed = f"1 to {MOST_LEVELS} numbers from {LEAST_LEVEL:g} to 1, with commas: 0.5,0.05,0.005"
    try:
        levels = tuple(float(part) for part in text.split(","))
    except ValueError:
        raise BadInput("--levels", text, allowed) from None
    if not 1 <= len(levels) <= MOST_LEVELS or not all(LEAST_LEVEL <= r <= 1.0 for r in levels):
        raise BadInput("--levels", text, allowed)
    return tuple(sorted(set(levels), reverse=True))


def run_study(
    names: tuple[str, ...],
    levels: tuple[float, ...],
    quick: bool,
    catalogue: Path | None,
    folder: Path,
    progress: Progress | None = None,
) -> JsonObject:
    """Measure scenes at a ladder of accuracies; everything found, as plain data.

    names : of scenes; where there is none all, or QUICK_SCENES
    levels : noise_fraction, coarsest first
    catalogue : of stars; None makes a synthetic one. folder : for work, its contents are lost
    """
    chosen = requests(names or (QUICK_SCENES if quick else ()), quick)

    def say(stage: str, done: int, of: int) -> None:
        if progress is not None:
            progress(stage, done, of)

    say("catalogue", 0, 1)
    stars = str(catalogue or make_catalogue(tuple(w.name for w in chosen), quick, folder))
    say("catalogue", 1, 1)
    told = []
    for request in chosen:
        say(request.name, 0, len(levels) + 1)
        found = run_child(_reference_order(request, levels, quick, stars, folder))
        rows = []
        for k, level in enumerate(levels):
            say(request.name, k + 1, len(levels) + 1)
            asked = {"noise_fraction": level, "flux_fraction": FLUX_OF_NOISE * level}
            rows.append(asked | run_child(_level_order(request, k, level, stars, folder)))
        say(request.name, len(levels) + 1, len(levels) + 1)
        told.append(_told(request, found, rows))
    return {
        "schema": "nightglass/scene-report/1",
        "quick": quick,
        "levels": list(levels),
        "catalogue": "given" if catalogue else "synthetic",
        "machine": _machine(),
        "nightglass": own_version(),
        "scenes": told,
    }


def _reference_order(
    request: ReportScene, levels: tuple[float, ...], quick: bool, stars: str, folder: Path
) -> JsonObject:
    finest = FINER * min(*levels, USUAL)
    return {
        "work": "reference",
        "windows": QUICK_WINDOWS if quick else WINDOWS,
        "levels": [with_accuracy(request, a, FLUX_OF_NOISE * a, stars) for a in levels],
        "finest": with_accuracy(request, finest, FLUX_OF_NOISE * finest, stars),
        "scene": with_accuracy(request, USUAL, FLUX_OF_NOISE * USUAL, stars),
        "share": request.share,
        "exact": str(folder / f"{request.name}.npz"),
        "folder": str(folder / f"{request.name}-first"),
    }


def _level_order(
    request: ReportScene, number: int, level: float, stars: str, folder: Path
) -> JsonObject:
    work = folder / f"{request.name}-{number}"
    work.mkdir()
    return {
        "work": "level",
        "scene": with_accuracy(request, level, FLUX_OF_NOISE * level, stars),
        "share": request.share,
        "exact": str(folder / f"{request.name}.npz"),
        "folder": str(work),
    }


def _told(request: ReportScene, found: JsonObject, rows: list[JsonObject]) -> JsonObject:
    size = request.data["sensor"]["shape"]
    return {
        "scene": request.name,
        "title": request.title,
        "shape": size,
        "tiles_drawn": list(request.share),
        "stars": rows[0]["stars"],
        "targets": rows[0]["targets"],
        "windows": found["windows"],
        "sources_drawn_again": found["sources"],
        "levels": rows,
        "switches": found["switches"],
    }


def make_catalogue(names: tuple[str, ...], quick: bool, folder: Path) -> Path:
    """A synthetic catalogue that is deep where these scenes look."""
    path = folder / "catalogue"
    limit = QUICK_ALL_SKY_G_MAG if quick else ALL_SKY_G_MAG
    make_demo(path, faintest_g_mag=limit, deep_fields=deep_fields(names, quick))
    return path


def run_child(order: JsonObject) -> JsonObject:
    """One measurement in a process of its own; raises what it says went wrong."""
    command = [sys.executable, "-m", "pipeline.studies.scenes.child"]
    done = subprocess.run(
        command,
        input=json.dumps(order),
        capture_output=True,
        text=True,
        check=False,
        timeout=CHILD_S,
    )
    lines = done.stdout.strip().splitlines()
    if done.returncode or not lines:
        last = (done.stderr.strip().splitlines() or ["no word"])[-1]
        name = order["scene"]["name"]
        raise NightglassError(f"{name}: its process ended with {done.returncode}: {last}")
    found: JsonObject = json.loads(lines[-1])
    if "refused" in found:
        raise BadInput(*found["refused"])
    if "failed" in found:
        raise NightglassError(found["failed"])
    return found


def _machine() -> JsonObject:
    """What it was measured on, and how much else it had to do."""
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else None
    return {
        "processor": platform.machine(),
        "cores": os.cpu_count(),
        "load_before": load,
        "python": platform.python_version(),
    }
