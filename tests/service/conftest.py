"""Fixtures of the service's tests: a small scene, a server in a process of its own."""

from __future__ import annotations

import copy
import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import psutil
import pytest

from service.accounts.keys import create_key
from service.store.database import connect, sqlite_url

SCENE: dict[str, Any] = {
    "schema": "nightglass/scene/1",
    "name": "small",
    "epoch": "2019-04-20T03:00:00Z",
    "seed": 7,
    "observer": {"kind": "ground", "latitude_deg": 20.7, "longitude_deg": -156.3},
    "sensor": {
        "shape": [64, 64],
        "pixel_pitch_um": 13.5,
        "focal_length_m": 1.0,
        "aperture_m": 0.4,
        "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
        "psf": {"kind": "gaussian", "sigma_px": 1.0},
        "read_noise_e": 5.0,
    },
    "pointing": {"mode": "target", "target": "sat-1"},
    "exposure": {"integration_s": 2.0, "frames": 2, "cadence_s": 5.0},
    "targets": [
        {
            "name": "sat-1",
            "orbit": {
                "kind": "state",
                "position_m": [-39e6, 14e6, 1e4],
                "velocity_m_s": [-1000.0, -2900.0, 0.0],
            },
            "body": {"kind": "sphere", "diameter_m": 3.0, "albedo": 0.2},
        }
    ],
    "background": {"uniform_mag_arcsec2": 21.5},
}
LIMITS = {
    "NIGHTGLASS_BODY_BYTES": str(1 << 18),
    "NIGHTGLASS_PIXEL_FRAMES": str(1 << 28),
    "NIGHTGLASS_TARGETS": "50",
    "NIGHTGLASS_HEARTBEAT_S": "0.5",
    "NIGHTGLASS_LEASE_S": "2",
}
FINAL = ("COMPLETED", "ERROR", "ABORTED")


def is_dead(process: psutil.Process) -> bool:
    """Whether a process ended, be it that what took it over never asks after it."""
    try:
        return process.status() in (psutil.STATUS_ZOMBIE, psutil.STATUS_DEAD)
    except psutil.NoSuchProcess:
        return True


def dies(process: psutil.Process, limit_s: float = 5) -> bool:
    """Whether a process ends within a time."""
    deadline = time.monotonic() + limit_s
    while not is_dead(process) and time.monotonic() < deadline:
        time.sleep(0.02)
    return is_dead(process)


@pytest.fixture
def scene() -> dict[str, Any]:
    """A scene without stars that renders in about a second; a copy to change at will."""
    return copy.deepcopy(SCENE)


@pytest.fixture(scope="session")
def postgres(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A real PostgreSQL server, or a skip that says why there is none."""
    from tests.service.postgres import Postgres

    server = Postgres(tmp_path_factory.mktemp("postgres"))
    yield server
    server.stop()


@pytest.fixture(params=["sqlite", "postgresql"])
def database(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """URL of an empty database, of each kind."""
    if request.param == "sqlite":
        return f"sqlite:///{tmp_path / 'jobs.sqlite'}"
    return request.getfixturevalue("postgres").database()


def _servers(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[..., Server]]:
    """Make servers; all are stopped at the end, with what they still run."""
    made: list[Server] = []

    def make(home: Path | None = None, **environment: str) -> Server:
        made.append(Server(home or tmp_path_factory.mktemp("home"), **environment))
        return made[-1]

    yield make
    for server in made:
        if server.process.poll() is None:
            server.stop()


@pytest.fixture
def make_server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[..., Server]]:
    """Start servers for one test: `make_server(NIGHTGLASS_X="1")`, each on a folder of its own."""
    yield from _servers(tmp_path_factory)


@pytest.fixture(scope="module")
def keep_server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[..., Server]]:
    """Start servers that all tests of a module share."""
    yield from _servers(tmp_path_factory)


def bearer(token: str) -> dict[str, str]:
    """The header that shows a key."""
    return {"authorization": f"Bearer {token}"}


class Server:
    """`service.main.serve` as a process, and a client that talks to it; its log is a file."""

    def __init__(self, home: Path, **environment: str) -> None:
        self.home, self.environment = home, environment
        # its own, also where several serve one folder: its address is read from it
        self.log = home.parent / f"{home.name}-{time.monotonic_ns()}.log"
        self.start()

    def make_keys(self, *teams: str) -> list[str]:
        """A key for each team; from the first one on the server asks for keys."""
        engine = connect(sqlite_url(self.home / "jobs.sqlite"))
        keys = [create_key(engine, team) for team in teams]
        engine.dispose()
        deadline = time.monotonic() + 10
        while self.client.get("/v1/jobs").status_code != 401:
            assert time.monotonic() < deadline
            time.sleep(0.1)
        return keys

    def start(self, port: int = 0) -> None:
        code = "import sys; from pathlib import Path; from service.main import serve; "
        code += "serve('127.0.0.1', int(sys.argv[2]), Path(sys.argv[1]))"
        known = self.log.stat().st_size if self.log.exists() else 0
        with self.log.open("ab") as log:
            self.process = subprocess.Popen(
                [sys.executable, "-c", code, str(self.home), str(port)], stderr=log,
                env=os.environ | LIMITS | self.environment, start_new_session=True,
            )  # fmt: skip
        deadline = time.monotonic() + 60
        while not (found := re.search(r"serves (https?://\S+)", self.logged()[known:])):
            assert self.process.poll() is None, self.logged()[known:]
            assert time.monotonic() < deadline
            time.sleep(0.02)
        self.url = found[1]
        self.client = httpx.Client(base_url=self.url, timeout=30, verify=False)

    def logged(self) -> str:
        """Everything that the server has said."""
        return self.log.read_text(errors="replace")

    def kill(self) -> None:
        """kill -9."""
        self.process.kill()
        self._gone()

    def stop(self) -> None:
        self.process.terminate()
        self._gone()

    def _gone(self) -> None:
        self.process.wait(30)
        self.client.close()

    def forks(self) -> list[psutil.Process]:
        """The process that forks the engine's, once there was an order."""
        return psutil.Process(self.process.pid).children()

    def workers(self) -> list[psutil.Process]:
        """The processes of the engine that run."""
        every = [worker for fork in self.forks() for worker in fork.children()]
        return [worker for worker in every if not is_dead(worker)]

    def submit(self, scene: dict[str, Any], **headers: str) -> str:
        answer = self.client.post("/v1/jobs", json=scene, headers=headers)
        assert answer.status_code == 202, answer.text
        return answer.headers["location"]

    def held(self, scene: dict[str, Any], **headers: str) -> str:
        """The path of a job that waits until its owner starts it (UWS: PHASE=RUN)."""
        form = {"SCENE": json.dumps(scene)}
        made = self.client.post("/uws/async", data=form, headers=headers).headers["location"]
        return f"/v1/jobs/{made.rpartition('/')[2]}"

    def until(
        self, job: str, wanted: Callable[[dict[str, Any]], bool], limit_s: float = 300
    ) -> dict[str, Any]:
        """The job once `wanted` holds, watched by long polls."""
        deadline, etag = time.monotonic() + limit_s, ""
        while True:
            answer = self.client.get(job, params={"wait": 5}, headers={"if-none-match": etag})
            if answer.status_code == 200:
                found, etag = answer.json(), answer.headers["etag"]
                if wanted(found):
                    return found
                assert found["phase"] not in FINAL, found
            assert time.monotonic() < deadline, found

    def ended(self, job: str) -> dict[str, Any]:
        return self.until(job, lambda found: found["phase"] in FINAL)


@pytest.fixture(scope="session")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A running server on a data folder of its own."""
    server = Server(tmp_path_factory.mktemp("home"))
    yield server
    server.stop()


@pytest.fixture(scope="session")
def finished(server: Server) -> str:
    """The path of a completed job of the small scene."""
    job = server.submit(copy.deepcopy(SCENE))
    assert server.ended(job)["phase"] == "COMPLETED"
    return job
