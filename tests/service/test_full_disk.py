"""A disk that fills up at every tenth write of a running service: nothing acknowledged is lost."""

from __future__ import annotations

import os
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from pipeline.store.product import check
from tests.full_disk.disk import Disk, make_disk

SAID = ("the disk of the job table is full", "the disk of the uploads is full",
        "the job table is locked or cannot be reached")  # fmt: skip
FULL_S = 60


@pytest.fixture(scope="module")
def disk(tmp_path_factory: pytest.TempPathFactory) -> tuple[Disk, dict[str, str]]:
    made, environ = make_disk(tmp_path_factory.mktemp("disk"))
    return made, {name: environ[name] for name in ("LD_PRELOAD", "FULL_DISK")}


def asked(server: Any, scene: dict[str, Any], number: int) -> tuple[list[str], list[str]]:
    """Jobs and files that the service took in one go; whatever it refuses, it says why."""
    jobs, files = [], []
    table = f"wavelength_nm,value\n400,{number}\n900,1\n".encode() * 400
    content = {"content-type": "application/octet-stream"}
    for answer in (
        server.client.post(f"/v1/files?name=t{number}.csv", content=table, headers=content),
        server.client.post("/v1/jobs", json=scene),
    ):
        if answer.status_code in (201, 202):
            (jobs if answer.status_code == 202 else files).append(answer.json()["id"])
        else:
            assert answer.status_code == 503, answer.text
            assert answer.json()["detail"].startswith(SAID), answer.text
            assert answer.headers["retry-after"]
    return jobs, files


def filled(server: Any, disk: Disk, scene: dict[str, Any], at: int, wanted: str) -> int:
    """Fill the disk at one write; then make room: every job that was taken ends as it should."""
    jobs: list[str] = []
    files: list[str] = []
    disk.fill(server.home, at)
    deadline = time.monotonic() + FULL_S
    while not disk.refused and time.monotonic() < deadline:
        made = asked(server, scene, at * 1000 + len(jobs))
        jobs, files = jobs + made[0], files + made[1]
        time.sleep(0.05)
    assert disk.refused
    asked(server, scene, at)  # on a disk that is full: refused, and said why
    disk.make_room()
    listed = {j["id"] for j in server.client.get("/v1/jobs?limit=1000").json()["jobs"]}
    assert set(jobs) <= listed
    kept = {f["id"] for f in server.client.get("/v1/files").json()["files"]}
    assert set(files) <= kept
    for job_id in jobs:
        job = server.ended(f"/v1/jobs/{job_id}")
        if job["phase"] == "COMPLETED":
            assert job["content_digest"] == wanted
            assert check(server.home / "products" / job_id).whole
        else:
            assert job["error"]["kind"] == "disk full", job
            assert "disk is full" in job["error"]["message"]
            product = server.client.get(f"/v1/jobs/{job_id}/results")
            assert product.status_code == 409
    assert not list((server.home / "uploads").glob(".part-*"))
    again = server.ended(server.submit(scene))  # going on: the same bits
    assert (again["phase"], again["content_digest"]) == ("COMPLETED", wanted)
    return len(jobs)


def run(make_server: Callable[..., Any], disk: Any, scene: dict[str, Any], ats: range) -> None:
    control, environ = disk
    control.make_room()
    server = make_server(**environ)
    wanted = server.ended(server.submit(scene))["content_digest"]
    for at in ats:
        filled(server, control, scene, at, wanted)
    server.stop()
    with sqlite3.connect(server.home / "jobs.sqlite") as db:
        assert db.execute("PRAGMA integrity_check").fetchone() == ("ok",)


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_a_full_disk_at_every_tenth_write(
    make_server: Any, disk: Any, scene: dict[str, Any]
) -> None:
    run(make_server, disk, scene, range(10, 401, 10))


@pytest.mark.parametrize("at", [8])
def test_a_service_does_not_start_on_a_full_disk(disk: Any, tmp_path: Path, at: int) -> None:
    """One message, exit code 3."""
    control, environ = disk
    control.fill(tmp_path, at)
    command = [sys.executable, "-m", "pipeline", "serve", "--home", str(tmp_path / "h"), "--port"]
    ended = subprocess.run(
        [*command, "0"], env=os.environ | environ, capture_output=True, text=True, timeout=100
    )
    control.make_room()
    assert ended.returncode == 3, ended.stderr
    assert ended.stderr.count("\n") == 1, ended.stderr
    full = "the disk is full (No space left on device); make room, then start again"
    assert full in ended.stderr
