"""A real scheduler behind TLS and its workers, each a process of its own: killed, started."""

from __future__ import annotations

import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from catalog_tools.engine.clusters import security_of

ROOT = Path(__file__).resolve().parents[1]
FILES = {"CA": "ca.pem", "CERT": "cluster.pem", "KEY": "cluster.key"}


def make_certificates(folder: Path, *names: str) -> Path:
    """What deploy/tls/make-certificates.sh makes."""
    if shutil.which("openssl") is None:
        pytest.skip("openssl is not installed")
    script = ROOT / "deploy" / "tls" / "make-certificates.sh"
    subprocess.run(["sh", str(script), str(folder), *names], check=True)
    return folder


@contextmanager
def tls_cluster_in(certificates: Path, folder: Path) -> Iterator[TlsCluster]:
    """A cluster that is not started yet; whatever of it runs at the end is killed."""
    cluster = TlsCluster(certificates, folder)
    try:
        yield cluster
    finally:
        cluster.kill_workers()
        if cluster.scheduler is not None:
            cluster.stop_scheduler()


class TlsCluster:
    """A scheduler at one address for as long as this lives, and workers that join it."""

    def __init__(self, certificates: Path, folder: Path) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self.address, self.folder = f"tls://127.0.0.1:{self.port}", folder
        self.environment = {
            f"NIGHTGLASS_CLUSTER_{k}": f"{certificates}/{v}" for k, v in FILES.items()
        }
        self.scheduler: subprocess.Popen[bytes] | None = None
        self.workers: list[subprocess.Popen[bytes]] = []

    def start(self) -> None:
        """Start the scheduler and wait until it listens."""
        self.scheduler = self._dask(
            "scheduler", "--protocol=tls", "--host=127.0.0.1", f"--port={self.port}",
            "--no-dashboard", "--no-jupyter",
        )  # fmt: skip
        end = time.monotonic() + 60
        while time.monotonic() < end:
            with socket.socket() as probe:
                if probe.connect_ex(("127.0.0.1", self.port)) == 0:
                    return
            time.sleep(0.1)
        raise TimeoutError("the scheduler does not listen")

    def add_workers(self, count: int, **environment: str) -> None:
        for _ in range(count):
            self.workers.append(self._dask(
                "worker", self.address, "--nthreads=1", "--no-dashboard", "--no-nanny",
                f"--local-directory={self.folder}", **environment,
            ))  # fmt: skip

    def wait_for_workers(self, count: int) -> None:
        """Wait until so many have joined."""
        from distributed import Client

        with pytest.MonkeyPatch.context() as patch:
            for name, value in self.environment.items():
                patch.setenv(name, value)
            with Client(self.address, security=security_of(self.address)) as client:
                client.wait_for_workers(count, timeout=60)

    def kill_workers(self) -> None:
        for worker in self.workers:
            worker.kill()
            worker.wait()
        self.workers = []

    def stop_scheduler(self, how: int = signal.SIGKILL) -> None:
        assert self.scheduler is not None
        self.scheduler.send_signal(how)
        self.scheduler.wait(30)

    def _dask(self, *arguments: str, **environment: str) -> subprocess.Popen[bytes]:
        files = {k: self.environment[f"NIGHTGLASS_CLUSTER_{k}"] for k in FILES}
        tls = [f"--tls-ca-file={files['CA']}", f"--tls-cert={files['CERT']}",
               f"--tls-key={files['KEY']}"]  # fmt: skip
        environ: dict[str, Any] = os.environ | {
            "DASK_DISTRIBUTED__COMM__REQUIRE_ENCRYPTION": "true", "PYTHONPATH": str(ROOT),
        } | environment  # fmt: skip
        with (self.folder / "log").open("ab") as log:
            return subprocess.Popen(
                [sys.executable, "-m", "dask", *arguments, *tls], env=environ, stdout=log,
                stderr=log,
            )  # fmt: skip
