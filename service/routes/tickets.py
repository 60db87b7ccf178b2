"""Tickets for downloads that a browser makes by itself, where no key can be sent along."""

from __future__ import annotations

from fastapi import APIRouter, Request
from fastapi.responses import JSONResponse, Response

from service.context import Service
from service.http.bodies import parse_json, read_body
from service.problems import NotAllowed
from service.routes.jobs import json_body

router = APIRouter(prefix="/v1/tickets", tags=["results"])
BODY = json_body('{"path": "/v1/jobs/ID/product.tar"}: something of a job of the caller\'s team.')


@router.post("", status_code=201, openapi_extra=BODY)
async def make(request: Request, service: Service) -> Response:
    """`href`: the path with a ticket, which a GET of just that may use for a minute."""
    body = await read_body(request, service.settings.body_bytes, service.settings.body_s)
    data = parse_json(body)
    if not isinstance(data, dict) or set(data) != {"path"} or not isinstance(data["path"], str):
        allowed = '{"path": "/v1/jobs/..."} alone'
        raise NotAllowed(f"the body: allowed: {allowed}", (("", data, allowed),))
    return JSONResponse({"href": service.tickets.make(service.caller, data["path"])}, 201)
