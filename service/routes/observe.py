"""What a scene's sensor sees of its targets, at its exposures or other times; nothing is drawn."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query, Request
from fastapi.responses import JSONResponse, Response
from starlette.concurrency import run_in_threadpool

from service.context import Service
from service.http.bodies import TEXTS, media_type, parse_text, read_body
from service.routes.jobs import SCENE_BODY
from service.scenes.scenes import accept_scene

router = APIRouter(prefix="/v1/observe", tags=["jobs"])
RANGE = r"^[^,]{1,40},[^,]{1,40},[^,]{1,40}$"


@router.post("", openapi_extra=SCENE_BODY)
async def observe(
    request: Request,
    service: Service,
    times: Annotated[
        str | None,
        Query(pattern=RANGE, description="START,STOP,STEP: UTC, or seconds after the epoch"),
    ] = None,
    snr: Annotated[float, Query(gt=0, le=1e9, description="below which it is too faint")] = 5.0,
) -> Response:
    """Every target and member of a population: place, rates, light, SNR, and whether it is seen."""
    settings = service.settings
    body = await read_body(request, settings.body_bytes, settings.body_s, TEXTS)
    data = await run_in_threadpool(parse_text, body, media_type(request))
    scene = await run_in_threadpool(accept_scene, data, settings, service.has_file, False)
    asked = {"times": times, "snr": snr}
    team = service.caller.team
    return JSONResponse(await service.looks.observe(request, team, scene.as_dict(), asked))
