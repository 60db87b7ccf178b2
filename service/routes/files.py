"""Files for scenes: send, list, remove. A scene names one as `upload:ID`."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query, Request
from fastapi.responses import JSONResponse, Response

from service.context import Service
from service.http.gate import allow_time
from service.store.named_files import PREFIX

router = APIRouter(prefix="/v1/files", tags=["files"])
BODY = {
    "requestBody": {
        "required": True,
        "description": "The file's bytes.",
        "content": {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}},
    }
}


@router.post("", status_code=201, openapi_extra=BODY)
async def send(
    request: Request,
    service: Service,
    name: Annotated[str, Query(max_length=100, description="its name; the ending tells its kind")],
) -> Response:
    """Store a file for scenes of the caller's team; the answer's `id` is what a scene names."""
    allow_time(request, service.settings.upload_s + service.settings.answer_s)
    found = await service.files.receive(request, name, service.caller)
    return JSONResponse(found, 201)


@router.get("")
def listing(service: Service) -> Response:
    """The files of the caller's team, oldest first."""
    return JSONResponse({"files": service.files.listing(service.caller.team)})


@router.delete("/{file_id}", status_code=204)
def remove(service: Service, file_id: str) -> Response:
    """Remove a file. 409, naming them, while jobs that have not ended name it."""
    service.files.remove(service.caller, file_id.removeprefix(PREFIX))
    return Response(status_code=204)
