"""Results of a job: the files of its product, its preview, plan and report."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated
from urllib.parse import quote, urlencode

from fastapi import APIRouter, Query, Request
from fastapi.responses import JSONResponse, Response

from pipeline.store import layout
from service.context import Context, Service
from service.jobs.jobs import FINAL, Job, Phase
from service.problems import NotReady, NotThere
from service.products.files import list_files, serve_file

router = APIRouter(prefix="/v1/jobs/{job_id}", tags=["results"])


def scene_job(service: Context, job_id: str) -> Job:
    """A job that draws frames. NotThere for one of a sweep or study, which never has any."""
    job = service.store.get(job_id)
    if job.kind != "scene":
        raise NotThere(f"a {job.kind} has neither frames nor a plan: /v1/jobs/{job_id}/results")
    return job


def _product(service: Context, job_id: str) -> Path:
    """The product of a job that is complete. NotReady before."""
    return whole_product(service, service.store.get(job_id))


def whole_product(service: Context, job: Job) -> Path:
    """The product of a job, as of `_product`."""
    product = service.settings.product(job.id)
    if job.phase != Phase.COMPLETED or not (product / layout.COMPLETE).is_file():
        raise NotReady(f"the job is {job.phase}: its product is not complete")
    return product


@router.get("/results")
def listing(
    service: Service,
    job_id: str,
    after: Annotated[str, Query(max_length=1024, description="cursor")] = "",
    limit: Annotated[int, Query(ge=1, le=10_000)] = 1000,
) -> Response:
    """The files of a product; a Zarr reader can open .../results/cube.zarr as it is."""
    files = [f for f in list_files(_product(service, job_id)) if f[0] > after]
    here, headers = f"/v1/jobs/{job_id}/results", {}
    if len(files) > limit:
        query = urlencode({"after": files[limit - 1][0], "limit": limit})
        headers["Link"] = f'<{here}?{query}>; rel="next"'
    shown = [{"path": p, "bytes": n, "href": f"{here}/{quote(p)}"} for p, n in files[:limit]]
    return JSONResponse({"files": shown}, headers=headers)


@router.head("/results/{path:path}", include_in_schema=False)
@router.get("/results/{path:path}")
def result(request: Request, service: Service, job_id: str, path: str) -> Response:
    """One file of a product (200, or 206 for a Range)."""
    return serve_file(request, _product(service, job_id), path)


@router.head("/preview.png", include_in_schema=False)
@router.get("/preview.png")
def preview(request: Request, service: Service, job_id: str) -> Response:
    """The first frame, stretched."""
    return serve_file(request, _product(service, job_id), layout.PREVIEW)


@router.get("/report")
def report(request: Request, service: Service, job_id: str) -> Response:
    """The report of a complete product."""
    return serve_file(request, _product(service, job_id), layout.REPORT)


@router.get("/plan")
def plan(request: Request, service: Service, job_id: str) -> Response:
    """The plan, from the moment that the job has one."""
    job = scene_job(service, job_id)
    product = service.settings.product(job_id)
    if not (product / layout.PLAN).is_file():
        yet = "" if job.phase in FINAL else " yet"
        raise NotReady(f"the job is {job.phase}: it has no plan{yet}")
    return serve_file(request, product, layout.PLAN)
