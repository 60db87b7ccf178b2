"""What a worker may be told to do: plan, judge, observe, render, sweep, study."""

from __future__ import annotations

import contextlib
import logging
import shutil
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from dask.callbacks import Callback

from catalog_tools.documents import JsonObject
from pipeline.errors import BadInput
from pipeline.route.judge import judge
from pipeline.route.prepare import check_cost, plan_scene
from pipeline.route.run import Options, render
from pipeline.spec.load import parse_scene
from pipeline.spec.sweep_load import parse_sweep
from service import logs
from service.problems import within

Say = Callable[[JsonObject], None]
Order = Callable[[JsonObject, Say], JsonObject]

log = logging.getLogger("nightglass.engine")
BETWEEN_LINES_S = 0.25


@contextlib.contextmanager
def _tiles_told(order: JsonObject) -> Iterator[None]:
    """Log each tile that this process draws (level debug), and those in flight when one fails."""
    said, running = logs.of_job(order), set()

    def name(key: Any) -> str | None:
        tile = isinstance(key, tuple) and key[0] == "tile"
        return "f{}_r{}_c{}".format(*key[1:4]) if tile else None

    def begins(key: Any, *_: Any) -> None:
        running.add(name(key))

    def ended(key: Any, *_: Any) -> None:
        running.discard(name(key))
        if name(key):
            log.debug("tile drawn", extra=said | {"tile": name(key)})

    try:
        with Callback(pretask=begins, posttask=ended):
            yield
    except BadInput:  # the user's mistake: the job shows it
        raise
    except Exception:
        tiles = sorted(tile for tile in running if tile)
        log.error("tiles in flight", extra=said | {"tile": " ".join(tiles[:20])})
        raise


def _plan(order: JsonObject, _: Say) -> JsonObject:
    scene = parse_scene(order["scene"])
    plan = plan_scene(scene)
    check_cost(scene, plan, order["most_cpu_s"])
    return {"outcome": "done", "plan": plan}


def _forecast(order: JsonObject, _: Say) -> JsonObject:
    from pipeline.capacity.run import StudyOptions, check_forecast, forecast_of

    told = forecast_of(order["scene"], Path.cwd())
    check_forecast(told, StudyOptions(most_cpu_s=order["most_cpu_s"]))
    return {"outcome": "done", "forecast": told}


def _observe(order: JsonObject, _: Say) -> JsonObject:
    from pipeline.observe import files, observe

    scene, most = parse_scene(order["scene"]), order["most_rows"]
    found = observe.observe(scene, order["times"], order["snr"], most_rows=most)
    return {"outcome": "done", "observed": files.as_data(found)}


def _judge(order: JsonObject, _: Say) -> JsonObject:
    judge(parse_scene(order["scene"]))
    return {"outcome": "done"}


def _judge_sweep(order: JsonObject, _: Say) -> JsonObject:
    from pipeline.sweep.check import judge_course
    from pipeline.sweep.run import course_of

    with within("scene"):
        judge(parse_scene(order["scene"]))
    sweep = parse_sweep(order["sweep"] | {"scene": order["scene"]})
    judge_course(course_of(sweep, Path.cwd(), Path()))
    return {"outcome": "done"}


def _options(order: JsonObject) -> Options:
    return Options(
        scheduler=order["scheduler"],
        workers=order["workers"],
        resume=order["resume"],
        most_cpu_s=order["most_cpu_s"],
    )


def _begun_anew(draw: Order) -> Order:
    """An order that begins anew what can't be gone on with, as what it reads has changed since:
    a catalogue, a table of the user's data."""

    def drawn(order: JsonObject, say: Say) -> JsonObject:
        try:
            return draw(order, say)
        except BadInput as error:
            if error.field != "--resume" or not order["resume"]:
                raise
        log.warning("what it reads has changed: begun anew", extra=logs.of_job(order))
        shutil.rmtree(order["product"])
        return draw(order | {"resume": False}, say)

    return drawn


def _render(order: JsonObject, say: Say) -> JsonObject:
    scene, product = parse_scene(order["scene"]), Path(order["product"])
    with _tiles_told(order):
        report = render(scene, product, _options(order), _listener(say))
    return {
        "outcome": "done",
        "tiles": report["tiles"],
        "content_digest": report["content_digest"],
    }


def _sweep(order: JsonObject, say: Say) -> JsonObject:
    from service.scenes.sweeps import run_sweep

    return {"outcome": "done"} | run_sweep(order, _options(order), _listener(say))


def _study(order: JsonObject, say: Say) -> JsonObject:
    from service.scenes.studies import run_study

    return {"outcome": "done"} | run_study(order, _listener(say))


def _listener(say: Say) -> Any:
    """Tell of progress, a few times a second."""
    last = {"s": 0.0}
    lock = threading.Lock()

    def listen(progress: Any) -> None:
        with lock:
            now = time.monotonic()
            if now - last["s"] >= BETWEEN_LINES_S or getattr(progress, "doing", "") == "start":
                last["s"] = now
                say({"done": progress.done, "total": progress.total})

    return listen


ORDERS: dict[str, Order] = {
    "plan": _plan,
    "forecast": _forecast,
    "judge": _judge,
    "judge_sweep": _judge_sweep,
    "observe": _observe,
    "render": _begun_anew(_render),
    "study": _begun_anew(_study),
    "sweep": _begun_anew(_sweep),
}
