"""Whatever the OpenAPI document allows, and what it does not, no answer is a 500."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Callable
from typing import Any

import pytest
import schemathesis
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from schemathesis import GenerationMode

from pipeline.spec.json_schemas import json_schema
from service.openapi import JOB, SCENE
from tests.service.drawn import (
    CATALOGUE,
    FILES,
    HEADERS,
    SAMPLES,
    TABLE,
    TEXTS,
    UPLOAD,
    UPLOADS,
    scene_requests,
)  # fmt: skip
from tests.slow import slow

STREAMS = ("/events",)


def test_the_example_is_accepted(server: Any) -> None:
    document = server.client.get("/openapi.json").json()
    body = document["paths"]["/v1/jobs"]["post"]["requestBody"]["content"]["application/json"]
    assert body["examples"]["sidereal"]["value"] == SCENE
    made = server.client.post("/v1/jobs", json=SCENE)
    assert made.status_code == 202
    assert server.client.delete(made.headers["location"]).status_code == 204


def test_the_example_of_a_job_is_one_that_runs() -> None:
    """As the service answers of it: nobody asked to cancel it, and nothing is at its end."""
    told = JOB["example"]
    assert (told["phase"], told["cancel_asked"], told["ended"]) == ("EXECUTING", False, None)
    assert 0 < told["tiles_done"] < told["tiles_total"]
    assert told["submitted"] < told["started"]
    assert told["links"]["self"].endswith(told["id"])


@pytest.mark.parametrize("of", ["scene", "sweep", "study"])
def test_schemas_are_those_that_the_command_prints(server: Any, of: str) -> None:
    answer = server.client.get(f"/v1/schema/{of}")
    assert answer.headers["content-type"] == "application/schema+json"
    assert answer.json() == json_schema(of)


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


class Target:
    """A server under fire, and what there is to aim at: jobs in every state, files, a catalogue."""

    def __init__(self, server: Any, schema: dict[str, Any]) -> None:
        self.server, self.schema = server, schema
        self.operations = [
            operation for found in schemathesis.openapi.from_dict(
                server.client.get("/openapi.json").json()
            ).get_all_operations()
            if not (operation := found.ok()).path.endswith(STREAMS)
        ]  # fmt: skip
        self.statuses: Counter[int] = Counter()

    def place(self, name: str, number: int) -> Any:
        """Something that is there, for a parameter of a path; made again once it was deleted."""
        if name == "file_id":
            found = [file["id"] for file in self.server.client.get("/v1/files").json()["files"]]
            return found[number % len(found)] if found else self.upload("a.csv", TABLE.encode())
        if name == "job_id":
            jobs = self.server.client.get("/v1/queue", params={"limit": 1000}).json()["jobs"]
            whole = [job["id"] for job in jobs if job["phase"] == "COMPLETED"]
            found = whole if number % 2 else [job["id"] for job in jobs]
            return found[number // 2 % len(found)] if found else self.complete_job()
        things = {"path": ["plan.json", "preview.png", "truth/targets.parquet", "cube.zarr"],
                  "part": ["phase", "error", "parameters", "results", "destruction"],
                  "name": ["result", "report"], "process": ["plan", "render"]}  # fmt: skip
        return things[name][number % len(things[name])] if name in things else number % 2

    def complete_job(self) -> str:
        return self.server.ended(self.server.submit(SAMPLES[0]))["id"]

    def upload(self, name: str, content: bytes) -> str | None:
        answer = self.send("POST", "/v1/files", {"content-type": "application/octet-stream"},
                           content, params={"name": name})  # fmt: skip
        return answer.json()["id"] if answer.status_code == 201 else None

    def send(self, method: str, path: str, headers: Any, content: bytes, **more: Any) -> Any:
        answer = self.server.client.request(method, path, headers=headers, content=content, **more)
        self.judge(answer, f"{method} {path} {headers} {content[:2000]!r}")
        return answer

    def judge(self, answer: Any, request: str) -> None:
        """No 5xx; but a 503 that says when to try again is load (plans are given one second)."""
        self.statuses[answer.status_code] += 1
        load = answer.status_code == 503 and "retry-after" in answer.headers
        assert answer.status_code < 500 or load, f"{request}: {answer.status_code} {answer.text}"


def documented(target: Target, data: st.DataObject) -> None:
    """What the document tells of, good or bad; most places in its path are there."""
    operation = data.draw(st.sampled_from(target.operations))
    case = data.draw(operation.as_strategy(data.draw(st.sampled_from(GenerationMode))))
    for name in case.path_parameters:
        if data.draw(st.integers(0, 2)):
            case.path_parameters[name] = target.place(name, data.draw(st.integers(0, 40)))
    try:
        answer = case.call(base_url=target.server.url, timeout=60)
    except (UnicodeError, ValueError):
        return  # what no client can send
    target.judge(answer, f"{operation.label} {case.path_parameters} {case.query} {case.body!r}")
    known = {int(status) for status in operation.definition.raw["responses"] if status.isdigit()}
    assert answer.status_code in known | {405}, (operation.label, answer.status_code)


def near_scenes(target: Target, data: st.DataObject) -> None:
    """Scenes and sweeps near to good ones, by every route that takes one, as JSON or YAML."""
    path, kind, body = data.draw(scene_requests(target.schema))
    for mark in sorted({*re.findall(rb"upload:@\d+\.", body)}):
        number = int(mark[len(UPLOAD) : -1])
        known = (FILES[number - 1].name, FILES[number - 1].read_bytes()) if number else None
        drawn = known is None or data.draw(st.integers(0, 3)) == 0
        file_id = target.upload(*(data.draw(UPLOADS) if drawn else known))
        body = body.replace(mark, str(file_id or target.place("file_id", number)).encode())
    target.send("POST", path, {"content-type": kind}, body)


def tickets(target: Target, data: st.DataObject) -> None:
    """A ticket for some path, and its use."""
    path = data.draw(st.sampled_from(["product.tar", "frames/0/fits", "results/plan.json", ""]))
    path = f"/v1/jobs/{target.place('job_id', data.draw(st.integers(0, 40)))}/{path}"
    path += data.draw(st.sampled_from(["", "?layer=dn", "?ticket=1"]) | TEXTS)
    asked = json.dumps({"path": path}).encode()
    made = target.send("POST", "/v1/tickets", {"content-type": "application/json"}, asked)
    if made.status_code == 201:
        target.send("GET", made.json()["href"] + data.draw(st.sampled_from(["", "0"])), {}, b"")


def odd_headers(target: Target, data: st.DataObject) -> None:
    job = f"/v1/jobs/{target.place('job_id', data.draw(st.integers(0, 40)))}"
    path = data.draw(
        st.sampled_from([job, f"{job}/retry", f"{job}/results/plan.json", f"{job}/preview.png",
                         f"{job}/product.tar", "/v1/jobs", "/v1/files?name=a.csv", "/v1/tickets",
                         "/v1/sweeps", "/metrics", "/v1/usage", "/x", "/"])
    )  # fmt: skip
    method = data.draw(st.sampled_from(["GET", "POST", "HEAD", "OPTIONS", "PUT", "DELETE"]))
    target.send(method, path, data.draw(HEADERS), data.draw(st.sampled_from([b"", b"{}"])))


@pytest.mark.timeout(3600)
@pytest.mark.parametrize("count", [60, slow(5000)])
def test_no_answer_is_a_500(keep_server: Callable[..., Any], count: int) -> None:
    """Requests of every kind, of which most reach what they aim at; the log shows no fault."""
    server = keep_server(NIGHTGLASS_PLAN_S="1", NIGHTGLASS_PIXEL_FRAMES=str(1 << 20))
    words = ["catalog", "demo", "-o", str(server.home / "catalogues" / CATALOGUE)]
    words += ["--faintest", "4"]
    subprocess.run([sys.executable, "-m", "pipeline", *words], check=True, capture_output=True)
    target = Target(server, server.client.get("/v1/schema/scene").json())
    target.complete_job()
    ways = [documented] * 5 + [near_scenes] * 3 + [tickets, odd_headers]

    @settings(max_examples=count, deadline=None, database=None,
              suppress_health_check=list(HealthCheck))  # fmt: skip
    @given(data=st.data())
    def one(data: st.DataObject) -> None:
        data.draw(st.sampled_from(ways))(target, data)

    one()
    print(f"{target.statuses.total()} requests: {dict(sorted(target.statuses.items()))}")
    assert target.statuses.total() >= count
    assert sum(n for status, n in target.statuses.items() if status < 400) > count / 20
    assert server.client.get("/healthz").status_code == 200
    faults = [line for line in server.logged().splitlines() if "Traceback" in line]
    assert faults == []
