"""One level: a scene rendered as a user does, in a process of its own; time, memory, and error."""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from catalog_tools.documents import JsonObject
from catalog_tools.engine.heap import peak_mb
from pipeline.arrays import Array
from pipeline.execute.blocks import around
from pipeline.execute.sources import excursion_px, place_targets
from pipeline.plan.accuracy import total_sigma
from pipeline.plan.described import plan_dict
from pipeline.plan.plan import Plan
from pipeline.plan.response.responses import cut_share
from pipeline.plan.tiles import Tile, distance_px
from pipeline.route.run import Options, render
from pipeline.route.shares import Share
from pipeline.spec.load import parse_scene
from pipeline.studies.scenes.exact import Exact, load_exact
from pipeline.studies.scenes.stage import Light, Stage, light_by, mean_of, open_stage
from pipeline.studies.worst import worst_of


def measure_level(order: JsonObject) -> JsonObject:
    """Time, memory and error of a scene at one accuracy.

    order : scene (plain data), share [part, parts], folder (empty, its own), exact (path of what
    `Exact.save` wrote). The first render of the process is timed with all that it makes, then a
    second one, whose tables are there.
    """
    folder = Path(order["folder"])
    before = peak_mb()
    first = render_once(order["scene"], order["share"], folder / "first")
    peak = peak_mb()
    again = render_once(order["scene"], order["share"], folder / "again")
    stage = open_stage(order["scene"])
    exact = load_exact(Path(order["exact"]))
    errors = errors_against(stage, light_by(stage, stage.plan), exact)
    return {
        "cpu_s": first[0],
        "wall_s": first[1],
        "again_cpu_s": again[0],
        "again_wall_s": again[1],
        "peak_mb": peak,
        "before_mb": before,
        "stars": len(stage.stars),
        "targets": len(stage.plan.scene.targets),
        "engine": plan_dict(stage.plan, None)["engine"],
        "noise_floor_e": stage.plan.facts.sigma_floor_e,
        "light_left_out": stage.plan.responses.lost_light,
        **errors,
    }


def render_once(scene: JsonObject, part: Sequence[int], product: Path) -> tuple[float, float]:
    """CPU and wall seconds of a render; its product is removed again.

    part : (part, of how many) of the tiles
    """
    parsed, share = parse_scene(scene), Share(*part)
    cpu, wall = time.process_time(), time.perf_counter()
    if share.parts == 1:
        render(parsed, product, Options())
    else:
        render(parsed, product, Options(), share=share)
    spent = time.process_time() - cpu, time.perf_counter() - wall
    shutil.rmtree(product)
    return spent


def errors_against(stage: Stage, light: Light, exact: Exact) -> JsonObject:
    """How far drawn light is from what belongs in the windows.

    max_sigma, rms_sigma : in units of each pixel's noise; max_e; bias : of all their light
    bound_sigma : what the plan allows, in a pixel near no bright source and in the one where it
    allows most; of_bound : largest share of what it allows that a pixel errs by
    """
    off = [
        mean_of(stage, light(w), w) - m for w, m in zip(exact.windows, exact.mean_e, strict=True)
    ]
    allowed = [
        allowed_e(stage.plan, n, *lights_near(stage, w))
        for w, n in zip(exact.windows, exact.noise_e, strict=True)
    ]
    total = sum(float(m.sum()) for m in exact.mean_e)
    share = _joined(o / n for o, n in zip(off, exact.noise_e, strict=True))
    bounds = _joined(a / n for a, n in zip(allowed, exact.noise_e, strict=True))
    used = _joined(np.abs(o) / a for o, a in zip(off, allowed, strict=True))
    return {
        "max_sigma": float(np.abs(share).max()),
        "rms_sigma": float(np.sqrt(np.mean(share**2))),
        "max_e": worst_of(*(np.abs(o).max() for o in off)),
        "bias": sum(float(o.sum()) for o in off) / total if total else 0.0,
        "bound_sigma": [total_sigma(stage.plan.decisions), float(bounds.max())],
        "of_bound": float(used.max()),
        "windows": len(off),
    }


def _joined(parts: Iterable[Array]) -> Array:
    return np.concatenate([p.ravel() for p in parts])


def allowed_e(plan: Plan, noise_e: Array, stars_e: list[float], targets_e: list[float]) -> Array:
    """What the plan says that pixels of this noise may err by [e-].

    stars_e, targets_e : light of the sources that reaches them. Of the brightest one the
    wavelengths, and beyond the core classes the wings, err by the plan's share of it; of all the
    end of the wings is missing.
    """
    r, band = plan.responses, plan.facts.band
    star, target = max(stars_e, default=0.0), max(targets_e, default=0.0)
    allowed = total_sigma(plan.decisions) * noise_e
    allowed = allowed + (band.error if band else 0.0) * max(star, target)
    if r.spacing_px:
        last = r.classes[-1]
        wings = max(last.wing_error * star, last.target_error * target)
        allowed = allowed + max(0.0, wings - r.budget_e)
        allowed = allowed + cut_e(plan, sum(stars_e) + sum(targets_e))
    return allowed


def cut_e(plan: Plan, light_e: float) -> float:
    """Light that a pixel lacks because the wings of sources end: of so much light in all [e-]."""
    return cut_share(plan.responses.blurs, plan.responses.reach_px) * light_e


def lights_near(stage: Stage, window: Tile) -> tuple[list[float], list[float]]:
    """Light of each star and of each target that reaches a window [e-]."""
    reach = stage.plan.halo_px + excursion_px(stage.plan, stage.g)
    stars = around(stage.stars, window, reach).light_e
    place = window.y0, window.x0, window.rows, window.columns
    targets = [
        t.light_e
        for t in place_targets(stage.plan, stage.g)
        if distance_px(np.array([t.x_px]), np.array([t.y_px]), *place)[0]
        < stage.plan.halo_px + t.radius_px + t.path.length_px
    ]
    return stars.tolist(), targets


def lights_e(stage: Stage) -> list[float]:
    """Light of each source of the frame [e-]."""
    whole = Tile(0, 0, 0, 0, stage.plan.camera.rows, stage.plan.camera.columns)
    stars, targets = lights_near(stage, whole)
    return [0.0, *stars, *targets]
