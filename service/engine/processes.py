"""The engine's process: started with one order, watched, ended whatever it does."""

from __future__ import annotations

import contextlib
import json
import os
import queue
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

from catalog_tools.documents import JsonObject
from service.engine.forks import ANSWER_BYTES
from service.problems import EngineFault, PlanRefused, PlanTooSlow
from service.settings import Settings

POLL_S = 0.2
LONGEST_START_S = 120.0  # until the engine has been loaded
Answers = queue.Queue[JsonObject | None]


class Forks:
    """The process that forks the engine's; started by the first order, and again if it has died."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._control: socket.socket

    def begin(self, folder: Path, files: tuple[int, int]) -> Callable[[], None]:
        """Begin a worker in a folder, with these as its stdin and stdout; what is returned kills
        it. OSError where no process can be started."""
        question = b"+" + os.fsencode(folder.absolute())
        with self._lock:
            if self._process is None:
                self._start()
            try:
                number = _asked(self._control, question, files)
            except OSError:
                self._start()
                number = _asked(self._control, question, files)
            return partial(self._end, self._control, number)

    def _end(self, control: socket.socket, number: int) -> None:
        with self._lock, contextlib.suppress(OSError):  # without it a worker ends with its stdin
            _asked(control, b"-%d" % number)

    def _start(self) -> None:
        if self._process is not None:
            self._control.close()
            self._process.kill()
            self._process.wait()
        environment = {k: v for k, v in os.environ.items() if not _secret(k)}
        self._control, its = socket.socketpair()
        self._control.settimeout(LONGEST_START_S)
        with its:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-c", "from service.engine.forks import main; main()"],
                env=environment,
                stdin=its.fileno(),
                start_new_session=True,
            )


_forks = Forks()


def _asked(control: socket.socket, question: bytes, files: Sequence[int] = ()) -> int:
    """The answer to a question. OSError where the one who is asked has died, or says nothing in
    time: then nothing more is asked on that socket, where a late answer would be another's."""
    try:
        socket.send_fds(control, [question], files)
        answer = control.recv(ANSWER_BYTES)
        if len(answer) < ANSWER_BYTES:
            raise ConnectionResetError
    except OSError:
        control.close()
        raise
    return int.from_bytes(answer, "big")


@contextlib.contextmanager
def worker(settings: Settings, order: JsonObject) -> Iterator[Answers]:
    """A worker process with its order given, and a queue of its answers (None: it has ended).

    Leaving the block ends the process, whatever it does: a product survives that at any moment.
    """
    (its_stdin, stdin), (stdout, its_stdout) = os.pipe(), os.pipe()
    try:
        end = _forks.begin(settings.catalogues, (its_stdin, its_stdout))
    except OSError as error:
        os.close(stdin)
        os.close(stdout)
        raise EngineFault("the engine could not be started") from error
    finally:
        os.close(its_stdin)
        os.close(its_stdout)
    answers: Answers = queue.Queue()
    reader = threading.Thread(target=_read, args=(stdout, answers), daemon=True)
    reader.start()
    try:
        with contextlib.suppress(BrokenPipeError), open(stdin, "wb", closefd=False) as orders:
            orders.write(json.dumps(order).encode() + b"\n")
        yield answers
    finally:
        end()
        os.close(stdin)
        reader.join()


def _secret(name: str) -> bool:
    """The engine has no business with the job table or the identity provider."""
    return name.startswith(("NIGHTGLASS_DATABASE", "NIGHTGLASS_OIDC", "NIGHTGLASS_TLS"))


def _read(file: int, answers: Answers) -> None:
    with open(file, "rb") as stream:
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
