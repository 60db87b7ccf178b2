"""JSON Schemas of scenes, sweeps and studies, and texts of scenes as plain data."""

from __future__ import annotations

from fastapi import APIRouter, Request
from fastapi.responses import JSONResponse, Response
from starlette.concurrency import run_in_threadpool

from pipeline.spec.json_schemas import json_schema
from service.context import Service
from service.http.bodies import TEXTS, media_type, parse_text, read_body
from service.routes.jobs import json_body

router = APIRouter(prefix="/v1/schema", tags=["schema"])


@router.get("/scene")
def scene(_: Service) -> Response:
    """JSON Schema (2020-12) of a scene, as `nightglass schema` prints it."""
    return _schema("scene")


@router.get("/sweep")
def sweep(_: Service) -> Response:
    """JSON Schema (2020-12) of a sweep, as `nightglass schema sweep` prints it."""
    return _schema("sweep")


@router.get("/study")
def study(_: Service) -> Response:
    """JSON Schema (2020-12) of a study of capacity, as `nightglass schema study` prints it."""
    return _schema("study")


def _schema(of: str) -> Response:
    return JSONResponse(json_schema(of), media_type="application/schema+json")


@router.post("/scene/read", openapi_extra=json_body("The text of a scene.", TEXTS))
async def read(request: Request, service: Service) -> Response:
    """A text of YAML or JSON as the data that it is (`scene`), not judged: for editors."""
    settings = service.settings
    body = await read_body(request, settings.body_bytes, settings.body_s, TEXTS)
    return JSONResponse({"scene": await run_in_threadpool(parse_text, body, media_type(request))})
