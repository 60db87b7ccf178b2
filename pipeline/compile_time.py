"""CPU seconds that kernels take to be compiled, which no later process takes again."""

from __future__ import annotations

import threading
import time

from numba.core import event

EVENT = "numba:compile"


class Compiling(event.Listener):
    """CPU seconds that the thread which makes it has spent on compiling since it was installed."""

    def __init__(self) -> None:
        self.cpu_s = 0.0
        self._thread, self._depth, self._since_s = threading.get_ident(), 0, 0.0

    def on_start(self, _: event.Event) -> None:
        if threading.get_ident() != self._thread:
            return
        if not self._depth:
            self._since_s = time.thread_time()
        self._depth += 1  # a kernel is compiled with those that it calls

    def on_end(self, _: event.Event) -> None:
        if threading.get_ident() != self._thread:
            return
        self._depth -= 1
        if not self._depth:
            self.cpu_s += time.thread_time() - self._since_s
