"""Drawing: the missing tasks of a product run, window by window of frames."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from catalog_tools.engine.ahead import Graph
from catalog_tools.engine.schedulers import TASKS_PER_WINDOW, Scheduler
from pipeline.execute.bundles import bundled, tiles_a_bundle, tiles_done
from pipeline.execute.graph import WindowWork, shard_graph, shard_key, window_graph
from pipeline.inputs.stars.stars import Shard
from pipeline.plan.cost import CHUNK_S, TILE_S
from pipeline.plan.needs import frame_seconds
from pipeline.plan.plan import Plan
from pipeline.plan.pointing.geometry import plan_geometry
from pipeline.resolve.stars import shards_of
from pipeline.route.prepare import Prepared
from pipeline.route.shares import WHOLE, Share
from pipeline.store.product import Begun, truth_kinds

Listener = Callable[["Progress"], None]

LONG_S = 60.0  # of CPU time: work whose size is told


@dataclass(frozen=True)
class Progress:
    """How far a render is: tiles done of all, and what was just done; "wait": for workers.

    left_s : CPU seconds forecast of the tiles that are left, until the first is done; then 0
    """

    done: int
    total: int
    doing: str
    left_s: float = 0.0

    @property
    def stage(self) -> str:
        """In words, with the size of long work before its first tile is done."""
        if self.doing == "wait":
            return "waiting for workers"
        size = f", {self.left_s / 60.0:.0f} CPU min" if self.left_s > LONG_S else ""
        return f"rendering{size}"


def draw(
    prepared: Prepared,
    begun: Begun,
    scheduler: Scheduler,
    listen: Listener | None,
    share: Share = WHOLE,
) -> None:
    """Run every missing task of a share, window by window of frames."""
    plan, catalogues = prepared.plan, prepared.catalogues
    inputs = scheduler.share(prepared.inputs(begun.writer))
    total = share.tiles(plan)
    ref_epochs = tuple(c.ref_epoch_jyear for c in catalogues)
    state = {"done": len(begun.done)}
    shards: dict[Shard, object] = {}
    tile_s = _tile_seconds(prepared)

    def done(kind: str) -> None:
        state["done"] += tiles_done(kind)
        if listen is not None:
            none_yet = state["done"] == len(begun.done)
            left_s = tile_s * (total - state["done"]) if none_yet else 0.0
            listen(Progress(state["done"], total, kind, left_s))

    done("start")
    size = _tiles_a_task(plan, scheduler, total, tile_s)

    def graphs() -> Iterator[Graph]:
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


def _tile_seconds(prepared: Prepared) -> float:
    """CPU seconds of a tile, by the plan's estimate of its frame's."""
    plan = prepared.plan
    frame_s = frame_seconds(plan, prepared.forecast)
    return frame_s / len(plan.tiles) + TILE_S + CHUNK_S * len(plan.scene.output.layers)


def _tiles_a_task(plan: Plan, scheduler: Scheduler, tiles: int, tile_s: float) -> int:
    """How many tiles of a job a task draws, each of so many seconds."""
    if tiles < 2 * scheduler.workers:
        return 1
    window = max(TASKS_PER_WINDOW, len(plan.tiles))  # at most so many are sent at a time
    return tiles_a_bundle(tile_s, scheduler.least_task_s, min(tiles, window), scheduler.workers)


def _windows(plan: Plan, share: Share) -> Iterator[np.ndarray]:
    """Frames of a share in windows of at most TASKS_PER_WINDOW tiles, so that no graph grows."""
    per_window = max(1, TASKS_PER_WINDOW // len(plan.tiles))
    first, end = share.span(plan)
    start, stop = first // len(plan.tiles), -(-end // len(plan.tiles))
    for at in range(start, stop, per_window):
        yield np.arange(at, min(at + per_window, stop), dtype=np.int64)


def missing(
    plan: Plan, begun: Begun, frames: np.ndarray, share: Share = WHOLE
) -> WindowWork | None:
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
            i + shift
            for i, f in enumerate(frames)
            if share.holds(plan, int(f), 0) and (kind, int(f)) not in begun.truth_done
        )
        for kind in truth_kinds(plan)
    }
    if not tiles and not any(truth.values()):
        return None
    seen = np.concatenate([earlier, frames])
    drawn = np.unique([plan.drawn_frame(int(f)) for f in seen])
    seen = np.concatenate([seen, np.setdiff1d(drawn, seen)])
    geometry = plan_geometry(plan.scene, seen, plan.dut1_s)
    return WindowWork(
        geometry,
        tuple(tiles),
        truth.get("stars", ()),
        truth.get("targets", ()),
        truth.get("cosmic_rays", ()),
    )
