"""The whole route: a scene prepared, its missing tiles drawn, the product finished."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from catalog_tools.schedulers import TASKS_PER_WINDOW, Scheduler, open_scheduler
from pipeline.errors import BadInput, NightglassError, TryLater
from pipeline.execute.bundles import bundled, tiles_a_bundle, tiles_done
from pipeline.execute.graph import Work, shard_graph, shard_key, window_graph
from pipeline.finish import finish, stored_report
from pipeline.inputs.stars import Shard
from pipeline.plan.cost import CHUNK_S, TILE_S
from pipeline.plan.geometry import plan_geometry
from pipeline.plan.needs import frame_seconds
from pipeline.plan.scene_plan import Plan
from pipeline.prepare import (
    Prepared,
    catalogue_facts_of,
    check_cost,
    check_room,
    forecast,
    prepare,
    shards_of,
    summary_of,
)
from pipeline.shares import WHOLE, Share
from pipeline.spec.scene import Scene
from pipeline.store import layout
from pipeline.store.markers import markers_present
from pipeline.store.product import Begun, begin, is_begun, is_sealed, truth_kinds

Listener = Callable[["Progress"], None]


@dataclass(frozen=True)
class Options:
    """How to render; none of it changes a bit of the result.

    scheduler : threads, synchronous, processes, or an address; workers : None for all cores
    resume : go on with an unfinished product; replace : remove what stands at the path first
    wait_s : how long another render of the same product is waited for
    most_cpu_s : a scene whose plan predicts more is refused before anything is drawn
    most_memory_mb : likewise of memory; None: what this machine has free, unless others draw
    """

    scheduler: str = "threads"
    workers: int | None = None
    resume: bool = False
    replace: bool = False
    wait_s: float = 0.0
    most_cpu_s: float | None = None
    most_memory_mb: float | None = None

    @property
    def processes(self) -> int:
        """How many processes of this machine draw; 0 where those of others do."""
        own = {"threads": 1, "synchronous": 1, "processes": self.workers or os.cpu_count() or 1}
        return own.get(self.scheduler, 0)


@dataclass(frozen=True)
class Progress:
    """How far a render is: tiles done of all, and what was just done."""

    done: int
    total: int
    doing: str


def render(
    scene: Scene, product: Path, options: Options | None = None, listen: Listener | None = None
) -> dict[str, Any]:
    """Render a scene into a product directory and return its report.

    Raises BadInput for a scene or path that cannot be used, Damaged for a damaged catalogue,
    Incomplete where work stopped before everything was done (what is done is kept), DiskFull
    where that was for want of room.
    """
    with layout.full_disk(product):
        return _render(scene, product, options or Options(), listen)


def _render(
    scene: Scene, product: Path, options: Options, listen: Listener | None
) -> dict[str, Any]:
    started = time.perf_counter()
    prepared = prepare(scene)
    plan, summary = prepared.plan, summary_of(prepared)
    check_cost(scene, summary, options.most_cpu_s)
    if options.processes or options.most_memory_mb:
        check_room(prepared, options.most_memory_mb, options.processes)
    if options.replace and product.exists():
        _remove(product, options.wait_s)
    digest = prepared.catalogue_digest
    if not (options.resume and is_begun(product)):
        begin(product, plan, digest, options.resume)
    with layout.only_writer(product, wait_s=options.wait_s):
        # Taken up inside: another writer may just have ended.
        begun = begin(product, plan, digest, resume=True)
        if is_sealed(begun, WHOLE.tiles(plan)):
            return stored_report(begun)
        unseal(product)
        layout.write_atomically(product / layout.PLAN, layout.to_json(summary))
        drawing = time.perf_counter()
        try:
            with open_scheduler(options.scheduler, options.workers) as scheduler:
                draw(prepared, begun, scheduler, listen)
                workers = scheduler.workers
        except NightglassError as error:
            kept = any(markers_present(product))
            if not kept:
                shutil.rmtree(product)  # nothing was finished, so nothing is left behind
            raise how_to_go_on(error, kept) from None
        times = times_of(options, started, drawing, workers)
        return finish(plan, catalogue_facts_of(prepared), begun, times)


def how_to_go_on(error: NightglassError, kept: bool) -> NightglassError:
    """An error that ended the drawing; where it says to try later, also by which command."""
    if not isinstance(error, TryLater):
        return error
    told = "what is finished is kept: go on with --resume" if kept else "nothing was finished yet"
    return TryLater(f"{error}; {told}")


def times_of(options: Options, started: float, drawing: float, workers: int) -> dict[str, Any]:
    """What a report says of its time; started, drawing : when planning and drawing began."""
    return {
        "plan_s": drawing - started, "draw_s": time.perf_counter() - drawing,
        "workers": workers, "scheduler": options.scheduler,
    }  # fmt: skip


def draw(
    prepared: Prepared, begun: Begun, scheduler: Scheduler, listen: Listener | None,
    share: Share = WHOLE,
) -> None:  # fmt: skip
    """Run every missing task of a share, window by window of frames."""
    plan, catalogues = prepared.plan, prepared.catalogues
    inputs = scheduler.share(prepared.inputs(begun.writer))
    total = share.tiles(plan)
    ref_epochs = tuple(c.ref_epoch_jyear for c in catalogues)
    state = {"done": len(begun.done)}
    shards: dict[Shard, Any] = {}

    def done(kind: str) -> None:
        state["done"] += tiles_done(kind)
        if listen is not None:
            listen(Progress(state["done"], total, kind))

    if listen is not None:
        listen(Progress(state["done"], total, "start"))
    size = _tiles_a_task(prepared, scheduler, total)

    def graphs() -> Iterator[tuple[dict[Any, Any], list[Any]]]:
        nonlocal shards
        for window in _windows(plan, share):
            work = missing(plan, begun, window, share)
            if work is None:
                continue
            needed = shards_of(plan, catalogues, work.geometry)
            shards = {shard: shards[shard] for shard in needed if shard in shards}
            fresh = [shard for shard in needed if shard not in shards]
            kept = scheduler.keep(shard_graph(inputs, fresh))
            shards |= {shard: kept[shard_key(shard)] for shard in fresh}
            graph, keys = window_graph(inputs, plan, work, shards, ref_epochs)
            yield bundled(graph, keys, size) if size > 1 else (graph, keys)

    scheduler.stream(graphs(), done)


def _tiles_a_task(prepared: Prepared, scheduler: Scheduler, tiles: int) -> int:
    """How many tiles of a job a task draws, by the plan's estimate of their work."""
    if tiles < 2 * scheduler.workers:
        return 1
    plan = prepared.plan
    tile_s = frame_seconds(plan, forecast(prepared)) / len(plan.tiles)
    tile_s += TILE_S + CHUNK_S * len(prepared.plan.scene.output.layers)
    window = max(TASKS_PER_WINDOW, len(plan.tiles))  # at most so many are sent at a time
    return tiles_a_bundle(tile_s, scheduler.least_task_s, min(tiles, window), scheduler.workers)


def _windows(plan: Plan, share: Share) -> Iterator[np.ndarray]:
    """Frames of a share in windows of at most TASKS_PER_WINDOW tiles, so that no graph grows."""
    per_window = max(1, TASKS_PER_WINDOW // len(plan.tiles))
    first, end = share.span(plan)
    start, stop = first // len(plan.tiles), -(-end // len(plan.tiles))
    for at in range(start, stop, per_window):
        yield np.arange(at, min(at + per_window, stop), dtype=np.int64)


def missing(plan: Plan, begun: Begun, frames: np.ndarray, share: Share = WHOLE) -> Work | None:
    """What a share of a window still lacks; None where nothing. Truth goes with a first tile."""
    first = int(frames[0])
    earlier = np.arange(max(0, first - plan.lag_frames), first, dtype=np.int64)
    shift = len(earlier)
    tiles = [
        (i + shift, tile)
        for i, frame in enumerate(frames)
        for number, tile in enumerate(plan.tiles)
        if share.holds(plan, int(frame), number)
        and (int(frame), tile.row, tile.column) not in begun.done
    ]
    truth = {
        kind: tuple(
            i + shift for i, f in enumerate(frames)
            if share.holds(plan, int(f), 0) and (kind, int(f)) not in begun.truth_done
        )
        for kind in truth_kinds(plan)
    }  # fmt: skip
    if not tiles and not any(truth.values()):
        return None
    seen = np.concatenate([earlier, frames])
    drawn = np.unique([plan.drawn_frame(int(f)) for f in seen])
    seen = np.concatenate([seen, np.setdiff1d(drawn, seen)])
    geometry = plan_geometry(plan.scene, seen, plan.dut1_s)
    return Work(
        geometry, tuple(tiles), truth.get("stars", ()), truth.get("targets", ()),
        truth.get("cosmic_rays", ()),
    )  # fmt: skip


def unseal(product: Path) -> None:
    """An earlier seal no longer holds once anything is drawn again."""
    for name in (layout.COMPLETE, f"{layout.CUBE}/zarr.json"):
        (product / name).unlink(missing_ok=True)


def _remove(product: Path, wait_s: float) -> None:
    """Remove an old product (only a product, never any other folder)."""
    if not product.is_dir() or not (product / layout.BEGUN).is_file():
        raise BadInput("--replace", str(product), "a product made by `nightglass render`")
    with layout.only_writer(product, wait_s=wait_s):
        shutil.rmtree(product)
