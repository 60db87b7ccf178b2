"""The job record: what may follow what, keys, order, and that it outlives the process."""

from __future__ import annotations

import asyncio
import fcntl
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import pytest
import sqlalchemy as sa
from hypothesis import given, settings
from hypothesis import strategies as st
from starlette.requests import Request

from pipeline.errors import BadInput, Damaged
from pipeline.store.layout import LOCK
from service.accounts.teams import pixel_frames_of
from service.engine.attempts import Attempt
from service.engine.cluster import SchedulerHealth
from service.jobs import submissions
from service.jobs.jobs import FINAL, LOCAL, NEXT, Job, Phase, Queue
from service.jobs.submissions import Ask, Intake, TeamLimits, submit_many
from service.jobs.views import job_dict
from service.problems import KeyReused, NotAllowed, NotReady, NotThere, QueueFull
from service.settings import Settings
from service.standards.ogc import _status
from service.store.database import writing
from service.store.tables import uploads


@pytest.fixture
def store(tmp_path: Path) -> Queue:
    return Queue(tmp_path / "jobs.sqlite")


def queue(store: Queue, key: str | None = None, body: str = "b", limit: int = 100) -> Job:
    ask = Ask("name", {"a": 1}, body, key)
    [answer] = submit_many(store, [ask], TeamLimits(queued_jobs=limit))
    if isinstance(answer, Exception):
        raise answer
    return answer[0]


def test_jobs_that_are_deleted_are_not_counted(store: Queue) -> None:
    """Neither one that waited nor one that runs until the dispatcher has stopped it."""
    first, second, third = (queue(store) for _ in range(3))
    assert store.claim() is not None
    for gone in (first, second):
        store.delete(gone.id)
    assert store.get(third.id).phase == Phase.QUEUED
    assert {phase for phase, count in store.counts().items() if count} == {Phase.QUEUED}
    assert store.counts()[Phase.QUEUED] == 1


def test_a_job_outlives_its_store(tmp_path: Path) -> None:
    store = Queue(tmp_path / "jobs.sqlite")
    job = queue(store, key="k")
    claimed = store.claim()
    assert claimed is not None
    store.progress(claimed, 3, 9)
    store.close()
    again = Queue(tmp_path / "jobs.sqlite")
    found = again.get(job.id)
    assert (found.phase, found.tiles_done, found.tiles_total) == (Phase.EXECUTING, 3, 9)
    assert again.scene(job.id) == {"a": 1}
    taken = again.claim()
    assert taken is not None
    assert (taken.id, taken.attempt) == (job.id, 2)
    assert claimed.started_s is not None
    assert taken.started_s == claimed.started_s  # from which the time that it may take is counted


def test_an_earlier_attempt_can_no_longer_write(store: Queue) -> None:
    queue(store)
    first = store.claim()
    second = store.claim()
    assert first is not None
    assert second is not None
    with pytest.raises(NotReady):
        store.progress(first, 1, 2)
    with pytest.raises(NotReady):
        store.finish(first, Phase.COMPLETED)
    store.finish(second, Phase.COMPLETED)


def test_jobs_left_behind_go_on_in_their_order(store: Queue) -> None:
    made = [queue(store) for _ in range(3)]
    busy: list[str] = []
    for _ in made:
        taken = store.claim(busy)
        assert taken is not None
        busy.append(taken.id)
    assert busy == [job.id for job in made]
    again = store.claim()
    assert again is not None
    assert (again.id, again.attempt) == (made[0].id, 2)


def test_key_replays_and_refuses_another_body(store: Queue) -> None:
    job = queue(store, key="k", body="one")
    assert queue(store, key="k", body="one") == job
    with pytest.raises(KeyReused):
        queue(store, key="k", body="two")
    store.delete(job.id)
    assert queue(store, key="k", body="two").id != job.id


def test_one_job_per_key_whatever_comes_at_once(store: Queue) -> None:
    with ThreadPoolExecutor(8) as pool:
        made = list(pool.map(lambda i: queue(store, key=f"k{i % 4}"), range(40)))
    assert len({job.id for job in made}) == len(store.listing((), 0, 50)) == 4


def test_a_job_that_kills_its_workers_ends(store: Queue, tmp_path: Path) -> None:
    """Three deaths in a row without a tile end it; a tile in between starts the count again."""
    made, here = queue(store), SchedulerHealth("threads")
    for deaths, tiles in ((1, 0), (2, 0), (1, 5), (2, 5)):
        job = store.claim()
        assert job is not None
        store.progress(job, tiles, 9)
        Attempt(Settings(tmp_path), store, job, lambda: True, here).count_death()
        assert (store.get(made.id).phase, store.get(made.id).deaths) == (Phase.EXECUTING, deaths)
    job = store.claim()
    assert job is not None
    Attempt(Settings(tmp_path), store, job, lambda: True, here).count_death()
    found = store.get(made.id)
    assert found.phase == Phase.ERROR
    assert found.error is not None
    assert "died" in found.error["message"]


@pytest.mark.parametrize(("tiles", "attempts"), [({}, 4), ({3: 5}, 6), ({3: 0}, 4)])
def test_a_job_is_tried_again_for_so_long(
    store: Queue,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    tiles: dict[int, int],
    attempts: int,
) -> None:
    """After 1, 2, 4, 8 s, for the 10 s of the setting; a tile in between starts both again."""
    clock, tried = [1000.0], []

    def sleep(s: float) -> None:
        clock[0] += s

    def attempt(self: Any) -> Any:
        tried.append(clock[0])
        assert len(tried) < 20
        if len(tried) in tiles:
            store.progress(self._job, tiles[len(tried)], 9)
        return {"kind": "try later", "message": "not there", "errors": []}

    told = SimpleNamespace(monotonic=lambda: clock[0], sleep=sleep)
    monkeypatch.setattr("service.engine.attempts.time", told)
    monkeypatch.setattr(Attempt, "_attempt", attempt)
    queue(store)
    job = store.claim()
    assert job is not None
    waits = Settings(tmp_path, scheduler_s=10.0)
    Attempt(waits, store, job, lambda: True, SchedulerHealth("threads")).run()
    ended = store.get(job.id)
    assert ended.error is not None
    assert (ended.phase, ended.error["message"]) == (Phase.ERROR, "not there")
    assert (len(tried), ended.attempt) == (attempts, attempts)
    begun = tried[2] if attempts == 6 else tried[0]
    assert clock[0] - begun == pytest.approx(10.0, abs=0.5)


def test_a_limit_that_is_changed_while_a_job_runs_holds(store: Queue, tmp_path: Path) -> None:
    """A shorter one ends it, a longer one or none lets it go on."""
    made = queue(store)
    job = store.claim()
    assert job is not None
    attempt = Attempt(Settings(tmp_path), store, job, lambda: True, SchedulerHealth("threads"))
    for limit_s, over in ((1e-9, True), (1000.0, False), (2e-9, True), (None, False)):
        store.amend(made.id, duration_s=limit_s)
        told = attempt._why_stopped()
        assert attempt._must_stop() == over
        assert ("" if told is None else told["message"]) == (
            f"it ran longer than the {limit_s:g} s that it was given" if over else ""
        )


def test_a_lock_that_cannot_be_asked_is_not_that_of_an_earlier_worker(
    store: Queue, tmp_path: Path
) -> None:
    """One that is held is waited for; else the attempt ends, and with it its place."""
    queue(store)
    job = store.claim()
    assert job is not None
    settings, asked = Settings(tmp_path), iter([True, True, False, True, False])
    attempt = Attempt(settings, store, job, lambda: next(asked), SchedulerHealth("threads"))
    lock = settings.product(job.id) / LOCK
    lock.parent.mkdir(parents=True)
    with lock.open("w") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        assert not attempt._alone()
    lock.unlink()
    lock.mkdir()
    with pytest.raises(IsADirectoryError):
        attempt._alone()


@pytest.mark.parametrize("down", [True, False])
def test_a_scheduler_is_asked_once_in_two_seconds(
    monkeypatch: pytest.MonkeyPatch, down: bool
) -> None:
    """One that is down, too: requests of that time do not wait for it one after the other."""
    now, asked = [100.0], []

    def ask(address: str, patience_s: float) -> None:
        asked.append(now[0])
        if down:
            raise Damaged(address, "gone")

    monkeypatch.setattr("catalog_tools.engine.clusters.ask", ask)
    monkeypatch.setattr("service.engine.cluster.time", SimpleNamespace(monotonic=lambda: now[0]))
    health = SchedulerHealth("tcp://127.0.0.1:1")
    for now[0] in (100.0, 100.5, 101.9, 102.5, 104.0):
        assert ("gone" in health.fault()) == down
    assert asked == [100.0, 102.5]


def test_full_queue_refuses(store: Queue) -> None:
    first = queue(store, key="k", limit=1)
    with pytest.raises(QueueFull):
        queue(store, limit=1)
    assert queue(store, key="k", limit=1) == first


def test_listing_by_cursor_and_phase(store: Queue) -> None:
    made = [queue(store) for _ in range(5)]
    store.cancel(made[1].id)
    store.delete(made[2].id)
    assert [j.id for j in store.listing((), made[0].number, 2)] == [made[1].id, made[3].id]
    assert [j.id for j in store.listing((Phase.ABORTED,), 0, 10)] == [made[1].id]
    assert store.counts()[Phase.QUEUED] == 3


def test_the_newest_of_some_phases_are_found_behind_newer_ones(store: Queue) -> None:
    submit_many(store, [Ask("old", {"a": 1}, "b", phase=Phase.PENDING)], TeamLimits())
    made = [queue(store) for _ in range(3)]
    assert [job.name for job in store.newest(2, phases=[Phase.PENDING])] == ["old"]
    assert store.newest(2) == store.newest(2, phases=[Phase.QUEUED]) == made[:0:-1]
    assert store.newest(9, after_s=made[1].submitted_s) == made[2:]


def test_a_job_that_is_deleted_while_it_runs_is_cleared_away_after_it_ended(store: Queue) -> None:
    """Until then its worker writes what is to be removed, and its record takes the outcome."""
    waits, runs = queue(store), queue(store)
    store.delete(waits.id)
    assert store.deleted() == [waits.id]
    store.forget(waits.id)
    job = store.claim()
    assert job is not None
    assert job.id == runs.id
    store.delete(runs.id)
    assert store.deleted() == []
    store.finish(job, Phase.ABORTED)
    assert store.deleted() == [runs.id]
    store.forget(runs.id)
    assert store.deleted() == []


def test_a_database_of_another_format_is_refused(tmp_path: Path) -> None:
    import sqlite3

    with sqlite3.connect(tmp_path / "jobs.sqlite") as db:
        db.execute("PRAGMA user_version = 99")
    with pytest.raises(BadInput):
        Queue(tmp_path / "jobs.sqlite")


ACTIONS = st.sampled_from(
    ["claim", "cancel", "delete", "progress", "COMPLETED", "ERROR", "ABORTED"]
)


@settings(max_examples=25, deadline=None)
@given(st.lists(ACTIONS, max_size=8))
def test_limits_phases_follow_the_table(
    tmp_path_factory: pytest.TempPathFactory, actions: list[str]
) -> None:
    """Whatever is asked in whatever order, a job only moves as NEXT allows, and ends once."""
    store = Queue(tmp_path_factory.mktemp("store") / "jobs.sqlite")
    made = queue(store)
    before = made
    for action in actions:
        try:
            if action == "claim":
                store.claim()
            elif action == "progress":
                store.progress(before, 1, 2)
            elif action in ("cancel", "delete"):
                getattr(store, action)(made.id)
            else:
                store.finish(before, Phase(action))
        except (NotReady, NotThere):
            assert store.seen(made) == before
        after = store.seen(made)
        assert after.phase == before.phase or after.phase in NEXT[before.phase]
        assert after == before or after.version > before.version
        assert (after.ended_s is not None) == (after.phase in FINAL)
        before = after
    store.close()


def shown(phase: Phase, kind: str | None = None) -> Job:
    """A job of which every time and number is another."""
    plain: dict[str, Any] = dict.fromkeys(Job.__dataclass_fields__)
    times = {"submitted_s": 1.25, "started_s": 2.5, "ended_s": 3.75}
    numbers = {"tiles_done": 3, "tiles_total": 8, "attempt": 4, "bytes_kept": 5}
    error = {"kind": kind, "message": "why", "errors": []} if kind else None
    return Job(**plain | times | numbers | {
        "id": "a" * 32, "kind": "scene", "name": "n", "owner": "me", "phase": phase,
        "error": error, "content_digest": "d",
    })  # fmt: skip


@pytest.mark.parametrize(
    ("phase", "links", "status"),
    [
        (Phase.PENDING, {"cancel"}, "accepted"),
        (Phase.QUEUED, {"cancel"}, "accepted"),
        (Phase.EXECUTING, {"cancel", "dashboard"}, "running"),
        (Phase.COMPLETED, {"results", "preview", "plan", "report"}, "successful"),
        (Phase.ERROR, set(), "failed"),
        (Phase.ABORTED, set(), "dismissed"),
    ],
)
def test_a_job_tells_its_own_times_and_what_may_be_done(
    phase: Phase, links: set[str], status: str
) -> None:
    """Each number under its name; the words of OGC API Processes 1.0, table 14."""
    told = job_dict(shown(phase), "http://dash")
    assert set(told["links"]) - {"self", "events", "scene"} == links
    whole = {"submitted": "01.250", "started": "02.500", "ended": "03.750"}
    times = {name: f"1970-01-01T00:00:{text}+00:00" for name, text in whole.items()}
    assert {k: told[k] for k in times} == times
    numbers = [told[k] for k in ("tiles_done", "tiles_total", "attempt", "bytes_kept")]
    assert numbers == [3, 8, 4, 5]
    scope = {"type": "http", "scheme": "http", "server": ("h", 80), "path": "/", "headers": []}
    info = _status(Request(scope | {"root_path": "", "query_string": b""}), shown(phase))
    named = ("status", "progress", "created", "started", "finished")
    assert [info[k] for k in named] == [status, 37, *times.values()]


@pytest.mark.parametrize("kind", ["try later", "incomplete", "disk full", "fault"])
def test_a_job_that_is_run_again_begins_anew(store: Queue, kind: str) -> None:
    """What ended it, its times and its dead workers count no more; a bad scene stays bad."""
    assert "retry" in job_dict(shown(Phase.ERROR, kind))["links"]
    assert "retry" not in job_dict(shown(Phase.ERROR, "bad input"))["links"]
    for phase in set(Phase) - {Phase.ERROR}:
        assert "retry" not in job_dict(shown(phase, kind))["links"]
    queue(store)
    job = store.claim()
    assert job is not None
    store.died(job, 2)
    store.finish(job, Phase.ERROR, error={"kind": kind, "message": "", "errors": []})
    again = store.retry(job.id)
    assert (again.phase, again.deaths, again.cancel_asked) == (Phase.QUEUED, 0, False)
    assert (again.error, again.started_s, again.ended_s) == (None, None, None)


def test_a_job_that_is_run_again_is_one_more_that_waits(store: Queue) -> None:
    """It has to have its place among the team's jobs, and each file that it names."""
    file_id = "f" * 32 + ".npy"
    whose = {"team": LOCAL, "id": file_id, "name": "a.npy", "bytes": 1, "created_s": 0.0}
    with writing(store.engine) as db:
        db.execute(sa.insert(uploads), [whose])
    scene = {"sensor": {"flat": f"upload:{file_id}"}}
    submit_many(store, [Ask("n", scene, "b")], TeamLimits())
    job = store.claim()
    assert job is not None
    store.finish(job, Phase.ERROR, error={"kind": "fault", "message": "", "errors": []})
    queue(store)
    with pytest.raises(QueueFull, match="1 jobs are waiting already"):
        store.retry(job.id, limits=TeamLimits(queued_jobs=1))
    with writing(store.engine) as db:
        db.execute(sa.delete(uploads))
    with pytest.raises(NotAllowed, match="there is no such file"):
        store.retry(job.id)
    assert store.get(job.id).phase == Phase.ERROR
    with writing(store.engine) as db:
        db.execute(sa.insert(uploads), [whose])
    assert store.retry(job.id, limits=TeamLimits(queued_jobs=2)).phase == Phase.QUEUED


def test_pixels_of_dwells_with_frames_of_their_own() -> None:
    """Dwells of 3 and of the scene's own 5 frames, of 20 x 30 pixels."""
    scene: dict[str, Any] = {"sensor": {"shape": [20, 30]}, "exposure": {"frames": 5}}
    assert pixel_frames_of(scene) == 5 * 600
    assert pixel_frames_of(scene | {"dwells": [{"frames": 3}, {}]}) == 8 * 600
    assert pixel_frames_of({"sensor": {}}) == 0


def test_jobs_that_the_table_does_not_take_are_refused_and_the_next_taken(
    store: Queue, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As long as its disk fails: each of those who wait is told so, and none waits for ever."""
    intake = Intake(store, TeamLimits())
    intake.start()

    async def put(count: int) -> list[Any]:
        asks = (intake.put(Ask("n", {"a": 1}, "b")) for _ in range(count))
        return await asyncio.wait_for(asyncio.gather(*asks, return_exceptions=True), 30)

    with monkeypatch.context() as patch:
        fault = OSError(5, "Input/output error")
        patch.setattr(submissions, "submit_many", Mock(side_effect=fault))
        assert asyncio.run(put(3)) == [fault] * 3
    [(job, new)] = asyncio.run(put(1))
    intake.stop()
    assert (job.phase, new, store.get(job.id).name) == (Phase.QUEUED, True, "n")
