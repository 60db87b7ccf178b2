"""Numbers for Prometheus that one process counts: answers and seconds; no names, ids or tokens."""

from __future__ import annotations

from prometheus_client import CollectorRegistry, Counter, Histogram

SECONDS = (0.005, 0.02, 0.1, 0.5, 2.0, 10.0, 60.0)


class Numbers:
    """What one process counts; scraped at /metrics."""

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        self.answers = Counter(
            "nightglass_answers",
            "Answers by method and status",
            ["method", "status"],
            registry=self.registry,
        )
        self.seconds = Histogram(
            "nightglass_answer_seconds",
            "Seconds until an answer begins, by route",
            ["route"],
            buckets=SECONDS,
            registry=self.registry,
        )
