"""A real PostgreSQL server on loopback for the tests; skipped with a reason where there is none."""

from __future__ import annotations

import os
import pwd
import shutil
import signal
import socket
import subprocess
import time
from pathlib import Path

import pytest


def _program(name: str) -> str | None:
    places = sorted(Path("/usr/lib/postgresql").glob(f"*/bin/{name}"), reverse=True)
    return str(places[0]) if places else shutil.which(name)


class Postgres:
    """initdb in a folder, a server on a free port of 127.0.0.1, a database for each test."""

    def __init__(self, folder: Path) -> None:
        initdb, server = _program("initdb"), _program("postgres")
        if initdb is None or server is None:
            pytest.skip("PostgreSQL is not installed (Debian package `postgresql`)")
        pytest.importorskip("psycopg", reason="psycopg is not installed")
        user = None
        if os.geteuid() == 0:  # the server refuses to run as root
            try:
                user = pwd.getpwnam("postgres")
            except KeyError:
                pytest.skip("PostgreSQL does not run as root, and there is no user `postgres`")
        data = Path("/tmp") / f"nightglass-pg-{os.getpid()}-{time.monotonic_ns()}"
        data.mkdir(mode=0o700)
        self.data, self.folder = data, folder
        as_user = {}
        if user is not None:
            os.chown(data, user.pw_uid, user.pw_gid)
            as_user = {"user": user.pw_uid, "group": user.pw_gid, "extra_groups": []}
        subprocess.run(
            [initdb, "-D", str(data), "-U", "nightglass", "-A", "trust", "--no-sync", "-E", "UTF8"],
            check=True, capture_output=True, cwd="/", **as_user,
        )  # fmt: skip
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        command = [server, "-D", str(data), "-p", str(self.port), "-h", "127.0.0.1", "-k", ""]
        self.process = subprocess.Popen(
            command, cwd="/", stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, **as_user
        )
        self._made = 0
        deadline = time.monotonic() + 60
        while not self._answers():
            assert self.process.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.1)

    def _answers(self) -> bool:
        import psycopg

        try:
            with psycopg.connect(self._url("postgres"), connect_timeout=5):
                return True
        except psycopg.OperationalError:
            return False

    def _url(self, name: str) -> str:
        return f"postgresql://nightglass@127.0.0.1:{self.port}/{name}"

    def database(self) -> str:
        """URL of a new, empty database."""
        import psycopg

        self._made += 1
        name = f"jobs{self._made}"
        with psycopg.connect(self._url("postgres"), autocommit=True) as db:
            db.execute(f"CREATE DATABASE {name}")  # type: ignore[arg-type]
        return self._url(name)

    def stop(self) -> None:
        self.process.send_signal(signal.SIGINT)  # at once, whoever is still connected
        self.process.wait(60)
        shutil.rmtree(self.data, ignore_errors=True)
