"""Names and addresses of schedulers, and which of them may be used."""

from __future__ import annotations

from urllib.parse import urlsplit

from ..errors import BadInput

LOCAL_KINDS = ("threads", "synchronous", "processes", "slurm")
LOOPBACK = ("localhost", "::1")


def check_scheduler(kind: str) -> None:
    """Refuse what is no scheduler, or an unsafe one: BadInput.

    An open scheduler runs anybody's code: beyond loopback only TLS is accepted, and nowhere else
    where Dask's settings require encryption.
    """
    if kind not in LOCAL_KINDS:
        check_address(kind)
    if kind == "processes" or kind.startswith("tcp:"):
        import dask.config

        setting = "distributed.comm.require-encryption"
        if dask.config.get(setting, None):
            allowed = f"threads, or tls:// with certificates: {setting} is set for Dask"
            raise BadInput("--scheduler", kind, allowed)


def check_address(address: str) -> None:
    """Refuse what is no scheduler's address, and an open one, which runs anybody's code."""
    try:
        parts = urlsplit(address)
        known = parts.scheme in ("tcp", "tls") and bool(parts.hostname) and bool(parts.port)
    except ValueError:  # a port that is no number
        known = False
    if not known:
        allowed = f"{', '.join(LOCAL_KINDS)}, tcp://127.0.0.1:PORT or tls://HOST:PORT"
        raise BadInput("--scheduler", address, allowed)
    host = str(parts.hostname)
    if parts.scheme == "tcp" and not (host in LOOPBACK or host.startswith("127.")):
        raise BadInput("--scheduler", address, "tls:// with certificates beyond this machine")
