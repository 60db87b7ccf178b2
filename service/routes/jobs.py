"""Jobs: submit, plan only, list, watch, cancel, delete."""

from __future__ import annotations

import json
import re
from collections.abc import AsyncIterator
from typing import Annotated
from urllib.parse import urlencode

from fastapi import APIRouter, Header, Query, Request
from fastapi.responses import JSONResponse, Response, StreamingResponse
from pydantic_core import to_json
from starlette.concurrency import run_in_threadpool
from starlette.types import Receive, Scope, Send

from catalog_tools.documents import JsonObject
from pipeline.errors import NightglassError
from service.context import Context, Service
from service.http.bodies import JSON, TEXTS, digest_of, media_type, parse_text, read_body
from service.http.gate import allow_time
from service.jobs.jobs import FINAL, Job, Phase
from service.jobs.views import etag, job_dict
from service.problems import Malformed, NoProvider, NotThere, TooMany, Unauthenticated
from service.products.files import is_known

router = APIRouter(prefix="/v1/jobs", tags=["jobs"])
KEY = re.compile(r"[\x21-\x7e]{1,255}")
DryRun = Annotated[bool, Query(description="answer the plan, or the forecast; make no job")]
IdempotencyKey = Annotated[str | None, Header(alias="idempotency-key")]


def json_body(description: str, kinds: tuple[str, ...] = (JSON,)) -> JsonObject:
    """What OpenAPI says of a body that the route reads by itself, JSON or (`kinds`) YAML, too."""
    content = {kind: {"schema": {"type": "object"}} for kind in kinds}
    return {"requestBody": {"required": True, "description": description, "content": content}}


SCENE_BODY = json_body("A scene. Its JSON Schema is at /v1/schema/scene.", TEXTS)


def with_time(plan: JsonObject) -> JsonObject:
    """A plan with its predicted CPU seconds first, where a client looks."""
    return {"estimated_cpu_s": plan["predicted"]["cpu_s"]} | plan


@router.post("", status_code=202, openapi_extra=SCENE_BODY)
async def submit(
    request: Request, service: Service, dry_run: DryRun = False, key: IdempotencyKey = None
) -> Response:
    """Queue a scene: 202 and where the job is; 200 for a key that was used with this body."""
    settings = service.settings
    check_key(key)
    body = await read_body(request, settings.body_bytes, settings.body_s, TEXTS)
    kind = media_type(request)
    try:
        found = await service.scenes.read(service.caller.team, body, service.has_file, kind)
        if dry_run:
            plan = await service.looks.plan(request, service.caller.team, found.scene())
            return JSONResponse(with_time(plan))
        if found.named:
            await service.looks.judge(request, service.caller.team, found.scene())
    except NightglassError as error:
        return await made_before(service, None if dry_run else key, body, kind, error)
    ask = service.store.ask(
        found.name,
        found.text,
        found.body_sha256,
        key,
        pixel_frames=found.pixel_frames,
    )
    return taken(service, *await service.intake.put(ask), found.least_cpu_s)


def check_key(key: str | None) -> None:
    """Malformed for an Idempotency-Key that cannot be one."""
    if key is not None and not KEY.fullmatch(key):
        raise Malformed("an Idempotency-Key is 1 to 255 visible ASCII characters")


async def made_before(
    service: Context, key: str | None, body: bytes, kind: str, refusal: NightglassError
) -> Response:
    """The job that a key made of a body that is refused now: what it names may have gone since. The
    refusal where it made none."""
    if key is not None:
        data = await run_in_threadpool(parse_text, body, kind)
        job = await run_in_threadpool(service.store.known, key, digest_of(data))
        if job is not None:
            return taken(service, job, False)
    raise refusal


def taken(service: Context, job: Job, made: bool, least_cpu_s: float | None = None) -> Response:
    """The answer to a submission that is on disk, with what a scene is forecast to take."""
    headers = {"Location": f"/v1/jobs/{job.id}", "ETag": etag(job)}
    if made:
        headers["Retry-After"] = "1"
        service.dispatcher.wake()
    told = {} if least_cpu_s is None else {"least_cpu_s": round(least_cpu_s, 1)}
    body = to_json(job_dict(job) | told)
    return Response(body, 202 if made else 200, headers, "application/json")


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
        query: list[tuple[str, str | int]] = [("phase", p.value) for p in phase or ()]
        query += [("after", shown[-1].number), ("limit", limit)]
        headers["Link"] = f'</v1/jobs?{urlencode(query)}>; rel="next"'
    return JSONResponse({"jobs": [job_dict(job) for job in shown]}, headers=headers)


@router.get("/{job_id}")
async def watch(
    request: Request,
    service: Service,
    job_id: str,
    wait: Annotated[float, Query(ge=0, le=3600, description="seconds")] = 0.0,
    if_none_match: Annotated[str | None, Header()] = None,
) -> Response:
    """A job. With `wait`, answers when it differs from the ETag given (else from now), or ends."""
    job = await run_in_threadpool(service.store.get, job_id)
    wait_s = min(wait, service.settings.wait_s)
    unchanged = if_none_match is None or is_known(if_none_match, etag(job))
    if wait_s and unchanged and job.phase not in FINAL:
        allow_time(request, wait_s + service.settings.answer_s)
        with service.changes.places.taken(service.caller.team):
            await service.change(job, wait_s)
        job = await run_in_threadpool(service.store.get, job_id)
    headers = {"ETag": etag(job)}
    if job.phase not in FINAL:
        headers["Retry-After"] = "1"
    if is_known(if_none_match, etag(job)):
        return Response(status_code=304, headers=headers)
    return JSONResponse(job_dict(job, service.settings.dashboard), headers=headers)


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


@router.post("/{job_id}/retry", status_code=202)
def retry(service: Service, job_id: str) -> Response:
    """Queue a job again that ended as ERROR through no fault of its scene; it goes on from the
    tiles that are drawn. 409 for any other job."""
    job = service.store.retry(job_id)
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
    """Server-sent events: the job at every change (id: its version), until it or the key ends."""
    job = await run_in_threadpool(service.store.get, job_id)
    return Watch(service, _events(service, job, last_event_id))


class Watch(StreamingResponse):
    """A stream of events. It holds a watcher's place from before its head is sent, so that a
    refusal is a 429, until it has ended, however it does."""

    def __init__(self, service: Context, events: AsyncIterator[str]) -> None:
        headers = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
        super().__init__(events, media_type="text/event-stream", headers=headers)
        self._places, self._team = service.changes.places, service.caller.team
        self._places.take(self._team)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        try:
            await super().__call__(scope, receive, send)
        finally:
            self._places.give(self._team)


async def _events(service: Context, job: Job, last_event_id: str | None) -> AsyncIterator[str]:
    sent = last_event_id or ""
    yield "retry: 1000\n\n"
    while True:
        if str(job.version) != sent:
            sent = str(job.version)
            yield f"id: {sent}\nevent: job\ndata: {json.dumps(job_dict(job))}\n\n"
        if job.phase in FINAL:
            return
        try:
            await service.change(job, service.settings.heartbeat_s)
            job = await run_in_threadpool(service.store.get, job.id)
        except NotThere:
            yield "event: deleted\ndata: {}\n\n"
            return
        except (Unauthenticated, NoProvider, TooMany):
            return
        if str(job.version) == sent:
            yield ": heartbeat\n\n"
