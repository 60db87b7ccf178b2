"""The queue as people look at it: the newest jobs first."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query
from fastapi.responses import JSONResponse, Response

from service.context import Service
from service.jobs.views import job_dict

router = APIRouter(prefix="/v1/queue", tags=["jobs"])


@router.get("")
def newest(service: Service, limit: Annotated[int, Query(ge=1, le=1000)] = 100) -> Response:
    """The jobs submitted last, newest first."""
    return JSONResponse({"jobs": [job_dict(job) for job in service.store.newest(limit)]})
