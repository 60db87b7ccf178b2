"""The command line's `nightglass serve` and `keys`, which the service makes: found by name."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Annotated

import typer

keys = import_module("service.accounts.commands").app


def serve(
    host: Annotated[str, typer.Option(help="address to listen on")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="0: any free one")] = 8765,
    home: Annotated[
        Path | None,
        typer.Option(help="folder of jobs, products, catalogues; default: NIGHTGLASS_HOME"),
    ] = None,
) -> None:
    """Serve the REST interface."""
    import_module("service.main").serve(host, port, home)
