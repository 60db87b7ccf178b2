"""IVOA UWS 1.1 over the same jobs: parameter SCENE, phases, waits, results; pyvo's client works."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Mapping
from datetime import UTC, datetime
from urllib.parse import parse_qsl

from fastapi import APIRouter, Request
from fastapi.responses import PlainTextResponse, RedirectResponse, Response
from starlette.concurrency import run_in_threadpool

from catalog_tools.documents import JsonObject
from pipeline.errors import BadInput
from pipeline.store import layout
from service.context import Context, Service
from service.http.bodies import JSON, YAML, digest_of, parse_text, read_body
from service.http.gate import allow_time
from service.jobs.jobs import FINAL, Job, Phase
from service.problems import Malformed, NotReady, NotThere
from service.products import frames
from service.products.files import list_files
from service.routes.results import _product as complete_product
from service.scenes.scenes import accept_scene
from service.standards import uws_xml

router = APIRouter(prefix="/uws/async", tags=["uws"])
FORM = "application/x-www-form-urlencoded"
FORM_BODY = {
    "requestBody": {
        "required": True,
        "description": "Parameters of UWS; SCENE is a scene as JSON or YAML text.",
        "content": {FORM: {"schema": {"type": "object"}}},
    }
}
SCENE_NAMES = ("SCENE", "QUERY")  # QUERY: what clients of TAP send
MEANT_FOR_TAP = frozenset({"REQUEST", "LANG", "MAXREC", "FORMAT", "RESPONSEFORMAT", "VERSION"})
KNOWN = frozenset({*SCENE_NAMES, "PHASE", "RUNID", "EXECUTIONDURATION", "DESTRUCTION"})
MOST_LISTED = 10_000
MOST_LINKS = 2000
Fields = dict[str, str]


@router.get("")
def listing(request: Request, service: Service) -> Response:
    """The jobs of the team; PHASE (any number), AFTER (a time) and LAST (a count) choose."""
    asked = [(key.upper(), value) for key, value in request.query_params.multi_items()]
    phases = {_phase(value) for key, value in asked if key == "PHASE"}
    after = max((_time(value, "AFTER") for key, value in asked if key == "AFTER"), default=0.0)
    counts = [_count(value, "LAST") for key, value in asked if key == "LAST"]
    last = min(MOST_LISTED, *counts) if counts else MOST_LISTED
    found = service.store.newest(last, phases, after)
    return _xml(uws_xml.jobs_xml(reversed(found), _base(request)))


@router.post("", status_code=303, openapi_extra=FORM_BODY)
async def create(request: Request, service: Service) -> Response:
    """Make a job that is PENDING, or with PHASE=RUN one that is queued."""
    given = await _fields(request, service)
    unknown = sorted(set(given) - KNOWN - MEANT_FOR_TAP)
    if unknown:
        raise BadInput(f"?{unknown[0]}", given[unknown[0]], ", ".join(sorted(KNOWN)))
    scene = await run_in_threadpool(_scene, service, given)
    if scene is None:
        raise BadInput("?SCENE", None, "a scene as JSON or YAML text")
    await service.looks.judge(request, service.caller.team, scene)
    phase = Phase.QUEUED if _runs(given) else Phase.PENDING
    digest = digest_of(scene)
    ask = service.store.ask(scene["name"], scene, digest, None, phase=phase, **_amends(given))
    job, _ = await service.intake.put(ask)
    service.dispatcher.wake()
    return _to(request, job.id)


@router.get("/{job_id}")
async def one(request: Request, service: Service, job_id: str) -> Response:
    """A job. With WAIT (seconds, -1 for as long as allowed) answers when its phase changes."""
    asked = {key.upper(): value for key, value in request.query_params.items()}
    job = await run_in_threadpool(service.store.get, job_id)
    if "WAIT" in asked:
        phase = _phase(asked["PHASE"]) if "PHASE" in asked else job.phase
        job = await _wait(request, service, job, phase, _wait_s(asked["WAIT"], service))
    return _xml(await run_in_threadpool(_job_xml, request, service, job))


@router.post("/{job_id}", status_code=303, openapi_extra=FORM_BODY)
async def act(request: Request, service: Service, job_id: str) -> Response:
    """ACTION=DELETE, for clients that cannot send DELETE; or parameters of a PENDING job."""
    await run_in_threadpool(service.store.get, job_id)
    given = await _fields(request, service)
    if given.get("ACTION", "").upper() == "DELETE":
        return await run_in_threadpool(delete, request, service, job_id)
    return await _change(request, service, job_id, given)


@router.delete("/{job_id}", status_code=303)
def delete(request: Request, service: Service, job_id: str) -> Response:
    """Stop a job and remove it with all that it made."""
    service.store.delete(job_id)
    service.dispatcher.wake()
    return RedirectResponse(_base(request), 303)


@router.get("/{job_id}/{part}")
def read(request: Request, service: Service, job_id: str, part: str) -> Response:
    """One part of a job: its phase, times, owner, error as text; parameters, results as XML."""
    job = service.store.get(job_id)
    here, base = f"{_base(request)}/{job_id}", str(request.base_url).rstrip("/")
    if part == "parameters":
        return _xml(uws_xml.parameters_xml(service.store.scene(job_id)))
    if part == "results":
        return _xml(uws_xml.results_xml(uws_xml.result_names(job, here, base)))
    texts = {
        "phase": job.phase.value,
        "executionduration": str(round(job.duration_s or 0)),
        "destruction": uws_xml.stamp(job.destruction_s) or "",
        "quote": "",
        "owner": job.owner,
        "error": _error_text(job),
    }
    if part not in texts:
        raise NotThere(f"a job has {', '.join([*texts, 'parameters', 'results'])}")
    return PlainTextResponse(texts[part])


@router.post("/{job_id}/{part}", status_code=303, openapi_extra=FORM_BODY)
async def write(request: Request, service: Service, job_id: str, part: str) -> Response:
    """Change a part: phase (RUN, ABORT), executionduration, destruction, parameters."""
    await run_in_threadpool(service.store.get, job_id)
    given = await _fields(request, service)
    if part == "phase":
        return await run_in_threadpool(_move, request, service, job_id, given)
    if part not in ("parameters", "executionduration", "destruction"):
        raise NotThere("phase, parameters, executionduration and destruction can be changed")
    return await _change(request, service, job_id, given)


@router.get("/{job_id}/results/{name}")
def result(request: Request, service: Service, job_id: str, name: str) -> Response:
    """`result`: a DataLink table of the product's files; other names lead to where they are."""
    product = complete_product(service, job_id)
    job, base = service.store.get(job_id), str(request.base_url).rstrip("/")
    places = {n: at for n, at, _ in uws_xml.result_names(job, f"{_base(request)}/{job_id}", base)}
    if name not in places:
        raise NotThere(f"the results are {', '.join(places)}")
    if name != "result":
        return RedirectResponse(places[name], 303)
    here = f"{base}/v1/jobs/{job_id}"
    links: list[JsonObject] = [
        _link(job_id, f"{here}/product.tar", "#this", "the whole product", "application/x-tar"),
        _link(
            job_id,
            f"{here}/results/cube.zarr",
            "#this",
            "the cube, Zarr v3",
            "application/vnd.zarr",
        ),
        _link(job_id, f"{here}/preview.png", "#preview", "the first frame", "image/png"),
    ]
    for path, size in list_files(product):
        if not path.startswith((f"{layout.CUBE}/", f"{layout.MARKERS}/", "preview.png")):
            kind = "application/json" if path.endswith(".json") else "application/octet-stream"
            made = _link(job_id, f"{here}/results/{path}", "#auxiliary", path, kind)
            links.append(made | {"content_length": size})
    count = min(frames.describe(product)["frames"], MOST_LINKS)
    for k in range(count):
        address, told = f"{here}/frames/{k}/fits", f"frame {k} as FITS, with WCS"
        links.append(_link(job_id, address, "#derivation", told, "application/fits"))
    kind = "application/x-votable+xml;content=datalink"
    return Response(uws_xml.links_votable(links), media_type=kind)


def _link(job_id: str, address: str, semantics: str, description: str, kind: str) -> JsonObject:
    return {
        "ID": job_id,
        "access_url": address,
        "semantics": semantics,
        "description": description,
        "content_type": kind,
    }


async def _fields(request: Request, service: Context) -> Fields:
    """The fields of a form, names in capitals; each once. An empty body has none."""
    if request.headers.get("content-length") == "0":
        return {}
    settings = service.settings
    body = await read_body(request, settings.body_bytes, settings.body_s, (FORM,))
    try:
        text = body.decode("utf-8")
        pairs = parse_qsl(
            text,
            keep_blank_values=True,
            strict_parsing=bool(text),
            errors="strict",
            max_num_fields=100,
        )
    except ValueError:
        raise Malformed("the body is not a form in UTF-8") from None
    found = {key.upper(): value for key, value in pairs}
    if len(found) != len(pairs):
        raise Malformed("a field of the form is given twice")
    return found


def _scene(service: Context, given: Mapping[str, str]) -> JsonObject | None:
    """The scene of a form, judged; None where it has none."""
    text = next((given[name] for name in SCENE_NAMES if given.get(name, "").strip()), None)
    if text is None:
        return None
    kind = JSON if text.lstrip()[:1] == "{" else YAML
    data = parse_text(text.encode("utf-8", "surrogatepass"), kind)
    return accept_scene(data, service.settings, service.has_file).as_dict()


def _amends(given: Mapping[str, str]) -> JsonObject:
    """RUNID, EXECUTIONDURATION (0: no limit), DESTRUCTION, as the job table has them."""
    values: dict[str, object] = {}
    if "RUNID" in given:
        if len(given["RUNID"]) > 128 or not given["RUNID"].isprintable():
            raise BadInput("?RUNID", given["RUNID"], "up to 128 printable characters")
        values["run_id"] = given["RUNID"] or None
    if "EXECUTIONDURATION" in given:
        asked = _count(given["EXECUTIONDURATION"], "EXECUTIONDURATION", 0)
        values["duration_s"] = float(asked) or None
    if "DESTRUCTION" in given:
        values["destruction_s"] = _time(given["DESTRUCTION"], "DESTRUCTION")
    return values


async def _change(request: Request, service: Context, job_id: str, given: Fields) -> Response:
    """Change what a form names, then go back to the job."""
    values = _amends(given)
    scene = await run_in_threadpool(_scene, service, given)
    if scene is not None:
        await service.looks.judge(request, service.caller.team, scene)
        values |= {"scene": scene, "name": scene["name"]}
    if not values:
        raise BadInput("?SCENE", None, ", ".join(sorted(KNOWN - {"PHASE", "QUERY"})))
    await run_in_threadpool(service.store.amend, job_id, **values)
    return _to(request, job_id)


def _runs(given: Mapping[str, str]) -> bool:
    phase = given.get("PHASE", "")
    if phase.upper() not in ("", "RUN"):
        raise BadInput("?PHASE", phase, "RUN, or nothing for a job that waits to be run")
    return phase.upper() == "RUN"


def _move(request: Request, service: Context, job_id: str, given: Fields) -> Response:
    phase = given.get("PHASE", "").upper()
    if phase == "RUN":
        job = service.store.get(job_id)
        if job.phase in FINAL:
            raise NotReady(f"the job is {job.phase}: it cannot be run again")
        if job.phase == Phase.PENDING:
            service.store.run(job_id)
    elif phase == "ABORT":
        service.store.cancel(job_id)
    else:
        raise BadInput("?PHASE", given.get("PHASE"), "RUN or ABORT")
    service.dispatcher.wake()
    return _to(request, job_id)


async def _wait(request: Request, service: Context, job: Job, phase: Phase, wait_s: float) -> Job:
    """The job when its phase is another than this one, it has ended, or time is up."""
    allow_time(request, wait_s + service.settings.answer_s)
    deadline = time.monotonic() + wait_s
    while job.phase == phase and job.phase not in FINAL and job.phase != Phase.PENDING:
        left = deadline - time.monotonic()
        if left <= 0:
            break
        with service.changes.places.taken(service.caller.team):
            await service.change(job, left)
        job = await run_in_threadpool(service.store.get, job.id)
        await asyncio.sleep(0)
    return job


def _wait_s(text: str, service: Context) -> float:
    try:
        asked = int(text)
    except ValueError:
        asked = -2
    if asked < -1:
        raise BadInput("?WAIT", text, "whole seconds, or -1")
    most = service.settings.wait_s
    return most if asked == -1 else float(min(asked, most))


def _job_xml(request: Request, service: Context, job: Job) -> bytes:
    here, base = f"{_base(request)}/{job.id}", str(request.base_url).rstrip("/")
    results = uws_xml.result_names(job, here, base)
    return uws_xml.job_xml(job, service.store.scene(job.id), results)


def _error_text(job: Job) -> str:
    if job.error is None:
        return ""
    listed = [f"{e['pointer']}: {e['value']}; {e['allowed']}" for e in job.error["errors"]]
    return "\n".join([job.error["message"], *listed])


def _base(request: Request) -> str:
    return f"{str(request.base_url).rstrip('/')}{router.prefix}"


def _to(request: Request, job_id: str) -> Response:
    return RedirectResponse(f"{_base(request)}/{job_id}", 303)


def _xml(content: bytes) -> Response:
    return Response(content, media_type="text/xml; charset=utf-8")


def _phase(text: str) -> Phase:
    if text.upper() not in Phase.__members__:
        raise BadInput("?PHASE", text, ", ".join(Phase.__members__))
    return Phase(text.upper())


def _count(text: str, name: str, least: int = 1) -> int:
    value = int(text) if text.isascii() and text.isdigit() and len(text) < 10 else -1
    if value < least:
        raise BadInput(f"?{name}", text, f"a whole number from {least}")
    return value


def _time(text: str, name: str) -> float:
    """Unix seconds of a time that can be told again."""
    try:
        value = datetime.fromisoformat(text.strip())
        seconds = (value if value.tzinfo else value.replace(tzinfo=UTC)).timestamp()
        uws_xml.stamp(seconds)
        return seconds
    except (ValueError, OverflowError):
        raise BadInput(f"?{name}", text, "a time in UTC like 2026-01-31T12:00:00Z") from None
