"""The job table in SQLite and PostgreSQL: batches, quotas, leases, forms, many processes."""

from __future__ import annotations

import asyncio
import os
import socket
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import sqlalchemy as sa
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from pipeline.errors import BadInput, TryLater
from service.accounts.auth import Caller
from service.app import _of_table
from service.jobs.jobs import FINAL, NEXT, Job, Phase, Queue
from service.jobs.submissions import Ask, Intake, TeamLimits, run_pending, submit_many, used_by
from service.jobs.views import job_dict
from service.problems import KeyReused, NotReady, NotThere, QueueFull, TableFault
from service.routes.jobs import _events
from service.scenes.uploads import Uploads
from service.settings import Settings
from service.store.database import LOCK_NUMBER, SILENCE, connect
from service.store.homes import FILE, check_home
from service.store.leases import give_up, take
from service.store.tables import audit, jobs, uploads


def ask(key: str | None = None, team: str = "red", body: str = "b", **more: Any) -> Ask:
    return Ask(name="n", scene={"a": 1}, body_sha256=body, key=key, team=team, **more)


def test_a_batch_is_one_commit_and_each_key_one_job(database: str) -> None:
    store = Queue(database)
    keys = [f"k{i % 5}" for i in range(20)]
    answers = submit_many(store, [ask(key) for key in keys], TeamLimits())
    found = [(job.id, made) for job, made in answers]
    assert len({job for job, _ in found}) == 5
    assert [made for _, made in found] == [i < 5 for i in range(20)]
    assert [j.number for j in store.listing((), 0, 50)] == [1, 2, 3, 4, 5]
    [again, other, blue] = submit_many(
        store, [ask("k0"), ask("k0", body="x"), ask("k0", team="blue")], TeamLimits()
    )
    assert again == (store.get(found[0][0]), False)
    assert isinstance(other, KeyReused)
    assert blue[1]
    store.close()


def test_a_table_is_that_of_one_data_folder(database: str, tmp_path: Path) -> None:
    """The jobs of another folder have their files there: they would be run without them."""
    one, other = tmp_path / "one", tmp_path / "other"
    one.mkdir()
    other.mkdir()
    engine = connect(database)
    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(lambda _: check_home(engine, one), range(4))) == [None] * 4
    with pytest.raises(BadInput, match=r"NIGHTGLASS_DATABASE.*another data folder"):
        check_home(engine, other)
    (other / FILE).write_bytes((one / FILE).read_bytes())  # moved there
    check_home(engine, other)
    store = Queue(database)
    [(job, made)] = submit_many(store, [ask()], TeamLimits())
    assert (job.number, made) == (1, True)
    store.close()
    engine.dispose()


def test_many_processes_worth_of_writers(database: str) -> None:
    """Threads with engines of their own, as processes have them: no job lost, none twice."""
    stores = [Queue(database) for _ in range(4)]

    def work(which: int) -> list[str]:
        out = []
        for i in range(15):
            [answer] = submit_many(stores[which], [ask(f"k{i}")], TeamLimits())
            out.append(answer[0].id)
        return out

    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(work, range(4)))
    assert all(ids == found[0] for ids in found)
    assert len(set(found[0])) == 15
    assert [j.number for j in stores[0].listing((), 0, 50)] == list(range(1, 16))
    claimed: list[Job] = []

    def claim(which: int) -> None:
        while (job := stores[which].claim([j.id for j in claimed])) is not None:
            claimed.append(job)

    threads = [threading.Thread(target=claim, args=(i,)) for i in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    last = {job.id: job for job in sorted(claimed, key=lambda j: j.attempt)}
    assert len(last) == 15
    for job in claimed:  # of two attempts at one job only the later may write
        if last[job.id].attempt == job.attempt:
            stores[0].finish(job, Phase.COMPLETED)
        else:
            with pytest.raises(NotReady):
                stores[0].finish(job, Phase.COMPLETED)
    for store in stores:
        store.close()


def test_events_of_every_version(database: str) -> None:
    """The ninth change is followed by the tenth; who comes back is told what is new."""
    store = Queue(database)
    [(job, _)] = submit_many(store, [ask(phase=Phase.PENDING)], TeamLimits())
    seen: list[int] = []

    async def after(*_: Any) -> None:
        if len(seen) < 12:
            store.amend(job.id, "red", TeamLimits(), run_id=f"run-{len(seen)}")
        else:
            store.delete(job.id, "red", "x")

    timing = SimpleNamespace(heartbeat_s=1.0)
    service: Any = SimpleNamespace(store=store, change=after, settings=timing)

    async def listen() -> str:
        text = ""
        async for event in _events(service, store.get(job.id), str(job.version)):
            text = event
            if event.startswith("id: "):
                seen.append(int(event.split()[1]))
            elif event.startswith("retry"):
                seen.append(job.version)
        return text

    last = asyncio.run(listen())
    assert seen == list(range(job.version, job.version + 12))
    assert max(seen) >= 10
    assert last.startswith("event: deleted")
    store.close()


def test_a_job_at_work_has_a_start_and_no_end(database: str) -> None:
    store = Queue(database)
    submit_many(store, [ask()], TeamLimits())
    job = store.claim()
    assert job is not None
    told = job_dict(store.get(job.id))
    assert told["started"] is not None
    assert told["ended"] is None
    store.finish(job, Phase.COMPLETED)
    assert job_dict(store.get(job.id))["ended"] >= told["started"]
    store.close()


def test_quotas(database: str) -> None:
    store = Queue(database)
    limits = TeamLimits(queued_jobs=3, pixel_frames_day=100, bytes_kept=50)
    answers = submit_many(store, [ask() for _ in range(5)], limits)
    assert [isinstance(a, QueueFull) for a in answers] == [False] * 3 + [True] * 2
    [other] = submit_many(store, [ask(team="blue", pixel_frames=90)], limits)
    assert other[1]
    [refused] = submit_many(store, [ask(team="blue", pixel_frames=11)], limits)
    assert "a day" in str(refused)
    [last] = submit_many(store, [ask(team="green", pixel_frames=100)], limits)
    assert last[1]  # all of it
    at_once = [ask(team="grey", pixel_frames=n) for n in (60, 30, 20, 10)]  # one commit
    answers = submit_many(store, at_once, limits)
    assert [isinstance(a, QueueFull) for a in answers] == [False, False, True, False]
    with store.engine.begin() as db:
        assert used_by(db, "grey", int(time.time() // 86_400)).pixel_frames == 100
    store.delete(other[0].id)  # what was asked for today stays asked for
    [refused] = submit_many(store, [ask(team="blue", pixel_frames=11)], limits)
    assert "a day" in str(refused)
    job = store.claim()
    assert job is not None
    store.finish(job, Phase.COMPLETED, bytes_kept=60)
    [refused] = submit_many(store, [ask()], limits)
    assert "bytes" in str(refused)
    store.close()


def test_pending_jobs_are_amended_and_run_once(database: str) -> None:
    store = Queue(database)
    [(job, _)] = submit_many(store, [ask(phase=Phase.PENDING)], TeamLimits())
    now = store.amend(job.id, "red", scene={"b": 2}, name="new", run_id="mine")
    assert now == store.get(job.id) != job
    assert (store.scene(job.id), store.get(job.id).run_id) == ({"b": 2}, "mine")
    assert store.claim() is None
    with pytest.raises(NotThere):
        run_pending(store, job.id, TeamLimits(), "blue", "x")
    assert run_pending(store, job.id, TeamLimits(), "red", "x").phase == Phase.QUEUED
    with pytest.raises(NotReady):
        run_pending(store, job.id, TeamLimits(), "red", "x")
    with pytest.raises(NotReady):
        store.amend(job.id, "red", scene={"c": 3})
    store.amend(job.id, "red", destruction_s=1.0)
    assert store.overdue() == [job.id]
    store.close()


def test_a_pending_job_does_not_stand_in_its_own_way(database: str) -> None:
    """A full quota counts the job that asks to run; one more than the quota is refused."""
    store, limits = Queue(database), TeamLimits(queued_jobs=2)
    [(first, _), (second, _)] = submit_many(
        store, [ask(phase=Phase.PENDING) for _ in range(2)], limits
    )
    assert isinstance(submit_many(store, [ask()], limits)[0], QueueFull)
    for job in (first, second):
        assert run_pending(store, job.id, limits, "red", "x").phase == Phase.QUEUED
    [(third, _)] = submit_many(store, [ask(phase=Phase.PENDING)], TeamLimits())
    with pytest.raises(QueueFull):
        run_pending(store, third.id, limits, "red", "x")
    assert store.get(third.id).phase == Phase.PENDING
    store.close()


def test_a_pending_job_grows_within_the_quota(database: str) -> None:
    """A larger scene counts as asked for, by what it is larger; one that is too large stays out."""
    store, limits = Queue(database), TeamLimits(pixel_frames_day=100)
    [(job, _)] = submit_many(store, [ask(phase=Phase.PENDING, pixel_frames=40)], limits)
    with pytest.raises(QueueFull, match="with this it would be 101"):
        store.amend(job.id, "red", limits, scene={"b": 2}, pixel_frames=101)
    assert (store.scene(job.id), store.get(job.id).pixel_frames) == ({"a": 1}, 40)
    for pixel_frames, counted in ((90, 90), (10, 90)):
        store.amend(job.id, "red", limits, scene={"b": 2}, pixel_frames=pixel_frames)
        with store.engine.connect() as db:
            assert used_by(db, "red", int(time.time() // 86_400)).pixel_frames == counted
    assert run_pending(store, job.id, limits, "red", "x").pixel_frames == 10
    store.close()


def test_a_pending_job_does_not_fill_the_queue_it_stands_in(database: str) -> None:
    """With the last place of the queue it may still grow; with more than all, it may not."""
    store, limits = Queue(database), TeamLimits(queued_jobs=1)
    [(job, _)] = submit_many(store, [ask(phase=Phase.PENDING, pixel_frames=4)], limits)
    store.amend(job.id, "red", limits, scene={"b": 2}, pixel_frames=5)
    assert (store.scene(job.id), store.get(job.id).pixel_frames) == ({"b": 2}, 5)
    submit_many(store, [ask()], TeamLimits())
    with pytest.raises(QueueFull):
        store.amend(job.id, "red", limits, scene={"c": 3}, pixel_frames=6)
    assert store.scene(job.id) == {"b": 2}
    store.close()


def test_a_deleted_job_is_not_overdue(database: str) -> None:
    """Its time of destruction came, and it is deleted already: nothing is left to be done."""
    store = Queue(database)
    [(job, _), (kept, _)] = submit_many(
        store, [ask(destruction_s=1.0) for _ in range(2)], TeamLimits()
    )
    assert sorted(store.overdue()) == sorted([job.id, kept.id])
    store.delete(job.id, "red")
    assert store.overdue() == [kept.id]
    assert store.deleted() == [job.id]
    store.close()


def test_files_of_a_team_count_in_what_it_keeps(database: str) -> None:
    """Products and uploads together are held against the quota; another team's are not."""
    store, limits = Queue(database), TeamLimits(bytes_kept=100)
    with store.engine.begin() as db:
        for team, size in (("red", 60), ("blue", 5000)):
            row = {"team": team, "id": "a.npy", "name": "a.npy", "bytes": size, "created_s": 0.0}
            db.execute(sa.insert(uploads), [row])
    submit_many(store, [ask()], limits)
    claimed = store.claim()
    assert claimed is not None
    store.finish(claimed, Phase.COMPLETED, bytes_kept=39)
    assert isinstance(submit_many(store, [ask()], limits)[0], tuple)
    with store.engine.connect() as db:
        assert used_by(db, "red", 0).bytes_kept == 99
    with store.engine.begin() as db:
        mine = uploads.c.team == "red"
        db.execute(sa.update(uploads).where(mine).values(bytes=61))
    assert "bytes" in str(submit_many(store, [ask()], limits)[0])
    store.close()


def test_bytes_that_two_teams_uploaded_stay_for_the_other(database: str, tmp_path: Path) -> None:
    """Files are named by their content: one on disk, whoever sent it, until the last lets go."""
    store, here = Queue(database), Settings(tmp_path)
    here.uploads.mkdir()
    files, file_id = Uploads(here, store.engine), "0" * 32 + ".npy"
    (here.uploads / file_id).write_bytes(b"x")
    with store.engine.begin() as db:
        row = {"id": file_id, "name": "a.npy", "bytes": 1, "created_s": 0.0}
        db.execute(sa.insert(uploads), [row | {"team": team} for team in ("red", "blue")])
    files.remove(Caller("red", "ann"), file_id)
    assert (files.has("red", file_id), files.has("blue", file_id)) == (False, True)
    assert (here.uploads / file_id).is_file()
    with pytest.raises(NotThere):
        files.remove(Caller("red", "ann"), file_id)
    files.remove(Caller("blue", "bob"), file_id)
    assert not (here.uploads / file_id).exists()
    store.close()


def test_what_is_left_of_files_that_no_longer_come_is_removed(
    database: str, tmp_path: Path
) -> None:
    """At the next start; what another service is still being sent stays, as all whole files do."""
    store, here = Queue(database), Settings(tmp_path, upload_s=60.0)
    here.uploads.mkdir()
    for name, age_s in (("a.npy", 900), (".part-old", 900), (".part-new", 30)):
        (here.uploads / name).write_bytes(b"x")
        os.utime(here.uploads / name, (time.time() - age_s,) * 2)
    Uploads(here, store.engine).remove_cut_off()
    assert {path.name for path in here.uploads.iterdir()} == {"a.npy", ".part-new"}
    store.close()


def test_files_that_come_at_once_are_counted_one_by_one(database: str, tmp_path: Path) -> None:
    """A team's bytes are looked at again when a file is stored, not only before it is sent."""
    store, here = Queue(database), Settings(tmp_path, bytes_kept=10)
    here.uploads.mkdir()
    files, part = Uploads(here, store.engine), here.uploads / ".part-x"
    first, other = ({"team": "red", "id": x, "name": "a.csv", "bytes": 9} for x in ("1", "2"))
    for row in (first, other):
        part.write_bytes(b"x")
        files._keep(part, row, Caller("red", "ann"))
    part.write_bytes(b"x")
    with pytest.raises(QueueFull, match="may keep 10 bytes"):
        files._keep(part, first | {"id": "3"}, Caller("red", "ann"))
    files._keep(part, first, Caller("red", "ann"))  # it has this one
    assert {path.name for path in here.uploads.iterdir()} == {"1", "2"}
    store.close()


def test_an_id_that_no_table_takes_is_not_there(database: str, tmp_path: Path) -> None:
    """As an address may have it: `%00`."""
    store = Queue(database)
    for ask_for in (store.get, store.scene, store.cancel, store.retry, store.delete):
        with pytest.raises(NotThere, match="no such job"):
            ask_for("a\0b")
    with pytest.raises(NotThere, match="no such file"):
        Uploads(Settings(tmp_path), store.engine).remove(Caller("red", "ann"), "a\0b")
    store.close()


def test_files_are_listed_oldest_first(database: str, tmp_path: Path) -> None:
    store = Queue(database)
    with store.engine.begin() as db:
        for age_s, name in enumerate(("a.csv", "c.csv", "b.csv")):
            row = {"id": name, "name": name, "bytes": 1, "created_s": 9.0 - age_s}
            db.execute(sa.insert(uploads), [row | {"team": "red"}])
    listed = Uploads(Settings(tmp_path), store.engine).listing("red")
    assert [file["name"] for file in listed] == ["b.csv", "c.csv", "a.csv"]
    store.close()


def test_the_lease_has_one_holder(database: str) -> None:
    store = Queue(database)
    submit_many(store, [ask()], TeamLimits())
    assert take(store.engine, "one", 60)
    assert not take(store.engine, "two", 60)
    assert store.claim(holder="two") is None
    assert take(store.engine, "one", 0.05)
    time.sleep(0.1)
    assert store.claim(holder="one") is None  # it ran out
    assert take(store.engine, "two", 60)
    assert store.claim(holder="two") is not None
    give_up(store.engine, "one")  # not its own any more
    assert not take(store.engine, "one", 60)
    give_up(store.engine, "two")
    assert take(store.engine, "one", 60)
    store.close()


def test_a_halted_process_keeps_no_lock_for_ever(
    postgres: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A process that halts in a transaction: the others give up, then the server ends it."""
    monkeypatch.setattr("service.store.database.BUSY_S", 0.5)
    database = postgres.database()
    halted, other = Queue(database), Queue(database)
    with halted.engine.connect() as db:
        db.execute(sa.select(sa.func.pg_advisory_xact_lock(LOCK_NUMBER)))
        began_s = time.monotonic()
        with pytest.raises(sa.exc.OperationalError, match="lock timeout"):
            submit_many(other, [ask()], TeamLimits())
        assert time.monotonic() - began_s < 10.0
        time.sleep(1.0)
        [(_, made)] = submit_many(other, [ask()], TeamLimits())
        assert made
        with pytest.raises(sa.exc.DBAPIError):  # the halted one goes on: too late
            db.execute(sa.delete(jobs))
    assert len(other.listing((), 0, 9)) == 1
    halted.close()
    other.close()


def test_a_server_that_says_nothing_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """The port is open, as of a machine that hangs, and nobody speaks."""
    pytest.importorskip("psycopg", reason="psycopg is not installed")
    monkeypatch.setitem(SILENCE, "connect_timeout", 2)
    began_s = time.monotonic()
    with socket.create_server(("127.0.0.1", 0)) as silent:
        port = silent.getsockname()[1]
        with pytest.raises(TryLater, match=r"does not answer: .*timeout"):
            connect(f"postgresql://ann@127.0.0.1:{port}/jobs")
    assert time.monotonic() - began_s < 20.0


def test_a_table_that_can_be_read_only_is_said(postgres: Any) -> None:
    """A standby, or a server whose disk is kept: 503, as a table that is locked; nothing stored."""
    database = postgres.database()
    store = Queue(database)
    with store.engine.begin() as db:
        name = db.engine.url.database
        db.exec_driver_sql(f"ALTER DATABASE {name} SET default_transaction_read_only = on")
    store.engine.dispose()
    with pytest.raises(sa.exc.DBAPIError) as refused:
        submit_many(store, [ask()], TeamLimits())
    told = _of_table(refused.value)
    assert isinstance(told, TableFault)
    assert "read only" in str(told)
    store.close()


def test_teams_take_turns(database: str) -> None:
    store = Queue(database)
    submit_many(store, [ask() for _ in range(4)] + [ask(team="blue")], TeamLimits())
    turns: dict[str, float] = {}
    order = []
    for i in range(5):
        job = store.claim([j.id for j in order], 100, turns)
        assert job is not None
        turns[job.team] = float(i + 1)
        order.append(job)
    assert [job.team for job in order][:3] == ["red", "blue", "red"]
    store.close()
    store = Queue(database)
    submit_many(store, [ask() for _ in range(2)], TeamLimits())
    assert store.claim([j.id for j in order], team_limit=4) is None
    store.close()


def test_audit_only_grows(database: str) -> None:
    store = Queue(database)
    [(job, _)] = submit_many(store, [ask()], TeamLimits())
    store.forget(job.id)  # one that nobody deleted stays
    store.cancel(job.id, "red", "key:ann")
    store.delete(job.id, "red", "key:ann")
    store.forget(job.id)
    with store.engine.connect() as db:
        lines = db.execute(sa.select(audit.c.action, audit.c.actor).order_by(audit.c.number)).all()
    assert [tuple(line) for line in lines] == [
        ("submit", "local"), ("cancel", "key:ann"), ("delete", "key:ann"), ("removed", "service"),
    ]  # fmt: skip
    for statement in (sa.update(audit).values(actor="x"), sa.delete(audit)):
        with pytest.raises(sa.exc.DBAPIError, match="append-only"), store.engine.begin() as db:
            db.execute(statement)
    store.close()


def test_an_intake_serves_many_with_few_commits(database: str) -> None:
    store = Queue(database)
    intake = Intake(store, TeamLimits(queued_jobs=250))

    async def work() -> list[Any]:
        intake.start()
        puts = [intake.put(ask(f"k{i % 200}")) for i in range(400)]
        refused = [intake.put(ask("k0", body="other"))]
        return await asyncio.gather(*puts, *refused, return_exceptions=True)

    answers = asyncio.run(work())
    intake.stop()
    assert isinstance(answers[-1], KeyReused)
    assert len({job.id for job, _ in answers[:-1]}) == 200
    assert sum(made for _, made in answers[:-1]) == 200
    assert intake.commits < 40
    store.close()


class JobMachine(RuleBasedStateMachine):
    """Clients and two dispatchers, of which one is always outdated, do whatever they like."""

    def __init__(self) -> None:
        super().__init__()
        self.engine_url = self.url()
        self.store = Queue(self.engine_url)
        with self.store.engine.begin() as db:
            db.execute(sa.delete(jobs))
        self.known: dict[str, Job] = {}
        self.attempts: list[Job] = []

    url: Any = None

    def teardown(self) -> None:
        self.store.close()

    def _try(self, action: Any, *arguments: Any, **more: Any) -> Any:
        try:
            return action(*arguments, **more)
        except (NotReady, NotThere):
            return None

    @precondition(lambda self: len(self.known) < 6)
    @rule(pending=st.booleans(), team=st.sampled_from(["red", "blue"]))
    def submit(self, pending: bool, team: str) -> None:
        phase = Phase.PENDING if pending else Phase.QUEUED
        [(job, made)] = submit_many(self.store, [ask(team=team, phase=phase)], TeamLimits())
        assert made
        self.known[job.id] = self.store.get(job.id)

    @rule(which=st.integers(0, 5), action=st.sampled_from(["cancel", "delete", "run", "amend"]))
    def client(self, which: int, action: str) -> None:
        ids = list(self.known)
        if which >= len(ids):
            return
        job_id, team = ids[which], self.known[ids[which]].team
        if action == "run":
            self._try(run_pending, self.store, job_id, TeamLimits(), team, "x")
        elif action == "amend":
            self._try(self.store.amend, job_id, team, run_id="r")
        else:
            self._try(getattr(self.store, action), job_id, team)
            wrong = "blue" if team == "red" else "red"
            before = self.store.seen(self.known[job_id])
            assert self._try(getattr(self.store, action), job_id, wrong) is None
            assert self.store.seen(self.known[job_id]) == before

    @rule(busy=st.booleans())
    def claim(self, busy: bool) -> None:
        job = self.store.claim([j.id for j in self.attempts] if busy else [])
        if job is not None:
            assert job.phase == Phase.EXECUTING
            self.attempts.append(job)

    @precondition(lambda self: self.attempts)
    @rule(which=st.integers(0, 9), end=st.sampled_from([None, *sorted(FINAL)]))
    def report(self, which: int, end: Phase | None) -> None:
        job = self.attempts[which % len(self.attempts)]
        before = self.store.seen(job)
        if end is None:
            self._try(self.store.progress, job, 1, 2)
        else:
            self._try(self.store.finish, job, end)
        if before.attempt != job.attempt:  # the fence
            assert self.store.seen(job) == before

    @invariant()
    def moves_are_allowed(self) -> None:
        for job_id, before in self.known.items():
            now = self.store.seen(before)
            after, seen = NEXT[before.phase], {before.phase}
            while after - seen:
                seen |= after
                after = frozenset().union(*(NEXT[phase] for phase in seen))
            assert now.phase in seen
            assert now == before or now.version > before.version
            assert (now.ended_s is not None) == (now.phase in FINAL)
            assert now.attempt >= before.attempt
            self.known[job_id] = now


@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_the_states_hold_whatever_is_asked(
    kind: str, tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest
) -> None:
    if kind == "postgresql":
        database = request.getfixturevalue("postgres").database()
    else:
        database = f"sqlite:///{tmp_path_factory.mktemp('machine') / 'jobs.sqlite'}"

    class Machine(JobMachine):
        url = staticmethod(lambda: database)

    case = Machine.TestCase
    case.settings = settings(max_examples=15, stateful_step_count=25, deadline=None)
    case().runTest()
