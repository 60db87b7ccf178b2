"""Open the database: SQLite in WAL mode or PostgreSQL, brought to the newest form."""

from __future__ import annotations

import contextlib
import errno
import os
import sqlite3
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import sqlalchemy as sa
from sqlalchemy.engine.interfaces import DBAPIConnection

from pipeline.errors import NO_ROOM, BadInput, DiskFull, Missing, NightglassError, TryLater
from service.store.tables import HEAD

LOCK_NUMBER = 7_316_881  # of PostgreSQL's advisory locks: writers of jobs, one at a time
FORMAT = 2  # PRAGMA user_version; the first form, without alembic, has 1
BUSY_S = 30.0
MISTAKES = (  # of who set the URL
    "authentication failed", "no password supplied", "does not exist", "pg_hba.conf",
    "SSL was required",
)  # fmt: skip
# How long a PostgreSQL server may say nothing, unless the URL says otherwise (libpq's own: hours).
SILENCE = {
    "connect_timeout": 10, "keepalives_idle": 10, "keepalives_interval": 5, "keepalives_count": 4,
    "tcp_user_timeout": 30_000,
}  # fmt: skip


def connect(url: str) -> sa.Engine:
    """An engine for `sqlite:////path` or `postgresql://...`, its tables in their newest form.

    BadInput where the URL cannot be used or the tables are of a later version, TryLater where no
    database answers. The message never holds a password.
    """
    try:
        parts = sa.make_url(url)
    except (sa.exc.ArgumentError, ValueError):  # ValueError: a port that is no number
        raise BadInput("NIGHTGLASS_DATABASE", "(not a URL)", ALLOWED) from None
    shown = parts.render_as_string(hide_password=True)
    kind = parts.get_backend_name()
    if kind not in ("sqlite", "postgresql"):
        raise BadInput("NIGHTGLASS_DATABASE", shown, ALLOWED)
    if kind == "sqlite":
        engine = sa.create_engine(parts, connect_args={"timeout": BUSY_S}, pool_size=20)
        sa.event.listen(engine, "connect", _configure)
        sa.event.listen(engine, "begin", _begin)
    else:
        parts = parts.set(drivername="postgresql+psycopg")
        try:
            silence = {k: v for k, v in SILENCE.items() if k not in parts.query}
            engine = sa.create_engine(parts, pool_pre_ping=True, pool_size=20, connect_args=silence)
            sa.event.listen(engine, "connect", _bound_waits)
        except ModuleNotFoundError:
            name = "NIGHTGLASS_DATABASE"
            raise Missing(
                "job tables in PostgreSQL", "psycopg", "postgresql", "use SQLite", name
            ) from None
    try:
        if kind == "sqlite":
            _keep_private(parts.database)
        _upgrade(engine, shown)
    except sa.exc.DBAPIError as error:
        engine.dispose()
        raise _not_opened(error, parts, kind, shown) from None
    return engine


def _not_opened(error: sa.exc.DBAPIError, parts: sa.URL, kind: str, shown: str) -> NightglassError:
    """Why a database could not be opened, without its password."""
    reason = " ".join(str(error.orig).split())[:200]
    if kind == "sqlite" and (code := _no_room(parts.database or "", reason)):
        return DiskFull(shown, code, "make room, then start again")
    if parts.password:
        reason = reason.replace(str(parts.password), "***")
    if _may_come(kind, error, reason):
        return TryLater(f"NIGHTGLASS_DATABASE: {shown} does not answer: {reason}")
    return BadInput("NIGHTGLASS_DATABASE", shown, f"a database that answers; {reason}")


def _keep_private(path: str | None) -> None:
    """The job table is its owner's alone; what SQLite makes beside it follows it."""
    if path and path != ":memory:":
        with contextlib.suppress(OSError):  # what is wrong with the place is said when it is opened
            os.close(os.open(path, os.O_RDWR | os.O_CREAT, 0o600))
            for file in (path, f"{path}-wal", f"{path}-shm"):
                with contextlib.suppress(FileNotFoundError):
                    Path(file).chmod(0o600)


def _may_come(kind: str, error: sa.exc.DBAPIError, reason: str) -> bool:
    """Whether a database that could not be opened may be there a little later."""
    if kind == "sqlite":
        return "locked" in reason
    return isinstance(error, sa.exc.OperationalError) and not any(m in reason for m in MISTAKES)


def _no_room(path: str, reason: str) -> int:
    """The errno of the lack of room that a database of SQLite could not be opened for, which it
    says or hides; 0 where it was something else."""
    if "unable to open" in reason:  # it, or a file beside it
        try:
            with tempfile.TemporaryFile(dir=Path(path).parent) as probe:
                probe.write(bytes(4096))
        except OSError as error:
            return error.errno if error.errno in NO_ROOM else 0
    return errno.ENOSPC if "disk is full" in reason or "disk I/O error" in reason else 0


ALLOWED = "sqlite:////path/to/jobs.sqlite or postgresql://user@host/name"


def sqlite_url(path: Path) -> str:
    return sa.URL.create("sqlite", database=str(path)).render_as_string()


@contextlib.contextmanager
def writing(engine: sa.Engine) -> Iterator[sa.Connection]:
    """One write transaction; writers of jobs come one after the other, whatever the database.

    So numbers grow in the order of commits, and what is counted in it stays true until the end.
    """
    if engine.dialect.name == "sqlite":
        with engine.connect() as db, db.execution_options(writes=True).begin():
            yield db
        return
    with engine.begin() as db:
        db.execute(sa.select(sa.func.pg_advisory_xact_lock(LOCK_NUMBER)))
        yield db


def now_s(db: sa.Connection) -> float:
    """Unix seconds by the clock that all processes share: PostgreSQL's, or this machine's."""
    if db.dialect.name == "sqlite":
        return time.time()
    return float(db.exec_driver_sql("SELECT extract(epoch from clock_timestamp())").scalar_one())


def _configure(connection: sqlite3.Connection, _: object) -> None:
    """Write-ahead log, synced at every commit; transactions are begun by `_begin`."""
    connection.isolation_level = None
    _keep_a_log(connection)
    for pragma in (
        "synchronous = FULL",
        "busy_timeout = 30000",
        "cell_size_check = ON",
        "trusted_schema = OFF",
    ):
        connection.execute(f"PRAGMA {pragma}").close()


def _keep_a_log(connection: sqlite3.Connection) -> None:
    """Turn the write-ahead log on. Of several that open a new database at once SQLite refuses all
    but one, without a wait; they ask again."""
    end_s = time.monotonic() + BUSY_S
    while True:
        try:
            return connection.execute("PRAGMA journal_mode = WAL").close()
        except sqlite3.OperationalError as error:
            if "locked" not in str(error) or time.monotonic() > end_s:
                raise
            time.sleep(0.01)


def _bound_waits(connection: DBAPIConnection, _: object) -> None:
    """No lock is waited for longer than with SQLite, and a process that halts or is cut off in a
    transaction does not keep the others' lock for ever."""
    cursor = connection.cursor()
    cursor.execute(f"SET lock_timeout = {BUSY_S * 1000:.0f}")
    cursor.execute(f"SET idle_in_transaction_session_timeout = {BUSY_S * 2000:.0f}")
    cursor.close()
    connection.commit()


def _begin(connection: sa.Connection) -> None:
    """Writers take the lock at once, so that none fails half-way; readers never wait."""
    writes = connection.get_execution_options().get("writes")
    connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")


def _upgrade(engine: sa.Engine, shown: str) -> None:
    """Run the migrations that are missing, in one transaction that no other process enters."""
    with writing(engine) as db:
        found = _revision(db)
        if found == HEAD:
            return
        known = [f"{i:04d}" for i in range(1, int(HEAD) + 1)]
        if found is not None and found not in known:
            allowed = f"tables of form {HEAD} or earlier (made by an earlier Nightglass)"
            raise BadInput("the job table", f"{shown} of form {found}", allowed)
        from alembic import command, config

        settings = config.Config()
        settings.set_main_option("script_location", str(Path(__file__).parents[1] / "migrations"))
        settings.attributes["connection"] = db
        if found == "0001":
            command.stamp(settings, "0001")
        command.upgrade(settings, "head")
        if db.dialect.name == "sqlite":
            db.exec_driver_sql(f"PRAGMA user_version = {FORMAT}")


def _revision(db: sa.Connection) -> str | None:
    """The form of the tables: a revision's name; None for an empty database."""
    if db.dialect.name == "sqlite":
        form = db.exec_driver_sql("PRAGMA user_version").scalar_one()
        if form == 1:
            return "0001"
        if form not in (0, FORMAT):
            return f"user_version {form}"
    if not sa.inspect(db).has_table("alembic_version"):
        return None
    return db.exec_driver_sql("SELECT version_num FROM alembic_version").scalar()
