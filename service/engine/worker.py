"""The engine in a process of its own: one order on stdin, JSON lines of progress on stdout.

`python -m service.engine.worker` is started by the runner inside the folder of catalogues, so that
a catalogue's registered name is its path and no path of the server enters a product. It ends at
once when its stdin closes: a worker never outlives the process that watches it.
"""

from __future__ import annotations

import contextlib
import errno
import json
import logging
import os
import re
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

from dask.callbacks import Callback

from catalog_tools.catalogue import MANIFEST_NAME
from catalog_tools.documents import JsonObject
from catalog_tools.engine.heap import one_heap
from pipeline.errors import NO_ROOM, BadInput, Damaged, DiskFull, NightglassError, TryLater
from pipeline.route.judge import judge
from pipeline.route.prepare import check_cost, plan_scene
from pipeline.route.run import Options, render
from pipeline.spec.load import parse_scene
from service import logs
from service.problems import cut, mistake_dict, mistakes_of

log = logging.getLogger("nightglass.engine")
BETWEEN_LINES_S = 0.25


def main() -> None:
    """Read the order, do it, say how it went."""
    one_heap()
    answers = os.fdopen(os.dup(1), "wb", buffering=0)
    os.dup2(2, 1)  # whatever a library prints must not be taken for an answer
    line = sys.stdin.buffer.readline()
    if not line.endswith(b"\n"):  # the parent died before it had said all
        sys.exit(1)
    order = json.loads(line)
    logs.set_up()
    threading.Thread(target=_end_with_parent, daemon=True).start()
    todo = {
        "plan": _plan,
        "forecast": _forecast,
        "judge": _judge,
        "observe": _observe,
        "render": _render,
        "study": _study,
        "sweep": _sweep,
    }
    try:
        _say(answers, todo[order["do"]](order, answers))
    except Exception as error:
        if not isinstance(error, NightglassError):
            log.exception("the engine failed", extra=_said(order))
        _say(answers, {"outcome": "error", "error": describe(error, order)})


def _end_with_parent() -> None:
    while os.read(0, 4096):
        pass
    os._exit(1)


def _say(answers: BinaryIO, message: JsonObject) -> None:
    answers.write(json.dumps(message).encode() + b"\n")


def _said(order: JsonObject) -> JsonObject:
    """What every line of the log carries."""
    return {name: order.get(name) for name in ("job", "attempt")}


@contextlib.contextmanager
def _tiles_told(order: JsonObject) -> Iterator[None]:
    """Log each tile that this process draws (level debug), and those in flight when one fails."""
    said, running = _said(order), set()

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


def _plan(order: JsonObject, _: BinaryIO) -> JsonObject:
    scene = parse_scene(order["scene"])
    plan = plan_scene(scene)
    check_cost(scene, plan, order["most_cpu_s"])
    return {"outcome": "done", "plan": plan}


def _forecast(order: JsonObject, _: BinaryIO) -> JsonObject:
    from pipeline.capacity.run import forecast_of

    return {"outcome": "done", "forecast": forecast_of(order["scene"], Path.cwd())}


def _observe(order: JsonObject, _: BinaryIO) -> JsonObject:
    from pipeline.observe.files import as_data
    from pipeline.observe.observe import observe

    scene, most = parse_scene(order["scene"]), order["most_rows"]
    found = observe(scene, order["times"], order["snr"], most_rows=most)
    return {"outcome": "done", "observed": as_data(found)}


def _judge(order: JsonObject, _: BinaryIO) -> JsonObject:
    judge(parse_scene(order["scene"]))
    return {"outcome": "done"}


def _render(order: JsonObject, answers: BinaryIO) -> JsonObject:
    options = Options(
        scheduler=order["scheduler"],
        workers=order["workers"],
        resume=order["resume"],
        most_cpu_s=order["most_cpu_s"],
    )
    with _tiles_told(order):
        report = render(
            parse_scene(order["scene"]), Path(order["product"]), options, _listener(answers)
        )
    return {
        "outcome": "done",
        "tiles": report["tiles"],
        "content_digest": report["content_digest"],
    }


def _sweep(order: JsonObject, answers: BinaryIO) -> JsonObject:
    from service.scenes.sweeps import run_sweep

    return {"outcome": "done"} | run_sweep(order, _listener(answers))


def _study(order: JsonObject, answers: BinaryIO) -> JsonObject:
    from service.scenes.studies import run_study

    return {"outcome": "done"} | run_study(order, _listener(answers))


def _listener(answers: BinaryIO) -> Any:
    """Tell of progress, a few times a second."""
    last = {"s": 0.0}
    lock = threading.Lock()

    def listen(progress: Any) -> None:
        with lock:
            now = time.monotonic()
            if now - last["s"] >= BETWEEN_LINES_S or getattr(progress, "doing", "") == "start":
                last["s"] = now
                _say(answers, {"done": progress.done, "total": progress.total})

    return listen


def describe(error: Exception, order: JsonObject) -> JsonObject:
    """An error as the job shows it: one message, and the fields to mend; no path of the server,
    and uploaded files by the names that their user gave them."""
    errors: list[JsonObject] = []
    if gone := _catalogues_gone(order):
        kind, message = "try later", f"the catalogue {gone[0]} is not there now"
    elif mistakes := [_without_paths(m, order) for m in mistakes_of(error)[:20]]:
        errors = [mistake_dict(mistake) for mistake in mistakes]
        kind, message = "bad input", cut(str(BadInput(*mistakes[0])))
    elif isinstance(error, Damaged):
        place, reason = _clean(Path(error.path).name, order), _clean(error.reason, order)
        kind, message = "damaged", cut(str(Damaged(place, reason)))
    elif code := _full_disk(error):
        told = f"the server's disk is full ({os.strerror(code)}); submit again when there is room"
        kind, message = "disk full", told
    elif isinstance(error, NightglassError):
        kind = "try later" if isinstance(error, TryLater) else "incomplete"
        message = cut(_clean(str(error), order))
    else:
        kind, message = "fault", _fault(error)
    return {"kind": kind, "message": message, "errors": errors}


def _full_disk(error: Exception) -> int:
    """The system's number for it; 0 where an error is of something else."""
    if isinstance(error, DiskFull):
        return error.code or errno.ENOSPC
    return error.errno or 0 if isinstance(error, OSError) and error.errno in NO_ROOM else 0


def _fault(error: Exception) -> str:
    if isinstance(error, OSError):
        return f"the server could not read or write: {error.strerror or type(error).__name__}"
    if isinstance(error, MemoryError):
        return "the server has not enough memory"
    return "an internal fault; the server's log tells more"


def _catalogues_gone(order: JsonObject) -> list[str]:
    """Registered catalogues that an accepted scene names and whose folder or link is gone."""
    scene = order["scene"]
    scene = scene.get("scene", scene)  # of a sweep: its base
    named = (scene.get("stars") or {}).get("catalogue") or []
    names = [named] if isinstance(named, str) else named
    return [name for name in names if not (Path(name) / MANIFEST_NAME).is_file()]


def _without_paths(mistake: tuple[str, Any, str], order: JsonObject) -> tuple[str, Any, str]:
    field, value, allowed = mistake
    value = _clean(value, order) if isinstance(value, str) else value
    return field, value, _clean(allowed, order)


def _clean(text: str, order: JsonObject) -> str:
    """Text with the places of the server's folders cut out, and the user's names of files."""
    for file_id, name in order.get("files", {}).items():
        for place in set(re.findall(rf"[\w./-]*{re.escape(file_id)}", text)):
            text = text.replace(place, name)
    product = order.get("product")
    places = [(str(Path.cwd()), "catalogues")]
    if product is not None:
        places += [(str(Path(product).resolve()), "product"), (product, "product")]
    for place, name in places:
        text = text.replace(place, name)
    return text


if __name__ == "__main__":
    main()
