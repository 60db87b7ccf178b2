"""A process that has loaded the engine, and forks a worker of it for each order.

`service.engine.processes` starts it, asks on a socket that is its stdin, one question at a time,
and hears eight bytes for each: `+FOLDER`, with a worker's stdin and stdout, forks one that works
in that folder (its process id); `-ID` ends one (0). It ends itself when the socket closes.
"""

from __future__ import annotations

import gc
import os
import signal
import socket
import sys
from importlib import import_module

import numpy as np

from catalog_tools.engine.code import code_digest
from catalog_tools.engine.heap import few_collections, one_heap
from service.engine import worker

ANSWER_BYTES = 8
MOST_BYTES = 8192  # of a question, which holds one path
REAP_S = 0.1


def main() -> None:
    """Fork and end workers until the socket closes."""
    one_heap()
    few_collections()
    control = socket.socket(fileno=os.dup(0))
    os.dup2(2, 1)
    _load()
    ending: set[int] = set()  # killed, and not waited for: their ids are still their own
    while True:
        control.settimeout(REAP_S if ending else None)
        ending -= {one for one in ending if os.waitpid(one, os.WNOHANG)[0]}
        try:
            question, files, _, _ = socket.recv_fds(control, MOST_BYTES, 2)
        except TimeoutError:
            continue
        if not question:
            return
        number = 0
        if question[:1] == b"+":
            number = _fork(control, question[1:], files)
        else:
            ending.add(int(question[1:]))
            os.kill(int(question[1:]), signal.SIGKILL)
        control.sendall(number.to_bytes(ANSWER_BYTES, "big"))


def _load() -> None:
    """Load what orders need, numba with its first kept kernel, and take down which code it is.

    What cannot be loaded is left for each worker to meet, and to tell.
    """
    try:
        code_digest()
        import_module("service.engine.orders")
        import_module("scipy.fft")
        import_module("scipy.special")
        streak = import_module("pipeline.physics.motion.streak")
        streak.path_through(np.arange(3.0), np.zeros(3), np.ones(2), 0.0)
    except Exception as error:
        print(f"the engine could not be loaded: {error}", file=sys.stderr)
    gc.freeze()


def _fork(control: socket.socket, folder: bytes, files: list[int]) -> int:
    """The process id of a new worker; in that process it does not return."""
    number = os.fork()
    if number:
        for file in files:
            os.close(file)
        return number
    control.close()
    os.setsid()
    os.chdir(folder)
    for place, file in enumerate(files):
        os.dup2(file, place)
        os.close(file)
    worker.main()
    sys.exit()
