"""kill -9 of workers, dispatcher, API, all at once: nothing acknowledged lost, no bit differs."""

from __future__ import annotations

import random
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import httpx
import psutil
import pytest

from pipeline.route.run import render
from pipeline.spec.load import parse_scene
from pipeline.store.product import check

RIGHT_STATE_S = 15.0
FINAL = ("COMPLETED", "ERROR", "ABORTED")
KILLS = 100


class Group:
    """Two processes on one data folder: one leads, both take jobs; they are killed and replaced."""

    def __init__(
        self, make_server: Callable[..., Any], database: str | None = None, lease_s: float = 2.0
    ) -> None:
        more = {"NIGHTGLASS_DATABASE": database} if database else {}
        more["NIGHTGLASS_LEASE_S"] = str(lease_s)
        self.first = make_server(**more)  # it makes the folder and the table
        self.second = make_server(self.first.home, **more)
        self.home: Path = self.first.home

    @property
    def servers(self) -> list[Any]:
        return [self.first, self.second]

    def leader(self) -> Any:
        """The process that runs jobs (None while nobody does)."""
        for server in self.servers:
            if "nightglass_leads 1.0" in server.client.get("/metrics").text:
                return server
        return None

    def workers(self) -> list[psutil.Process]:
        return [worker for server in self.servers for worker in server.workers()]

    def kill(self, what: str) -> None:
        """kill -9 of one thing, or of everything; what was a server is started again."""
        if what == "worker":
            for worker in self.workers():
                worker.kill()
            return
        leader = self.leader() or self.first
        others = [server for server in self.servers if server is not leader]
        dying = {"dispatcher": [leader], "api": others, "group": self.servers}[what]
        if what == "group":
            for worker in self.workers():
                worker.kill()
        for server in dying:
            server.kill()
        with ThreadPoolExecutor() as pool:
            list(pool.map(lambda server: server.start(), dying))


def markers(home: Path) -> dict[Path, int]:
    """Every finished tile of every product, and when its marker was written."""
    return {p: p.stat().st_mtime_ns for p in home.glob("products/*/markers/f*.json")}


def chaos(
    group: Group, scene: dict[str, Any], kills: int, seed: int, tmp_path: Path, together: int = 1
) -> None:
    """Submit, kill, submit, kill...; then everything must come to its right end.

    together : so many kills follow each other at once; the first of them waits for a new tile,
        and after the last all must come into its right state
    """
    dice = random.Random(seed)
    scenes = [scene | {"seed": seed} for seed in range(max(2, kills // 8))]
    jobs: dict[int, str] = {}
    waiting = list(range(len(scenes)))
    seen: dict[Path, int] = {}

    def submit(which: int) -> None:
        answer = group.second.client.post(
            "/v1/jobs", json=scenes[which], headers={"idempotency-key": f"job-{which}"}
        )
        assert answer.status_code in (200, 202), answer.text
        assert jobs.setdefault(which, answer.json()["id"]) == answer.json()["id"]

    submit(waiting.pop(0))
    kinds = ["worker", "dispatcher", "api", "group", "worker"]
    for i in range(kills):
        if waiting:
            submit(waiting.pop(0))
        if i % together == 0:
            another_tile(group, jobs)
        time.sleep(dice.uniform(0.0, 0.4))
        seen |= {path: at for path, at in markers(group.home).items() if path not in seen}
        kind = kinds[i] if i < len(kinds) else dice.choice(kinds[:4])
        group.kill(kind)
        if i % together == together - 1 or i == kills - 1:
            right_state(group, jobs)
        print(f"kill {i + 1}: {kind}, {len(seen)} tiles before it", flush=True)
    for which in waiting:
        submit(which)
    deadline = time.monotonic() + 120 + 2 * kills
    while not all_done(group, jobs):
        assert time.monotonic() < deadline
        time.sleep(0.2)
    again = [p for p, at in markers(group.home).items() if p in seen and at != seen[p]]
    assert again == [], "tiles that were finished before a kill were drawn again"
    for which, job_id in jobs.items():
        job = group.first.client.get(f"/v1/jobs/{job_id}").json()
        assert (job["phase"], job["error"]) == ("COMPLETED", None), job
        product = group.home / "products" / job_id
        assert check(product).whole
        alone = render(parse_scene(scenes[which]), tmp_path / f"alone{which}")
        assert job["content_digest"] == alone["content_digest"]


def another_tile(group: Group, jobs: dict[int, str]) -> None:
    """Return when one more tile is finished than now, or nothing is left to do."""
    before = len(markers(group.home))
    deadline = time.monotonic() + 300
    while len(markers(group.home)) <= before and not all_done(group, jobs):
        assert time.monotonic() < deadline, group.first.logged()[-3000:]
        time.sleep(0.02)


def right_state(group: Group, jobs: dict[int, str]) -> None:
    """Within 15 s of a kill: all jobs are there, one process leads, and what can run runs."""
    deadline = time.monotonic() + RIGHT_STATE_S
    while True:
        found = [group.first.client.get(f"/v1/jobs/{job_id}") for job_id in jobs.values()]
        assert all(answer.status_code == 200 for answer in found)
        phases = [answer.json()["phase"] for answer in found]
        assert not {"ERROR", "ABORTED", "PENDING"} & set(phases), found[0].text
        busy = "EXECUTING" in phases and group.workers()
        if group.leader() is not None and (busy or set(phases) <= {"COMPLETED"}):
            return
        assert time.monotonic() < deadline, phases
        time.sleep(0.05)


def all_done(group: Group, jobs: dict[int, str]) -> bool:
    for job_id in jobs.values():
        try:
            phase = group.first.client.get(f"/v1/jobs/{job_id}").json()["phase"]
        except httpx.TransportError:
            return False
        if phase not in FINAL:
            return False
    return True


@pytest.fixture
def long_scene(scene: dict[str, Any]) -> dict[str, Any]:
    """Some seconds of work in many tiles."""
    scene["name"] = "long"
    scene["sensor"]["shape"] = [640, 640]
    scene["exposure"]["frames"] = 24
    return scene


@pytest.mark.slow
def test_five_kills(
    make_server: Callable[..., Any], scene: dict[str, Any], tmp_path: Path
) -> None:
    """A worker, then at once dispatcher and API, then everything and its new worker."""
    scene["sensor"]["shape"], scene["exposure"]["frames"] = [512, 512], 12
    scene["output"] = {"tile_shape": [256, 256]}
    chaos(Group(make_server, lease_s=0.6), scene, 5, 1, tmp_path, together=3)


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_fifty_kills(
    make_server: Callable[..., Any], long_scene: dict[str, Any], tmp_path: Path, kind: str,
    request: pytest.FixtureRequest,
) -> None:  # fmt: skip
    database = request.getfixturevalue("postgres").database() if kind != "sqlite" else None
    chaos(Group(make_server, database), long_scene, 50, 2, tmp_path)


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_a_hundred_kills_while_jobs_come(
    make_server: Callable[..., Any], scene: dict[str, Any], tmp_path: Path
) -> None:
    """kill -9 of the service at random moments, in the midst of submissions, starts and jobs."""
    server, dice = make_server(NIGHTGLASS_LEASE_S="0.6"), random.Random(3)
    jobs: dict[int, str] = {}
    stopped = threading.Event()

    def one(number: int) -> dict[str, Any]:
        return scene | {"seed": number, "exposure": scene["exposure"] | {"frames": number % 40 + 1}}

    def submit() -> None:
        number = 0
        while not stopped.wait(0.3):
            key = {"idempotency-key": f"job-{number}"}
            try:
                answer = server.client.post("/v1/jobs", json=one(number), headers=key)
            except (httpx.TransportError, RuntimeError):  # killed: nothing is acknowledged
                continue
            assert answer.status_code in (200, 202), answer.text
            jobs[number] = answer.json()["id"]
            number += 1

    began = time.monotonic()
    with ThreadPoolExecutor(1) as pool:
        submitter = pool.submit(submit)
        try:
            for _ in range(KILLS):
                time.sleep(dice.expovariate(1.0))
                assert not submitter.done(), submitter.result()
                server.kill()
                server.start()
        finally:
            stopped.set()
        submitter.result()
    print(f"{KILLS} kills in {time.monotonic() - began:.0f} s, {len(jobs)} jobs acknowledged")
    listed = server.client.get("/v1/jobs", params={"limit": 1000}).json()["jobs"]
    assert len({*jobs.values()}) == len(jobs) > KILLS / 2
    assert {*jobs.values()} <= {job["id"] for job in listed}
    assert len(listed) <= len(jobs) + 1  # the last one may be stored and not acknowledged
    lives = 0
    for number, job_id in jobs.items():
        job = server.ended(f"/v1/jobs/{job_id}")
        lives += job["attempt"]
        assert (job["phase"], job["error"]) == ("COMPLETED", None), job
        assert check(server.home / "products" / job_id).whole
        alone = render(parse_scene(one(number)), tmp_path / f"alone{number}")
        assert job["content_digest"] == alone["content_digest"]
    print(f"all completed in {lives} attempts, {time.monotonic() - began:.0f} s")


@pytest.mark.parametrize("order", [b"", b'{"do": "rend'])
def test_a_worker_whose_parent_dies_before_the_order_is_whole_ends_silently(order: bytes) -> None:
    words = [sys.executable, "-c", "from service.engine.worker import main; main()"]
    told = subprocess.run(words, input=order, capture_output=True, check=False)
    assert (told.returncode, told.stdout, told.stderr) == (1, b"", b"")
