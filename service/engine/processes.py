"""The engine's process: started with one order, watched, ended whatever it does."""

from __future__ import annotations

import contextlib
import json
import os
import queue
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from typing import BinaryIO

from catalog_tools.documents import JsonObject
from service.problems import EngineFault, PlanRefused, PlanTooSlow
from service.settings import Settings

POLL_S = 0.2
Answers = queue.Queue[JsonObject | None]


@contextlib.contextmanager
def worker(settings: Settings, order: JsonObject) -> Iterator[Answers]:
    """A worker process with its order given, and a queue of its answers (None: it has ended).

    Leaving the block ends the process, whatever it does: a product survives that at any moment.
    """
    environment = {k: v for k, v in os.environ.items() if not _secret(k)}
    process = subprocess.Popen(
        [sys.executable, "-P", "-m", "service.engine.worker"],
        cwd=settings.catalogues,
        env=environment,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        start_new_session=True,
    )
    assert process.stdin is not None
    assert process.stdout is not None
    answers: Answers = queue.Queue()
    reader = threading.Thread(target=_read, args=(process.stdout, answers), daemon=True)
    reader.start()
    try:
        with contextlib.suppress(BrokenPipeError):
            process.stdin.write(json.dumps(order).encode() + b"\n")
            process.stdin.flush()
        yield answers
    finally:
        process.kill()
        process.wait()
        reader.join()
        with contextlib.suppress(BrokenPipeError):
            process.stdin.close()
        process.stdout.close()


def _secret(name: str) -> bool:
    """The engine has no business with the job table or the identity provider."""
    return name.startswith(("NIGHTGLASS_DATABASE", "NIGHTGLASS_OIDC", "NIGHTGLASS_TLS"))


def _read(stream: BinaryIO, answers: Answers) -> None:
    for line in stream:
        with contextlib.suppress(ValueError):  # a line cut off by the worker's death
            answers.put(json.loads(line))
    answers.put(None)


def look_at(
    settings: Settings, order: JsonObject, limit_s: float, stopped: Callable[[], bool]
) -> JsonObject:
    """What a worker says of a scene (`do`: plan or judge), so that the service stays quick and can
    stop it.

    Raises PlanRefused, PlanTooSlow, EngineFault.
    """
    deadline = time.monotonic() + limit_s
    outcome = None
    with worker(settings, order) as answers:
        while not stopped():
            try:
                outcome = answers.get(timeout=POLL_S)
                break
            except queue.Empty:
                if time.monotonic() > deadline:
                    raise PlanTooSlow(f"planning took over {limit_s:g} s") from None
    if outcome is None:
        raise EngineFault("the planner stopped without an answer")
    if "error" in outcome:
        error = outcome["error"]
        raise PlanRefused(error) if error["kind"] == "bad input" else EngineFault(error["message"])
    return outcome
