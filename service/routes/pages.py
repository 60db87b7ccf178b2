"""One plain page for people: how to submit, and the newest jobs."""

from __future__ import annotations

from html import escape

from fastapi import APIRouter
from fastapi.responses import HTMLResponse, Response

from service.context import Service
from service.jobs import Job, Phase
from service.views import utc

router = APIRouter(include_in_schema=False)
SHOWN = 50
POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src 'self'; base-uri 'none'"
PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>Nightglass</title>
<style>
body {{ font: 15px/1.5 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto }}
table {{ border-collapse: collapse; width: 100% }}
th, td {{ text-align: left; padding: .25rem .6rem; border-bottom: 1px solid #ccc }}
pre {{ background: #eee; padding: .6rem; overflow: auto }}
img {{ height: 4rem; image-rendering: pixelated }}
</style></head><body>
<h1>Nightglass</h1>
<pre>curl -i -H 'Content-Type: application/json' --data @scene.json /v1/jobs</pre>
<p><a href="/v1/jobs">jobs</a> · <a href="/v1/catalogues">catalogues</a> ·
<a href="/v1/schema/scene">scene schema</a> · <a href="/openapi.json">all endpoints</a> ·
<a href="/readyz">ready?</a> · <a href="/metrics">metrics</a></p>
<h2>Newest jobs</h2>
<table><tr><th>name</th><th>phase</th><th>tiles</th><th>submitted</th><th>frame</th></tr>
{rows}</table>
</body></html>
"""


@router.get("/")
def front(service: Service) -> Response:
    """The page."""
    rows = "\n".join(_row(job) for job in service.store.newest(SHOWN))
    headers = {"Content-Security-Policy": POLICY, "X-Content-Type-Options": "nosniff"}
    return HTMLResponse(PAGE.format(rows=rows), headers=headers)


def _row(job: Job) -> str:
    here = f"/v1/jobs/{job.id}"
    tiles = f"{job.tiles_done} of {job.tiles_total}" if job.tiles_total is not None else ""
    done = job.phase == Phase.COMPLETED
    frame = f'<a href="{here}/results"><img src="{here}/preview.png" alt="preview"></a>'
    message = escape(job.error["message"]) if job.error else ""
    return (
        f'<tr><td><a href="{here}">{escape(job.name)}</a></td><td>{job.phase.value}</td>'
        f"<td>{tiles}</td><td>{utc(job.submitted_s)}</td><td>{frame if done else message}</td></tr>"
    )
