"""How a job looks to clients: JSON with links, an ETag, times in UTC."""

from __future__ import annotations

from datetime import UTC, datetime

from catalog_tools.documents import JsonObject
from service.jobs.jobs import FINAL, Job, Phase, can_be_retried

MADE = {
    "scene": ("results", "preview.png", "plan", "report"),
    "study": ("results", "report"),
    "sweep": ("results", "report"),
}


def job_dict(job: Job, dashboard: str | None = None) -> JsonObject:
    """A job as plain data; absent is null. `dashboard`: of the Dask scheduler that draws it."""
    here = f"/v1/jobs/{job.id}"
    links = {"self": here, "events": f"{here}/events", "scene": f"{here}/scene"}
    if job.phase not in FINAL:
        links["cancel"] = f"{here}/cancel"
    if can_be_retried(job):
        links["retry"] = f"{here}/retry"
    if job.phase == Phase.COMPLETED:
        for name in MADE[job.kind]:
            links[name.partition(".")[0]] = f"{here}/{name}"
    if dashboard and job.phase == Phase.EXECUTING:
        links["dashboard"] = dashboard
    return {
        "id": job.id,
        "kind": job.kind,
        "name": job.name,
        "owner": job.owner,
        "phase": job.phase.value,
        "submitted": utc(job.submitted_s),
        "started": utc(job.started_s),
        "ended": utc(job.ended_s),
        "tiles_done": job.tiles_done,
        "tiles_total": job.tiles_total,
        "attempt": job.attempt,
        "bytes_kept": job.bytes_kept,
        "cancel_asked": job.cancel_asked,
        "error": job.error,
        "content_digest": job.content_digest,
        "links": links,
    }


def etag(job: Job) -> str:
    return f'"{job.version}"'


def utc(seconds: float | None) -> str | None:
    """Unix seconds as ISO 8601 in UTC, to the millisecond."""
    if seconds is None:
        return None
    return datetime.fromtimestamp(seconds, UTC).isoformat(timespec="milliseconds")
