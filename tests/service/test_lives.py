"""A job at the edges of its life: tampered tiles, times given, logs, the check of the table."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from catalog_tools.synthetic.synthetic import make_demo
from pipeline.route.run import render
from pipeline.spec.load import parse_scene
from pipeline.store import layout
from service.engine.attempts import Attempt, _too_long
from service.jobs.jobs import Job, Phase, Queue
from service.jobs.submissions import Ask, TeamLimits, submit_many
from service.store.database import sqlite_url
from tests.service.conftest import dies, is_dead


@pytest.fixture
def long_scene(scene: dict[str, Any]) -> dict[str, Any]:
    """Some seconds of work in many tiles."""
    scene["sensor"]["shape"] = [512, 512]
    scene["exposure"]["frames"] = 24
    return scene


@pytest.mark.slow
def test_tampered_tiles_are_drawn_again(
    make_server: Callable[..., Any], long_scene: dict[str, Any], tmp_path: Path
) -> None:
    """A chunk flipped, one emptied, one deleted, a marker cut, one flipped, one deleted."""
    long_scene["exposure"]["frames"] = 100
    server = make_server(NIGHTGLASS_DASHBOARD="http://127.0.0.1:8787/status")
    job = server.submit(long_scene)
    found = server.until(job, lambda found: (found["tiles_done"] or 0) >= 8)
    assert found["links"]["dashboard"] == "http://127.0.0.1:8787/status"
    server.kill()
    time.sleep(0.5)
    product = server.home / "products" / job.rpartition("/")[2]
    chunks = sorted(p for p in (product / "cube.zarr" / "dn" / "c").rglob("*") if p.is_file())
    markers = sorted((product / "markers").glob("f*.json"))
    assert len(chunks) >= 6
    assert len(markers) >= 6
    for path in (chunks[0], markers[1]):
        content = bytearray(path.read_bytes())
        content[len(content) // 2] ^= 4
        path.write_bytes(content)
    chunks[1].write_bytes(b"")
    markers[2].write_bytes(markers[2].read_bytes()[:40])
    chunks[3].unlink()
    markers[4].unlink()
    server.start()
    done = server.ended(job)
    assert done["phase"] == "COMPLETED", done
    alone = render(parse_scene(long_scene), tmp_path / "alone")
    assert done["content_digest"] == alone["content_digest"]


def test_what_the_service_began_before_an_upgrade_is_begun_anew(
    make_server: Callable[..., Any], long_scene: dict[str, Any]
) -> None:
    """Tiles of other code may have other bits: a killed job does not go on from them."""
    server = make_server()
    job = server.submit(long_scene)
    server.until(job, lambda found: (found["tiles_done"] or 0) >= 2)
    server.kill()
    time.sleep(0.5)
    product = server.home / "products" / job.rpartition("/")[2]
    begun = product / layout.BEGUN
    code = json.loads(begun.read_text())["code"]
    begun.write_text(json.dumps(json.loads(begun.read_text()) | {"code": "0"}))
    server.start()
    assert server.ended(job)["phase"] == "COMPLETED"
    assert json.loads((product / "report.json").read_text())["tiles_resumed"] == 0
    assert json.loads(begun.read_text())["code"] == code


def test_a_job_may_be_given_little_time_and_a_short_life(
    make_server: Callable[..., Any], long_scene: dict[str, Any]
) -> None:
    server = make_server()
    assert server.client.get("/readyz").json()
    store = Queue(sqlite_url(server.home / "jobs.sqlite"))
    scene = parse_scene(long_scene | {"seed": 5}).as_dict()
    asks = [
        Ask("short", scene, "b", duration_s=0.5),
        Ask("gone", scene, "b", destruction_s=time.time() + 1.0),
    ]
    (short, _), (gone, _) = submit_many(store, asks, TeamLimits())  # type: ignore[misc]
    found = server.ended(f"/v1/jobs/{short.id}")
    assert (found["phase"], "longer than" in found["error"]["message"]) == ("ABORTED", True)
    deadline = time.monotonic() + 60
    while server.client.get(f"/v1/jobs/{gone.id}").status_code != 404:
        assert time.monotonic() < deadline
        time.sleep(0.1)
    store.close()


def test_a_job_waits_for_a_catalogue_that_is_gone(
    make_server: Callable[..., Any], tmp_path: Path, scene: dict[str, Any]
) -> None:
    """It is tried again for as long as was set, ends with a word on the catalogue, and can be run
    again; one whose link comes back in time is drawn."""
    make_demo(tmp_path / "sky", faintest_g_mag=6.0)
    server = make_server(NIGHTGLASS_SCHEDULER_S="5")
    link = server.home / "catalogues" / "sky"
    link.symlink_to(tmp_path / "sky")
    frames = scene["exposure"] | {"frames": 100}
    before = server.submit(scene | {"exposure": frames})  # others wait behind it
    named = [scene | {"stars": {"catalogue": "sky"}, "seed": seed} for seed in (1, 2)]
    gone, back = map(server.submit, named)
    link.unlink()
    ended = server.ended(gone)
    assert (ended["phase"], ended["error"]["kind"]) == ("ERROR", "try later")
    assert ended["error"]["message"] == "the catalogue sky is not there now"
    assert ended["attempt"] > 1
    server.until(back, lambda found: found["attempt"] > 1)
    link.symlink_to(tmp_path / "sky")
    assert server.client.post(ended["links"]["retry"]).status_code == 202
    for job in (before, back, gone):
        assert server.ended(job)["phase"] == "COMPLETED"


def test_time_in_the_queue_is_not_time_given() -> None:
    """An hour's wait, and a second's work of the minute that it may take."""
    now = time.time()
    for since_s, too_long in ((1.0, False), (90.0, True)):
        job = SimpleNamespace(duration_s=60.0, submitted_s=now - 3600.0, started_s=now - since_s)
        assert _too_long(cast(Job, job)) is too_long


@pytest.mark.parametrize("phase", [Phase.ERROR, Phase.ABORTED])
def test_what_an_unfinished_job_drew_counts(phase: Phase, tmp_path: Path) -> None:
    """Its bytes are its team's until it is deleted, however it ended."""
    (tmp_path / "tiles").mkdir()
    for name, size in (("plan.json", 10), ("tiles/0", 7)):
        (tmp_path / name).write_bytes(bytes(size))
    ended: list[Any] = []
    attempts = Attempt.__new__(Attempt)
    attempts._product = tmp_path
    attempts._job = cast(Any, SimpleNamespace(id="j", attempt=1))
    store = SimpleNamespace(finish=lambda job, phase, **values: ended.append((phase, values)))
    attempts._store = cast(Any, store)
    attempts._finish(phase, error={"kind": "fault"})
    assert ended == [(phase, {"error": {"kind": "fault"}, "bytes_kept": 17})]


def test_pauses_before_another_attempt_double_up_to_a_minute() -> None:
    """Of an attempt that goes on failing; they begin anew once a tile was finished meanwhile."""
    paused: list[float] = []
    job = SimpleNamespace(id="j", attempt=1, tiles_done=0)

    class Failing(Attempt):
        def _attempt(self) -> dict[str, Any] | None:
            return {"message": "not there"}

        def _pause(self, pause_s: float, until_s: float) -> bool:
            paused.append(pause_s)
            return True

    attempts = Failing.__new__(Failing)
    done = iter([0] * 9 + [1] * 3)
    attempts._settings, attempts._job = cast(Any, SimpleNamespace(scheduler_s=1e4)), cast(Any, job)

    def again(job: Any, why: str) -> Any:
        return SimpleNamespace(id="j", attempt=2, tiles_done=len(paused) // 10)

    seen = SimpleNamespace(seen=lambda job: SimpleNamespace(tiles_done=next(done)), again=again)
    attempts._store = cast(Any, seen)
    attempts._go_on = lambda: len(paused) < 12
    attempts.run()
    assert paused == [1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 60.0, 60.0, 60.0, 1.0, 2.0, 4.0]


def test_debug_logs_name_tiles(make_server: Callable[..., Any], scene: dict[str, Any]) -> None:
    server = make_server(NIGHTGLASS_LOG="debug")
    job = server.ended(server.submit(scene))
    lines = [json.loads(line) for line in server.logged().splitlines() if line.startswith("{")]
    tiles = {line["tile"] for line in lines if line.get("job") == job["id"] and "tile" in line}
    assert tiles == {"f0_r0_c0", "f1_r0_c0"}
    assert any(line.get("method") == "POST" and line["status"] == 202 for line in lines)


def test_work_goes_on_though_what_forks_the_engine_dies(
    make_server: Callable[..., Any], scene: dict[str, Any]
) -> None:
    """A job that runs is not touched by it; what comes after it begins by another; one that is
    cancelled ends all the same."""
    server = make_server()
    assert server.forks() == []  # no order, no process
    long, longer = (scene | {"exposure": scene["exposure"] | {"frames": n}} for n in (120, 200))
    first, second = server.submit(long), server.submit(longer)
    server.until(first, lambda found: (found["tiles_done"] or 0) >= 2)
    [fork], [worker] = server.forks(), server.workers()
    fork.kill()
    done = server.ended(first)
    assert (done["phase"], done["attempt"]) == ("COMPLETED", 1)
    server.until(second, lambda found: (found["tiles_done"] or 0) >= 2)
    assert is_dead(worker)
    [other], [worker] = server.forks(), server.workers()
    assert other.pid != fork.pid
    other.kill()
    assert server.client.post(f"{second}/cancel").status_code == 202
    assert server.ended(second)["phase"] == "ABORTED"
    assert dies(worker)
    assert server.ended(server.submit(scene))["phase"] == "COMPLETED"
    [last] = server.forks()
    server.kill()
    assert dies(last)  # with its server
