"""SQLite files, opened read-only: the rows of the form's query, a few thousand at a time."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from urllib.parse import quote

import pyarrow as pa

from ..errors import BadInput, Damaged
from ..forms import Layout
from .kinds import Choose, choose_once

ROWS = 20_000
LOG_START = 8  # bytes that are zeros, or absent, once all that a log has is in its file
ALLOWED = {sqlite3.SQLITE_SELECT, sqlite3.SQLITE_READ, sqlite3.SQLITE_FUNCTION}


def read_sqlite(path: Path, where: str, layout: Layout, choose: Choose) -> Iterator[pa.Table]:
    """Tables of the chosen columns of `layout.query`; attached files lie beside `path`.

    Raises BadInput where there is no query or it fails, or what a program has written is not in
    the file yet, and Damaged where the file is broken.
    """
    if layout.query is None:
        raise BadInput(where, "an SQLite file", "with a form that has `query` in its [table]")
    try:
        with closing(sqlite3.connect(_uri(path, where), uri=True)) as base:
            for alias, name in layout.attach:
                other = path.parent / name
                if not other.is_file():
                    raise BadInput(f"{where} attach.{alias}", str(other), "a file that exists")
                base.execute(f"ATTACH DATABASE ? AS {alias}", (_uri(other, where),))
            base.set_authorizer(lambda action, *_: 0 if action in ALLOWED else 1)
            yield from _rows(base, where, layout.query, choose)
    except sqlite3.DatabaseError as error:
        broken = "malformed" in str(error) or "not a database" in str(error)
        if broken or "disk I/O" in str(error):
            raise Damaged(str(path), f"cannot be read as SQLite ({error})") from None
        allowed = f"a query that reads this file ({error})"
        raise BadInput(f"{where} query", layout.query, allowed) from None


def _uri(path: Path, where: str) -> str:
    """For reading a file as it is; BadInput where a log beside it has rows that it lacks."""
    for ending in ("-wal", "-journal"):
        log = path.with_name(path.name + ending)
        if not log.is_file():
            continue
        with log.open("rb") as file:
            if any(file.read(LOG_START)):
                allowed = "no such log: close what writes the file, then open it with sqlite3 once"
                raise BadInput(where, log.name, allowed)
    return f"file:{quote(str(path.absolute()))}?mode=ro&immutable=1"


def _rows(base: sqlite3.Connection, where: str, query: str, choose: Choose) -> Iterator[pa.Table]:
    cursor = base.execute(query)
    if cursor.description is None:
        raise BadInput(f"{where} query", query, "a query that gives rows")
    names = [column[0] for column in cursor.description]
    chosen = choose_once(choose, names, {}, f"{where} query", "query")
    places = {name: names.index(name) for name in chosen}
    before = 0
    while rows := cursor.fetchmany(ROWS):
        arrays = {}
        for name, place in places.items():
            arrays[name] = _values([row[place] for row in rows], chosen[name], name, before, where)
        before += len(rows)
        yield pa.table(arrays)


def _values(values: list[object], want: str, name: str, before: int, where: str) -> pa.Array:
    kinds: tuple[type, ...] = {"integer": (int,), "number": (int, float), "text": (str,)}[want]
    for row, value in enumerate(values, before + 1):
        if value is not None and not isinstance(value, kinds):
            allowed = {"integer": "integers", "number": "numbers", "text": "texts"}[want]
            raise BadInput(f"{where} {name} row {row}", value, allowed)
    kind = {"integer": pa.int64(), "number": pa.float64(), "text": pa.string()}[want]
    if want == "number":  # Arrow takes no whole number that a double does not hold exactly
        values = [float(v) if isinstance(v, int) else v for v in values]
    return pa.array(values, kind)
