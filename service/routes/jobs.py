"""Jobs: submit, plan only, list, watch, cancel, delete."""

from __future__ import annotations

import asyncio
import hashlib
import json
import re
import time
from collections.abc import AsyncIterator
from typing import Annotated, Any
from urllib.parse import urlencode

from fastapi import APIRouter, Header, Query, Request
from fastapi.responses import JSONResponse, Response, StreamingResponse
from starlette.concurrency import run_in_threadpool

from service.bodies import parse_json, read_body
from service.context import Context, Service
from service.jobs import FINAL, Job, Phase
from service.problems import Malformed, NotThere
from service.runner import plan_dry
from service.scenes import accept_scene
from service.views import etag, job_dict

router = APIRouter(prefix="/v1/jobs", tags=["jobs"])
KEY = re.compile(r"[\x21-\x7e]{1,255}")
BETWEEN_LOOKS_S = 0.2
SCENE_BODY = {
    "requestBody": {
        "required": True,
        "description": "A scene. Its JSON Schema is at /v1/schema/scene.",
        "content": {"application/json": {"schema": {"type": "object"}}},
    }
}


@router.post("", status_code=202, openapi_extra=SCENE_BODY)
async def submit(
    request: Request,
    service: Service,
    dry_run: Annotated[bool, Query(description="answer the plan; make no job")] = False,
    idempotency_key: Annotated[str | None, Header()] = None,
) -> Response:
    """Queue a scene: 202 and where the job is; 200 for a key that was used with this body."""
    settings = service.settings
    if idempotency_key is not None and not KEY.fullmatch(idempotency_key):
        raise Malformed("an Idempotency-Key is 1 to 255 visible ASCII characters")
    body = await read_body(request, settings.body_bytes, settings.body_s)
    if dry_run:
        return await _plan(service, body)
    job, made = await run_in_threadpool(_submit, service, body, idempotency_key)
    headers = {"Location": f"/v1/jobs/{job.id}", "ETag": etag(job)}
    if made:
        headers["Retry-After"] = "1"
        service.dispatcher.wake()
    return JSONResponse(job_dict(job), 202 if made else 200, headers)


async def _plan(service: Context, body: bytes) -> Response:
    scene = await run_in_threadpool(lambda: accept_scene(parse_json(body), service.settings))
    async with service.plans:
        return JSONResponse(
            await run_in_threadpool(plan_dry, scene, service.settings, service.dispatcher.stopping)
        )


def _submit(service: Context, body: bytes, key: str | None) -> tuple[Job, bool]:
    data = parse_json(body)
    scene = accept_scene(data, service.settings)
    digest = hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()
    limit = service.settings.queued_jobs
    return service.store.submit(scene.name, scene.as_dict(), digest, key, limit)


@router.get("")
def listing(
    service: Service,
    phase: Annotated[list[Phase] | None, Query()] = None,
    after: Annotated[int, Query(ge=0, lt=2**62, description="cursor")] = 0,
    limit: Annotated[int, Query(ge=1, le=1000)] = 100,
) -> Response:
    """Jobs in order of submission; the Link header leads to the next page."""
    found = service.store.listing(phase or (), after, limit + 1)
    shown, headers = found[:limit], {}
    if len(found) > limit:
        query: list[tuple[str, Any]] = [("phase", p.value) for p in phase or ()]
        query += [("after", shown[-1].number), ("limit", limit)]
        headers["Link"] = f'</v1/jobs?{urlencode(query)}>; rel="next"'
    return JSONResponse({"jobs": [job_dict(job) for job in shown]}, headers=headers)


@router.get("/{job_id}")
async def watch(
    service: Service,
    job_id: str,
    wait: Annotated[float, Query(ge=0, le=3600, description="seconds")] = 0.0,
    if_none_match: Annotated[str | None, Header()] = None,
) -> Response:
    """A job. With `wait`, answers when it differs from the ETag given (else from now), or ends."""
    job = await run_in_threadpool(service.store.get, job_id)
    known = if_none_match or etag(job)
    deadline = time.monotonic() + min(wait, service.settings.wait_s)
    while etag(job) == known and job.phase not in FINAL and time.monotonic() < deadline:
        await asyncio.sleep(BETWEEN_LOOKS_S)
        job = await run_in_threadpool(service.store.get, job_id)
    headers = {"ETag": etag(job)}
    if job.phase not in FINAL:
        headers["Retry-After"] = "1"
    if if_none_match == etag(job):
        return Response(status_code=304, headers=headers)
    return JSONResponse(job_dict(job), headers=headers)


@router.get("/{job_id}/scene")
def scene(service: Service, job_id: str) -> Response:
    """The scene of a job, defaults filled in."""
    return JSONResponse(service.store.scene(job_id))


@router.post("/{job_id}/cancel", status_code=202)
def cancel(service: Service, job_id: str) -> Response:
    """Stop a job; what it has drawn stays until the job is deleted. 409 once it has ended."""
    job = service.store.cancel(job_id)
    service.dispatcher.wake()
    return JSONResponse(job_dict(job), 202, {"ETag": etag(job)})


@router.delete("/{job_id}", status_code=204)
def delete(service: Service, job_id: str) -> Response:
    """Stop a job and remove it with all that it made."""
    service.store.delete(job_id)
    service.dispatcher.wake()
    return Response(status_code=204)


@router.get("/{job_id}/events")
async def events(
    service: Service, job_id: str, last_event_id: Annotated[str | None, Header()] = None
) -> Response:
    """Server-sent events: the job at every change (id: its version), until it has ended."""
    job = await run_in_threadpool(service.store.get, job_id)
    stream = _events(service, job, last_event_id)
    headers = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
    return StreamingResponse(stream, media_type="text/event-stream", headers=headers)


async def _events(service: Context, job: Job, last_event_id: str | None) -> AsyncIterator[str]:
    sent, spoke_s = last_event_id or "", time.monotonic()
    yield "retry: 1000\n\n"
    while True:
        if str(job.version) != sent:
            sent, spoke_s = str(job.version), time.monotonic()
            yield f"id: {sent}\nevent: job\ndata: {json.dumps(job_dict(job))}\n\n"
        if job.phase in FINAL:
            return
        if time.monotonic() - spoke_s > service.settings.heartbeat_s:
            spoke_s = time.monotonic()
            yield ": heartbeat\n\n"
        await asyncio.sleep(BETWEEN_LOOKS_S)
        try:
            job = await run_in_threadpool(service.store.get, job.id)
        except NotThere:
            yield "event: deleted\ndata: {}\n\n"
            return
