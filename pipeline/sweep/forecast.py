"""What a whole sweep takes, before it runs: what its points share is counted once."""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Iterable
from pathlib import Path

from catalog_tools.documents import JsonObject
from pipeline.execute.tile import LIGHTS
from pipeline.plan.cost import CHUNK_S, NOISE_S_PER_PIXEL, START_S, TILE_S
from pipeline.plan.needs import predict
from pipeline.spec.load import parse_scene
from pipeline.spec.sweep import Grid, axis_length
from pipeline.sweep.check import check
from pipeline.sweep.dependence import AFTER_LIGHT, light_is_shared
from pipeline.sweep.points import Course, scene_of, set_field, with_floor
from pipeline.sweep.stages import Base, stages

LOOKED_AT = 3  # points whose plan tells the cost of light
COUNTED = 100_000  # places of a design that are looked at one by one, at most


def forecast_course(course: Course) -> JsonObject:
    """Points, how often each stage is run for all of them, CPU seconds and memory.

    plans, stars, targets, sky : how many different ones there are, drawn once each in a process
    that keeps them; cpu_s : of one core, all points in one process. Raises BadInput as the sweep
    itself would.
    """
    warnings = check(course).warnings
    design, run = course.design, stages(course.run)
    shared = light_is_shared(scene_of(course, design, 0))
    spots = dict.fromkeys(k * (design.size - 1) // max(1, LOOKED_AT - 1) for k in range(LOOKED_AT))
    began = time.process_time()
    bases = [with_floor(course, run, scene_of(course, design, p))[1] for p in spots]
    plan_s = (time.process_time() - began) / len({base.key for base in bases})
    plan, counts = bases[0].plan, _counts(course, bases[0], shared)
    frames, pixels = plan.frames, math.prod(plan.scene.sensor.shape)
    tiles = frames * len(plan.tiles)
    needs = [predict(b.plan, b.prepared.forecast, b.prepared.spent) for b in bases]
    bare_s = frames * pixels * NOISE_S_PER_PIXEL + tiles * (TILE_S + 2 * CHUNK_S) + START_S
    light_s = max(0.0, sum(n["cpu_s"] for n in needs) / len(needs) - bare_s - plan_s)
    point_s = frames * pixels * NOISE_S_PER_PIXEL
    lights = counts["stars"] or counts["targets"]  # what takes time; the sky is smooth
    return {
        "points": design.size,
        "frames": frames,
        "shape": list(plan.scene.sensor.shape),
        "different": counts,
        "cpu_s": START_S
        + counts["plans"] * plan_s
        + lights * light_s
        + design.size * point_s
        + counts["plans"] * tiles * TILE_S,
        "seconds_each": {"plan": plan_s, "light": light_s, "point": point_s},
        "worker_memory_mb": max(n["worker_memory_mb"] for n in needs),
        "metrics": list(course.sweep.metrics),
        "warnings": warnings,
        "alone_cpu_s": design.size * needs[0]["cpu_s"],
    }


def _counts(course: Course, base: Base, shared: bool) -> dict[str, int]:
    """How many different plans and lights of each kind the points have."""
    fields = {name for axis in course.design.axes for name in axis.fields}
    if shared:
        fields -= set(AFTER_LIGHT)
    counts = {"plans": _distinct(course, fields, shared)}
    for kind in LIGHTS:
        names = _touching(course, base, kind, fields) if shared else fields
        drawn = kind == "sky" or getattr(base.plan.scene, kind)
        counts[kind] = _distinct(course, names, shared) if drawn else 0
    return counts


def _touching(course: Course, base: Base, kind: str, fields: Iterable[str]) -> set[str]:
    """Of some fields those that change one kind of light, each tried alone at its other values."""
    design, run = course.design, stages(course.run)
    first, found = design.values(0), set()
    for name in fields:
        others = [v for v in design.extremes(name) if v != first[name]]
        data = copy.deepcopy(course.data)
        for field, value in {**first, name: others[-1] if others else first[name]}.items():
            set_field(data, field, value)
        scene = parse_scene(data, base=Path(course.base_folder))
        if others and with_floor(course, run, scene)[1].parts[kind][1] != base.parts[kind][1]:
            found.add(name)
    return found


def _distinct(course: Course, fields: set[str], shared: bool) -> int:
    """How many different values some fields take together; of large designs at most so many."""
    design = course.design
    if not shared:
        return design.size
    places = design.size // course.sweep.seeds
    if places <= COUNTED:
        return len(
            {
                tuple(
                    (k, repr(v))
                    for k, v in design.values(place * course.sweep.seeds).items()
                    if k in fields
                )
                for place in range(places)
            }
        )
    if isinstance(course.sweep.design, Grid):
        return math.prod(axis_length(a) for a in design.axes if not fields.isdisjoint(a.fields))
    return places if fields else 1
