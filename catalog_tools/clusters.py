"""Clusters beyond this machine: TLS with client certificates, and workers that Slurm starts."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from .errors import BadInput, Incomplete

LOOPBACK = ("localhost", "::1")
CERTIFICATES = ("NIGHTGLASS_CLUSTER_CA", "NIGHTGLASS_CLUSTER_CERT", "NIGHTGLASS_CLUSTER_KEY")
WAIT_S = "NIGHTGLASS_WORKERS_WAIT_S"  # how long to wait for the first worker
MOST_JOBS = 16
ANSWER_S = 10.0  # how long a scheduler may take to answer


def check_address(address: str, others: tuple[str, ...]) -> None:
    """Refuse what is no scheduler's address: an open one runs anybody's code, so TLS off loopback.

    others : names of schedulers that are no addresses, for the message
    """
    try:
        parts = urlsplit(address)
        known = parts.scheme in ("tcp", "tls") and bool(parts.hostname) and bool(parts.port)
    except ValueError:  # a port that is no number
        known = False
    if not known:
        allowed = f"{', '.join(others)}, tcp://127.0.0.1:PORT or tls://HOST:PORT"
        raise BadInput("--scheduler", address, allowed)
    host = str(parts.hostname)
    if parts.scheme == "tcp" and not (host in LOOPBACK or host.startswith("127.")):
        raise BadInput("--scheduler", address, "tls:// with certificates beyond this machine")


def security_of(address: str) -> Any:
    """TLS settings for an address: certificates from the environment, or from Dask's own settings.

    None for tcp://. Raises BadInput where a file is not given or not there.
    """
    if not address.startswith("tls://"):
        return None
    from distributed import Security

    files = {name: os.environ.get(name) for name in CERTIFICATES}
    if not any(files.values()):
        security = Security(require_encryption=True)  # distributed.comm.tls of Dask's settings
        told = (getattr(security, name, None) for name in ("tls_ca_file", "tls_client_cert"))
        if all(told):
            return security
    for name, path in files.items():
        if not path or not Path(path).is_file():
            raise BadInput(name, path, "a PEM file of the cluster's TLS (docs/cluster.md)")
    ca, cert, key = (files[name] for name in CERTIFICATES)
    return Security(
        tls_ca_file=ca, tls_client_cert=cert, tls_client_key=key, require_encryption=True
    )


@contextmanager
def connected(address: str) -> Iterator[Any]:
    """A client of the scheduler at an address, with at least one worker there."""
    from distributed import Client

    security = security_of(address)
    try:
        client = Client(address, timeout=ANSWER_S, security=security)
    except (OSError, TimeoutError, ValueError) as error:
        raise BadInput(
            "--scheduler", address, f"the address of a running scheduler; {error}"
        ) from None
    with client:
        if not client.nthreads():
            wait_for_workers(client, address, float(os.environ.get(WAIT_S, "0")))
        yield client


def wait_for_workers(client: Any, where: str, seconds: float) -> None:
    """Wait for a first worker. Raises BadInput where none comes."""
    try:
        if seconds <= 0:
            raise TimeoutError
        client.wait_for_workers(1, timeout=seconds)
    except TimeoutError:
        allowed = f"a scheduler that has workers ({WAIT_S} seconds are waited for the first)"
        raise BadInput("--scheduler", where, allowed) from None


@contextmanager
def slurm(jobs: int | None) -> Iterator[Any]:
    """A client of workers that Slurm starts: as many jobs as there is work for, up to `jobs`.

    Queue, cores, memory and the like come from Dask's own settings (jobqueue.slurm). Scheduler and
    workers speak TLS with certificates made for this run, in a folder that only the user can read.
    """
    try:
        from dask_jobqueue import SLURMCluster
    except ImportError:
        allowed = "pip install nightglass[slurm], which brings dask-jobqueue"
        raise BadInput("--scheduler", "slurm", allowed) from None
    from distributed import Client, Security

    folder = Path(os.environ.get("NIGHTGLASS_SLURM_FOLDER") or Path.home() / ".nightglass-slurm")
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    try:
        cluster = SLURMCluster(
            security=Security.temporary(), protocol="tls://", shared_temp_directory=str(folder)
        )
    except (ValueError, RuntimeError, OSError) as error:
        raise BadInput(
            "--scheduler", "slurm", f"settings in jobqueue.slurm of Dask's configuration; {error}"
        ) from None
    with cluster, Client(cluster, timeout=30) as client:
        cluster.adapt(minimum_jobs=1, maximum_jobs=jobs or MOST_JOBS)
        try:
            client.wait_for_workers(1, timeout=float(os.environ.get(WAIT_S, "86400")))
        except TimeoutError:
            raise Incomplete("Slurm started no job in time; what is finished is kept") from None
        yield client
