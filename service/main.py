"""Start the service: check where it would listen, bind, run."""

from __future__ import annotations

import gc
import ipaddress
import logging
import socket
import ssl
import sys
from pathlib import Path

import uvicorn

from catalog_tools.engine.heap import few_collections
from pipeline.errors import BadInput
from service import logs
from service.accounts.keys import any_key
from service.accounts.oidc import check_place
from service.app import create_app
from service.http.wire import bounded
from service.settings import Settings, read_settings, unknown_variables
from service.store.database import connect
from service.store.homes import check_home

LISTEN = 2048
STOP_S = 3  # how long answers in flight may take to end
KEEP_ALIVE_S = 15

log = logging.getLogger("nightglass.service")


def serve(host: str = "127.0.0.1", port: int = 8765, home: Path | None = None) -> None:
    """Serve the REST interface until interrupted. BadInput for an address it may not take.

    Beyond loopback it serves only where requests need a key or token. Port 0 takes a free one.
    """
    settings = read_settings(home)
    if settings.oidc_jwks:
        check_place(settings.oidc_jwks)
    _check_certificate(settings)
    with bind(host, port, lambda: _guarded(settings)) as listener:
        logs.set_up()
        for name in unknown_variables():
            log.warning("%s in the environment is no setting: it changes nothing", name)
        settings.make_folders()
        _check_table(settings)
        app = create_app(settings)
        config = uvicorn.Config(
            app,
            log_config=None,
            access_log=False,
            server_header=False,
            backlog=LISTEN,
            timeout_graceful_shutdown=STOP_S,
            timeout_keep_alive=KEEP_ALIVE_S,
            ws="none",
            http=bounded(settings.head_s),
            ssl_certfile=settings.tls_cert,
            ssl_keyfile=settings.tls_key,
        )
        where, at = listener.getsockname()[:2]
        shown = f"[{where}]" if ":" in where else where
        scheme = "https" if settings.tls_cert else "http"
        print(f"Nightglass serves {scheme}://{shown}:{at} from {settings.home}", file=sys.stderr)
        sys.stderr.flush()
        gc.freeze()  # what is there now stays: collections need not look at it again
        few_collections()
        uvicorn.Server(config).run(sockets=[listener])


def _check_certificate(settings: Settings) -> None:
    """BadInput for files that are no certificate and its key."""
    if not settings.tls_cert:
        return
    try:
        ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(settings.tls_cert, settings.tls_key)
    except OSError as error:
        reason = "these are no pair" if isinstance(error, ssl.SSLError) else error.strerror
        allowed = f"a certificate (PEM), and its key as NIGHTGLASS_TLS_KEY; {reason}"
        raise BadInput("NIGHTGLASS_TLS_CERT", settings.tls_cert, allowed) from None


def _check_table(settings: Settings) -> None:
    """What is wrong with the job table is said before all else."""
    engine = connect(settings.database_url)
    try:
        if settings.database:
            check_home(engine, settings.home)
    finally:
        engine.dispose()


def _guarded(settings: object) -> bool:
    """Whether requests will need a key or token: an identity provider is set, or a key was made."""
    assert isinstance(settings, Settings)
    if settings.oidc_issuer:
        return True
    settings.make_folders()
    engine = connect(settings.database_url)
    try:
        return any_key(engine)
    finally:
        engine.dispose()


def bind(host: str, port: int, guarded: object = False) -> socket.socket:
    """A listening socket. BadInput for a port in use, and for an address beyond loopback unless
    requests are `guarded` (a bool, or a function that is asked only then)."""
    name = "127.0.0.1" if host == "localhost" else host.strip("[]")
    try:
        address = ipaddress.ip_address(name)
    except ValueError:
        address = None
    if address is None or not (
        address.is_loopback or (guarded() if callable(guarded) else guarded)
    ):
        allowed = (
            "a loopback address (127.0.0.1 or ::1); any other only once requests need a key "
            "(`nightglass keys create --team NAME`) or a token (NIGHTGLASS_OIDC_ISSUER)"
        )
        raise BadInput("--host", host, allowed)
    if not 0 <= port <= 65535:
        raise BadInput("--port", port, "0 (any free port) to 65535")
    family = socket.AF_INET6 if address.version == 6 else socket.AF_INET
    # asyncio sets TCP_NODELAY only where the protocol is named; without it an answer takes 40 ms
    listener = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((name, port))
        listener.listen(LISTEN)
    except OSError as error:
        listener.close()
        raise BadInput("--port", port, f"a free port; {error.strerror}") from None
    return listener
