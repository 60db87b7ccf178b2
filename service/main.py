"""Start the service: check where it would listen, bind, run."""

from __future__ import annotations

import ipaddress
import logging
import os
import socket
import sys
from pathlib import Path

from pipeline.errors import BadInput

LISTEN = 2048
STOP_S = 3  # how long answers in flight may take to end


def serve(host: str = "127.0.0.1", port: int = 8765, home: Path | None = None) -> None:
    """Serve the REST interface until interrupted. BadInput for an address it may not take.

    There is no authentication in this version: only loopback is served. Port 0 takes a free one.
    """
    os.environ.setdefault("MALLOC_TRIM_THRESHOLD_", "65536")  # for the workers
    listener = bind(host, port)
    with listener:
        import uvicorn

        from service.app import create_app
        from service.settings import read_settings

        settings = read_settings(home)
        settings.make_folders()
        logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s %(message)s")
        config = uvicorn.Config(
            create_app(settings), log_config=None, access_log=False, server_header=False,
            backlog=LISTEN, timeout_graceful_shutdown=STOP_S, ws="none",
        )  # fmt: skip
        where, at = listener.getsockname()[:2]
        shown = f"[{where}]" if ":" in where else where
        print(f"Nightglass serves http://{shown}:{at} from {settings.home}", file=sys.stderr)
        sys.stderr.flush()
        uvicorn.Server(config).run(sockets=[listener])


def bind(host: str, port: int) -> socket.socket:
    """A listening socket on loopback. BadInput for any other address or a port in use."""
    name = "127.0.0.1" if host == "localhost" else host.strip("[]")
    try:
        address = ipaddress.ip_address(name)
    except ValueError:
        address = None
    if address is None or not address.is_loopback:
        allowed = (
            "a loopback address (127.0.0.1 or ::1): without API keys, which this version has not, "
            "anybody who reaches the service may use it; put a proxy that authenticates before it"
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
