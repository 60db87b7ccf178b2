"""Schedulers of this machine alone listen to this machine alone."""

from __future__ import annotations

import psutil

from catalog_tools.engine.schedulers import open_scheduler


def test_processes_listen_on_loopback_alone() -> None:
    """Scheduler, workers and the dashboard, which shows tasks, paths and logs."""
    with open_scheduler("processes", 1) as scheduler:
        told = scheduler.client.scheduler_info()
        here = psutil.Process()
        sockets = [c for p in (here, *here.children(True)) for c in p.net_connections("inet")]
        heard = {c.laddr.ip for c in sockets if c.status == psutil.CONN_LISTEN}
    assert heard == {"127.0.0.1"}
    addresses = [told["address"], *told["workers"]]
    assert all(address.startswith("tcp://127.0.0.1:") for address in addresses)
