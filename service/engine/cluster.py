"""Does the Dask scheduler answer that jobs run on? Asked at most every few seconds."""

from __future__ import annotations

import threading
import time

from catalog_tools.engine.addresses import LOCAL_KINDS
from pipeline.errors import NightglassError

FRESH_S = 2.0
PATIENCE_S = 2.0


class SchedulerHealth:
    """Whether the scheduler at an address answers; one of this process always does."""

    def __init__(self, address: str) -> None:
        self._address, self._lock = address, threading.Lock()
        self._asked_s, self._fault = float("-inf"), ""

    def fault(self) -> str:
        """What is wrong with it, in words for the operator; empty where it answers."""
        if self._address in LOCAL_KINDS:
            return ""
        from catalog_tools.engine.clusters import ask  # with it all of Dask's distributed

        with self._lock:
            if time.monotonic() - self._asked_s > FRESH_S:
                try:
                    ask(self._address, PATIENCE_S)
                    self._fault = ""
                except NightglassError as error:
                    self._fault = str(error)
                self._asked_s = time.monotonic()
            return self._fault
