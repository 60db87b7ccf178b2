"""What Prometheus is told of the service: each number under its own name."""

from __future__ import annotations

import shutil
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from service.gauges import Gauges
from service.jobs.jobs import Phase


@pytest.mark.parametrize("fault", [None, "no answer"])
def test_each_number_stands_under_its_own_name(tmp_path: Path, fault: str | None) -> None:
    """Five submissions in two commits; none of the numbers is the same as another."""
    dispatcher = SimpleNamespace(
        scheduler=SimpleNamespace(fault=lambda: fault), leads=True, running=3
    )
    context = SimpleNamespace(
        table=SimpleNamespace(counts=lambda: {Phase.QUEUED: 7, Phase.ERROR: 4}),
        settings=SimpleNamespace(home=tmp_path),
        dispatcher=dispatcher,
        changes=SimpleNamespace(places=SimpleNamespace(held=6)),
        intake=SimpleNamespace(commits=2, jobs=5),
        started_s=time.time() - 1e5,
    )
    gauges = Gauges(context)  # type: ignore[arg-type]
    told = {
        (sample.name.removeprefix("nightglass_"), *sample.labels.values()): sample.value
        for metric in gauges.collect()
        for sample in metric.samples
    }
    assert told.pop(("uptime_seconds",)) == pytest.approx(1e5, abs=60.0)
    free = shutil.disk_usage(tmp_path).free
    assert told.pop(("disk_free_bytes",)) == pytest.approx(free, rel=0.1)
    assert told == {
        ("jobs", "QUEUED"): 7, ("jobs", "ERROR"): 4, ("leads",): 1, ("running",): 3,
        ("scheduler",): int(fault is None), ("watchers",): 6,
        ("commits_total",): 2, ("submissions_total",): 5,
    }  # fmt: skip
