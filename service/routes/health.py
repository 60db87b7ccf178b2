"""Health for machines: alive, ready, and numbers for Prometheus. None of it needs a key."""

from __future__ import annotations

import shutil

from fastapi import APIRouter
from fastapi.responses import JSONResponse, Response
from prometheus_client import CONTENT_TYPE_LATEST, generate_latest

from service.context import Everyone

router = APIRouter(tags=["health"])


@router.get("/healthz")
async def alive() -> Response:
    """200 while the process answers."""
    return JSONResponse({"status": "ok"})


@router.get("/readyz")
def ready(service: Everyone) -> Response:
    """200 where jobs can be taken and run, else 503 with what is wrong."""
    faults = []
    try:
        service.table.counts()
    except Exception:
        faults.append("the job table cannot be read")
    if not service.dispatcher.alive:
        faults.append("the dispatcher has stopped")
    elif silent_s := service.dispatcher.leaderless_s:
        faults.append(f"nobody has run the jobs for {silent_s:.0f} s: the lease cannot be taken")
    if service.dispatcher.scheduler.fault():
        faults.append("the scheduler does not answer")
    if shutil.disk_usage(service.settings.home).free < service.settings.free_bytes:
        faults.append("the disk is nearly full")
    return JSONResponse({"ready": not faults, "faults": faults}, 503 if faults else 200)


@router.get("/metrics")
def metrics(service: Everyone) -> Response:
    """Prometheus text; no team, job, key or token is in it."""
    return Response(generate_latest(service.numbers.registry), media_type=CONTENT_TYPE_LATEST)
