"""Scenes and sweeps as YAML over REST: as strict as JSON, and the same jobs."""

from __future__ import annotations

import json
from typing import Any

import pytest

from pipeline.spec.load import parse_scene, scene_yaml
from service.http.bodies import YAML_BYTES

YAML = {"content-type": "application/yaml"}
MALFORMED = {
    "twice": "name: a\nname: b\n",
    "alias": "a: &x [1]\nb: *x\n",
    "infinity": "a: .inf\n",
    "not a number": "a: .nan\n",
    "number as key": "1: a\n",
    "bytes": "a: !!binary aGVsbG8=\n",
    "set": "a: !!set {x, y}\n",
    "python": "a: !!python/object/apply:os.system [id]\n",
    "two documents": "a: 1\n---\nb: 2\n",
    "version 1.1": "%YAML 1.1\n---\na: yes\n",
    "deep": "[" * 60 + "]" * 60,
    "no text": "a: \x01\n",
    "open": "a: [1, 2\n",
    "tab": "a:\n\t- 1\n",
    "latin": "a: é\n".encode("latin-1"),
}


def test_yaml_and_json_are_the_same_submission(server: Any, scene: dict[str, Any]) -> None:
    plain = parse_scene(scene).as_dict()
    key = {"idempotency-key": "by-yaml"}
    made = server.client.post("/v1/jobs", content=scene_yaml(parse_scene(scene)),
                              headers=YAML | key)  # fmt: skip
    assert made.status_code == 202, made.text
    again = server.client.post("/v1/jobs", json=plain, headers=key)
    assert (again.status_code, again.json()["id"]) == (200, made.json()["id"])
    assert server.client.get(f"{made.headers['location']}/scene").json() == plain
    dry = server.client.post("/v1/jobs?dry_run=1", content=json.dumps(scene), headers=YAML)
    assert dry.status_code == 200, dry.text
    sweep = {"schema": "nightglass/sweep/1", "name": "two", "scene": scene,
             "axes": [{"field": "sensor.read_noise_e", "values": [1.0, 4.0]}]}  # fmt: skip
    dry = server.client.post("/v1/sweeps?dry_run=1", content=json.dumps(sweep), headers=YAML)
    assert dry.json()["points"] == 2
    server.client.delete(made.headers["location"])


@pytest.mark.parametrize("name", MALFORMED)
@pytest.mark.parametrize("path", ["/v1/jobs", "/v1/sweeps", "/v1/schema/scene/read"])
def test_what_is_no_plain_yaml_is_400(server: Any, name: str, path: str) -> None:
    answer = server.client.post(path, content=MALFORMED[name], headers=YAML)
    assert (answer.status_code, answer.json()["status"]) == (400, 400), answer.text


def test_mistakes_are_named_as_in_json(server: Any, scene: dict[str, Any]) -> None:
    text = scene_yaml(parse_scene(scene)).replace("aperture_m: 0.4", "aperture_m: -1")
    answer = server.client.post("/v1/jobs", content=text, headers=YAML)
    assert answer.status_code == 422
    assert answer.json()["errors"][0]["pointer"] == "/sensor/aperture_m"
    large = server.client.post("/v1/jobs", content=" " * (YAML_BYTES + 1), headers=YAML)
    assert large.status_code == 413
    for kind in ("text/yaml", "application/yaml; charset=latin-1", "application/x-yaml"):
        refused = server.client.post("/v1/jobs", content=text, headers={"content-type": kind})
        assert (refused.status_code, "application/yaml" in refused.text) == (415, True)


def test_a_text_is_read_for_editors(server: Any) -> None:
    answer = server.client.post("/v1/schema/scene/read", content="a: [1, 1e3, x]", headers=YAML)
    assert answer.json() == {"scene": {"a": [1, 1000.0, "x"]}}
