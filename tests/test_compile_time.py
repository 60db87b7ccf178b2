"""What compiling takes, once on a machine, is no part of what a plan says that a scene takes."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import numba
import pytest
from numba.core.event import install_listener

from pipeline.compile_time import EVENT, Compiling
from pipeline.resolve.resolve import Resolved, resolve
from pipeline.route import prepare
from pipeline.spec.load import load_scene
from pipeline.spec.scene import Scene

EXAMPLE = Path(__file__).parents[1] / "examples" / "space-based-rate.yaml"


def compiled() -> None:
    """A kernel and one that it calls, both compiled here and now."""

    @numba.njit
    def callee(x: float) -> float:
        return x + 1.0

    @numba.njit
    def caller(x: float) -> float:
        return 10.0 * callee(x)

    assert caller(1.0) == 20.0


def test_compiling_is_counted_once_and_where_it_is_done() -> None:
    with install_listener(EVENT, Compiling()) as compiling:
        before = time.thread_time()
        compiled()
        took_s = time.thread_time() - before
        assert 0.3 * took_s < compiling.cpu_s <= took_s  # a callee's time is not added to it
        counted = compiling.cpu_s
        other = threading.Thread(target=compiled)
        other.start()
        other.join()
        assert compiling.cpu_s == counted


def test_planning_counts_without_what_it_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = load_scene(EXAMPLE)
    prepare.prepare(scene)
    usual_s = prepare.prepare(scene).spent.cpu_s

    def compiles(scene: Scene) -> Resolved:
        while time.thread_time() - before < 1.0 + usual_s:
            compiled()
        return resolve(scene)

    before = time.thread_time()
    monkeypatch.setattr(prepare, "resolve", compiles)
    assert prepare.prepare(scene).spent.cpu_s < 0.5 + usual_s
