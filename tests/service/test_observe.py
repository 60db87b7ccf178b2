"""POST /v1/observe: the rows of Python's door, what it refuses, and skies that are not drawn."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

import nightglass
from pipeline.observe.files import as_data
from service.client import Client

PATH = "/v1/observe"


@pytest.fixture(scope="module")
def server(keep_server: Callable[..., Any]) -> Any:
    return keep_server(NIGHTGLASS_OBSERVED_ROWS="100")


def test_the_same_as_in_python(server: Any, scene: dict[str, Any]) -> None:
    answer = server.client.post(PATH, json=scene)
    assert answer.status_code == 200, answer.text
    assert answer.json() == as_data(nightglass.observe(scene))
    with Client(server.url) as client:
        found = client.observe(scene, times="0,3600,900", snr=1e6)
    assert found == as_data(nightglass.observe(scene, "0,3600,900", 1e6))
    assert "too faint" in found["counts"]
    assert len(found["rows"]) == 5


def test_what_is_not_drawn_is_answered(server: Any, scene: dict[str, Any]) -> None:
    """By day, and of a target that has set, a submission is refused and an observation is not."""
    scene |= {"epoch": "2019-04-20T22:00:00Z", "background": {"airglow": True}}
    assert server.client.post("/v1/jobs", json=scene).status_code == 422
    answer = server.client.post(PATH, json=scene)
    assert answer.status_code == 200, answer.text
    assert "yes" not in answer.json()["counts"]


@pytest.mark.parametrize(
    ("query", "change", "pointer"),
    [
        ("times=0,10", {}, "?times"),
        ("times=/etc/passwd", {}, "?times"),
        ("times=0,1000,1", {}, "/times"),
        ("snr=0", {}, "?snr"),
        ("snr=nan", {}, "?snr"),
        ("", {"targets": [], "pointing": {"mode": "sidereal", "boresight_ra_deg": 1,
                                          "boresight_dec_deg": 1}}, "/targets"),
        ("", {"populations": [{"name": "a", "path": "/etc/passwd",
                               "body": {"kind": "sphere", "diameter_m": 1, "albedo": 0.2}}]},
         "/populations/0/path"),
    ],
)  # fmt: skip
def test_refusals(
    server: Any, scene: dict[str, Any], query: str, change: Any, pointer: str
) -> None:
    answer = server.client.post(f"{PATH}?{query}", json=scene | change)
    assert answer.status_code == 422, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    assert [error["pointer"] for error in answer.json()["errors"]] == [pointer]
