"""Very long plans are streamed: memory does not grow with the number of tiles or points."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
MOST_MB = 500.0


def streamed(tiles: int, scheduler: str) -> dict:
    command = [sys.executable, "-m", "benchmarks.scheduling", "scale", "--scheduler", scheduler]
    result = subprocess.run(
        [*command, "--tiles", str(tiles)], cwd=ROOT, capture_output=True, text=True, check=True
    )
    return json.loads(result.stdout.splitlines()[-1])


def test_memory_does_not_grow_with_the_tiles():
    few, many = streamed(512, "synchronous"), streamed(10_240, "synchronous")
    assert many["tiles"] == 10_240
    assert many["peak_mb"] < min(MOST_MB, few["peak_mb"] + 40.0)


@pytest.mark.slow
@pytest.mark.timeout(7200)
@pytest.mark.parametrize(
    ("scheduler", "tiles"), [("threads", 1_000_000), ("apart", 1_000_000)]
)  # fmt: skip
def test_a_million_tiles(scheduler, tiles):
    """Tiles that do nothing, so that only planning, graphs and scheduling are left; also with a
    distributed scheduler and its workers as processes of their own."""
    found = streamed(tiles, scheduler)
    assert found["tiles"] >= tiles
    assert found["peak_mb"] + (found["scheduler_peak_mb"] or 0.0) < MOST_MB
