"""Pinned words and numbers of the service's parts: at their edges, on a clock that is given."""

from __future__ import annotations

import asyncio
import dataclasses
import io
import json
import logging
import re
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
import sqlalchemy as sa
from starlette.requests import Request
from starlette.responses import StreamingResponse

from catalog_tools.catalogue import MANIFEST_NAME
from pipeline.errors import BadInput, Damaged, DiskFull, Incomplete, TryLater
from pipeline.spec.load import InvalidScene
from service import logs, problems
from service.accounts.teams import pixel_frames_of
from service.answers import problem_of
from service.engine import worker
from service.http import bodies
from service.jobs import views
from service.jobs.jobs import NEXT, Job, Phase, Queue
from service.jobs.submissions import Ask, TeamLimits, Used, refuse, run_pending, submit_many
from service.products import pixels
from service.products.files import _part, serve_file
from service.scenes import uploads
from service.scenes.scenes import product_bytes_of
from service.settings import Settings, read_settings
from service.standards import uws
from service.standards import uws_xml as xml
from service.store.leases import give_up, holds, take
from service.store.named_files import files_in
from tests.pins.test_told_service import SMALL, Clock, clock, fill, scene, short
from tests.pins.told import check_told

__all__ = ["clock"]
EMPTY = [
    "run_id",
    "started_s",
    "ended_s",
    "destruction_s",
    "duration_s",
    "tiles_done",
    "tiles_total",
    "error",
    "content_digest",
]
JOB: dict[str, Any] = dict.fromkeys(EMPTY) | dict.fromkeys(("cancel_asked", "deleted"), False)
JOB |= {"number": 3, "id": "a1", "team": "red", "owner": "key:1", "kind": "scene", "name": "x"}
JOB |= {"pixel_frames": 9, "bytes_kept": 5, "submitted_s": 1.7e9, "attempt": 1, "deaths": 0}
JOB |= {"version": 4, "phase": Phase.QUEUED}


def told(what: Callable[..., Any], *given: Any, shown: str | None = None, **more: Any) -> str:
    """A call in words: what it was given, and what it gives or refuses with."""
    name = f"{getattr(what, '__name__', what)}({', '.join(map(brief, given))[:200]})"
    try:
        found = what(*given, **more)
    except Exception as error:
        said = f"{type(error).__name__}: {error} {getattr(error, 'errors', '')}"
    else:
        said = brief(found)
    return short(f"{shown or name} -> {said}")


def brief(value: Any) -> str:
    """A value in words: of a job what is not empty, of a table or engine its kind."""
    if isinstance(value, tuple):
        return f"({', '.join(map(brief, value))})"
    if isinstance(value, Job):
        usual = ("id", "owner", "kind", "submitted_s")
        kept = {k: v for k, v in dataclasses.asdict(value).items() if v and k not in usual}
        return f"job {value.id} {kept}"
    return (
        type(value).__name__
        if isinstance(value, Queue | sa.Engine | TeamLimits | Settings)
        else repr(value)
    )


def check(name: str, lines: list[str], **places: Any) -> None:
    check_told(f"service/{name}", "\n".join(lines).replace("\0", "\\0"), **places)


def request(method: str = "GET", path: str = "/", *pieces: bytes, **headers: str) -> Request:
    """A request, and the pieces of its body; one that is None: the client goes."""
    sent = [
        {"type": "http.request", "body": p, "more_body": i + 1 < len(pieces)}
        if p is not None
        else {"type": "http.disconnect"}
        for i, p in enumerate(pieces)
    ]

    async def receive() -> dict[str, Any]:
        if not sent:
            await asyncio.sleep(9.0)
        return sent.pop(0)

    named = [(k.replace("_", "-").encode(), v.encode()) for k, v in headers.items()]
    where, _, asked = path.partition("?")
    scope = {
        "type": "http",
        "method": method,
        "path": where,
        "raw_path": where.encode(),
        "query_string": asked.encode(),
        "headers": named,
    }
    return Request(scope, receive)


def test_settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each default, what the environment may say, and what it may not."""
    monkeypatch.setenv("HOME", str(tmp_path))
    lines = [f"{k} = {v!r}" for k, v in dataclasses.asdict(Settings(tmp_path)).items()]
    for given in (
        {},
        {"XDG_DATA_HOME": "/x"},
        {"HOME": "~/h"},
        {"TARGETS": "5", "PLAN_S": "0.5"},
        {"HOSTS": " A.test,, b.test "},
        {"TARGETS": "1.5"},
        {"PLAN_S": "nan"},
        {"PLAN_S": "-1"},
        {"TARGETS": "0"},
        {"BODY_S": "1e18"},
        {"BODY_S": "9e17"},
        {"TLS_KEY": "k"},
        {"TLS_CERT": "c"},
        {"OIDC_ISSUER": "i"},
        {"OIDC_JWKS": "j"},
        {"DATABASE": ""},
        {"SCHEDULER": "tcp://far.test:1"},
        {"SCHEDULER": "processes", "WORKERS": "3"},
        {"OIDC_ISSUER": "i", "OIDC_AUDIENCE": "a", "OIDC_JWKS": "j"},
    ):
        environ = {k if k[:3] == "XDG" else f"NIGHTGLASS_{k}": v for k, v in given.items()}
        lines.append(told(_differs, environ, shown=str(given)))
    settings = Settings(tmp_path / "home")
    settings.make_folders()
    (tmp_path / "home").chmod(0o755)
    settings.make_folders()
    lines += [oct(settings.home.stat().st_mode), settings.database_url, str(settings.product("a"))]
    (tmp_path / "file").write_text("")
    lines.append(told(Settings(tmp_path / "file").make_folders))
    check("settings", lines, home=tmp_path)


def _differs(environ: dict[str, str]) -> dict[str, Any]:
    settings = read_settings(None, environ)
    plain = dataclasses.asdict(Settings(settings.home))
    return {k: v for k, v in dataclasses.asdict(settings).items() if v != plain[k] or k == "home"}


TEXTS = (
    b"{}",
    b"",
    b"[1,",
    b"\xff",
    b"NaN",
    b"[Infinity]",
    b"1e999",
    b'{"a":1,"b":{"c":2,"c":3}}',
    b'"\\ud800"',
    b'{"\\ud800":1}',
    b"[" * 33 + b"]" * 33,
    b"[" * 32 + b"]" * 32,
    b"[" * 34 + b"]" * 34,
    b"9" * 5000,
    b'{"a": [true, null, 1.5, "\xc3\xa9"]}',
    b"[" * 100_000,
)
YAMLS = (
    b"a: [1, 2.5, yes, null, '1']",
    b"1: a",
    b"a: .nan",
    b"a: &x 1\nb: *x",
    b"a: 1\na: 2",
    b"a: 2020-01-01",
    b"a: !!python/x 1",
    b"a: 1\n---\nb: 2",
    b"",
    b"{a",
    b"x" * (1 << 17),
    b"#" * ((1 << 17) + 1),
)


def test_bodies(monkeypatch: pytest.MonkeyPatch) -> None:
    """Texts that are data or are not; bodies in pieces, too long, too slow, cut off."""
    lines = [told(bodies.parse_text, text, bodies.JSON, shown=repr(text[:40])) for text in TEXTS]
    lines += [
        told(bodies.parse_text, text, bodies.YAML, shown=repr(text[:40]))[:400] for text in YAMLS
    ]
    monkeypatch.setattr(bodies, "DISCARD_S", 0.01)
    for pieces, headers in (
        ((b"ab", b"c"), {}),
        ((b"abcd", b"e"), {}),
        ((b"abcd", b"ef", b"gh"), {}),
        ((b"a", None), {}),
        ((b"a",), {"content_length": "6"}),
        ((b"a",), {"content_length": "5"}),
        ((b"a",), {"content_length": "1" * 19}),
        ((b"a",), {"content_type": "TEXT/x"}),
        ((b"a",), {"content_type": "application/json; charset=utf-16"}),
        ((), {}),
        ((b"a",), {"content_encoding": " Identity "}),
        ((b"a",), {"content_encoding": "br"}),
    ):
        asked = request("POST", "/", *pieces, **({"content_type": "Application/JSON"} | headers))
        read = bodies.read_body(asked, 5, 0.01)
        lines.append(told(asyncio.run, read, shown=f"{pieces} {headers}"))
    check("bodies", lines)


@contextmanager
def elsewhere() -> Iterator[None]:
    """The time zone of another place."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TZ", "Asia/Tokyo")
        time.tzset()
        yield
    time.tzset()


def test_words(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Pointers, cuts, times, jobs as JSON and XML, log lines, errors of the engine, of answers."""
    with elsewhere():
        _words(tmp_path, monkeypatch)


def _words(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lines = [
        told(problems.pointer, f) for f in ("a.b[2].c", "?limit", "scene", "", "a/b~c.d", "x" * 300)
    ]
    lines += [told(problems.mistake_dict, ("a.b", "v" * 500, "allowed: " + "w" * 500))]
    lines += [told(what, s) for what in (views.utc, xml.stamp) for s in (None, 0.0, 1.7e9 + 0.9996)]
    stamps = (
        "2023-11-14T22:13:20",
        " 2023-11-14T22:13:20Z",
        "2023-11-14T22:13:20+02:00",
        "2023-11-14",
        "0001-01-01",
        "",
    )
    lines += [told(uws._time, stamp, "AFTER") for stamp in stamps]
    texts = (
        "key ng_0123456789ab_secret-x and Bearer abc",
        "eyJa.b.c",
        "postgresql://u:p@h/x",
        "http://h:80/@",
    )
    lines += [told(logs.redact, text) for text in texts]
    made = logging.LogRecord("n", logging.WARNING, "", 1, "Bearer %s", ("abc",), None)
    made.__dict__ |= {
        "created": 1.7e9,
        "job": "a",
        "team": None,
        "ms": 2.5,
        "path": "Bearer abc",
        "other": 1,
    }
    lines.append(logs.JsonLines().format(made))
    for changes in (
        {},
        {
            "phase": Phase.EXECUTING,
            "started_s": 1.7e9,
            "tiles_done": 1,
            "tiles_total": 3,
            "run_id": "r\x01",
        },
        {
            "phase": Phase.COMPLETED,
            "ended_s": 1.7e9,
            "destruction_s": 1.8e9,
            "duration_s": 90.4,
            "tiles_total": 3,
        },
        {"phase": Phase.COMPLETED, "kind": "sweep"},
        {"phase": Phase.ABORTED},
        *(
            {"phase": Phase.ERROR, "error": {"kind": kind, "message": "m", "errors": []}}
            for kind in ("fault", "bad input", "try later", "incomplete", "disk full", "damaged")
        ),
    ):
        job = _job(**changes)
        links = views.job_dict(job, "http://dash")["links"]
        lines.append(f"{changes} {views.etag(job)} {links['self']} {[*links]}")
        results = xml.result_names(job, "http://h/uws/async/a1", "http://h")
        written = xml.job_xml(job, {"name": "\x00é"}, results[:2]).decode()
        told_already = "uws:(owner|quote|creation|parameters)" if job.phase != Phase.QUEUED else "#"
        kept = [
            line
            for line in written.replace("><uws", ">\n<uws").split("\n")
            if not re.search(told_already, line)
        ]
        lines += kept[2:]
    lines.append(xml.jobs_xml([job, _job(run_id="r")], "http://h/uws/async").decode())
    order = {
        "scene": {"stars": {"catalogue": ["here", "gone"]}},
        "files": {"0f.csv": "mine.csv"},
        "product": "../p/a1",
    }
    fine = order | {"scene": {}}
    monkeypatch.chdir(tmp_path)
    for name in ("here", "gone"):
        (tmp_path / name).mkdir()
    (tmp_path / "here" / MANIFEST_NAME).write_text("")
    for error, given in (
        (BadInput("a.b", f"{tmp_path}/up/0f.csv", "x"), fine),
        (InvalidScene([("a", 1, "x"), ("b", "../u/0f.csv", "y")]), fine),
        (Damaged(f"{tmp_path}/c/cube", "in ../p/a1"), fine),
        (DiskFull("x", 28, "y"), fine),
        (OSError(28, "z"), fine),
        (TryLater(f"{tmp_path} is gone"), fine),
        (Incomplete("i"), fine),
        (OSError(5, "input"), fine),
        (OSError(), fine),
        (MemoryError(), fine),
        (ValueError("secret"), fine),
        (ValueError(), order),
        (ValueError(), {"scene": order}),
    ):
        lines.append(told(worker.describe, error, given, shown=repr(error)))
    for status, body in (
        (200, {}),
        (
            422,
            {
                "detail": "d",
                "errors": [{"pointer": "/a~1b/0", "value": "v", "allowed": "allowed: x"}],
            },
        ),
        (503, {"detail": "d", "errors": [{"pointer": "", "value": "v", "allowed": "x"}]}),
        (404, {"title": "t"}),
        (500, []),
        (422, {"errors": [{"pointer": ""}]}),
    ):
        answer = httpx.Response(status, json=body, request=httpx.Request("GET", "http://h:8/"))
        found = problem_of(answer)
        lines.append(
            f"{status} {body} -> {type(found).__name__} {found} {getattr(found, 'status', None)}"
        )
    check("words", lines, folder=tmp_path)


def _job(**changes: Any) -> Job:
    return Job(**(JOB | changes))


def test_files(tmp_path: Path) -> None:
    """Ranges and conditions of a file; what of a folder is served; amounts of scenes."""
    fill(tmp_path)
    tag, lines = '"de0b6b3a7640010-1e"', []
    for asked in (
        "",
        "bytes=0-0",
        "bytes=5-",
        "bytes=-4",
        "bytes=-40",
        "bytes=-0",
        "bytes=30-",
        "bytes=29-99",
        "bytes=4-3",
        "bytes=-",
        "bytes=0-1,3-4",
        "items=0-1",
        " bytes=1-2 ",
        f"bytes={'1' * 19}-",
    ):
        lines.append(told(lambda asked=asked: _served(tmp_path, range=asked), shown=asked))
    for given in (
        {"if_none_match": tag},
        {"if_none_match": '"x"'},
        {"range": "bytes=1-2", "if_range": tag},
        {"range": "bytes=1-2", "if_range": "x"},
    ):
        lines.append(told(lambda given=given: _served(tmp_path, **given), shown=str(given)))
    for path in (
        "plan.json",
        "preview.png",
        "scene.yaml",
        "a//b",
        "../x",
        ".hidden/x",
        "truth/.x",
        "link",
        "truth",
        "plan.json/x",
        "a\0b",
        "",
        "truth/a b.txt",
    ):
        lines.append(told(lambda path=path: _served(tmp_path, path), shown=path))
    lines += [
        told(_part, None, 5),
        told(product_bytes_of, _scene()),
        told(product_bytes_of, _scene(adc_bits=8)),
    ]
    for made in (
        {},
        SMALL,
        SMALL | {"dwells": [{"frames": 3}, {}]},
        {"sensor": {"shape": [2, "x"]}, "exposure": {"frames": 1}},
    ):
        lines.append(told(pixel_frames_of, made, shown="pixel_frames_of"))
    values = np.arange(35.0).reshape(5, 7)
    lines += [pixels.binned(values, n).round(4).tolist().__repr__() for n in (1, 2, 3, 8)]
    for name, content in (
        ("a.npy", _npy(np.zeros((2, 3)))),
        ("a.npy", _npy(np.zeros((2, 3)))[:-1]),
        ("a.npy", _npy(np.array(["x"]))),
        ("a.npy", b"\x93NUMPY"),
        ("a.npy", _npy(np.array([None]))),
        ("a.fits", b"SIMPLE  = T"),
        ("a.fit", b"x"),
        ("a.fits", b"SIMPLE  = T" + b" " * (1 << 20) + b"ZIMAGE  = T"),
        ("a.fits", b"SIMPLE  = T" + b" " * ((1 << 20) - 16) + b"ZIMAGE  = T"),
        ("a.csv", b"PK\x03\x04"),
        ("a.csv", b"PK\x03"),
        ("a.txt", b"\xfd7zXZ"),
        ("a.txt", b"BZh"),
        ("a.txt", b"\x28\xb5\x2f\xfd"),
        ("a.txt", b"\x1f\x8b"),
        ("a.npy", _npy(np.zeros(2, complex))),
    ):
        (tmp_path / name).write_bytes(content)
        lines.append(
            told(uploads.check_content, tmp_path / name, name[2:], shown=f"{name} {content[:12]}")
        )
    for text in (
        "{}",
        json.dumps(scene(sensor__bandpass={"path": "upload:a.csv"})),
        json.dumps({"scene": {"sensor": {"bandpass": {"path": "upload:b.csv"}}}}),
    ):
        lines.append(told(files_in, text, shown=text[-20:]))
    check("files", lines)


def _scene(**sensor: Any) -> Any:
    from pipeline.spec.load import parse_scene

    changes: Any = {f"sensor__{name}": value for name, value in sensor.items()}
    return parse_scene(scene(output={"layers": ["dn", "mean_e"]}, **changes))


def _npy(values: Any) -> bytes:
    out = io.BytesIO()
    np.save(out, values, allow_pickle=True)
    return out.getvalue()


def _served(folder: Path, path: str = "cube.zarr/dn/c/0", **headers: str) -> str:
    answer = serve_file(request(**headers), folder, path)
    given = {
        k: v
        for k, v in answer.headers.items()
        if k not in ("accept-ranges", "etag", "x-content-type-options")
    }

    async def body() -> bytes:
        return b"".join([piece async for piece in answer.body_iterator])

    content = asyncio.run(body()) if isinstance(answer, StreamingResponse) else b""
    return f"{answer.status_code} {given} {content!r}"


def test_the_job_table(clock: Clock, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Which phase may follow which, whose turn it is, quotas at their edges, leases, faults."""
    table, lines = Queue(tmp_path / "jobs.sqlite"), [f"{p}: {sorted(n)}" for p, n in NEXT.items()]
    asks = [
        Ask(f"n{i}", SMALL, "0" * 64, None, t, phase=p, pixel_frames=10)
        for i, (t, p) in enumerate(
            [("red", Phase.QUEUED)] * 3 + [("blue", Phase.QUEUED)] * 2 + [("red", Phase.PENDING)]
        )
    ]
    limits = TeamLimits(queued_jobs=4, pixel_frames_day=30)
    made = submit_many(
        table,
        [*asks, dataclasses.replace(asks[0], key="k"), dataclasses.replace(asks[0], key="k")],
        limits,
    )
    lines += [told(lambda m=m: m, shown="made")[:150] for m in made]
    ids = [job.id for job, _ in (m for m in made if isinstance(m, tuple))]
    pending = submit_many(table, [dataclasses.replace(asks[5], team="green")], limits)[0][0]
    for used, asked in (
        (Used(3, 0, 0), 30),
        (Used(3, 0, 0, 1), 0),
        (Used(0, 20, 0, 0, 5), 5),
        (Used(0, 20, 0, 0, 6), 5),
        (Used(0, 0, 1 << 62), 0),
    ):
        lines.append(told(refuse, used, asked, limits))
    turns: dict[str, float] = {}
    busy: list[str] = []
    for most in (9, 1, 1, 2, 1, 9):
        job = table.claim(busy, most, turns) if busy else table.claim()
        busy += [job.id] if job else []
        clock.now += 1.0
        turns |= {job.team: clock.now} if job else {}
        lines.append(f"claimed of {most}: {brief(job)}")
    first = table.get(ids[0])
    for what, given in (
        (table.progress, (first, 1, 4)),
        (table.died, (first, 2)),
        (table.again, (first, "why")),
        (table.progress, (first, 2, 4)),
        (table.finish, (table.get(ids[0]), Phase.ERROR)),
        (table.finish, (table.get(ids[0]), Phase.QUEUED)),
        (table.cancel, (ids[0],)),
        (table.retry, (ids[0],)),
        (table.cancel, (pending.id, "red")),
        (table.amend, (pending.id,)),
        (table.scene, (ids[1], False, "blue")),
        (run_pending, (table, pending.id, TeamLimits(0), "green", "x")),
        (run_pending, (table, pending.id, limits, "green", "x")),
        (run_pending, (table, pending.id, limits, "green", "x")),
        (table.get, ("zed",)),
        (table.counts, ("red",)),
        (table.versions, (ids,)),
        (table.overdue, ()),
        (table.deleted, ()),
    ):
        lines.append(told(what, *given)[-700:])
    lines.append(told(table.amend, ids[2], name="x"))
    lines.append(told(table.amend, pending.id, destruction_s=clock.now - 1)[-400:])
    lines += [
        told(table.overdue),
        told(table.delete, pending.id),
        told(table.deleted),
        told(table.forget, pending.id),
    ]
    waits = submit_many(table, [dataclasses.replace(asks[5], team="grey")], limits)[0][0]
    more = {"scene": SMALL, "name": "m"}
    lines += [
        told(table.amend, waits.id, "grey", limits, pixel_frames=n, **more, shown=f"{n}")[-500:]
        for n in (31, 30, 5)
    ]
    with table.engine.connect().execution_options(writes=True) as db, db.begin():
        db.execute(sa.text("insert into uploads values ('blue', 'z', 'z.csv', 3, 1.0)"))
    lines += [
        told(
            table.amend,
            waits.id,
            "grey",
            limits,
            scene=scene(sensor__bandpass={"path": "upload:z"}),
        )
    ]
    lines += [
        f"{row}"
        for row in table.engine.connect().exec_driver_sql("select * from usage order by team").all()
    ]
    lease = table.engine
    for who, seconds, step in (
        ("a", 5, 0),
        ("b", 5, 4.9),
        ("a", 5, 0.2),
        ("b", 5, 5),
        ("c", 1, 0),
        ("b", 5, 0),
    ):
        clock.now += step
        with lease.connect() as db:
            held_by = [x for x in "abc" if holds(db, x)]
        lines.append(
            f"{held_by} {who} takes: {take(lease, who, seconds)} {db_row(lease, 'leases')}"
        )
    give_up(lease, "a"), lines.append(db_row(lease, "leases"))
    give_up(lease, "c"), lines.append(db_row(lease, "leases"))
    lines += [
        told(table.scene, ids[2]),
        told(table.get, ids[1])[-500:],
        told(table.get, waits.id)[-500:],
        told(table.cancel, ids[1]),
        told(table.claim),
    ]
    lines += [
        told(table.finish, table.get(ids[1]), Phase.ERROR, error={"kind": "fault", "message": "m"}),
        db_row(lease, "audit"),
    ]
    check("table", [short(line) for line in lines])


def db_row(engine: sa.Engine, table: str) -> str:
    return str(engine.connect().exec_driver_sql(f"select * from {table}").all()[-1])
