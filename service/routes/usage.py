"""What the caller's team uses, and what it may use."""

from __future__ import annotations

import time

from fastapi import APIRouter
from fastapi.responses import JSONResponse, Response

from service.context import Service
from service.jobs.jobs import Phase
from service.jobs.quotas import DAY_S, used_by
from service.scenes.uploads import bytes_kept

router = APIRouter(prefix="/v1/usage", tags=["usage"])


@router.get("")
def show(service: Service) -> Response:
    """Jobs by phase, pixels x frames asked for today (UTC), bytes kept; each with its quota."""
    settings, team = service.settings, service.caller.team
    with service.table.engine.connect() as db:
        used = used_by(db, team, int(time.time() // DAY_S))
    counts = service.store.counts()
    amounts = {
        "queued_jobs": (used.waiting, settings.queued_jobs),
        "running_jobs": (counts[Phase.EXECUTING], settings.running_jobs),
        "pixel_frames_today": (used.pixel_frames, settings.pixel_frames_day),
        "bytes_kept": (bytes_kept(service.table.engine, team), settings.bytes_kept),
    }
    return JSONResponse(
        {
            "team": team,
            "jobs": {phase.value: count for phase, count in counts.items()},
            "quotas": {
                name: {"used": used, "limit": most} for name, (used, most) in amounts.items()
            },
            "limits": {
                "body_bytes": settings.body_bytes,
                "upload_bytes": settings.upload_bytes,
                "pixel_frames": settings.pixel_frames,
                "targets": settings.targets,
                "sweep_points": settings.sweep_points,
            },
        }
    )
