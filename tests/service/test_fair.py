"""Dry runs and watchers: no team shuts others out, and what nobody waits for any more ends."""

from __future__ import annotations

import asyncio
import copy
import json
import select
import socket
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx
import psutil
import pytest
from fastapi.concurrency import run_in_threadpool

from service.app import create_app
from service.engine.runner import Dispatcher
from service.jobs.shares import IN_LINE, Shares
from service.problems import TooMany
from service.settings import Settings
from tests.service.conftest import SCENE, bearer

MANY = 6000  # targets, whose plan takes some 20 s
LIMITS = {"BODY_BYTES": 1 << 23, "TARGETS": 2 * MANY, "PLANS": 2, "WATCHERS": 40}


@pytest.fixture(scope="module")
def shared(keep_server: Callable[..., Any]) -> Any:
    """A server of two teams."""
    server = keep_server(**{f"NIGHTGLASS_{name}": str(most) for name, most in LIMITS.items()})
    red, blue = server.make_keys("red", "blue")
    server.keys = {"red": bearer(red), "blue": bearer(blue)}
    assert plan(server, "blue", copy.deepcopy(SCENE)) == 200  # imported and compiled by now
    return server


@pytest.fixture(scope="module")
def heavy() -> dict[str, Any]:
    scene = copy.deepcopy(SCENE)
    scene["exposure"]["frames"] = 500
    [target] = scene["targets"]
    scene["targets"] = [target | {"name": f"sat-{i + 1}"} for i in range(MANY)]
    return scene


def plan(server: Any, team: str, scene: dict[str, Any]) -> int:
    keys = server.keys[team]
    return server.client.post("/v1/jobs?dry_run=1", json=scene, headers=keys).status_code


def sent(server: Any, team: str, scene: dict[str, Any]) -> socket.socket:
    """The connection on which a dry run was asked for, and is answered."""
    url, body = httpx.URL(server.url), json.dumps(scene).encode()
    head = "POST /v1/jobs?dry_run=1 HTTP/1.1\r\ncontent-type: application/json\r\n"
    head += f"host: {url.host}\r\ncontent-length: {len(body)}\r\n"
    head += "".join(f"{name}: {value}\r\n" for name, value in server.keys[team].items())
    connection = socket.create_connection((url.host, url.port or 0))
    connection.sendall(f"{head}\r\n".encode() + body)
    return connection


def test_large_dry_runs_hold_up_no_other_team_and_end_when_abandoned(
    shared: Any, heavy: dict[str, Any], scene: dict[str, Any]
) -> None:
    asked = [sent(shared, "red", heavy) for _ in range(4)]
    while not shared.workers():
        time.sleep(0.05)
    assert plan(shared, "blue", scene) == 200
    answered, _, _ = select.select(asked, [], [], 0.0)
    assert not answered  # they were waited for all the while
    for connection in asked:
        connection.close()
    deadline = time.monotonic() + 5
    while shared.workers():
        assert time.monotonic() < deadline
        time.sleep(0.1)
    assert plan(shared, "red", scene) == 200


def test_one_teams_watchers_leave_places_for_others(shared: Any, scene: dict[str, Any]) -> None:
    with httpx.Client(base_url=shared.url, headers=shared.keys["red"]) as red:
        job = shared.held(scene, **shared.keys["red"])
        opened = []
        for _ in range(LIMITS["WATCHERS"]):
            request = red.build_request("GET", f"{job}/events")
            opened.append(red.send(request, stream=True))
        statuses = [answer.status_code for answer in opened]
        assert statuses == [200] * 20 + [429] * 20  # before any head of a stream was sent
        assert opened[-1].headers["retry-after"]
        assert red.get(job, params={"wait": 5}).status_code == 429
        with httpx.Client(base_url=shared.url, headers=shared.keys["blue"]) as blue:
            other = shared.held(scene, **shared.keys["blue"])
            assert blue.get(other, params={"wait": 0.5}).status_code == 200
        for answer in opened:
            answer.close()
        deadline = time.monotonic() + 10
        while "nightglass_watchers 0.0" not in shared.client.get("/metrics").text:
            assert time.monotonic() < deadline
            time.sleep(0.1)
        assert red.get(job, params={"wait": 0.5}).status_code == 200


def test_watchers_that_come_and_go_cost_no_memory(
    make_server: Callable[..., Any], scene: dict[str, Any]
) -> None:
    server = make_server(NIGHTGLASS_WATCHERS="2000")
    job = server.held(scene)
    limits = httpx.Limits(max_connections=None)

    def round_of(count: int) -> int:
        with httpx.Client(base_url=server.url, timeout=60, limits=limits) as client:
            for _ in range(count):
                request = client.build_request("GET", f"{job}/events")
                assert client.send(request, stream=True).status_code == 200
        while "nightglass_watchers 0.0" not in server.client.get("/metrics").text:
            time.sleep(0.1)
        return int(psutil.Process(server.process.pid).memory_info().rss)

    first = round_of(200)
    for _ in range(3):
        last = round_of(200)
    assert last - first < 4e6


def test_places_go_to_teams_in_turn() -> None:
    """Of four places one team has two; who waits is served team by team, who has gone is not."""

    async def story() -> list[str]:
        places, order = Shares(4, "dry runs"), []
        leave = asyncio.Event()

        async def one(team: str) -> None:
            async with places.place(team):
                order.append(team)
                await leave.wait() if len(order) <= 4 else await asyncio.sleep(0)

        asked = [asyncio.create_task(one(team)) for team in "aaaaabbcd"]
        await asyncio.sleep(0.01)
        assert "".join(order) == "aabc"
        asked[2].cancel()
        await asyncio.sleep(0.01)
        leave.set()
        await asyncio.gather(*asked, return_exceptions=True)
        assert places.held == 0
        with places.taken("a"), places.taken("a"), pytest.raises(TooMany):
            places.take("a")
        return order[4:]

    assert sorted(asyncio.run(story())) == list("aabd")


def test_a_line_has_an_end() -> None:
    """One at work and IN_LINE that wait: the next one of the team is refused, another's is not."""

    async def story() -> list[type]:
        places = Shares(4, "dry runs")

        async def one(team: str) -> None:
            async with places.place(team):
                await asyncio.sleep(0.01)

        teams = ["a"] * (2 + IN_LINE + 1) + ["b"]
        ends = await asyncio.gather(*map(one, teams), return_exceptions=True)
        return [type(end) for end in ends]

    ends = asyncio.run(story())
    assert [k for k, end in enumerate(ends) if end is TooMany] == [2 + IN_LINE]


def test_as_many_requests_are_worked_on_at_once_as_there_are_threads(tmp_path: Path) -> None:
    """Those that block have `request_threads`, whatever the library's own number is."""
    lock, now, most = threading.Lock(), [], []

    def work() -> None:
        with lock:
            now.append(1)
            most.append(len(now))
        time.sleep(0.05)
        with lock:
            now.pop()

    async def story() -> None:
        app = create_app(Settings(tmp_path, request_threads=3))
        async with app.router.lifespan_context(app):
            await asyncio.gather(*(run_in_threadpool(work) for _ in range(12)))

    asyncio.run(story())
    assert max(most) == 3


def test_a_place_is_given_back_whatever_becomes_of_its_request() -> None:
    async def fail(places: Shares) -> None:
        async with places.place("a"):
            raise ValueError("of a request that fails")

    places = Shares(4, "dry runs")
    with pytest.raises(ValueError, match="fails"), places.taken("a"):
        raise ValueError("of a request that fails")
    assert places.held == 0
    with pytest.raises(ValueError, match="fails"):
        asyncio.run(fail(places))
    assert places.held == 0


def test_a_dispatcher_knows_whose_turn_was_last_and_fills_its_slots(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two jobs in two slots; then one that has ended makes room, and no scheduler starts any."""
    queue = [SimpleNamespace(id=f"{k}", team=team) for k, team in enumerate(("red", "blue"))]
    asked: list[tuple[list[str], int, dict[str, float]]] = []
    done = threading.Event()

    def claim(busy: list[str], limit: int, turns: dict[str, float], _: str) -> Any:
        asked.append((busy, limit, dict(turns)))
        return queue.pop(0) if queue else None

    monkeypatch.setattr(Dispatcher, "_guarded", lambda *_: done.wait())
    store: Any = SimpleNamespace(engine=None, claim=claim)
    began, dispatcher = time.monotonic(), Dispatcher(Settings(tmp_path, slots=2), store)
    assert [dispatcher._step() for _ in range(3)] == [True, True, False]
    done.set()
    for thread in dispatcher._busy.values():
        thread.join()
    dispatcher.scheduler = SimpleNamespace(fault=lambda: "it is away")  # type: ignore[assignment]
    assert not dispatcher._step()
    assert [busy for busy, _, _ in asked] == [[], ["0"], []]
    assert [limit > 0 for _, limit, _ in asked] == [True, True, False]
    assert [list(turns) for _, _, turns in asked] == [[], ["red"], ["red", "blue"]]
    red, blue = asked[-1][2].values()
    assert began <= red <= blue <= time.monotonic()
