"""Bodies that were accepted are kept: what is kept changes no answer, and nothing outlives it."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Any

import pytest

from catalog_tools.catalogue import MANIFEST_NAME
from pipeline.spec.load import parse_scene
from service.problems import Malformed, NotAllowed
from service.scenes.accepted import LARGEST_KEPT, Acceptance
from service.settings import Settings


def nothing(_: str) -> bool:
    return False


def read(kept: Acceptance, data: Any, team: str = "a", has_file: Any = nothing) -> Any:
    body = data if isinstance(data, bytes) else json.dumps(data).encode()
    return asyncio.run(kept.read(team, body, has_file))


def settings_of(tmp_path: Path) -> Settings:
    settings = Settings(tmp_path)
    settings.make_folders()
    return settings


def test_the_same_bytes_are_judged_once(tmp_path: Path, scene: dict[str, Any]) -> None:
    kept = Acceptance(settings_of(tmp_path))
    first, again = read(kept, scene), read(kept, scene)
    assert again is first
    assert first.scene() == parse_scene(scene).as_dict()
    assert first.pixel_frames == 64 * 64 * 2
    turned = dict(reversed(scene.items()))
    assert read(kept, turned).body_sha256 == first.body_sha256  # the order of keys tells nothing
    assert read(kept, scene | {"seed": 8}).body_sha256 != first.body_sha256
    assert kept.reused == 1
    assert read(kept, scene, "b") is not first  # another team's is its own
    assert kept.reused == 1


def test_the_same_bytes_at_once_are_kept_once(tmp_path: Path, scene: dict[str, Any]) -> None:
    """And what they take of the memory is counted once."""
    one, both = (Acceptance(settings_of(tmp_path)) for _ in range(2))
    alone, body = read(one, scene), json.dumps(scene).encode()

    async def twice() -> list[Any]:
        return await asyncio.gather(*(both.read("a", body, nothing) for _ in range(2)))

    assert [found.body_sha256 for found in asyncio.run(twice())] == [alone.body_sha256] * 2
    assert (both.reused, both.kept_bytes) == (0, one.kept_bytes)


def test_what_a_scene_names_is_looked_for_every_time(
    tmp_path: Path, scene: dict[str, Any]
) -> None:
    kept, there = Acceptance(settings_of(tmp_path)), {"f" * 32 + ".npy"}
    scene["sensor"]["flat"] = f"upload:{'f' * 32}.npy"
    scene["stars"] = {"catalogue": "gaia"}
    folder = tmp_path / "catalogues" / "gaia"
    folder.mkdir()
    (folder / MANIFEST_NAME).write_text("{}")
    read(kept, scene, has_file=there.__contains__)
    read(kept, scene, has_file=there.__contains__)
    assert kept.reused == 1
    with pytest.raises(NotAllowed, match=r"sensor\.flat"):
        read(kept, scene, has_file=nothing)
    (folder / MANIFEST_NAME).unlink()
    with pytest.raises(NotAllowed, match=r"stars\.catalogue"):
        read(kept, scene, has_file=there.__contains__)


def test_refusals_are_not_kept_and_memory_is_bounded(
    tmp_path: Path, scene: dict[str, Any]
) -> None:
    kept = Acceptance(settings_of(tmp_path), kept_bytes=50_000)
    for _ in range(2):
        with pytest.raises(Malformed):
            read(kept, b'{"a": NaN}')
    large = json.dumps(scene).encode() + b" " * LARGEST_KEPT
    assert read(kept, large) is not read(kept, large)
    assert (kept.reused, kept.kept_bytes) == (0, 0)
    for seed in range(100):
        read(kept, scene | {"seed": seed})
        assert kept.kept_bytes <= 50_000
    read(kept, scene | {"seed": 99})
    assert kept.reused == 1
    read(kept, scene | {"seed": 0})  # the least recently used has gone
    assert kept.reused == 1


def test_with_a_query_and_without_the_answers_are_the_same(
    server: Any, scene: dict[str, Any]
) -> None:
    """Plain submissions take a shorter way through the application."""
    bad = scene | {"seed": -1}
    for data, status in ((scene, 202), (bad, 422)):
        answers = [
            server.client.post(path, json=data, headers={"idempotency-key": f"{status}{i}"})
            for i, path in enumerate(("/v1/jobs", "/v1/jobs?dry_run=0"))
        ]
        assert [a.status_code for a in answers] == [status, status], answers[0].text
        one, two = (a.json() for a in answers)
        assert set(one) == set(two)
        if status == 422:
            assert one == two
        else:
            shown = ("name", "phase", "kind", "owner", "tiles_total", "error")
            assert [one[n] for n in shown] == [two[n] for n in shown]
            headers = [set(a.headers) - {"date"} for a in answers]
            assert headers[0] == headers[1]
            for answer in answers:
                server.client.delete(answer.headers["location"])
    odd = server.client.post("/v1/jobs?dry_run=perhaps", json=scene)
    assert (odd.status_code, "dry_run" in odd.text) == (422, True)
    for headers in ({"idempotency-key": "a b"}, {"content-type": "text/plain"}):
        answers = [server.client.post(p, content=b"{}", headers=headers)
                   for p in ("/v1/jobs", "/v1/jobs?dry_run=0")]  # fmt: skip
        assert answers[0].status_code == answers[1].status_code >= 400
        assert answers[0].json() == answers[1].json()
    assert 'route="/v1/jobs"' in server.client.get("/metrics").text
