"""One heap for the threads of a process."""

from __future__ import annotations

import os
import platform
import subprocess
import sys

import pytest

from catalog_tools.engine.heap import peak_mb

COUNTED = """
import ctypes, sys, threading
{before}
from catalog_tools.engine.heap import one_heap
if sys.argv[1] == "one":
    one_heap()
import pyarrow

def take(start):
    start.wait()
    kept = [bytearray(1000) for _ in range(10_000)]
    start.wait()

start = threading.Barrier(5)
threads = [threading.Thread(target=take, args=(start,)) for _ in range(4)]
for t in threads: t.start()
start.wait(); start.wait()
libc = ctypes.CDLL(None)
libc.fopen.restype = ctypes.c_void_p
told = libc.fopen(sys.argv[2].encode(), b"w")
libc.malloc_info(0, ctypes.c_void_p(told)); libc.fclose(ctypes.c_void_p(told))
print(open(sys.argv[2]).read().count("<heap nr"), pyarrow.default_memory_pool().backend_name)
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only glibc has heaps of threads")
@pytest.mark.parametrize("before", ["", "import pyarrow"])
def test_threads_share_one_heap(tmp_path, before):
    def told(wish: str, **more: str) -> list[str]:
        known = ("MALLOC_ARENA_MAX", "ARROW_DEFAULT_MEMORY_POOL")
        environment = {k: v for k, v in os.environ.items() if k not in known} | more
        command = [sys.executable, "-c", COUNTED.format(before=before), wish, str(tmp_path / "x")]
        done = subprocess.run(
            command, env=environment, capture_output=True, text=True, check=True
        )
        return done.stdout.split()

    assert int(told("many")[0]) >= 4
    heaps, pool = told("one")
    assert int(heaps) <= 2  # a library's own thread may have begun one before
    assert pool == "system"
    assert int(told("one", MALLOC_ARENA_MAX="8")[0]) >= 4  # as the environment says


@pytest.mark.skipif(platform.system() != "Linux", reason="others tell that of the starter, too")
def test_the_peak_of_a_process_is_not_that_of_its_starter():
    told = "from catalog_tools.engine.heap import peak_mb; print(peak_mb())"
    large = bytearray(600_000_000)
    done = subprocess.run(
        [sys.executable, "-c", told], capture_output=True, text=True, check=True
    )
    assert 1.0 < float(done.stdout) < 300.0 < peak_mb()
    assert peak_mb(os.getppid()) > 0.0
    del large
