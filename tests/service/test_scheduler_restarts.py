"""Jobs on a Dask scheduler that goes away: they wait for it and go on from their tiles."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from pipeline.route.run import render
from pipeline.spec.load import parse_scene
from tests.tls_cluster import TlsCluster, make_certificates, tls_cluster_in


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[TlsCluster]:
    with tls_cluster_in(make_certificates(tmp_path / "tls"), tmp_path) as made:
        yield made


@pytest.fixture
def on(make_server: Callable[..., Any], cluster: TlsCluster) -> Callable[..., Any]:
    """Starts a service whose jobs run on the cluster."""

    def make(**more: str) -> Any:
        address = {"NIGHTGLASS_SCHEDULER": cluster.address, "NIGHTGLASS_WORKERS_WAIT_S": "60"}
        return make_server(**(address | cluster.environment | more))

    return make


def eventually(holds: Callable[[], bool], limit_s: float = 120.0) -> None:
    deadline = time.monotonic() + limit_s
    while not holds():
        assert time.monotonic() < deadline
        time.sleep(0.1)


def tiles(home: Path) -> int:
    return len(list(home.glob("products/*/markers/f*.json")))


@pytest.mark.slow
def test_a_scheduler_stopped_three_times_under_ten_jobs(
    on: Callable[..., Any], cluster: TlsCluster, scene: dict[str, Any], tmp_path: Path
) -> None:
    scene["sensor"]["shape"], scene["exposure"]["frames"] = [512, 512], 8
    scene["output"] = {"tile_shape": [256, 256]}
    cluster.start()
    cluster.add_workers(2)
    server = on()
    jobs = [server.submit(scene) for _ in range(10)]

    def facts() -> list[dict[str, Any]]:
        return [server.client.get(job).json() for job in jobs]

    for _ in range(3):
        before = tiles(server.home)
        eventually(lambda before=before: tiles(server.home) > before)
        cluster.stop_scheduler()
        cluster.kill_workers()
        eventually(lambda: server.client.get("/readyz").status_code == 503)
        faults = server.client.get("/readyz").json()["faults"]
        assert faults == ["the scheduler does not answer"]
        eventually(lambda: "nightglass_scheduler 0.0" in server.client.get("/metrics").text)
        time.sleep(3.0)
        phases = [found["phase"] for found in facts()]
        assert set(phases) <= {"QUEUED", "EXECUTING", "COMPLETED"}, facts()
        assert phases.count("EXECUTING") <= 1
        cluster.start()
        cluster.add_workers(2)
        eventually(lambda: server.client.get("/readyz").status_code == 200)
    ended = [server.ended(job) for job in jobs]
    assert [(found["phase"], found["error"]) for found in ended] == [("COMPLETED", None)] * 10
    alone = render(parse_scene(scene), tmp_path / "alone")
    assert {found["content_digest"] for found in ended} == {alone["content_digest"]}
    assert sum(found["attempt"] for found in ended) > 10
    assert "nightglass_scheduler 1.0" in server.client.get("/metrics").text


@pytest.mark.slow
def test_a_job_waits_so_long_and_can_be_run_again(
    on: Callable[..., Any], cluster: TlsCluster, scene: dict[str, Any]
) -> None:
    scene["exposure"]["frames"] = 4
    cluster.start()
    server = on(NIGHTGLASS_SCHEDULER_S="4", NIGHTGLASS_WORKERS_WAIT_S="1")
    job = server.submit(scene)
    ended = server.ended(job)  # nobody works for the scheduler
    assert (ended["phase"], ended["error"]["kind"]) == ("ERROR", "try later")
    assert f"{cluster.address} has no workers" in ended["error"]["message"]
    assert ended["attempt"] > 1
    cluster.add_workers(1)
    cluster.wait_for_workers(1)
    again = server.client.post(ended["links"]["retry"])
    assert (again.status_code, again.json()["phase"]) == (202, "QUEUED")
    done = server.ended(job)
    assert (done["phase"], done["error"]) == ("COMPLETED", None)
    assert done["attempt"] > ended["attempt"]
    refused = server.client.post(f"{job}/retry")
    assert refused.status_code == 409
    assert "retry" not in done["links"]
