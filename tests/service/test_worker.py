"""The process of a job's engine ends with the one that watches it."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from service.engine import processes
from service.problems import EngineFault
from service.settings import Settings

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


def test_an_engine_that_cannot_be_loaded_is_told_by_the_worker(
    tmp_path: Path, forks: processes.Forks, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What forks workers lives on, and says it on its log; the order ends with the fault."""
    (tmp_path / "dask.py").write_text("raise ImportError('dask is broken')\n")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), *sys.path]))
    settings = Settings(tmp_path)
    settings.make_folders()
    for _ in range(2):
        with processes.worker(settings, {"do": "judge", "scene": {}}) as answers:
            answer = answers.get(timeout=60)
        assert answer is not None
        assert answer["error"]["kind"] == "fault"
    assert forks._process is not None
    assert forks._process.poll() is None


@pytest.fixture
def forks(monkeypatch: pytest.MonkeyPatch) -> Iterator[processes.Forks]:
    """What forks workers, of the test's own."""
    monkeypatch.setattr(processes, "_forks", forks := processes.Forks())
    yield forks
    if forks._process is not None:
        forks._process.kill()
        forks._process.wait()


def test_what_forks_workers_is_begun_again_where_it_died(
    tmp_path: Path, forks: processes.Forks
) -> None:
    settings, asked = Settings(tmp_path), []
    settings.make_folders()
    for _ in range(2):
        with processes.worker(settings, {"do": "judge", "scene": {}}) as answers:
            answer = answers.get(timeout=60)
        assert answer is not None
        assert answer["error"]["kind"] == "bad input"
        assert forks._process is not None
        asked.append(forks._process.pid)
        forks._process.kill()
        forks._process.wait()
    assert asked[0] != asked[1]


def test_an_engine_that_cannot_be_started_is_the_services_fault(
    tmp_path: Path, forks: processes.Forks, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "executable", str(tmp_path / "none"))
    held = []
    for _ in range(3):
        with (
            pytest.raises(EngineFault, match="the engine could not be started"),
            processes.worker(Settings(tmp_path), {"do": "judge", "scene": {}}),
        ):
            pass
        held.append(len(os.listdir("/proc/self/fd")))  # noqa: PTH208
    assert held[1] == held[2]  # nothing stays open
