"""The OpenAPI document: what FastAPI finds, with examples, the form of a job, and of a problem."""

from __future__ import annotations

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi

from catalog_tools.documents import JsonObject
from pipeline.spec.json_schemas import FORMATS

TEXT = {"type": ["string", "null"]}
NUMBER = {"type": ["integer", "null"]}
ANY_OBJECT = {"type": "object"}
SCENE = {
    "schema": "nightglass/scene/1",
    "name": "geo-rate-track",
    "epoch": "2019-04-20T03:00:00Z",
    "seed": 7,
    "observer": {"kind": "ground", "latitude_deg": 20.7, "longitude_deg": -156.3},
    "sensor": {
        "shape": [256, 256],
        "pixel_pitch_um": 13.5,
        "focal_length_m": 1.0,
        "aperture_m": 0.4,
        "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
        "psf": {"kind": "gaussian", "sigma_px": 1.0},
        "read_noise_e": 5.0,
    },
    "pointing": {"mode": "sidereal", "boresight_ra_deg": 83.0, "boresight_dec_deg": 5.0},
    "exposure": {"integration_s": 2.0, "frames": 2, "cadence_s": 5.0},
    "background": {"uniform_mag_arcsec2": 21.5},
}
JOB = {
    "type": "object",
    "required": ["id", "name", "phase", "submitted", "links"],
    "properties": {
        "id": {"type": "string"},
        "kind": {"enum": ["scene", "sweep"]},
        "name": {"type": "string"},
        "owner": {"type": "string"},
        "phase": {"enum": ["PENDING", "QUEUED", "EXECUTING", "COMPLETED", "ERROR", "ABORTED"]},
        "submitted": TEXT,
        "started": TEXT,
        "ended": TEXT,
        "tiles_done": NUMBER,
        "tiles_total": NUMBER,
        "attempt": {"type": "integer"},
        "bytes_kept": {"type": "integer"},
        "cancel_asked": {"type": "boolean"},
        "error": {"type": ["object", "null"]},
        "content_digest": TEXT,
        "least_cpu_s": {
            "type": "number",
            "description": "in the answer to a submission alone: "
            "CPU seconds forecast, the light of the stars not counted",
        },
        "links": ANY_OBJECT,
    },
    "example": {
        "id": "5f0c1e8a6c0b4f6e9d2f3a7b8c9d0e1f",
        "kind": "scene",
        "name": "geo-rate-track",
        "owner": "key:4f2a91c07be3",
        "phase": "EXECUTING",
        "submitted": "2026-01-05T10:00:00.120+00:00",
        "started": "2026-01-05T10:00:00.310+00:00",
        "ended": None,
        "tiles_done": 3,
        "tiles_total": 8,
        "attempt": 1,
        "bytes_kept": 0,
        "cancel_asked": False,
        "error": None,
        "content_digest": None,
        "links": {"self": "/v1/jobs/5f0c1e8a6c0b4f6e9d2f3a7b8c9d0e1f"},
    },
}
PROBLEM = {
    "type": "object",
    "required": ["type", "title", "status", "detail", "errors"],
    "properties": {
        "type": {"type": "string"},
        "title": {"type": "string"},
        "status": {"type": "integer"},
        "detail": {"type": "string"},
        "errors": {
            "type": "array",
            "items": {
                "type": "object",
                "properties": {n: {"type": "string"} for n in ("pointer", "value", "allowed")},
            },
        },
    },
    "example": {
        "type": "about:blank",
        "title": "Unprocessable Content",
        "status": 422,
        "detail": "1 mistake, the first at /sensor/focal_length_m",
        "errors": [
            {
                "pointer": "/sensor/focal_length_m",
                "value": "-1",
                "allowed": "allowed: greater than 0",
            }
        ],
    },
}
A_JOB, A_PROBLEM = ({"$ref": f"#/components/schemas/{name}"} for name in ("Job", "Problem"))
JOB_ANSWERS = {
    ("post", "/v1/jobs"): ("200", "202"),
    ("post", "/v1/studies"): ("200", "202"),
    ("post", "/v1/sweeps"): ("200", "202"),
    ("get", "/v1/jobs/{job_id}"): ("200",),
    ("post", "/v1/jobs/{job_id}/cancel"): ("202",),
    ("post", "/v1/jobs/{job_id}/retry"): ("202",),
}
REFUSALS = {
    "400": "malformed",
    "401": "no valid key or token",
    "403": "not allowed",
    "404": "not there, or another team's",
    "408": "too slow",
    "409": "not in this state",
    "413": "too large",
    "415": "not this media type",
    "421": "another host's name",
    "422": "mistakes, each named",
    "429": "a quota is used up",
    "503": "not now",
}
OTHERS = {
    ("get", "/v1/jobs/{job_id}"): {"304": "not changed"},
    ("get", "/v1/jobs/{job_id}/results/{path}"): {
        "206": "a Range",
        "304": "not changed",
        "416": "no such Range",
    },
    ("get", "/v1/jobs/{job_id}/preview.png"): {"206": "a Range", "304": "not changed"},
    ("get", "/v1/jobs/{job_id}/plan"): {"206": "a Range", "304": "not changed"},
    ("get", "/v1/jobs/{job_id}/report"): {"206": "a Range", "304": "not changed"},
}
JOB_PATH = "/v1/jobs/{job_id}"
KINDS: dict[str, tuple[str, ...]] = {  # of what is answered to a GET, where it is not JSON alone
    f"{JOB_PATH}/events": ("text/event-stream",),
    f"{JOB_PATH}/preview.png": ("image/png",),
    f"{JOB_PATH}/product.tar": ("application/x-tar",),
    f"{JOB_PATH}/results/{{path}}": (
        "application/octet-stream",
        "application/json",
        "image/png",
        "text/plain",
    ),
    f"{JOB_PATH}/frames/{{frame}}/fits": ("application/fits",),
    f"{JOB_PATH}/frames/{{frame}}/tiles/{{row}}/{{column}}": ("application/octet-stream",),
    f"{JOB_PATH}/frames/{{frame}}/tiles/{{row}}/{{column}}/picture.png": ("image/png",),
    **{f"/v1/schema/{of}": ("application/schema+json",) for of in FORMATS},
    "/metrics": ("text/plain",),
    "/uws/async": ("text/xml",),
    "/uws/async/{job_id}": ("text/xml",),
    "/uws/async/{job_id}/{part}": ("text/plain", "text/xml"),
    "/uws/async/{job_id}/results/{name}": ("application/x-votable+xml;content=datalink",),
}
PLAIN = ("/healthz", "/readyz", "/metrics")


def describe(app: FastAPI) -> None:
    """Have the application publish this document; it is made when it is first asked for."""

    def document() -> JsonObject:
        if app.openapi_schema is None:
            app.openapi_schema = _complete(
                get_openapi(
                    title=app.title,
                    version=app.version,
                    routes=app.routes,
                    description="Raw sensor frames with known truth, from scenes. Errors are "
                    "problem+json (RFC 9457).",
                )
            )
        return app.openapi_schema

    app.openapi = document  # type: ignore[method-assign]


def _complete(document: JsonObject) -> JsonObject:
    schemas = document.setdefault("components", {}).setdefault("schemas", {})
    schemas |= {"Job": JOB, "Problem": PROBLEM}
    for unused in ("HTTPValidationError", "ValidationError"):
        schemas.pop(unused, None)
    for path, methods in document["paths"].items():
        for method, operation in methods.items():
            _complete_answers(method, path, operation["responses"])
    body = document["paths"]["/v1/jobs"]["post"]["requestBody"]["content"]["application/json"]
    body["examples"] = {"sidereal": {"summary": "two short frames, no stars", "value": SCENE}}
    planned = {"anyOf": [A_JOB, {"type": "object", "description": "a plan (dry_run)"}]}
    for path in ("/v1/jobs", "/v1/studies", "/v1/sweeps"):
        if path in document["paths"]:
            answer = document["paths"][path]["post"]["responses"]["200"]
            answer["content"]["application/json"] = {"schema": planned}
    if "/readyz" in document["paths"]:
        document["paths"]["/readyz"]["get"]["responses"]["503"]["content"] = {
            "application/json": {"schema": ANY_OBJECT}
        }
    return document


def _complete_answers(method: str, path: str, answers: JsonObject) -> None:
    problem = {"application/problem+json": {"schema": A_PROBLEM}}
    refusals = {"503": "not now"} if path in PLAIN else REFUSALS
    for status, told in refusals.items():
        answers[status] = {"description": told, "content": problem}
    for status in JOB_ANSWERS.get((method, path), ()):
        answers.setdefault(status, {"description": "the job"})
        answers[status]["content"] = {"application/json": {"schema": A_JOB}}
    if method == "get" and path in KINDS:
        answers["200"]["content"] = {kind: {} for kind in KINDS[path]}
    for status, told in OTHERS.get((method, path), {}).items():
        answers[status] = {"description": told}
        if status == "206":
            answers[status]["content"] = answers["200"]["content"]
