"""Studies of capacity: submitted here, watched and fetched like any other job."""

from __future__ import annotations

from fastapi import APIRouter, Request
from fastapi.responses import JSONResponse, Response
from starlette.concurrency import run_in_threadpool

from pipeline.errors import NightglassError
from service.context import Service
from service.http.bodies import TEXTS, digest_of, media_type, parse_text, read_body
from service.routes.jobs import DryRun, IdempotencyKey, check_key, json_body, made_before, taken
from service.scenes.studies import accept_study

router = APIRouter(prefix="/v1/studies", tags=["studies"])
STUDY_BODY = json_body("A study: cameras, sensors, a catalogue, a period, tasking.", TEXTS)


@router.post("", status_code=202, openapi_extra=STUDY_BODY)
async def submit(
    request: Request, service: Service, dry_run: DryRun = False, key: IdempotencyKey = None
) -> Response:
    """Queue a study: 202 and where its job is; 200 for a key that was used with this body. With
    `dry_run` what it takes."""
    check_key(key)
    settings = service.settings
    body = await read_body(request, settings.body_bytes, settings.body_s, TEXTS)
    kind = media_type(request)
    data = await run_in_threadpool(parse_text, body, kind)
    try:
        study = await run_in_threadpool(accept_study, data, settings, service.has_file)
        if dry_run:
            return JSONResponse(await service.looks.forecast(request, service.caller.team, study))
        await service.looks.judge(request, service.caller.team, study, service.looks.of_study)
    except NightglassError as error:
        return await made_before(service, None if dry_run else key, body, kind, error)
    digest = digest_of(data)
    ask = service.store.ask(study["name"], study, digest, key, kind="study")
    return taken(service, *await service.intake.put(ask))
