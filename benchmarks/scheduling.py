"""What scheduling costs: its share of a job's CPU time, and the memory of a plan of 1e6 tiles.

Run: python -m benchmarks.scheduling overhead|scale|model [--scheduler NAME] [--tiles N] [--json F].
NAME "apart" is a Dask scheduler and two workers as processes of their own.
"overhead" renders real frames at default tiles and compares the CPU seconds inside of the tasks
with those of all processes (of one thread each: synchronous, processes); "scale" streams a plan of
very many tiles whose body does nothing; "model" measures both, one worker process against two, and
says what that makes of 1 to 1,000 workers.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import psutil

from catalog_tools.engine.heap import peak_mb

IDLE_S = 10.0
SKY = {
    "schema": "nightglass/scene/1", "name": "load", "epoch": "2019-07-20T09:00:00Z",
    "observer": {"kind": "fixed", "position_au": [1, 0, 0]},
    "sensor": {
        "shape": [2048, 2048], "pixel_pitch_um": 9.0, "focal_length_m": 0.5, "aperture_m": 0.1,
        "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900}, "read_noise_e": 4.0,
        "psf": {"kind": "airy"},
    },
    "pointing": {"mode": "sidereal", "boresight_ra_deg": 10.0, "boresight_dec_deg": 5.0},
    "exposure": {"integration_s": 1.0, "frames": 8},
    "background": {"uniform_e_per_s": 9.0},
}  # fmt: skip


def timed(folder: str, function: Any, *arguments: Any) -> Any:
    """A task that leaves its own CPU seconds in a folder."""
    started = time.process_time()  # with the threads that Zarr compresses in
    out = function(*arguments)
    name = f"{os.getpid()}-{threading.get_ident()}-{time.perf_counter_ns()}"
    (Path(folder) / name).write_text(repr(time.process_time() - started))
    return out


def nothing(*_: Any) -> int:
    """The body of a simulated tile."""
    return 0


def emptied(task: tuple[Any, ...]) -> tuple[Any, ...]:
    """A task whose tiles do nothing; all that is sent to it stays."""
    from pipeline.execute.bundles import Bundle, run_bundle

    if task[0] is not run_bundle:
        return (nothing, *task[2:])
    steps = tuple(replace(step, function=nothing) for step in task[1].steps)
    return (run_bundle, Bundle(steps), *task[2:])


class Wrapped:
    """A scheduler whose graphs are changed before they run, by `change(task)`."""

    def __init__(self, inner: Any, change: Any) -> None:
        self.inner, self.change, self.workers = inner, change, inner.workers
        self.share, self.least_task_s = inner.share, inner.least_task_s
        self.planning_s = 0.0  # of windows: their geometry, and their graphs

    def keep(self, graph: dict[Any, Any]) -> Any:
        return self.inner.keep({k: self.change(t) for k, t in graph.items()})

    def stream(self, graphs: Any, done: Any) -> None:
        self.inner.stream(self._changed(graphs), done)

    def _changed(self, graphs: Any) -> Iterator[Any]:
        while True:
            started = time.thread_time()
            graph, keys = next(graphs, ({}, []))
            self.planning_s += time.thread_time() - started
            if not keys:
                return
            yield {k: self.change(t) for k, t in graph.items()}, keys


def _processes() -> Iterator[psutil.Process]:
    me = psutil.Process()
    yield me
    yield from me.children(recursive=True)


def _cpu_s() -> float:
    """CPU seconds of this process and its children so far."""
    return sum(sum(p.cpu_times()[:2]) for p in _processes())


def overhead(scheduler: str, frames: int, workers: int = 2) -> dict[str, Any]:
    """Share of a job's CPU seconds that is not spent in its tasks."""
    from catalog_tools.engine.schedulers import open_scheduler
    from pipeline.route.draw import draw
    from pipeline.route.prepare import prepare
    from pipeline.spec.load import parse_scene
    from pipeline.store.product import begin

    exposure = {"integration_s": 1.0, "frames": frames}
    with tempfile.TemporaryDirectory() as name, open_scheduler(scheduler, workers) as inner:
        for k, count in enumerate((2, frames)):  # the first one warms the workers
            prepared = prepare(parse_scene(SKY | {"exposure": exposure | {"frames": count}}))
            begun = begin(Path(name) / f"run{k}", prepared.plan, None, resume=False)
            times = Path(name) / f"times{k}"
            times.mkdir()
            wrapped: Any = Wrapped(inner, lambda task, to=str(times): (timed, to, *task))
            before, began = _cpu_s(), time.perf_counter()
            draw(prepared, begun, wrapped, None)
            total, wall_s = _cpu_s() - before, time.perf_counter() - began
            useful = sum(float(p.read_text()) for p in times.iterdir())
        idle = _cpu_s()
        time.sleep(IDLE_S)
        idle_s = (_cpu_s() - idle) / IDLE_S
    tiles = len(prepared.plan.tiles) * frames
    waited_s = max(0.0, wall_s - total / (1 if scheduler == "synchronous" else workers))
    steady = total - idle_s * waited_s
    return {
        "scheduler": scheduler, "tiles": tiles, "cpu_s": total, "in_tasks_s": useful,
        "planning_s": wrapped.planning_s, "wall_s": wall_s, "overhead": 1.0 - useful / total,
        "overhead_less_planning": 1.0 - (useful + wrapped.planning_s) / total,
        "ms_a_tile": 1e3 * (total - useful) / tiles,
        # Processes that wait for a loaded machine go on ticking; without that:
        "idle_cpu_s_a_s": idle_s, "overhead_less_waiting": 1.0 - useful / steady,
    }  # fmt: skip


@contextmanager
def apart(name: str) -> Iterator[tuple[str, int | None]]:
    """Name of a scheduler and its process: of its own for "apart", else none."""
    if name != "apart":
        yield name, None
        return
    with ExitStack() as stack:
        file = Path(stack.enter_context(tempfile.TemporaryDirectory())) / "scheduler.json"
        dask = [sys.executable, "-m", "distributed.cli.dask_"]
        told = ["--scheduler-file", str(file), "--no-dashboard"]
        scheduler = _started(stack, [*dask[:2], f"{dask[2]}scheduler", *told, "--port", "0",
                                     "--host", "127.0.0.1"])  # fmt: skip
        while not file.is_file() or not file.read_text().strip():
            time.sleep(0.2)
        for _ in range(2):
            _started(stack, [*dask[:2], f"{dask[2]}worker", *told, "--nthreads", "1"])
        os.environ["NIGHTGLASS_WORKERS_WAIT_S"] = "120"
        yield json.loads(file.read_text())["address"], scheduler.pid


def _started(stack: ExitStack, command: list[str]) -> subprocess.Popen[bytes]:
    process = subprocess.Popen(command, stderr=subprocess.DEVNULL)
    stack.callback(process.wait)
    stack.callback(process.terminate)
    return process


def scale(scheduler: str, tiles: int) -> dict[str, Any]:
    """Peak memory of this process and of a scheduler's while a long plan is streamed."""
    from catalog_tools.engine.schedulers import open_scheduler
    from pipeline.route.draw import draw
    from pipeline.route.prepare import prepare
    from pipeline.spec.load import parse_scene
    from pipeline.store.cube import CubeWriter
    from pipeline.store.product import Begun

    sensor = SKY["sensor"] | {"shape": [4096, 4096]}  # type: ignore[operator]
    data = SKY | {
        "sensor": sensor, "output": {"tile_shape": [256, 256]},
        "exposure": {"integration_s": 1.0, "frames": -(-tiles // 256)},
    }  # fmt: skip
    prepared = prepare(parse_scene(data))
    begun = Begun(Path("nowhere"), CubeWriter("nowhere", ("dn",)), frozenset(), frozenset(), ())
    done, started = [0], time.perf_counter()
    with apart(scheduler) as (name, its_process), open_scheduler(name, 2) as inner:
        wrapped: Any = Wrapped(inner, emptied)
        cpu_s = time.process_time()
        draw(prepared, begun, wrapped, lambda p: done.__setitem__(0, p.done))
        cpu_s = time.process_time() - cpu_s
        its_s = sum(psutil.Process(its_process).cpu_times()[:2]) if its_process else 0.0
        scheduler_mb = peak_mb(its_process) if its_process else None
    return {
        "scheduler": scheduler, "tiles": done[0], "peak_mb": peak_mb(),
        "scheduler_peak_mb": scheduler_mb,  # none: it runs in this process
        "us_a_tile": 1e6 * (time.perf_counter() - started) / done[0],
        "cpu_us_a_tile": 1e6 * cpu_s / done[0],  # of this process
        "scheduler_cpu_us_a_tile": 1e6 * its_s / done[0],
    }  # fmt: skip


def model(tiles: int, frames: int) -> dict[str, Any]:
    """Tiles a second of many workers, from what a tile takes a worker, the client, the scheduler.

    Workers draw side by side, client and scheduler serve them one after the other, each a core of
    its own: the slowest of the three says how many tiles are done in a second.
    """
    found = {n: overhead("processes", frames, n) for n in (1, 2)}
    streamed = scale("apart", tiles)
    tile_s = found[1]["in_tasks_s"] / found[1]["tiles"]
    served_s = 1e-6 * max(streamed["cpu_us_a_tile"], streamed["scheduler_cpu_us_a_tile"])
    most = {n: min(n / tile_s, 1.0 / served_s) for n in (1, 10, 100, 300, 1000)}
    return {
        "two_over_one": found[1]["wall_s"] / found[2]["wall_s"],
        "overhead": found[1]["overhead"], "tile_s": tile_s,
        "client_us_a_tile": streamed["cpu_us_a_tile"],
        "scheduler_us_a_tile": streamed["scheduler_cpu_us_a_tile"],
        "tiles_a_second": most,
        "efficiency": {n: rate * tile_s / n for n, rate in most.items()},
        "all_at_work_from_tile_s": {n: n * served_s for n in most},
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("overhead", "scale", "model"))
    parser.add_argument("--scheduler", default="synchronous")
    parser.add_argument("--tiles", type=int, default=1_000_000)
    parser.add_argument("--frames", type=int, default=8)
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    if args.what == "model":
        found = model(args.tiles, args.frames)
    elif args.what == "overhead":
        found = overhead(args.scheduler, args.frames)
    else:
        found = scale(args.scheduler, args.tiles)
    print(json.dumps(found))
    if args.json:
        machine = f"{platform.machine()}, {platform.python_version()}"
        args.json.write_text(json.dumps({"machine": machine} | found, indent=2) + "\n")


if __name__ == "__main__":
    from benchmarks.scheduling import main as imported  # workers find its functions by name

    imported()
