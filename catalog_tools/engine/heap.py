"""How processes hold their memory: threads of one heap use again what another has freed."""

from __future__ import annotations

import ctypes
import gc
import os
import resource
import sys
from contextlib import suppress
from functools import cache
from pathlib import Path

# Thresholds are what glibc comes to by itself; Dask's 64 KiB cost a worker eight times the page
# faults. One heap, with Arrow's arrays in it, takes a third less than one for each thread.
ALLOCATION = {
    "MALLOC_MMAP_THRESHOLD_": str(32 << 20),
    "MALLOC_TRIM_THRESHOLD_": str(64 << 20),
    "MALLOC_ARENA_MAX": "1",
    "ARROW_DEFAULT_MEMORY_POOL": "system",
}
ARENA_MAX = -8  # of glibc's mallopt


def few_collections() -> None:
    """Look for cycles of objects after 20,000 new ones in place of 700.

    A start makes some 100,000 that stay; looking through them took a tenth of its time.
    """
    gc.set_threshold(20_000, 20, 20)


@cache
def one_heap() -> None:
    """One heap for this process, where its C library is glibc and its environment says nothing.

    The earlier the better: threads keep the heap that they began with.
    """
    name = "ARROW_DEFAULT_MEMORY_POOL"
    if os.environ.setdefault(name, ALLOCATION[name]) == "system" and "pyarrow" in sys.modules:
        pyarrow = sys.modules["pyarrow"]
        pyarrow.set_memory_pool(pyarrow.system_memory_pool())
    if "MALLOC_ARENA_MAX" not in os.environ:
        with suppress(OSError, AttributeError):
            ctypes.CDLL(None).mallopt(ARENA_MAX, int(ALLOCATION["MALLOC_ARENA_MAX"]))


def peak_mb(process: int | str = "self") -> float:
    """Most memory that a process has held since its program began [MB], as Linux tells it.

    (`ru_maxrss` of this process, used elsewhere, may be that of the one that started it.)
    """
    status = Path(f"/proc/{process}/status")
    told = status.read_text().partition("VmHWM:")[2] if status.is_file() else ""
    if not told:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    return int(told.split()[0]) / 1024.0
