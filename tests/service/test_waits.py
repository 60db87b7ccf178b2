"""Answers that wait for a job to change: how long, for what, and that their deadline allows it."""

from __future__ import annotations

import asyncio
import threading
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from service.engine import looks
from service.http.gate import DEADLINE
from service.jobs.changes import Changes
from service.jobs.jobs import Phase
from service.jobs.views import etag
from service.routes.jobs import watch
from service.settings import Settings
from service.standards.uws import _wait
from tests.service.jobs.test_jobs import shown

P, ANSWER_S = Phase, 40.0


class Waited:
    """A service whose job is the next of `phases` whenever somebody has waited for it."""

    def __init__(self, phases: list[Phase]) -> None:
        self.jobs = [replace(shown(p), version=k) for k, p in enumerate(phases)]
        self.waits: list[float] = []
        self.until: list[float] = []
        self.settings = SimpleNamespace(answer_s=ANSWER_S, wait_s=500.0, dashboard=None)
        self.changes = SimpleNamespace(places=SimpleNamespace(taken=lambda team: nullcontext()))
        self.caller, self.store = SimpleNamespace(team="red"), SimpleNamespace(get=self._get)
        deadline = SimpleNamespace(reschedule=self.until.append)
        self.request: Any = SimpleNamespace(scope={DEADLINE: deadline})

    async def change(self, job: Any, left_s: float) -> None:
        assert (job.id, job.version) == (self.jobs[0].id, self.jobs[0].version)
        self.waits.append(left_s)
        del self.jobs[0]

    def _get(self, job_id: str) -> Any:
        return self.jobs[0]


@pytest.mark.parametrize(
    ("phases", "asked", "waits"),
    [
        ([P.QUEUED, P.QUEUED, P.EXECUTING], P.QUEUED, 2),
        ([P.EXECUTING, P.EXECUTING, P.COMPLETED], P.EXECUTING, 2),
        ([P.EXECUTING], P.QUEUED, 0),
        ([P.QUEUED], P.EXECUTING, 0),
        ([P.PENDING], P.PENDING, 0),
        ([P.COMPLETED], P.COMPLETED, 0),
        ([P.ERROR], P.EXECUTING, 0),
    ],
)
def test_uws_waits_while_the_phase_is_the_one_asked_for(
    phases: list[Phase], asked: Phase, waits: int
) -> None:
    """Of a job that is under way; the request may take so long, and its answer's time."""

    async def talk() -> None:
        service: Any = Waited(phases)
        now_s = asyncio.get_running_loop().time()
        job = await _wait(service.request, service, service.jobs[0], asked, 300.0)
        assert (job.phase, len(service.waits)) == (phases[-1], waits)
        assert service.waits == pytest.approx([300.0] * waits, abs=20.0)
        assert service.until == pytest.approx([now_s + 300.0 + ANSWER_S], abs=20.0)
        timeless: Any = Waited([P.QUEUED])
        job = await _wait(timeless.request, timeless, timeless.jobs[0], P.QUEUED, 0.0)
        assert (job.phase, timeless.waits) == (P.QUEUED, [])

    asyncio.run(talk())


@pytest.mark.parametrize(
    ("phases", "wait_s", "known", "waits"),
    [
        ([P.QUEUED, P.EXECUTING], 300.0, None, [300.0]),
        ([P.QUEUED, P.EXECUTING], 300.0, 0, [300.0]),
        ([P.QUEUED, P.EXECUTING], 3000.0, 0, [500.0]),  # the most of the settings
        ([P.QUEUED], 300.0, 1, []),  # it has changed already
        ([P.QUEUED], 0.0, 0, []),
        ([P.COMPLETED], 300.0, 0, []),
    ],
)
def test_a_watch_waits_for_a_change_of_what_is_known(
    phases: list[Phase], wait_s: float, known: int | None, waits: list[float]
) -> None:
    async def talk() -> None:
        service: Any = Waited(phases)
        first, now_s = service.jobs[0], asyncio.get_running_loop().time()
        tag = None if known is None else etag(replace(first, version=known))
        answer = await watch(service.request, service, first.id, wait_s, tag)
        assert service.waits == waits
        ends = [now_s + s + ANSWER_S for s in waits]
        assert service.until == pytest.approx(ends, abs=20.0)
        assert answer.status_code == (304 if tag == etag(service.jobs[0]) else 200)
        assert answer.headers["etag"] == etag(service.jobs[0])

    asyncio.run(talk())


def test_a_watch_waits_behind_a_proxy_that_packs_answers() -> None:
    """It makes the ETag weak, and the client sends it back so: unchanged, all the same."""

    async def talk() -> None:
        service: Any = Waited([P.QUEUED, P.EXECUTING])
        first = service.jobs[0]
        await watch(service.request, service, first.id, 300.0, f"W/{etag(first)}")
        assert service.waits == [300.0]

    asyncio.run(talk())


def test_a_wait_ends_before_a_proxy_gives_up() -> None:
    """nginx, and most others, answer with 504 after 60 s."""
    assert Settings(Path()).wait_s < 60.0


@pytest.mark.parametrize(
    ("look", "found", "more"),
    [("plan", "plan", ()), ("forecast", "forecast", ()), ("observe", "observed", ({"snr": 5.0},))],
)
def test_a_look_may_take_longer_than_other_answers(
    monkeypatch: pytest.MonkeyPatch, look: str, found: str, more: Any
) -> None:
    """`plan_s`, and its answer's time: of a dry run, a forecast, an observation."""
    monkeypatch.setattr(looks, "look_at", lambda *_: {found: {"tiles": 2}})
    monkeypatch.setattr(looks, "engine_scene", lambda scene, _: scene)

    async def talk() -> None:
        service: Any = Waited([P.QUEUED])
        settings = Settings(Path(), plan_s=70.0, answer_s=ANSWER_S)
        files: Any = SimpleNamespace(names=lambda *_: {})
        service.request.receive = asyncio.Event().wait  # the caller stays
        asked = getattr(looks.Looks(settings, files, threading.Event()), look)
        now_s = asyncio.get_running_loop().time()
        assert await asked(service.request, "red", {"name": "small"}, *more) == {"tiles": 2}
        assert service.until == pytest.approx([now_s + 70.0 + ANSWER_S], abs=20.0)

    asyncio.run(talk())


@pytest.mark.parametrize("last", [{"a": 4, "b": 7}, {"b": 7}], ids=["changed", "gone"])
def test_waiting_ends_with_the_change_of_that_job(
    monkeypatch: pytest.MonkeyPatch, last: dict[str, int]
) -> None:
    """Not before, and not for another's; by the limit where nothing changes. One look for all."""
    monkeypatch.setattr("service.jobs.changes.BETWEEN_LOOKS_S", 0.001)
    looks: list[list[str]] = []
    told = [{"a": 3, "b": 7}] * 3

    def versions(asked: list[str]) -> dict[str, int]:
        looks.append(sorted(asked))
        return told[len(looks) - 1] if len(looks) <= len(told) else last

    async def talk() -> None:
        changes = Changes(SimpleNamespace(versions=versions), 9)  # type: ignore[arg-type]
        other = asyncio.create_task(changes.after("b", 7, 60.0))
        await asyncio.gather(*(changes.after("a", 3, 60.0) for _ in range(5)))
        assert looks == [["a", "b"]] * 4
        assert not other.done()
        other.cancel()
        await changes.after("b", 7, 0.01)
        assert changes._looking is not None
        await changes._looking  # nobody waits: nobody looks

    asyncio.run(talk())
