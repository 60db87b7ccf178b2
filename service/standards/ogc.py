"""OGC API - Processes, part 1, over the same jobs: `render` (a job) and `plan` (at once)."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query, Request
from fastapi.responses import JSONResponse, Response
from starlette.concurrency import run_in_threadpool

from catalog_tools.documents import JsonObject
from pipeline.spec.json_schemas import json_schema
from pipeline.spec.scene import Scene
from service.context import Context, Service
from service.http.bodies import digest_of, parse_json, read_body
from service.jobs.jobs import FINAL, Job, Phase
from service.jobs.views import utc
from service.problems import NotAllowed, NotReady, NotThere
from service.scenes.scenes import accept_scene

router = APIRouter(prefix="/ogc", tags=["ogc"])
NAMES = "http://www.opengis.net/def/exceptions/ogcapi-processes-1/1.0"
CLASSES = ("core", "json", "job-list", "dismiss", "ogc-process-description")
CONFORMS = [
    "http://www.opengis.net/spec/ogcapi-common-1/1.0/conf/core",
    *(f"http://www.opengis.net/spec/ogcapi-processes-1/1.0/conf/{name}" for name in CLASSES),
]
STATUS = {
    Phase.PENDING: "accepted",
    Phase.QUEUED: "accepted",
    Phase.EXECUTING: "running",
    Phase.COMPLETED: "successful",
    Phase.ERROR: "failed",
    Phase.ABORTED: "dismissed",
}
OUTPUTS = {
    "product": ("the whole product", "product.tar", "application/x-tar"),
    "cube": ("the frames, Zarr v3", "results/cube.zarr", "application/vnd.zarr"),
    "report": ("achieved error, bounds, times", "report", "application/json"),
    "preview": ("the first frame", "preview.png", "image/png"),
}
EXECUTE_BODY = {
    "requestBody": {
        "required": True,
        "description": 'An OGC execute request: {"inputs": {"scene": {...}}}.',
        "content": {"application/json": {"schema": {"type": "object"}}},
    }
}


class NoSuchProcess(NotThere):
    """There is no such process."""

    type_uri = f"{NAMES}/no-such-process"


class NoSuchJob(NotThere):
    """There is no such job of the caller's team."""

    type_uri = f"{NAMES}/no-such-job"


class ResultNotReady(NotReady):
    """The job has no result (yet)."""

    type_uri = f"{NAMES}/result-not-ready"


@router.get("/", include_in_schema=False)
@router.get("")
async def landing(request: Request) -> Response:
    """Where everything is."""
    root, here = _root(request), f"{_root(request)}/ogc"
    rel = "http://www.opengis.net/def/rel/ogc/1.0"
    links = [
        _to(here, "self"),
        _to(f"{root}/openapi.json", "service-desc", "application/vnd.oai.openapi+json;version=3.1"),
        _to(f"{root}/", "service-doc", "text/html"),
        _to(f"{here}/conformance", f"{rel}/conformance"),
        _to(f"{here}/processes", f"{rel}/processes"),
        _to(f"{here}/jobs", f"{rel}/job-list"),
    ]
    told = "Raw sensor frames of space scenes with known truth."
    return JSONResponse({"title": "Nightglass", "description": told, "links": links})


@router.get("/conformance")
async def conformance() -> Response:
    """The conformance classes that are kept."""
    return JSONResponse({"conformsTo": CONFORMS})


@router.get("/processes")
async def processes(request: Request) -> Response:
    """Both processes."""
    listed = [_summary(request, name) for name in PROCESSES]
    return JSONResponse({"processes": listed, "links": [_to(_here(request), "self")]})


@router.get("/processes/{process}")
async def process(request: Request, process: str) -> Response:
    """A process with its input's JSON Schema (that of a scene) and its outputs."""
    about = _summary(request, process)
    schema = json_schema("scene")
    schema["$id"] = f"{_root(request)}/v1/schema/scene"  # references are taken from here
    scene = {
        "title": "scene",
        "description": "what is to be rendered; units stand in the keys",
        "minOccurs": 1,
        "maxOccurs": 1,
        "schema": schema,
    }
    return JSONResponse(about | {"inputs": {"scene": scene}, "outputs": PROCESSES[process][2]})


@router.post("/processes/{process}/execution", status_code=201, openapi_extra=EXECUTE_BODY)
async def execute(request: Request, service: Service, process: str) -> Response:
    """`render` always makes a job (201 and its status); `plan` answers at once."""
    _known(process)
    settings = service.settings
    body = await read_body(request, settings.body_bytes, settings.body_s)
    data, scene = await run_in_threadpool(_accept, service, body)
    if process == "plan":
        plan = await service.looks.plan(request, service.caller.team, scene.as_dict())
        return JSONResponse({"plan": plan})
    await service.looks.judge(request, service.caller.team, scene.as_dict())
    digest = digest_of(data)
    ask = service.store.ask(scene.name, scene.as_dict(), digest, None)
    job, _ = await service.intake.put(ask)
    service.dispatcher.wake()
    headers = {
        "Location": f"{_root(request)}/ogc/jobs/{job.id}",
        "Preference-Applied": "respond-async",
    }
    return JSONResponse(_status(request, job), 201, headers)


@router.get("/jobs")
def jobs(
    request: Request, service: Service, limit: Annotated[int, Query(ge=1, le=10_000)] = 1000
) -> Response:
    """The jobs of the team, newest first."""
    listed = [_status(request, job) for job in service.store.newest(limit)]
    return JSONResponse({"jobs": listed, "links": [_to(_here(request), "self")]})


@router.get("/jobs/{job_id}")
def job(request: Request, service: Service, job_id: str) -> Response:
    """How a job is."""
    return JSONResponse(_status(request, _job(service, job_id)))


@router.delete("/jobs/{job_id}")
def dismiss(request: Request, service: Service, job_id: str) -> Response:
    """Stop a job that has not ended; remove one that has, with all that it made."""
    found = _job(service, job_id)
    if found.phase in FINAL:
        service.store.delete(job_id)
    else:
        service.store.cancel(job_id)
    service.dispatcher.wake()
    told = _status(request, found)
    return JSONResponse(told | {"status": "dismissed", "message": "dismissed", "links": []})


@router.get("/jobs/{job_id}/results")
def results(request: Request, service: Service, job_id: str) -> Response:
    """Where the outputs of a job are."""
    found = _job(service, job_id)
    if found.phase == Phase.ERROR and found.error is not None:
        raise ResultNotReady(f"the job failed: {found.error['message']}")
    if found.phase != Phase.COMPLETED:
        raise ResultNotReady(f"the job is {STATUS[found.phase]}: it has no results")
    here = f"{_root(request)}/v1/jobs/{job_id}"
    return JSONResponse(
        {
            name: {"href": f"{here}/{path}", "type": kind, "title": title}
            for name, (title, path, kind) in OUTPUTS.items()
            if found.kind == "scene" or name == "report"  # of sweeps and studies no frames are kept
        }
    )


def _accept(service: Context, body: bytes) -> tuple[JsonObject, Scene]:
    """The scene of an execute request; its mistakes are named as in the scene itself."""
    data = parse_json(body)
    inputs = data.get("inputs") if isinstance(data, dict) else None
    if not isinstance(inputs, dict) or set(inputs) != {"scene"}:
        raise _refusal("inputs", inputs, '{"scene": {...}} alone')
    if "subscriber" in data:
        allowed = "no subscriber: this server calls nobody back"
        raise _refusal("subscriber", data["subscriber"], allowed)
    scene = inputs["scene"]
    if isinstance(scene, dict) and "href" in scene:
        allowed = "the scene itself: nothing is fetched for you"
        raise _refusal("inputs.scene.href", scene["href"], allowed)
    if isinstance(scene, dict) and set(scene) <= {"value", "mediaType", "schema", "encoding"}:
        scene = scene.get("value")
    return data, accept_scene(scene, service.settings, service.has_file)


def _refusal(field: str, value: object, allowed: str) -> NotAllowed:
    return NotAllowed(f"{field}: allowed: {allowed}", ((field, value, allowed),))


def _known(name: str) -> None:
    if name not in PROCESSES:
        raise NoSuchProcess(f"the processes are {' and '.join(PROCESSES)}")


def _summary(request: Request, name: str) -> JsonObject:
    _known(name)
    title, control, _ = PROCESSES[name]
    here = f"{_root(request)}/ogc/processes/{name}"
    execution = "http://www.opengis.net/def/rel/ogc/1.0/execute"
    return {
        "id": name,
        "version": request.app.version,
        "title": title,
        "jobControlOptions": control,
        "outputTransmission": ["reference" if name == "render" else "value"],
        "links": [_to(here, "self"), _to(f"{here}/execution", execution)],
    }


def _status(request: Request, job: Job) -> JsonObject:
    """A job as an OGC statusInfo."""
    here = f"{_root(request)}/ogc/jobs/{job.id}"
    links = [_to(here, "self")]
    if job.phase == Phase.COMPLETED:
        results = "http://www.opengis.net/def/rel/ogc/1.0/results"
        links.append(_to(f"{here}/results", results))
    told = {
        "processID": "render",
        "type": "process",
        "jobID": job.id,
        "status": STATUS[job.phase],
        "message": job.error["message"] if job.error else job.name,
        "created": utc(job.submitted_s),
        "started": utc(job.started_s),
        "finished": utc(job.ended_s),
        "links": links,
    }
    if job.tiles_total:
        told["progress"] = 100 * (job.tiles_done or 0) // job.tiles_total
    return {key: value for key, value in told.items() if value is not None}


def _job(service: Context, job_id: str) -> Job:
    try:
        return service.store.get(job_id)
    except NotThere as error:
        raise NoSuchJob(str(error)) from None


def _root(request: Request) -> str:
    return str(request.base_url).rstrip("/")


def _here(request: Request) -> str:
    return f"{_root(request)}{request.url.path}"


def _to(href: str, rel: str, kind: str = "application/json") -> dict[str, str]:
    return {"href": href, "rel": rel, "type": kind}


_REFERENCE = {"type": "string", "format": "uri"}
_PLAN = {"title": "size, cost, and each decision with its bound", "schema": {"type": "object"}}
PROCESSES: dict[str, tuple[str, list[str], JsonObject]] = {
    "render": (
        "Render a scene into raw frames with known truth",
        ["async-execute", "dismiss"],
        {
            name: {"title": title, "schema": _REFERENCE | {"contentMediaType": kind}}
            for name, (title, _, kind) in OUTPUTS.items()
        },
    ),
    "plan": ("Plan a scene: what it needs, and why", ["sync-execute"], {"plan": _PLAN}),
}
