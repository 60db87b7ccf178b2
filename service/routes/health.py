"""Health for machines: alive, ready, and a few numbers for Prometheus."""

from __future__ import annotations

import shutil
import time

from fastapi import APIRouter
from fastapi.responses import JSONResponse, PlainTextResponse, Response

from service.context import Service

router = APIRouter(tags=["health"])


@router.get("/healthz")
async def alive() -> Response:
    """200 while the process answers."""
    return JSONResponse({"status": "ok"})


@router.get("/readyz")
def ready(service: Service) -> Response:
    """200 where jobs can be taken and run, else 503 with what is wrong."""
    faults = []
    try:
        service.store.counts()
    except Exception:
        faults.append("the job table cannot be read")
    if not service.dispatcher.alive:
        faults.append("the dispatcher has stopped")
    if shutil.disk_usage(service.settings.home).free < service.settings.free_bytes:
        faults.append("the disk is nearly full")
    return JSONResponse({"ready": not faults, "faults": faults}, 503 if faults else 200)


@router.get("/metrics")
def metrics(service: Service) -> Response:
    """Prometheus text."""
    lines = ["# TYPE nightglass_jobs gauge"]
    for phase, count in service.store.counts().items():
        lines.append(f'nightglass_jobs{{phase="{phase.value}"}} {count}')
    lines.append("# TYPE nightglass_answers_total counter")
    for status, count in sorted(service.answers.items()):
        lines.append(f'nightglass_answers_total{{status="{status}"}} {count}')
    free = shutil.disk_usage(service.settings.home).free
    for name, value in (
        ("nightglass_leads", int(service.dispatcher.leads)),
        ("nightglass_disk_free_bytes", free),
        ("nightglass_uptime_seconds", round(time.time() - service.started_s, 3)),
    ):
        lines += [f"# TYPE {name} gauge", f"{name} {value}"]
    media_type = "text/plain; version=0.0.4; charset=utf-8"
    return PlainTextResponse("\n".join(lines) + "\n", media_type=media_type)
