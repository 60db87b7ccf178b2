"""Sweeps: submitted here, watched and fetched like any other job."""

from __future__ import annotations

from fastapi import APIRouter, Request
from fastapi.responses import JSONResponse, Response
from starlette.concurrency import run_in_threadpool

from pipeline.errors import NightglassError
from service.accounts.teams import pixel_frames_of
from service.context import Service
from service.http.bodies import TEXTS, digest_of, media_type, parse_text, read_body
from service.problems import within
from service.routes.jobs import (
    DryRun,
    IdempotencyKey,
    check_key,
    json_body,
    made_before,
    taken,
    with_time,
)
from service.scenes.sweeps import accept_sweep

router = APIRouter(prefix="/v1/sweeps", tags=["sweeps"])
SWEEP_BODY = json_body("A sweep: a base scene and axes over its keys.", TEXTS)


@router.post("", status_code=202, openapi_extra=SWEEP_BODY)
async def submit(
    request: Request, service: Service, dry_run: DryRun = False, key: IdempotencyKey = None
) -> Response:
    """Queue a sweep: 202 and where its job is; 200 for a key that was used with this body. With
    `dry_run` its size, and the plan of its base scene."""
    check_key(key)
    body = await read_body(request, service.settings.body_bytes, service.settings.body_s, TEXTS)
    kind = media_type(request)
    data = await run_in_threadpool(parse_text, body, kind)
    try:
        sweep, pixel_frames = await run_in_threadpool(
            accept_sweep, data, service.settings, service.has_file
        )
        axes = {k: v for k, v in sweep.items() if k != "scene"}
        asked = {"do": "judge_sweep", "sweep": axes}
        await service.looks.judge(request, service.caller.team, sweep["scene"], asked)
        if dry_run:
            with within("scene"):
                plan = await service.looks.plan(request, service.caller.team, sweep["scene"])
            points = pixel_frames // pixel_frames_of(sweep["scene"])
            size = {"points": points, "pixel_frames": pixel_frames}
            return JSONResponse(size | {"base": with_time(plan)})
    except NightglassError as error:
        return await made_before(service, None if dry_run else key, body, kind, error)
    digest = digest_of(data)
    name = str(data.get("name", "sweep"))[:128]
    ask = service.store.ask(name, sweep, digest, key, kind="sweep", pixel_frames=pixel_frames)
    return taken(service, *await service.intake.put(ask))
