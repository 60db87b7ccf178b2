"""Clusters beyond this machine: TLS with client certificates, workers of ours or of Slurm."""

from __future__ import annotations

import asyncio
import logging
import os
import signal
import socket
import ssl
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import FrameType
from urllib.parse import SplitResult, urlsplit

import dask
from distributed import Client, LocalCluster, Nanny, Security
from distributed.utils import get_mp_context

from ..errors import BadInput, Missing, TryLater, why_broken
from .ahead import Value
from .heap import ALLOCATION

CHATTY = ("distributed", "distributed.client", "tornado", "tornado.application")
CERTIFICATES = ("NIGHTGLASS_CLUSTER_CA", "NIGHTGLASS_CLUSTER_CERT", "NIGHTGLASS_CLUSTER_KEY")
WAIT_S = "NIGHTGLASS_WORKERS_WAIT_S"  # how long to wait for the first worker
MOST_JOBS = 16
METHOD = "distributed.worker.multiprocessing-method"
DEAF = "catalog_tools.engine.deaf"
FORKS = sys.platform == "linux"  # elsewhere a process of many libraries may not be forked
ANSWER_S = 10.0  # how long a scheduler may take to answer


@contextmanager
def cluster(kind: str, workers: int | None, cores: int) -> Iterator[tuple[Client, int]]:
    """A client of processes, of Slurm's jobs or of the scheduler at an address; tasks at once."""
    set_up_dask()
    if kind == "processes":
        with _no_script(), ExitStack() as closing:
            with _interrupts_held():
                client = closing.enter_context(Client(closing.enter_context(_processes(cores))))
            yield client, cores
        return
    with slurm(workers) if kind == "slurm" else connected(kind) as client:
        yield client, max(1, sum(client.nthreads().values()))


@contextmanager
def _no_script() -> Iterator[None]:
    """Processes that start do not run the script that starts them: it would start others.

    multiprocessing takes a main module of this name as what needs no running.
    """
    main = sys.modules["__main__"]
    before, main.__spec__ = main.__spec__, ModuleSpec("__main__", None)
    try:
        yield
    finally:
        main.__spec__ = before


@contextmanager
def _interrupts_held() -> Iterator[None]:
    """Ctrl-C comes at the end: half a cluster cannot be closed."""
    if threading.current_thread() is not threading.main_thread():
        yield  # no signal comes here
        return
    held: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, _: held.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        if held:
            signal.raise_signal(signal.SIGINT)


def _processes(count: int) -> LocalCluster:
    """Processes of this machine, of one thread each. BadInput where none can be started."""
    if FORKS:  # off one process, which imports once what this one has of the product
        dask.config.set({METHOD: "forkserver"})
        ours = {name for name in sys.modules if name.split(".")[0] in ("pipeline", "catalog_tools")}
        get_mp_context().set_forkserver_preload([DEAF, "distributed.nanny", *sorted(ours)])
    try:
        return LocalCluster(
            n_workers=count,
            threads_per_worker=1,
            processes=True,
            host="127.0.0.1",
            dashboard_address=None,
            silence_logs=50,
            scheduler_sync_interval=60,
            scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},  # not 8787 of all networks
        )
    except RuntimeError as error:
        first: BaseException = error
        while earlier := first.__cause__ or first.__context__:
            first = earlier
        allowed = f"threads, where no processes can be started ({first})"
        raise BadInput("--scheduler", "processes", allowed) from None


def set_up_dask() -> None:
    """Dask's settings as our clients and workers want them, and silence: what goes wrong we say."""
    for name, value in ALLOCATION.items():
        os.environ.setdefault(name, value)
    dask.config.set(
        {
            METHOD: "spawn",
            "distributed.scheduler.allowed-failures": 3,
            "distributed.worker.profile.enabled": False,
            # By default 1 to 1000 times a second, in every process: a tenth of a short job.
            "distributed.admin.tick.interval": "5s",
            "distributed.admin.tick.limit": "60s",
            "distributed.admin.system-monitor.interval": "5s",
            "distributed.admin.system-monitor.gil.enabled": False,
            "distributed.worker.memory.monitor-interval": "1s",
            "distributed.client.scheduler-info-interval": "10s",
            # what tasks share goes in one graph
            "distributed.admin.large-graph-warning-threshold": "1TB",
            "distributed.logging": dict.fromkeys(CHATTY, "critical"),
        }
    )
    for name in CHATTY:
        logging.getLogger(name).setLevel(logging.CRITICAL)


def security_of(address: str) -> Security | None:
    """TLS settings for an address: certificates from the environment, or from Dask's own settings.

    None for tcp://. Raises BadInput where a file is not given or not there.
    """
    if not address.startswith("tls://"):
        return None
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
        tls_ca_file=ca,
        tls_client_cert=cert,
        tls_client_key=key,
        tls_worker_cert=cert,
        tls_worker_key=key,
        require_encryption=True,
    )


@contextmanager
def connected(address: str) -> Iterator[Client]:
    """A client of the scheduler at an address, with at least one worker there."""
    ask(address)
    try:
        client = Client(address, timeout=ANSWER_S, security=security_of(address))
    except (OSError, TimeoutError, ValueError) as error:
        raise TryLater(f"the scheduler at {address} takes no client ({error})") from None
    with client:
        if not client.nthreads():
            wait_for_workers(client, address, float(os.environ.get(WAIT_S, "0")))
        yield client


def ask(address: str, patience_s: float | None = None) -> None:
    """Make sure that a scheduler answers at an address: it speaks first.

    Raises TryLater where none does, BadInput where the certificates do not fit.
    """
    security = security_of(address)
    try:
        _await_greeting(urlsplit(address), security, patience_s or ANSWER_S)
    except ssl.SSLError as error:
        allowed = f"a scheduler whose certificates fit those given here ({error.reason or error})"
        raise BadInput("--scheduler", address, allowed) from None
    except OSError as error:
        hint = "" if security else "; is it a tls:// one?"
        reason = error.strerror or str(error) or type(error).__name__
        raise TryLater(f"no scheduler answers at {address} ({reason}{hint})") from None


def _await_greeting(parts: SplitResult, security: Security | None, patience_s: float) -> None:
    """Connect and wait for the first byte. Raises OSError."""
    with ExitStack() as closing:
        wire = socket.create_connection((str(parts.hostname), int(parts.port or 0)), patience_s)
        closing.callback(wire.close)
        if security is not None:
            context = security.get_connection_args("client")["ssl_context"]
            wire = closing.enter_context(context.wrap_socket(wire))
        if not wire.recv(1):
            raise ConnectionResetError("it closes the connection")


def wait_for_workers(client: Client, where: str, seconds: float) -> None:
    """Wait for a first worker. Raises TryLater where none comes."""
    try:
        if seconds <= 0:
            raise TimeoutError
        client.wait_for_workers(1, timeout=seconds)
    except TimeoutError:
        told = f"{WAIT_S} says how many seconds are waited for the first"
        raise TryLater(f"the scheduler at {where} has no workers ({told})") from None


async def work(address: str, patience_s: float, **options: Value) -> None:
    """Work for the scheduler at an address until a signal comes.

    patience_s : how long a scheduler is waited for; options : of Dask's Nanny
    Raises TryLater where the scheduler goes away, or does not come.
    """
    stopped, loop = asyncio.Event(), asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, stopped.set)
    stop = asyncio.ensure_future(stopped.wait())
    security = security_of(address)
    nanny = Nanny(address, security=security, death_timeout=patience_s, dashboard=False, **options)

    async def whole() -> None:
        await nanny
        await nanny.finished()

    life = asyncio.ensure_future(whole())
    await asyncio.wait({life, stop}, return_when=asyncio.FIRST_COMPLETED)
    if stopped.is_set():
        await nanny.close(timeout=10)
        return
    stop.cancel()
    if error := life.exception():
        reason = str(error.__cause__ or error) or f"within {patience_s:g} s"
        raise TryLater(f"no scheduler answers at {address} ({reason})") from None
    raise TryLater(f"the scheduler at {address} went away: this worker ends")


@contextmanager
def slurm(jobs: int | None) -> Iterator[Client]:
    """A client of workers that Slurm starts: as many jobs as there is work for, up to `jobs`.

    Queue, cores, memory and the like come from Dask's own settings (jobqueue.slurm). Scheduler and
    workers speak TLS with certificates made for this run, in a folder that only the user can read.
    """
    before = signal.getsignal(signal.SIGINT)
    try:
        from .slurm_jobs import cluster_of_jobs, wait_for_a_job
    except ImportError as error:
        field, broken = "--scheduler slurm", why_broken(error, "dask_jobqueue")
        raise Missing("workers of Slurm", "dask-jobqueue", "slurm", "", field, broken) from None
    finally:  # dask_jobqueue lets Ctrl-C end the process at once, with exit code 0
        signal.signal(signal.SIGINT, before)
    folder = Path(os.environ.get("NIGHTGLASS_SLURM_FOLDER") or Path.home() / ".nightglass-slurm")
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    with (
        _signals_unwind(),
        cluster_of_jobs(folder, jobs or MOST_JOBS) as made,
        Client(made, timeout=30) as client,
    ):
        wait_for_a_job(client, made, float(os.environ.get(WAIT_S, "86400")))
        yield client


@contextmanager
def _signals_unwind() -> Iterator[None]:
    """What would end the process at once unwinds it, so that no job stays in the queue."""
    taken = [n for n in (signal.SIGTERM, signal.SIGHUP) if signal.getsignal(n) == signal.SIG_DFL]

    def end(number: int, _: FrameType | None) -> None:
        sys.exit(128 + number)

    for number in taken:
        signal.signal(number, end)
    try:
        yield
    finally:
        for number in taken:
            signal.signal(number, signal.SIG_DFL)
