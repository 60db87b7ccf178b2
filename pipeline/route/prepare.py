"""A scene made ready to be drawn: resolved, planned, and weighed."""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import cached_property
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np
from numba.core.event import install_listener

from catalog_tools.documents import JsonObject
from pipeline.arrays import SensorMaps
from pipeline.compile_time import EVENT, Compiling
from pipeline.errors import BadInput
from pipeline.inputs.memory import free_mb
from pipeline.inputs.stars.catalogues import catalogue_facts
from pipeline.inputs.stars.stars import Catalogue
from pipeline.plan.described import plan_dict
from pipeline.plan.needs import Spent, StarForecast, check_memory
from pipeline.plan.plan import Plan
from pipeline.plan.pointing.geometry import plan_geometry
from pipeline.plan.pointing.paths import near_frame
from pipeline.plan.pointing.star_paths import excursions_px
from pipeline.plan.scene_plan import make_plan
from pipeline.plan.stars.brightest import points_beyond
from pipeline.resolve.resolve import Resolved, resolve
from pipeline.resolve.stars import shards_of
from pipeline.spec.scene import Scene

if TYPE_CHECKING:
    from pipeline.execute.graph import Inputs
    from pipeline.physics.cosmic_rays.frame import CosmicRays
    from pipeline.store.cube import CubeWriter


@dataclass(frozen=True)
class Prepared:
    """A plan with what was read to make it.

    catalogues : the main one and the layers over it; left_out : of each, the sorted source_ids of
    stars that an earlier one holds; spent : what planning took
    """

    plan: Plan
    maps: SensorMaps
    catalogues: tuple[Catalogue, ...]
    left_out: tuple[np.ndarray, ...]
    spent: Spent
    rays: CosmicRays | None = None

    @property
    def catalogue_digest(self) -> str | None:
        """Of all catalogues that it looked into; None without any."""
        return "+".join(c.digest for c in self.catalogues) or None

    @cached_property
    def forecast(self) -> StarForecast | None:
        """What is read of the catalogues for the scene's frames; None without stars."""
        plan = self.plan
        if plan.scene.stars is None:
            return None
        frames = np.unique(np.linspace(0, plan.frames - 1, min(plan.frames, 32)).astype(np.int64))
        g = plan_geometry(plan.scene, frames, plan.dut1_s)
        leaves = [shard.leaf for shard in shards_of(plan, self.catalogues, g)]
        groups = [group for leaf in leaves for group in leaf.row_groups]
        rows, size = sum(g.rows for g in groups), sum(g.bytes for g in groups)
        return StarForecast(len(leaves), len(groups), rows, size, plan.stars_per_frame)

    def inputs(self, writer: CubeWriter, plan: Plan | None = None) -> Inputs:
        """What tasks need; plan : in place of its own."""
        from pipeline.execute.graph import Inputs  # drawing: a plan alone does without

        used = plan or self.plan
        return Inputs(used, self.maps, self.catalogues, self.left_out, writer, self.rays)


def prepare(scene: Scene) -> Prepared:
    """Resolve a scene and plan it; what is read and raised, `resolve` says."""
    started = time.thread_time()
    with install_listener(EVENT, Compiling()) as compiling:
        r = resolve(scene)
        warnings = r.warnings
        if r.scene.scene.targets:
            warnings = (*warnings, *_drawing().full_warnings(r.scene, r.geometry))
        plan = make_plan(r.scene, r.geometry, r.stars, r.remarks, warnings, r.targets)
        spent = _spent(plan, r, started, compiling)
    return Prepared(plan, r.maps, r.catalogues, r.left_out, spent, r.rays)


def _spent(plan: Plan, r: Resolved, started: float, compiling: Compiling) -> Spent:
    """What planning took since the thread's time `started` but for compiling, and how far its
    stars move."""
    moved = excursions_px(plan.camera, r.geometry, plan.scene.star_effects["aberration"])
    far = float(moved.max()) if plan.scene.stars is not None else 0.0
    beyond_s = 0.0
    if points_beyond(plan, r.geometry):
        beyond_s = _drawing().quadrature_s(plan, r.geometry)
    frames = len(r.geometry.frame)
    near = frames < plan.frames or near_frame(plan.scene, r.geometry, plan.halo_px).any()
    took_s = time.thread_time() - started - compiling.cpu_s
    return Spent(took_s, r.geometry_s, frames, far, beyond_s, bool(near))


def plan_scene(scene: Scene) -> JsonObject:
    """The plan of a scene as plain data (`nightglass plan`), with what its frames will show; what
    it reads, `prepare` says."""
    prepared = prepare(scene)
    return summary_of(prepared) | {"outlook": _drawing().outlook(prepared.plan)}


def _drawing() -> ModuleType:
    """What frames will show, by what draws them: a plan for a render without targets needs none."""
    from pipeline.execute import outlook

    return outlook


def check_cost(scene: Scene, summary: JsonObject, most_cpu_s: float | None) -> None:
    """BadInput where a plan predicts more CPU seconds than are allowed; None allows any."""
    asked = summary["predicted"]["cpu_s"]
    if most_cpu_s is not None and asked > most_cpu_s:
        field = "exposure.frames" if scene.dwells is None else "dwells"
        allowed = f"a scene of at most {most_cpu_s:g} CPU s (predicted: {asked:.0f})"
        raise BadInput(field, summary["frames"], allowed)


def summary_of(prepared: Prepared) -> JsonObject:
    facts = catalogue_facts_of(prepared)
    return plan_dict(prepared.plan, prepared.forecast, facts, prepared.spent)


def check_room(
    prepared: Prepared, most_mb: float | None = None, processes: int = 1, threads: int = 1
) -> None:
    """BadInput where a plan forecasts more memory than this machine has free for each of so many
    processes, with so many threads; most_mb : than so much, whatever is free."""
    if most_mb is None:
        most_mb = free_mb() / processes
    check_memory(prepared.plan, prepared.forecast, prepared.spent, most_mb, threads)


def catalogue_facts_of(prepared: Prepared) -> list[JsonObject]:
    return catalogue_facts(prepared.catalogues, prepared.left_out)
