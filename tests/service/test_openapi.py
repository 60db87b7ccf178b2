"""Whatever the OpenAPI document allows, and what it does not, no answer is a 500."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import httpx
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from service.openapi import SCENE

schemathesis = pytest.importorskip("schemathesis", reason="schemathesis is not installed")
STREAMS = ("/events",)


@pytest.fixture(scope="module")
def quick(keep_server: Callable[..., Any]) -> Any:
    """A server that plans for a second at most, and runs nothing large."""
    return keep_server(NIGHTGLASS_PLAN_S="1", NIGHTGLASS_PIXEL_FRAMES=str(1 << 14))


def test_the_example_is_accepted(server: Any) -> None:
    document = server.client.get("/openapi.json").json()
    body = document["paths"]["/v1/jobs"]["post"]["requestBody"]["content"]["application/json"]
    assert body["examples"]["sidereal"]["value"] == SCENE
    made = server.client.post("/v1/jobs", json=SCENE)
    assert made.status_code == 202
    assert server.client.delete(made.headers["location"]).status_code == 204


def test_the_document_holds_every_v1_route(server: Any) -> None:
    paths = server.client.get("/openapi.json").json()["paths"]
    wanted = {
        "/v1/jobs", "/v1/jobs/{job_id}", "/v1/jobs/{job_id}/events", "/v1/jobs/{job_id}/cancel",
        "/v1/jobs/{job_id}/retry",
        "/v1/jobs/{job_id}/results", "/v1/jobs/{job_id}/results/{path}", "/v1/catalogues",
        "/v1/jobs/{job_id}/preview.png", "/v1/jobs/{job_id}/plan", "/v1/jobs/{job_id}/report",
        "/v1/schema/scene", "/v1/usage", "/v1/files", "/v1/files/{file_id}", "/healthz",
        "/readyz", "/metrics", "/v1/tickets",
    }  # fmt: skip
    assert wanted <= set(paths)


def test_every_kind_of_content_is_documented(server: Any, finished: str) -> None:
    """Each GET of the document, with a finished job: the answer's media type is named there."""
    given = {"job_id": finished.rpartition("/")[2], "frame": 0, "row": 0, "column": 0}
    given |= {"path": "plan.json", "part": "phase", "name": "result", "process": "render"}
    several = {"path": ["plan.json", "preview.png", "scene.yaml", "truth/targets.parquet"]}
    several["part"] = ["phase", "results"]
    document, seen = server.client.get("/openapi.json").json(), 0
    for path, methods in document["paths"].items():
        names = [name for name in several if f"{{{name}}}" in path] or ["path"]
        for value in several[names[0]] if names[0] in path else ["plan.json"]:
            if "get" not in methods:
                continue
            url = path.format(**given | {names[0]: value})
            with server.client.stream("GET", url) as answer:
                kind = answer.headers.get("content-type", "").split("; charset")[0]
                kind = kind.split("; version")[0]
                told = methods["get"]["responses"][str(answer.status_code)]
                assert (answer.status_code, kind in told["content"]) == (200, True), (url, kind)
            seen += 1
    assert seen >= 30


def test_no_answer_is_a_500(quick: Any) -> None:
    """schemathesis draws requests for every operation; what is sent is answered, as documented."""
    document = quick.client.get("/openapi.json").json()
    schema = schemathesis.openapi.from_dict(document)
    count = 0
    for found in schema.get_all_operations():
        operation = found.ok()
        if operation.path.endswith(STREAMS):
            continue
        count += 1
        _try(operation, quick)
    assert count >= 17
    assert quick.client.get("/healthz").status_code == 200
    assert '"level": "error"' not in "\n".join(
        line for line in quick.logged().splitlines() if "internal" in line or "Traceback" in line
    )


def _try(operation: Any, server: Any) -> None:
    documented = {int(s) for s in operation.definition.raw["responses"] if s.isdigit()}

    @settings(
        max_examples=8, deadline=None, database=None,
        suppress_health_check=list(HealthCheck),
    )  # fmt: skip
    @given(case=operation.as_strategy())
    def one(case: Any) -> None:
        try:
            answer = case.call(base_url=server.url, timeout=30)
        except (UnicodeError, ValueError, httpx.InvalidURL):
            return  # what no client can send
        assert answer.status_code < 500 or answer.status_code == 503, answer.text
        assert answer.status_code in documented | {405}, (operation.label, answer.status_code)

    one()


HEADERS = st.dictionaries(
    st.sampled_from(
        ["range", "if-range", "if-none-match", "last-event-id", "accept", "idempotency-key",
         "content-type", "content-encoding", "authorization", "x-forwarded-for", "cookie"]
    ),
    st.text(st.characters(min_codepoint=32, max_codepoint=126), max_size=40).map(str.strip),
    max_size=5,
)  # fmt: skip


@settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(headers=HEADERS, data=st.data())
def test_odd_headers_are_answered(server: Any, finished: str, headers: Any, data: Any) -> None:
    path = data.draw(
        st.sampled_from([finished, "/v1/jobs", f"{finished}/results/plan.json", "/v1/files",
                         f"{finished}/preview.png", "/metrics", "/v1/usage", "/x"])
    )  # fmt: skip
    method = data.draw(st.sampled_from(["GET", "POST", "HEAD", "OPTIONS", "PUT"]))
    answer = server.client.request(method, path, headers=headers)
    assert answer.status_code < 500, answer.text
