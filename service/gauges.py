"""Numbers for Prometheus that are looked up: jobs by phase, commits, disk; no names, no ids."""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator

from prometheus_client import Metric
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily

from service.context import Context

FRESH_S = 1.0


class Gauges:
    """What is looked up when somebody asks, at most once a second."""

    def __init__(self, context: Context) -> None:
        self._context, self._looked_s = context, float("-inf")
        self._found: list[Metric] = []

    def collect(self) -> Iterator[Metric]:
        if time.monotonic() - self._looked_s > FRESH_S:
            self._found, self._looked_s = list(self._look()), time.monotonic()
        yield from self._found

    def describe(self) -> list[Metric]:
        return []  # nothing is looked up while the registry is made

    def _look(self) -> Iterator[Metric]:
        context = self._context
        by_phase = GaugeMetricFamily("nightglass_jobs", "Jobs by phase", labels=["phase"])
        for phase, count in context.table.counts().items():
            by_phase.add_metric([phase.value], count)
        yield by_phase
        free = shutil.disk_usage(context.settings.home).free
        answers = int(not context.dispatcher.scheduler.fault())
        for name, told, value in (
            ("leads", "whether this process runs the jobs", int(context.dispatcher.leads)),
            ("running", "jobs that this process runs", context.dispatcher.running),
            ("scheduler", "whether the scheduler of the jobs answers", answers),
            ("watchers", "requests that wait for a change", context.changes.places.held),
            ("disk_free_bytes", "free space of the data folder", free),
            ("uptime_seconds", "since start", round(time.time() - context.started_s, 3)),
        ):
            yield GaugeMetricFamily(f"nightglass_{name}", told, value)
        for name, told, count in (
            ("commits", "commits of submissions", context.intake.commits),
            ("submissions", "submissions committed", context.intake.jobs),
        ):
            yield CounterMetricFamily(f"nightglass_{name}", told, count)
