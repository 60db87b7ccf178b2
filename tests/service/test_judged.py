"""What can be judged when a scene is submitted is judged then, at every door; files have names."""

from __future__ import annotations

import asyncio
import io
import json
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from pipeline.inputs.targets.meshes import MOST_FACETS
from service.engine import looks
from service.engine.looks import Looks
from service.settings import Settings

STARE = {"mode": "sidereal", "boresight_ra_deg": 0.0, "boresight_dec_deg": 0.0}
TURNED = {  # its boresight sinks below the horizon of the site within the exposures
    "pointing": STARE | {"boresight_ra_deg": 250.0, "boresight_dec_deg": 20.0},
    "exposure": {"integration_s": 2.0, "frames": 200, "cadence_s": 300.0},
}
LONG = {"integration_s": 2.0, "frames": 10, "cadence_s": 3600.0}
IN_ORBIT = {
    "observer": {
        "kind": "orbit",
        "orbit": {
            "kind": "state",
            "position_m": [7e6, 0.0, 0.0],
            "velocity_m_s": [0.0, 7546.0, 0.0],
        },
    },
    "pointing": STARE | {"boresight_ra_deg": 150.0},
}
WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "early": ({"epoch": "1850-01-01T00:00:00Z"}, "/epoch"),
    "late": ({"epoch": "2150-01-01T00:00:00Z"}, "/epoch"),
    "no such day": ({"epoch": "2019-02-30T00:00:00Z"}, "/epoch"),
    "beyond the ephemeris": ({"epoch": "2100-12-31T23:59:50Z", "exposure": LONG}, "/exposure"),
    "below the horizon": (TURNED, "/pointing"),
    "Earth's limb": (IN_ORBIT, "/pointing"),
    "daylight": ({"epoch": "2019-04-20T21:00:00Z", "background": {"airglow": True}}, "/background"),
}


def doors(server: Any, scene: dict[str, Any]) -> dict[str, Any]:
    """The same scene at every door that takes one."""
    post = server.client.post
    axes = [{"field": "sensor.read_noise_e", "values": [1.0, 2.0]}]
    sweep = {"schema": "nightglass/sweep/1", "name": "s", "scene": scene, "axes": axes}
    return {
        "jobs": post("/v1/jobs", json=scene),
        "sweeps": post("/v1/sweeps", json=sweep),
        "ogc": post("/ogc/processes/render/execution", json={"inputs": {"scene": scene}}),
        "uws": post("/uws/async", data={"SCENE": json.dumps(scene)}),
    }


OF_SWEEPS = "/scene"  # where a base scene stands in a body


@pytest.mark.parametrize("name", WRONG)
def test_times_and_skies_are_judged_at_once(server: Any, scene: dict[str, Any], name: str) -> None:
    change, pointer = WRONG[name]
    for door, answer in doors(server, scene | change).items():
        assert answer.status_code == 422, (door, answer.text)
        at = OF_SWEEPS if door == "sweeps" else ""
        assert answer.json()["errors"][0]["pointer"].startswith(at + pointer), (door, answer.text)


@pytest.fixture(scope="module")
def judging(keep_server: Callable[..., Any]) -> Any:
    return keep_server(NIGHTGLASS_UPLOAD_BYTES=str(1 << 26))


def sent(server: Any, name: str, content: bytes) -> str:
    answer = server.client.post("/v1/files", params={"name": name}, content=content)
    assert answer.status_code == 201, answer.text
    return str(answer.json()["id"])


def npy(values: Any) -> bytes:
    out = io.BytesIO()
    np.save(out, values)
    return out.getvalue()


def flat_of(value: float, side: int = 64) -> bytes:
    image = np.ones((side, side))
    image[3, 4] = value
    return npy(image)


IMAGES = {
    "shape": ("flat", flat_of(1.0, 32), "shape (32, 32)"),
    "not finite": ("flat", flat_of(np.nan), "NaN"),
    "negative": ("read_noise_e", flat_of(-1.0), "pixel of -1"),
    "not an image": ("flat", npy(np.ones(5)), "two-dimensional"),
}


@pytest.mark.parametrize("name", IMAGES)
def test_images_are_judged_at_once_by_their_names(
    judging: Any, scene: dict[str, Any], name: str
) -> None:
    field, content, said = IMAGES[name]
    file_id = sent(judging, "my-camera.npy", content)
    scene["sensor"][field] = file_id
    if name == "shape":
        answers = doors(judging, scene)
    else:  # at one door: each takes a process that reads the file
        answers = {"jobs": judging.client.post("/v1/jobs", json=scene)}
    for door, answer in answers.items():
        assert answer.status_code == 422, (door, answer.text)
        told = answer.text
        assert (said in told, "my-camera.npy" in told) == (True, True), (door, told)
        at = OF_SWEEPS if door == "sweeps" else ""
        assert answer.json()["errors"][0]["pointer"] == f"{at}/sensor/{field}"
        assert file_id.removeprefix("upload:")[:8] not in told


def with_mesh(scene: dict[str, Any], file_id: str) -> dict[str, Any]:
    body = {
        "kind": "mesh",
        "path": file_id,
        "unit": "m",
        "surface": {"kind": "lambert", "albedo": 0.2},
    }
    body["attitude"] = {"kind": "inertial", "quaternion": [1.0, 0.0, 0.0, 0.0]}
    scene["targets"][0]["body"] = body
    return scene


def test_meshes_are_judged_at_once(judging: Any, scene: dict[str, Any]) -> None:
    corners = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n"
    faces = b"f 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
    large = corners + b"f 1 3 2\n" * (MOST_FACETS + 1)
    for name, content, said in (
        ("torn.obj", b"v 0 0\nf 1 2 9\n", "torn.obj"),
        ("large.obj", large, f"at most {MOST_FACETS} facets"),
    ):
        began = time.monotonic()
        file_id = sent(judging, name, content)
        answer = judging.client.post("/v1/jobs", json=with_mesh(scene, file_id))
        assert answer.status_code == 422, answer.text
        assert said in answer.text
        assert answer.json()["errors"][0]["pointer"] == "/targets/0/body/path"
        assert time.monotonic() - began < 15
    good = with_mesh(scene, sent(judging, "whole.obj", corners + faces))
    answer = judging.client.post("/v1/jobs", json=good)
    assert answer.status_code == 202, answer.text
    assert judging.ended(answer.headers["location"])["phase"] == "COMPLETED"


def test_good_files_are_judged_once_for_all_seeds(judging: Any, scene: dict[str, Any]) -> None:
    scene["sensor"]["flat"] = sent(judging, "flat.npy", flat_of(0.9))
    jobs = []
    for seed in range(20):
        began = time.monotonic()
        jobs.append(judging.submit(scene | {"seed": seed, "name": f"point-{seed}"}))
        assert seed == 0 or time.monotonic() - began < 1.0
    for job in jobs:
        judging.client.delete(job)


def test_of_more_judgements_than_are_kept_the_oldest_go(
    tmp_path: Path, scene: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two are kept: a third takes the first one's place, and is known afterwards."""
    judged: list[str] = []

    async def look(_: Looks, team: str, *__: Any) -> None:
        judged.append(team)

    async def stay() -> None:
        await asyncio.Event().wait()

    async def story() -> None:
        seen = Looks(Settings(tmp_path), Mock(), threading.Event())
        for team in ("a", "b", "c", "c", "b", "a"):
            await seen.judge(Mock(receive=stay), team, scene)

    monkeypatch.setattr(looks, "KEPT", 2)
    monkeypatch.setattr(Looks, "_look", look)
    scene["sensor"]["flat"] = f"upload:{'0' * 32}.npy"
    asyncio.run(story())
    assert judged == ["a", "b", "c", "a"]


def test_what_cannot_be_judged_in_time_is_taken(
    make_server: Callable[..., Any], scene: dict[str, Any]
) -> None:
    """The job then says it, by the user's name of the file, and no line of the log is an error."""
    server = make_server(NIGHTGLASS_JUDGE_S="0.01")
    scene["sensor"]["flat"] = sent(server, "my-camera.npy", flat_of(1.0, 32))
    ended = server.ended(server.submit(scene))
    assert ended["phase"] == "ERROR"
    assert "my-camera.npy" in ended["error"]["errors"][0]["value"]
    assert "my-camera.npy" in ended["error"]["message"]
    said = server.client.get(f"{ended['links']['self']}/plan").json()["detail"]
    assert said == "the job is ERROR: it has no plan"
    assert '"level": "error"' not in server.logged()
