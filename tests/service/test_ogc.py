"""The OGC API - Processes face by owslib's client, and its refusals."""

from __future__ import annotations

import json
from typing import Any

import pytest
from owslib.ogcapi.processes import Processes

from pipeline.spec.scene import Scene


@pytest.fixture
def ogc(server: Any) -> Processes:
    return Processes(f"{server.url}/ogc")


def test_owslib_lists_describes_executes(
    server: Any, ogc: Processes, scene: dict[str, Any]
) -> None:
    assert any(c.endswith("processes-1/1.0/conf/core") for c in ogc.conformance()["conformsTo"])
    assert [p["id"] for p in ogc.processes()] == ["render", "plan"]
    about = ogc.process("render")
    assert about["jobControlOptions"] == ["async-execute", "dismiss"]
    schema = about["inputs"]["scene"]["schema"]
    assert schema["properties"].keys() == Scene.model_json_schema()["properties"].keys()
    told = ogc.execute("render", {"scene": scene}, async_=True)
    assert told["status"] == "accepted"
    assert ogc.response_headers["location"].endswith(told["jobID"])
    assert server.ended(f"/v1/jobs/{told['jobID']}")["phase"] == "COMPLETED"
    status = server.client.get(f"/ogc/jobs/{told['jobID']}").json()
    assert (status["status"], status["progress"]) == ("successful", 100)
    results = server.client.get(f"/ogc/jobs/{told['jobID']}/results").json()
    assert set(results) == set(about["outputs"])
    assert server.client.get(results["report"]["href"]).json()["complete"]
    assert server.client.get(results["product"]["href"]).status_code == 200
    plan = ogc.execute("plan", {"scene": {"value": scene, "mediaType": "application/json"}})
    assert plan["plan"]["tiles"] == 2
    assert told["jobID"] in [j["jobID"] for j in server.client.get("/ogc/jobs").json()["jobs"]]
    newer = ogc.execute("render", {"scene": scene | {"seed": 2}}, async_=True)["jobID"]
    listed = server.client.get("/ogc/jobs?limit=1").json()["jobs"]
    assert [j["jobID"] for j in listed] == [newer]
    gone = server.client.delete(f"/ogc/jobs/{told['jobID']}")
    assert gone.json()["status"] == "dismissed"
    assert server.client.get(f"/v1/jobs/{told['jobID']}").status_code == 404


def test_dismissed_jobs_stop(server: Any, ogc: Processes, scene: dict[str, Any]) -> None:
    scene["sensor"]["shape"], scene["exposure"]["frames"] = [640, 640], 50
    told = ogc.execute("render", {"scene": scene})
    path = f"/ogc/jobs/{told['jobID']}"
    waiting = server.client.get(f"{path}/results")
    assert waiting.status_code in (404, 409)
    assert waiting.json()["type"].endswith("result-not-ready")
    assert server.client.delete(path).json()["status"] == "dismissed"
    assert server.ended(f"/v1/jobs/{told['jobID']}")["phase"] == "ABORTED"
    assert server.client.get(path).json()["status"] == "dismissed"


@pytest.mark.parametrize(
    ("path", "body", "status", "said"),
    [
        ("fly", {"inputs": {}}, 404, "no-such-process"),
        ("render", {"inputs": {}}, 422, "/inputs"),
        ("render", [], 422, "/inputs"),
        ("render", {"inputs": {"scene": {"href": "http://10.0.0.1/x"}}}, 422, "nothing is fetched"),
        ("render", {"inputs": {"scene": {}}}, 422, "mistake"),
        ("render", {"inputs": {"scene": 5}}, 422, "mistake"),
        ("plan", {"inputs": {"scene": {}}, "subscriber": {"successUri": "http://x"}}, 422, "calls"),
    ],
    ids=("process", "nothing", "list", "href", "empty", "number", "subscriber"),
)
def test_mistakes(server: Any, path: str, body: Any, status: int, said: str) -> None:
    answer = server.client.post(f"/ogc/processes/{path}/execution", content=json.dumps(body),
                                headers={"content-type": "application/json"})  # fmt: skip
    assert (answer.status_code, said in answer.text) == (status, True), answer.text
    assert answer.headers["content-type"] == "application/problem+json"


def test_unknown_jobs(server: Any) -> None:
    for ask in (server.client.get, server.client.delete):
        answer = ask("/ogc/jobs/nojob")
        assert (answer.status_code, answer.json()["type"].endswith("no-such-job")) == (404, True)
