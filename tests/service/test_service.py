"""Jobs from submission to pixels on a running server, through kills, cancels and conflicts."""

from __future__ import annotations

import asyncio
import contextlib
import copy
import json
import sqlite3
import time
from pathlib import Path
from typing import Any

import pytest

from catalog_tools.catalogue import VERSION
from catalog_tools.synthetic.synthetic import make_demo
from pipeline.route.run import Options, render
from pipeline.spec.load import parse_scene
from pipeline.store.product import check
from service.app import create_app
from service.engine.attempts import bytes_of
from service.settings import Settings

FINAL = ("COMPLETED", "ERROR", "ABORTED")


@pytest.fixture
def long_scene(scene: dict[str, Any]) -> dict[str, Any]:
    """Some seconds of work in many tiles."""
    scene["name"] = "long"
    scene["sensor"]["shape"] = [640, 640]
    scene["exposure"]["frames"] = 24
    return scene


def test_same_bits_as_the_engine(
    server: Any, finished: str, scene: dict[str, Any], tmp_path: Path
) -> None:
    job = server.client.get(finished).json()
    alone = render(parse_scene(scene), tmp_path / "alone")
    assert job["content_digest"] == alone["content_digest"]
    assert job["tiles_done"] == job["tiles_total"] == alone["tiles"] == 2
    assert (job["attempt"], job["error"]) == (1, None)
    report = server.client.get(f"{finished}/report").json()
    assert report["content_digest"] == alone["content_digest"]
    assert server.client.get(f"{finished}/plan").json()["tiles"] == 2
    assert server.client.get(f"{finished}/scene").json() == parse_scene(scene).as_dict()
    assert check(server.home / "products" / job["id"]).whole


@pytest.mark.slow
def test_same_bits_with_a_catalogue_and_no_path_in_the_product(
    server: Any, scene: dict[str, Any], tmp_path: Path
) -> None:
    folder = server.home / "catalogues" / "tiny"
    make_demo(folder, faintest_g_mag=5.0)
    every = server.client.get("/v1/catalogues").json()["catalogues"]
    [listed] = [c for c in every if c["name"] == "tiny"]
    assert (listed["name"], listed["usable"], listed["synthetic"]) == ("tiny", True, True)
    scene["stars"] = {"catalogue": "tiny"}
    scene["pointing"] = {"mode": "sidereal", "boresight_ra_deg": 83.0, "boresight_dec_deg": 5.0}
    scene["sensor"]["focal_length_m"] = 0.005
    job = server.submit(scene)
    done = server.ended(job)
    assert done["phase"] == "COMPLETED", done
    local = copy.deepcopy(scene)
    local["stars"]["catalogue"] = str(folder)
    alone = render(parse_scene(local), tmp_path / "alone")
    assert alone["truth_rows"]["stars"] > 0
    assert done["content_digest"] == alone["content_digest"]
    assert server.client.get(f"{job}/scene").json()["stars"]["catalogue"] == "tiny"
    assert server.client.get(f"{job}/plan").json()["shards"] > 0
    told = server.client.get(f"{job}/results").text + server.client.get(job).text
    assert str(server.home) not in told
    for file in server.client.get(f"{job}/results").json()["files"]:
        assert str(server.home).encode() not in server.client.get(file["href"]).content, file
    manifest = folder / "nightglass.json"
    manifest.write_text(manifest.read_text().replace('"rows"', '"rowz"', 1))
    assert not server.client.get("/v1/catalogues").json()["catalogues"][0]["usable"]
    failed = server.ended(server.submit(scene))
    assert (failed["phase"], failed["error"]["kind"]) == ("ERROR", "damaged")
    assert str(server.home) not in json.dumps(failed)


@pytest.mark.slow
def test_same_bits_with_layers(server: Any, scene: dict[str, Any], tmp_path: Path) -> None:
    """A list of registered names: planned, drawn and told as the engine does alone."""
    folder = server.home / "catalogues"
    for name, seed, faintest in (("deep", 3, 5.0), ("over", 4, 4.0)):
        make_demo(folder / name, faintest_g_mag=faintest, seed=seed)
    scene["stars"] = {"catalogue": ["deep", "over"]}
    scene["pointing"] = {"mode": "sidereal", "boresight_ra_deg": 83.0, "boresight_dec_deg": 5.0}
    scene["sensor"]["focal_length_m"] = 0.005
    dry = server.client.post("/v1/jobs?dry_run=1", json=scene)
    assert dry.status_code == 200
    assert dry.json()["layers"][0]["digest"]
    job = server.submit(scene)
    done = server.ended(job)
    assert done["phase"] == "COMPLETED", done
    local = copy.deepcopy(scene)
    local["stars"]["catalogue"] = [str(folder / "deep"), str(folder / "over")]
    alone = render(parse_scene(local), tmp_path / "alone")
    assert done["content_digest"] == alone["content_digest"]
    assert server.client.get(f"{job}/scene").json()["stars"]["catalogue"] == ["deep", "over"]
    report = server.client.get(f"{job}/report").json()
    assert report["layers"] == alone["layers"]
    for file in server.client.get(f"{job}/results").json()["files"]:
        assert str(server.home).encode() not in server.client.get(file["href"]).content, file
    manifest = folder / "over" / "nightglass.json"
    manifest.write_text(manifest.read_text().replace(f'"version": {VERSION}', '"version": 9', 1))
    failed = server.ended(server.submit(scene))
    assert failed["error"]["errors"][0]["pointer"] == "/stars/catalogue/1"
    assert str(server.home) not in json.dumps(failed)


def test_a_scene_that_only_the_planner_refuses(server: Any, scene: dict[str, Any]) -> None:
    lost = copy.deepcopy(scene["targets"][0]) | {"name": "not-followed"}
    lost["orbit"]["position_m"] = [1.0, 1.0, 1.0]
    scene["targets"].append(lost)
    dry = server.client.post("/v1/jobs?dry_run=1", json=scene)
    assert dry.status_code == 422
    assert dry.json()["errors"][0]["allowed"]
    job = server.ended(server.submit(scene))
    assert job["phase"] == "ERROR"
    assert job["error"]["errors"] == dry.json()["errors"]
    assert server.client.get(f"/v1/jobs/{job['id']}/results").status_code == 409


def test_dry_run_makes_no_job(server: Any, scene: dict[str, Any]) -> None:
    before = server.client.get("/v1/jobs").json()
    plan = server.client.post("/v1/jobs?dry_run=1", json=scene)
    assert plan.status_code == 200
    assert (plan.json()["tiles"], plan.json()["frames"]) == (2, 2)
    assert server.client.get("/v1/jobs").json() == before


def test_idempotency_key(server: Any, scene: dict[str, Any]) -> None:
    job = server.submit(scene, **{"idempotency-key": "one"})
    again = server.client.post("/v1/jobs", json=scene, headers={"idempotency-key": "one"})
    assert (again.status_code, again.headers["location"]) == (200, job)
    turned = dict(reversed(scene.items()))
    again = server.client.post("/v1/jobs", json=turned, headers={"idempotency-key": "one"})
    assert (again.status_code, again.headers["location"]) == (200, job)
    other = scene | {"seed": 8}
    refused = server.client.post("/v1/jobs", json=other, headers={"idempotency-key": "one"})
    assert refused.status_code == 409
    assert server.client.delete(job).status_code == 204


@pytest.mark.slow
def test_killed_worker_and_killed_server_go_on_where_they_were(
    server: Any, long_scene: dict[str, Any], tmp_path: Path
) -> None:
    job = server.submit(long_scene)
    waiting = server.submit(long_scene | {"name": "behind"})
    server.until(job, lambda found: (found["tiles_done"] or 0) >= 2)
    [worker] = server.workers()
    worker.kill()
    server.until(job, lambda found: found["attempt"] == 2 and found["tiles_done"] >= 4)
    server.kill()
    server.start()
    assert server.client.get(waiting).json()["phase"] == "QUEUED"
    assert server.client.delete(waiting).status_code == 204
    done = server.ended(job)
    assert (done["phase"], done["attempt"]) == ("COMPLETED", 3)
    report = server.client.get(f"{job}/report").json()
    assert 4 <= report["tiles_resumed"] < 24
    alone = render(parse_scene(long_scene), tmp_path / "alone", Options())
    assert done["content_digest"] == alone["content_digest"]


def test_cancel_and_delete(server: Any, long_scene: dict[str, Any]) -> None:
    def kept() -> int:
        return int(server.client.get("/v1/usage").json()["quotas"]["bytes_kept"]["used"])

    busy = "SELECT count(*) FROM jobs WHERE deleted OR phase IN ('QUEUED', 'EXECUTING')"
    deadline = time.monotonic() + 60
    with contextlib.closing(sqlite3.connect(server.home / "jobs.sqlite")) as db:
        while db.execute(busy).fetchone() != (0,):  # other tests' jobs: they come to count, and go
            assert time.monotonic() < deadline
            time.sleep(0.05)
    before = kept()
    job, waiting = server.submit(long_scene), server.submit(long_scene)
    server.until(job, lambda found: (found["tiles_done"] or 0) >= 1)
    assert server.client.get(f"{job}/plan").json()["frames"] == 24  # while it runs
    assert server.client.post(f"{waiting}/cancel").json()["phase"] == "ABORTED"
    answer = server.client.post(f"{job}/cancel")
    assert (answer.status_code, answer.json()["cancel_asked"]) == (202, True)
    assert server.ended(job)["phase"] == "ABORTED"
    left = bytes_of(server.home / "products" / job.rpartition("/")[2])
    assert kept() - before == left > 0  # it counts until it is deleted
    assert server.client.post(f"{job}/cancel").status_code == 202
    assert server.client.get(f"{job}/results").status_code == 409
    running = server.submit(long_scene)
    server.until(running, lambda found: (found["tiles_done"] or 0) >= 1)
    for gone in (job, waiting, running):
        assert server.client.delete(gone).status_code == 204
        assert server.client.get(gone).status_code == 404
    deadline = time.monotonic() + 20
    folders = [server.home / "products" / path.rpartition("/")[2] for path in (job, running)]
    while any(folder.exists() for folder in folders):
        assert time.monotonic() < deadline
        time.sleep(0.05)


@pytest.mark.slow
def test_a_second_process_watches_but_does_not_run(server: Any, scene: dict[str, Any]) -> None:
    """The first holds the lock; what the second takes, the first runs; then they change places."""
    second = type(server)(server.home)
    try:
        job = second.submit(scene)
        assert second.ended(job)["phase"] == "COMPLETED"
        leads = "nightglass_leads 1"
        assert leads in server.client.get("/metrics").text
        assert leads not in second.client.get("/metrics").text
        server.stop()
        deadline = time.monotonic() + 10
        while leads not in second.client.get("/metrics").text:
            assert time.monotonic() < deadline
            time.sleep(0.05)
    finally:
        second.stop()
        if server.process.poll() is not None:
            server.start()


def test_events_tell_every_change_and_end(server: Any, scene: dict[str, Any]) -> None:
    """A heartbeat, too, while nothing changes: before its owner starts the job."""
    job = server.held(scene)
    own = f"/uws/async/{job.rpartition('/')[2]}/phase"
    seen, lines = [], []
    with server.client.stream("GET", f"{job}/events") as stream:
        assert stream.headers["content-type"].startswith("text/event-stream")
        for line in stream.iter_lines():
            if line == ": heartbeat" and line not in lines:
                server.client.post(own, data={"PHASE": "RUN"})
            lines.append(line)
            if line.startswith("data: "):
                seen.append(json.loads(line[6:]))
    assert seen[-1]["phase"] == "COMPLETED"
    assert ": heartbeat" in lines
    last = [line for line in lines if line.startswith("id: ")][-1][4:]
    again = server.client.get(f"{job}/events", headers={"last-event-id": last})
    assert "data:" not in again.text
    earlier = server.client.get(f"{job}/events", headers={"last-event-id": "1"})
    assert earlier.text.count("data:") == 1


def test_it_starts_and_stops_as_its_server_asks(tmp_path: Path) -> None:
    """By ASGI's messages of a server's life, which are no requests."""
    asked, said = iter(("lifespan.startup", "lifespan.shutdown")), []

    async def receive() -> Any:
        return {"type": next(asked)}

    async def send(message: Any) -> None:
        said.append(message["type"])

    asyncio.run(create_app(Settings(tmp_path))({"type": "lifespan"}, receive, send))
    assert said == ["lifespan.startup.complete", "lifespan.shutdown.complete"]


def test_health_listing_and_page(server: Any, finished: str) -> None:
    assert server.client.get("/healthz").json() == {"status": "ok"}
    assert server.client.get("/readyz").json() == {"ready": True, "faults": []}
    assert 'nightglass_jobs{phase="COMPLETED"}' in server.client.get("/metrics").text
    assert "/v1/jobs" in server.client.get("/openapi.json").json()["paths"]
    page = server.client.get("/")
    assert page.headers["content-type"].startswith("text/html")
    assert "Nightglass" in page.text
    found, path = [], "/v1/jobs?limit=1&phase=COMPLETED&phase=ABORTED"
    while path:
        answer = server.client.get(path)
        found += [job["links"]["self"] for job in answer.json()["jobs"]]
        path = answer.links.get("next", {}).get("url")
    assert finished in found
    assert len(set(found)) == len(found)
