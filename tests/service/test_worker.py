"""The process of a job's engine ends with the one that watches it."""

from __future__ import annotations

import subprocess
import sys

WATCHED = """
import threading, time
from service.engine import worker
threading.Thread(target=worker._end_with_parent, daemon=True).start()
print("at work", flush=True)
time.sleep(60)
print("orphan", flush=True)
"""


def test_it_ends_at_once_when_its_parent_is_gone() -> None:
    """Whatever it does: its main thread is at work when its stdin closes."""
    command = [sys.executable, "-c", WATCHED]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as engine:
        assert engine.stdin is not None
        assert engine.stdout is not None
        assert engine.stdout.readline() == b"at work\n"
        engine.stdin.write(b"more")  # is no end
        engine.stdin.close()
        assert engine.wait(timeout=20) == 1
        assert engine.stdout.read() == b""
