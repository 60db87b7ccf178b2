"""What the guards cost: their share of a frame's CPU time, as a ratio within one run.

Run: python -m benchmarks.guards [--side PIXELS] [--stars N] [--json FILE]. The same tile of the
same sky is drawn again and again, with stars and all noise, and written as a product's; the CPU
seconds inside of the guards are summed beside those of placing, drawing and writing.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

REPEATS = 8
GUARDS = ("guard_stars", "guard_light", "inside_tile", "guard_mean", "guard_some")


def measure(side: int, stars: int) -> dict[str, Any]:
    """Seconds of a tile of `side` pixels with so many stars, and of the guards in it."""
    from pipeline.arrays import SensorMaps, StarTable
    from pipeline.execute import light, sources, tile
    from pipeline.plan.pointing.geometry import plan_geometry
    from pipeline.store.product import begin

    plan = _plan(side)
    g = plan_geometry(plan.scene, np.zeros(1, int), 0.0)
    rng = np.random.default_rng(1)
    half = 0.5 * side * plan.facts.ifov_rad
    none = np.full(stars, np.nan)
    ra = np.radians(40.0) + rng.uniform(-half, half, stars) / np.cos(np.radians(25.0))
    dec = np.radians(25.0) + rng.uniform(-half, half, stars)
    table = StarTable(
        np.arange(stars), ra, dec, none, none, none, none, np.full(stars, 15.0),
        10.0 ** rng.uniform(1.5, 4.5, stars), np.zeros(stars, np.uint8),
    )  # fmt: skip
    maps, (whole,) = SensorMaps(1.0, 0.1, 5.0, 1.5, 500.0), plan.tiles
    spent: Counter[str] = Counter()
    for module in (light, sources, tile):
        for name in GUARDS:
            if hasattr(module, name):
                setattr(module, name, _timed(getattr(module, name), name, spent))

    with tempfile.TemporaryDirectory() as folder:
        writer = begin(Path(folder) / "product", plan, None, resume=False).writer

        def frame(k: int) -> None:
            placed = sources.place_stars(plan, table, g, 2015.5)
            lit = tile.TileSources([placed], [])
            writer.write(k, whole, *tile.render_tile(plan, maps, g, whole, lit))

        frame(0)
        spent.clear()
        began = time.process_time()
        for k in range(REPEATS):
            frame(k + 1)
        total = (time.process_time() - began) / REPEATS
    each = {name: seconds / REPEATS for name, seconds in spent.items()}
    return {
        "side_px": side, "stars": stars, "frame_s": total, "guards_s": sum(each.values()),
        "share": sum(each.values()) / total, "each_s": each,
    }  # fmt: skip


def _timed(function: Callable[..., Any], name: str, spent: Counter[str]) -> Callable[..., Any]:
    def timed(*arguments: Any) -> Any:
        began = time.process_time()
        out = function(*arguments)
        spent[name] += time.process_time() - began  # type: ignore[assignment]
        return out

    return timed


def _plan(side: int) -> Any:
    """A plan of one still frame; nothing is read."""
    from pipeline.physics.radiometry import box
    from pipeline.plan.facts import gather_facts
    from pipeline.plan.pointing.geometry import plan_geometry
    from pipeline.plan.resolved import resolved_scene
    from pipeline.plan.scene_plan import make_plan
    from pipeline.spec.load import parse_scene

    scene = parse_scene({
        "schema": "nightglass/scene/1", "name": "guards", "epoch": "2019-04-20T03:00:00Z",
        "observer": {"kind": "fixed", "position_au": [1.0, 0.0, 0.0]},
        "sensor": {
            "shape": [side, side], "pixel_pitch_um": 10.0, "focal_length_m": 1.0,
            "aperture_m": 0.065, "psf": {"kind": "gaussian", "sigma_px": 0.9}, "read_noise_e": 5.0,
            "bandpass": {"kind": "box", "short_nm": 600.0, "long_nm": 700.0},
        },
        "pointing": {"mode": "sidereal", "boresight_ra_deg": 40.0, "boresight_dec_deg": 25.0},
        "exposure": {"integration_s": 1.0, "frames": REPEATS + 1}, "stars": {"catalogue": "none"},
        "background": {"uniform_e_per_s": 50.0}, "accuracy": {"check_cells": 0},
    })  # fmt: skip
    facts = gather_facts(scene, box(600e-9, 700e-9), 0.1, 5.0, 1.5)
    g = plan_geometry(scene, np.zeros(1, int), 0.0)
    return make_plan(resolved_scene(scene, facts, g), g)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--side", type=int, default=1024)
    parser.add_argument("--stars", type=int, default=10_000)
    parser.add_argument("--json", type=Path)
    wish = parser.parse_args()
    found = measure(wish.side, wish.stars)
    found |= {"cores": os.cpu_count(), "processor": platform.machine(),
              "load": os.getloadavg()[0]}  # fmt: skip
    text = json.dumps(found, indent=2)
    print(text)
    if wish.json:
        wish.json.write_text(text + "\n")


if __name__ == "__main__":
    main()
