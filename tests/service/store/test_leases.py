"""The dispatcher's lease: one of a clock that ran ahead, and a service that nobody leads."""

from __future__ import annotations

import sqlite3
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import sqlalchemy as sa

from service.engine import runner
from service.settings import Settings
from service.store.database import connect, sqlite_url, writing
from service.store.leases import take
from service.store.tables import leases


def test_a_lease_of_a_clock_that_ran_ahead_is_taken_over(
    database: str, caplog: pytest.LogCaptureFixture
) -> None:
    engine = connect(database)
    assert take(engine, "first", 5.0)
    assert not take(engine, "second", 5.0)
    with writing(engine) as db:
        db.execute(sa.update(leases).values(until_s=leases.c.until_s + 3600))
    assert take(engine, "second", 5.0)
    assert "a clock ran ahead" in caplog.text
    assert not take(engine, "first", 5.0)
    with engine.connect() as db:
        assert db.execute(sa.select(leases.c.epoch)).scalar_one() == 2
    engine.dispose()


def test_a_lease_taken_at_the_same_instant_ran_not_ahead(
    database: str, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One that ends a second later did, by a second."""
    monkeypatch.setattr("service.store.leases.now_s", lambda _: 1000.0)
    engine = connect(database)
    assert take(engine, "first", 5.0)
    assert not take(engine, "second", 5.0)
    assert take(engine, "second", 4.0)
    assert "ends 1 s too late" in caplog.text
    engine.dispose()


def test_a_lease_is_counted_from_before_it_was_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A database that answers after 8 s of a lease of 10 s leaves 2 s in which this one leads."""
    clock_s = 100.0

    def slow(*_: object) -> bool:
        nonlocal clock_s
        clock_s += 8.0
        led.stopping.set()
        return True

    monkeypatch.setattr(runner, "time", SimpleNamespace(monotonic=lambda: clock_s))
    monkeypatch.setattr(runner, "take", slow)
    store: Any = SimpleNamespace(engine=None)
    led = runner.Dispatcher(Settings(tmp_path, lease_s=10.0), store)
    led._renew()
    clock_s = 109.9
    assert led.leads
    clock_s = 110.1
    assert not led.leads


def test_what_still_runs_is_not_removed_though_it_was_deleted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its worker would write its folder anew; it goes when the worker has ended."""
    settings, forgotten = Settings(tmp_path), list[str]()
    for name in ("ended", "runs"):
        settings.product(name).mkdir(parents=True)
    store: Any = SimpleNamespace(
        overdue=list, deleted=lambda: ["runs", "ended"], forget=forgotten.append
    )
    led = runner.Dispatcher(settings, store)
    led._renewed_s = time.monotonic()
    led._busy = {"runs": threading.current_thread()}
    rounds = iter([False, True])
    monkeypatch.setattr(led, "stopping", SimpleNamespace(wait=lambda _: next(rounds)))
    led._keep()
    assert forgotten == ["ended"]
    assert [settings.product(name).exists() for name in ("ended", "runs")] == [False, True]


def test_work_goes_on_after_a_clock_ran_ahead(
    make_server: Callable[..., Any], scene: dict[str, Any]
) -> None:
    server = make_server()
    ahead = 0
    while not ahead:  # until it has taken its first lease
        time.sleep(0.1)
        with sqlite3.connect(server.home / "jobs.sqlite") as db:
            ahead = db.execute("SELECT count(*) FROM leases").fetchone()[0]
        db.close()
    server.kill()
    with sqlite3.connect(server.home / "jobs.sqlite") as db:
        db.execute("UPDATE leases SET until_s = ?", (time.time() + 3600,))
    db.close()
    server.start()
    assert server.ended(server.submit(scene))["phase"] == "COMPLETED"
    assert "a clock ran ahead" in server.logged()


def test_not_ready_while_nobody_runs_jobs(make_server: Callable[..., Any]) -> None:
    server = make_server(NIGHTGLASS_LEASE_S="0.5")
    assert server.client.get("/readyz").status_code == 200
    db = sqlite3.connect(server.home / "jobs.sqlite", isolation_level=None)
    db.execute("BEGIN IMMEDIATE")  # no lease can be taken or renewed

    def until(status: int) -> str:
        deadline = time.monotonic() + 60
        while (answer := server.client.get("/readyz")).status_code != status:
            assert time.monotonic() < deadline, answer.text
            time.sleep(0.1)
        return answer.text

    assert "nobody has run the jobs" in until(503)
    db.execute("ROLLBACK")
    db.close()
    until(200)


def test_a_nearly_full_disk_is_not_ready(make_server: Callable[..., Any]) -> None:
    """Less room than NIGHTGLASS_FREE_BYTES: 503 that says so."""
    answer = make_server(NIGHTGLASS_FREE_BYTES=str(10**17)).client.get("/readyz")
    assert answer.status_code == 503
    assert answer.json() == {"ready": False, "faults": ["the disk is nearly full"]}


def test_what_is_committed_is_on_the_disk(tmp_path: Path) -> None:
    """SQLite's FULL (2): with NORMAL a power cut may take the last commits of its log back."""
    engine = connect(sqlite_url(tmp_path / "jobs.sqlite"))
    with writing(engine) as db:
        assert db.exec_driver_sql("PRAGMA synchronous").scalar() == 2
    engine.dispose()
