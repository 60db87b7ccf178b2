"""The command line's `nightglass worker`: work for a scheduler until it goes away."""

from __future__ import annotations

import asyncio
import math
from pathlib import Path
from typing import Annotated

import typer

from catalog_tools.engine.addresses import check_address
from catalog_tools.engine.clusters import set_up_dask, work
from pipeline.errors import BadInput


def worker(
    address: Annotated[str, typer.Argument(help="tls://HOST:PORT", metavar="SCHEDULER")],
    threads: Annotated[int, typer.Option(min=1, help="tasks at once")] = 1,
    memory: Annotated[str, typer.Option(help="most memory, such as 2GiB")] = "auto",
    folder: Annotated[
        Path | None, typer.Option(help="folder for what does not fit into memory")
    ] = None,
    port: Annotated[int, typer.Option(help="its own port; 0: any")] = 0,
    nanny_port: Annotated[int, typer.Option(help="of the process that watches it")] = 0,
    patience: Annotated[float, typer.Option(help="seconds to wait for the scheduler")] = 60.0,
) -> None:
    """Draw for a scheduler, with the certificates of the environment. Exit 4 when it goes away."""
    check_address(address)
    set_up_dask()
    if not 0.0 <= patience < math.inf:
        raise BadInput("--patience", patience, "seconds, 0 or more")
    if memory != "auto":
        _check_memory(memory)
    asyncio.run(
        work(
            address,
            patience,
            nthreads=threads,
            memory_limit=memory,
            port=nanny_port,
            worker_port=port,
            local_directory=folder and str(folder),
        )
    )


def _check_memory(memory: str) -> None:
    """Refuse what Dask does not take for bytes, or for a fraction of the machine's."""
    from dask.utils import parse_bytes

    try:
        if parse_bytes(memory) < 0:
            raise ValueError(memory)
    except (ValueError, OverflowError):
        raise BadInput("--memory", memory, "such as 2GiB, or auto") from None
