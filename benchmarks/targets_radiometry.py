"""Light of 10,000 targets of simple shapes at 100 times each: seconds on one core, cold and warm.

Run: python -m benchmarks.targets_radiometry. Spheres, plates, boxes, cylinders, cones and frusta in
turn, under all attitude laws but tables; places are given (orbits are not part of it).
"""

from __future__ import annotations

import json
import time
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from pipeline.physics.positions.times import parse_utc
from pipeline.plan.bodies.attitudes import View
from pipeline.plan.bodies.shapes import reflected_m2_sr
from pipeline.spec.targets.body import Body

SHAPES: tuple[dict[str, Any], ...] = (
    {"kind": "sphere", "diameter_m": 1.0},
    {"kind": "plate", "area_m2": 2.0, "two_sided": True},
    {"kind": "box", "size_m": [1.0, 2.0, 3.0]},
    {"kind": "cylinder", "diameter_m": 1.0, "length_m": 3.0},
    {"kind": "cone", "diameter_m": 1.0, "length_m": 3.0},
    {"kind": "frustum", "base_diameter_m": 1.0, "top_diameter_m": 0.5, "length_m": 3.0},
)
LAWS: tuple[dict[str, Any], ...] = (
    {"kind": "inertial", "quaternion": [1.0, 2.0, 3.0, 4.0]},
    {"kind": "nadir"},
    {"kind": "sun"},
    {"kind": "velocity"},
    {"kind": "spin", "rate_deg_s": 3.0, "axis": [1.0, 0.0, 0.0]},
    {"kind": "sun_tracking"},
)


def bodies(count: int) -> list[Body]:
    """Targets' bodies: every shape, under every law in turn."""
    made = []
    for i in range(count):
        shape, law = SHAPES[i % 6], LAWS[i // 6 % 6]
        oriented = {} if shape["kind"] == "sphere" else {"attitude": law}
        made.append(TypeAdapter(Body).validate_python(shape | oriented | {"albedo": 0.2}))
    return made


def view(count: int, times: int) -> View:
    """Random places in low orbits along straight pieces, one site, one Sun."""
    rng = np.random.default_rng(0)
    start, speed = rng.normal(size=(2, count, 1, 3))
    start *= 7e6 / np.linalg.norm(start, axis=-1, keepdims=True)
    speed *= 7.5e3 / np.linalg.norm(speed, axis=-1, keepdims=True)
    time_s = np.broadcast_to(np.linspace(0.0, 60.0, times), (count, times))
    shape = (count, times, 3)
    return View(
        time_s, start + speed * time_s[..., None], np.broadcast_to(speed, shape),
        np.broadcast_to([1.5e11, 0.0, 0.0], shape), np.broadcast_to([6.4e6, 0.0, 0.0], shape),
    )  # fmt: skip


def radiometry_figures(count: int = 10_000, times: int = 100) -> dict[str, float]:
    """Seconds (wall and CPU, best of five) for the intensities of `count` targets."""
    targets, seen, epoch = bodies(count), view(count, times), parse_utc("2020-01-01T00:00:00Z")
    started = time.perf_counter()
    reflected_m2_sr(targets[:72], epoch, seen.of(np.arange(72)))
    first = time.perf_counter() - started
    wall, cpu = [], []
    for _ in range(5):
        started, used = time.perf_counter(), time.process_time()
        reflected_m2_sr(targets, epoch, seen)
        wall.append(time.perf_counter() - started)
        cpu.append(time.process_time() - used)
    return {
        "targets": count, "times": times, "first_call_s": round(first, 3),
        "wall_s": round(min(wall), 3), "cpu_s": round(min(cpu), 3),
    }  # fmt: skip


if __name__ == "__main__":
    print(json.dumps(radiometry_figures()))
