"""Forms of the job table: every earlier one is brought to the newest, with its rows."""

from __future__ import annotations

import contextlib
import json
import sqlite3
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa
from alembic import command
from alembic.autogenerate import compare_metadata
from alembic.config import Config
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory

import service.migrations
from service.jobs.jobs import Phase, Queue
from service.jobs.submissions import Ask, TeamLimits, submit_many
from service.store import database
from service.store.database import connect, sqlite_url, writing
from service.store.tables import HEAD, metadata

SCENE = json.dumps({"sensor": {"shape": [4, 5]}, "exposure": {"frames": 3}})
FIRST: dict[str, Any] = {
    "number": 7, "id": "a" * 32, "name": "old", "phase": "EXECUTING", "scene": SCENE,
    "idempotency_key": "key", "body_sha256": "b" * 64, "submitted_s": 1.0, "started_s": 2.0,
    "ended_s": None, "tiles_done": 1, "tiles_total": 3, "attempt": 2, "deaths": 0,
    "cancel_asked": False, "deleted": False, "error": None, "content_digest": None, "version": 5,
}  # fmt: skip
FAILED = FIRST | {
    "number": 9, "id": "c" * 32, "phase": "ERROR", "idempotency_key": None, "ended_s": 3.0,
    "error": json.dumps({"kind": "fault", "message": "it was so", "errors": []}),
}  # fmt: skip

# A value of its own in every column.
ENDED = FIRST | {
    "number": 11, "id": "e" * 32, "name": "done", "phase": "COMPLETED", "idempotency_key": "last",
    "body_sha256": "f" * 64, "submitted_s": 11.0, "started_s": 12.0, "ended_s": 13.0,
    "tiles_done": 3, "tiles_total": 4, "attempt": 5, "deaths": 6, "cancel_asked": True,
    "content_digest": "9" * 64, "version": 8,
}  # fmt: skip


def migrations(db: sa.Connection | None = None) -> Config:
    config = Config()
    config.set_main_option("script_location", str(Path(service.migrations.__path__[0])))
    config.attributes["connection"] = db
    return config


def differences(engine: sa.Engine) -> list[Any]:
    """What alembic finds between a database and the tables that the program works with."""
    with engine.connect() as db:
        options = {"compare_type": True, "compare_server_default": True}
        found = compare_metadata(MigrationContext.configure(db, opts=options), metadata)
    return [d for d in found if "alembic_version" not in str(d)]


@pytest.mark.parametrize("form", ["0001", "0002"])
def test_every_form_with_rows_becomes_the_newest(database: str, form: str) -> None:
    """A database that alembic made in an earlier form, with rows; opened twice."""
    url = sa.make_url(database)
    if url.get_backend_name() == "postgresql":
        url = url.set(drivername="postgresql+psycopg")
    engine = sa.create_engine(url)
    with engine.begin() as db:
        command.upgrade(migrations(db), "0001")
        told = sa.Table("jobs", sa.MetaData(), autoload_with=db)
        assert "team" not in told.c
        columns, values = ", ".join(FIRST), ", ".join(f":{name}" for name in FIRST)
        insert = sa.text(f"INSERT INTO jobs ({columns}) VALUES ({values})")
        db.execute(insert, [FIRST, FAILED, ENDED])
        command.upgrade(migrations(db), form)
        if form == "0002":
            db.execute(sa.text("UPDATE jobs SET seal = 3141592653, scene_crc = 2718281828"))
            if db.dialect.name == "sqlite":
                db.exec_driver_sql("PRAGMA user_version = 2")
    engine.dispose()
    store = Queue(database)
    assert differences(store.engine) == []
    left, failed, ended = store.listing((), 0, 10)
    assert (left.id, left.team, left.pixel_frames) == ("a" * 32, "local", 60)
    assert left.phase == Phase.EXECUTING
    assert (left.number, left.attempt, left.tiles_done, left.version) == (7, 2, 1, 5)
    assert (failed.phase, failed.error) == (Phase.ERROR, json.loads(FAILED["error"]))
    for name in ENDED.keys() - {"scene", "error", "deleted", "body_sha256", "idempotency_key"}:
        assert getattr(ended, name) == ENDED[name], name
    assert store.scene("a" * 32) == json.loads(SCENE)
    again = Ask(name="old", scene=json.loads(SCENE), body_sha256="b" * 64, key="key")
    new = Ask(name="new", scene={}, body_sha256="d" * 64)
    (replayed, made), (fresh, _) = submit_many(store, [again, new], TeamLimits())  # type: ignore[misc]
    assert (replayed.id, made) == ("a" * 32, False)
    assert fresh.number == 12
    with store.engine.connect() as db:
        assert MigrationContext.configure(db).get_current_revision() == HEAD
    store.close()
    assert Queue(database).get("a" * 32) == left


def test_an_empty_database_becomes_the_newest_form(database: str) -> None:
    engine = connect(database)
    assert differences(engine) == []
    with writing(engine) as db:
        db.execute(sa.text("ALTER TABLE leases ADD COLUMN odd INTEGER"))
    assert [d[0] for d in differences(engine)] == ["remove_column"]  # it would be seen
    engine.dispose()


def test_jobs_of_the_first_form_go_along(tmp_path: Path) -> None:
    path = tmp_path / "jobs.sqlite"
    with sqlite3.connect(path) as db:
        db.execute(
            "CREATE TABLE jobs (number INTEGER PRIMARY KEY AUTOINCREMENT, id VARCHAR(32) UNIQUE, "
            "name VARCHAR(128), phase VARCHAR(9), scene TEXT, idempotency_key VARCHAR(255) UNIQUE, "
            "body_sha256 VARCHAR(64), submitted_s FLOAT, started_s FLOAT, ended_s FLOAT, "
            "tiles_done INTEGER, tiles_total INTEGER, attempt INTEGER, deaths INTEGER, "
            "cancel_asked BOOLEAN, deleted BOOLEAN, error JSON, content_digest VARCHAR(64), "
            "version INTEGER)"
        )
        scene = json.dumps({"sensor": {"shape": [4, 5]}, "exposure": {"frames": 3}})
        row = (7, "a" * 32, "old", "EXECUTING", scene, "key", "b" * 64, 1.0, 2.0, None, 1, 3, 2, 0,
               0, 0, None, None, 5)  # fmt: skip
        db.execute(f"INSERT INTO jobs VALUES ({', '.join('?' * len(row))})", row)
        db.execute("PRAGMA user_version = 1")
    store = Queue(path)
    job = store.get("a" * 32)
    assert (job.team, job.phase, job.pixel_frames) == ("local", "EXECUTING", 60)
    [(new, _)] = submit_many(store, [Ask("new", {}, "b")], TeamLimits())
    assert new.number == 8
    store.close()
    assert Queue(path).get("a" * 32) == job


def test_the_newest_form_is_the_last_migration() -> None:
    assert ScriptDirectory.from_config(migrations()).get_current_head() == HEAD


def test_two_that_start_together_make_the_tables_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The one that comes second looks at the database after the first has made its tables."""
    url, found, looked = sqlite_url(tmp_path / "jobs.sqlite"), database._revision, []
    meet = threading.Barrier(2)

    def look_together(db: sa.Connection) -> str | None:
        looked.append(found(db))
        with contextlib.suppress(threading.BrokenBarrierError):
            meet.wait(0.5)
        return looked[-1]

    monkeypatch.setattr(database, "_revision", look_together)
    with ThreadPoolExecutor(2) as both:
        for engine in both.map(connect, (url, url)):
            engine.dispose()
    assert looked == [None, HEAD]


def test_one_that_starts_while_another_writes_a_new_database_waits(tmp_path: Path) -> None:
    """SQLite turns a log on for nobody while someone writes, and does not wait by itself."""
    path = tmp_path / "jobs.sqlite"
    with contextlib.closing(sqlite3.connect(path, check_same_thread=False)) as first:
        first.isolation_level = None
        first.execute("BEGIN IMMEDIATE")
        threading.Timer(0.3, first.rollback).start()
        connect(sqlite_url(path)).dispose()
    with contextlib.closing(sqlite3.connect(path)) as db:
        assert db.execute("PRAGMA journal_mode").fetchone() == ("wal",)
