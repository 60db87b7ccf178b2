"""Pinned requests: what the service answers to a long talk with several teams, and its document."""

from __future__ import annotations

import contextlib
import io
import json
import logging
import os
import pkgutil
import queue
import re
import shutil
import sys
import tarfile
import time
from collections import Counter
from collections.abc import Iterator
from importlib import import_module
from itertools import count
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from urllib.parse import urlencode

import httpx
import numpy as np
import pytest
from anyio.from_thread import start_blocking_portal

import service
from catalog_tools.catalogue import MANIFEST_NAME
from pipeline.spec.dotted import changed
from service.accounts.keys import create_key, revoke_key
from service.app import create_app
from service.client import Client, RemoteJob
from service.engine import worker
from service.jobs.jobs import Phase
from service.settings import Settings
from service.store.database import connect
from service.store.leases import take
from tests.pins.told import check_told
from tests.service.conftest import SCENE

FILE = "d36fc21bd4646d6704cbab4077af88fc.csv"  # its content, by its digest
LONG_S = 1e6
REAL = ("standards.uws", "engine.looks", "jobs.changes")  # that wait by the real clock
SMALL = changed(SCENE, {"sensor.shape": [16, 24], "sensor.psf.sigma_px": 1.25})
FORM = "application/x-www-form-urlencoded"
LIMITS: dict[str, Any] = {
    "hosts": ("127.0.0.1", "night.test"),
    "body_bytes": 6000,
    "upload_bytes": 600,
    "targets": 2,
    "pixel_frames": 4000,
    "product_bytes": 12_000,
    "job_cpu_s": 2500.0,
    "sweep_points": 4,
    "queued_jobs": 5,
    "running_jobs": 2,
    "pixel_frames_day": 13_000,
    "bytes_kept": 5000,
    "wait_s": 0.02,
    "heartbeat_s": 0.02,
    "watchers": 3,
    "workers": 1,
    "plan_s": 50.0,
    "dashboard": "http://dash.test:8787",
    "lease_s": LONG_S,
    "free_bytes": 1,
}


class Clock:
    """A clock that stands still until a test or a sleeper moves it."""

    def __init__(self) -> None:
        self.now, self.slept = 1_700_000_000.25, 0.0

    def time(self) -> float:
        return self.now

    monotonic = perf_counter = time

    def sleep(self, seconds: float) -> None:
        self.now, self.slept = self.now + seconds, self.slept + seconds


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    """All of the service on one such clock; the ids and secrets that it makes are numbers."""
    clock = Clock()
    for _, name, _ in pkgutil.walk_packages(service.__path__, "service."):
        if (
            name[8:] not in REAL
            and "migrations" not in name
            and getattr(import_module(name), "time", None) is time
        ):
            monkeypatch.setattr(f"{name}.time", clock)
    ids, secrets = count(1), count(1)

    monkeypatch.setattr(
        "service.jobs.submissions.uuid4", lambda: SimpleNamespace(hex=f"{next(ids):032x}")
    )
    monkeypatch.setattr(
        "service.accounts.keys.secrets",
        SimpleNamespace(
            token_hex=lambda n: f"{next(secrets):0{2 * n}x}",
            token_urlsafe=lambda n: "k" * 43,
        ),
    )
    monkeypatch.setattr("service.jobs.changes.BETWEEN_LOOKS_S", 0.002)
    monkeypatch.setattr("service.engine.processes.worker", engine)
    monkeypatch.setattr("service.engine.attempts.worker", engine)
    monkeypatch.setattr(worker.logs, "set_up", lambda: None)
    return clock


@contextlib.contextmanager
def engine(settings: Settings, order: dict[str, Any]) -> Iterator[Any]:
    """The engine's process, in this one: its answers, line by line."""
    said, answers = io.BytesIO(), queue.Queue()
    given = SimpleNamespace(buffer=io.BytesIO(json.dumps(order).encode() + b"\n"))
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(settings.catalogues)
        patch.setattr(worker, "sys", SimpleNamespace(stdin=given, exit=sys.exit))
        patch.setattr(
            worker,
            "os",
            SimpleNamespace(
                fdopen=lambda *_, **__: said,
                dup=int,
                dup2=lambda *_: None,
                read=lambda *_: b"",
                _exit=lambda code: None,
                strerror=os.strerror,
            ),
        )
        worker.main()
    for line in said.getvalue().splitlines():
        answers.put(json.loads(line))
    answers.put(None)
    yield answers


class Wire(httpx.BaseTransport):
    """Requests to an application in this process."""

    def __init__(self, portal: Any, app: Any) -> None:
        self.portal, self.inner = portal, httpx.ASGITransport(app, raise_app_exceptions=False)

    def handle_request(self, request: httpx.Request) -> httpx.Response:
        body = request.read()

        async def ask() -> httpx.Response:
            sent = httpx.Request(request.method, request.url, headers=request.headers, content=body)
            answer = await self.inner.handle_async_request(sent)
            return httpx.Response(
                answer.status_code,
                headers=answer.headers,
                stream=httpx.ByteStream(await answer.aread()),
            )

        return self.portal.call(ask)


@contextlib.contextmanager
def served(home: Path, keys: tuple[str, ...] = (), **settings: Any) -> Iterator[Any]:
    """A service whose jobs are led by somebody else, and a client; `tokens`: a key of each team."""
    settings_ = Settings(home, **(LIMITS | settings))
    settings_.make_folders()
    (home / "tickets.key").write_bytes(bytes(32))
    table = connect(settings_.database_url)
    assert take(table, "somebody else", LONG_S)
    tokens = {team: create_key(table, team, f"of {team}", actor="test") for team in keys}
    app = create_app(settings_)
    with (
        start_blocking_portal() as portal,
        portal.wrap_async_context_manager(app.router.lifespan_context(app)),
        httpx.Client(transport=Wire(portal, app), base_url="http://127.0.0.1:80") as client,
    ):
        context = app.state.context
        wakes: list[bool] = []
        context.dispatcher.wake = lambda: wakes.append(True)
        yield SimpleNamespace(
            client=client,
            tokens=tokens,
            context=context,
            wakes=wakes,
            app=app,
            table=context.table,
            portal=portal,
        )
    table.dispose()


def short(text: str) -> str:
    """Ids as numbers, and tickets cut."""
    text = re.sub(r"\b0{16,}([0-9a-f]+)\b", r"<\1>", text)
    return re.sub(r"ticket=[^\"\s]{9,}", "ticket=...", text)


def plain(value: Any) -> Any:
    """Numbers at 10 digits."""
    if isinstance(value, float):
        return float(f"{value:.10g}")
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    return [plain(item) for item in value] if isinstance(value, list) else value


def answer_told(answer: httpx.Response) -> str:
    """An answer: a problem in words; else its headers, and its body as far as it can be read."""
    kind, content = answer.headers.get("content-type", ""), answer.content
    if kind == "application/problem+json":
        found = answer.json()
        errors = "".join(
            f"\n    {e['pointer']}: {e['value']}; {e['allowed']}" for e in found["errors"]
        )
        head = [found["type"]] if found["type"] != "about:blank" else []
        more = [f"{k}={v}" for k, v in answer.headers.items() if not k.startswith("content-")]
        return short(" ".join([str(answer.status_code), *head, *more, found["detail"]]) + errors)
    page = kind.startswith(("text/html", "image/svg", "text/javascript", "text/css"))
    drawn = kind in ("image/png", "application/fits", "application/x-tar") and len(content) > 99
    hidden = {"content-length", "etag"} if page or drawn else set()
    hidden |= {"content-length", "content-type"} if "json" in kind else set()
    told = [f"{k}={v}" for k, v in sorted(answer.headers.items()) if k not in hidden]
    body = "" if page else content.decode(errors="replace")
    if "json" in kind and body:
        body = json.dumps(plain(answer.json()), separators=(",", ":"))
    elif "x-type" in answer.headers:
        body = array_told(np.frombuffer(content, answer.headers["x-type"]))
    elif drawn:
        body = drawn_told(kind, io.BytesIO(content))
    body = re.sub(r'"(\w+)":', r"\1:", body).replace(":null", "-")
    body = re.sub(r"(&quot;|\W)(schema.{40}).*?(</uws:)", r"\1\2 ... \3", body)
    body = body if len(body) < 1500 else f"{body[:900]} ... {body[-200:]}"
    return short(" ".join([str(answer.status_code), *told]) + (f"\n    {body}" if body else ""))


def array_told(values: Any) -> str:
    flat = np.asarray(values, float).ravel()
    return f"mean {flat.mean():.6g}, most {flat.max():g}, first {flat[:4].round(3).tolist()}"


def drawn_told(kind: str, file: io.BytesIO) -> str:
    """A tar as its names and sizes, FITS as its header's names, a picture as its numbers."""
    if kind == "application/x-tar":
        with tarfile.open(fileobj=file) as tar:
            return ", ".join(f"{m.name} {oct(m.mode)}" for m in tar)
    if kind == "image/png":
        from PIL import Image

        image = np.asarray(Image.open(file))
        return f"{image.shape} {array_told(image)}"
    from astropy.io import fits

    with fits.open(file) as units:
        return f"{units[0].data.shape} {array_told(units[0].data)}"


def talk(house: Any, script: str, bodies: dict[str, Any], acts: dict[str, Any]) -> list[str]:
    """Ask line by line, `TEAM METHOD PATH [@BODY] [HEADER=VALUE]...`: `<N>` is an id, `!` acts."""
    lines = []
    for line in filter(None, re.split("; |\n", script)):
        lines.append(line)
        if line.startswith("!"):
            name, *words = line[1:].split()
            done = acts[name](*words)
            lines += [f"    {done}"] if done is not None else []
            continue
        given = re.sub(r"<(\w+)>", lambda m: f"{m[1]:0>32}", line)
        team, method, path, *rest = given.split()
        headers = dict(word.split("=", 1) for word in rest if not word.startswith("@"))
        headers = {name: value.replace("~", " ") for name, value in headers.items()}
        if team in house.tokens:
            headers["authorization"] = f"Bearer {house.tokens[team]}"
        content: Any = None
        for word in rest:
            if word.startswith("@"):
                content = bodies[word[1:]]
                kind = FORM if word.startswith("@form") else "application/json"
                headers.setdefault("content-type", kind)
        if isinstance(content, dict | list):
            content = urlencode(content) if headers["content-type"] == FORM else json.dumps(content)
        answer = house.last = house.client.request(method, path, headers=headers, content=content)
        if path.endswith("tickets") and answer.status_code == 201:
            house.href = answer.json()["href"]
        lines.append(answer_told(answer) + (" (wakes)" if house.wakes else ""))
        house.wakes.clear()
    return lines


def fill(product: Path, note: str = "") -> None:
    """A product of a few files, as far as a server of files looks at it."""
    for name, text in {
        ".begun.json": "{}\n",
        "_COMPLETE": "{}\n",
        "plan.json": '{"tiles": 2}',
        "scene.yaml": "",
        "report.json": '{"tiles": 2}',
        "preview.png": "\x89PNG\n",
        "cube.zarr/zarr.json": "{}",
        "cube.zarr/dn/c/0": "0123456789" * 3,
        "truth/a b.txt": note or "a\n",
        ".hidden/x": "x",
        "truth/.x": "x",
        "truth/long": "x" * 600,
    }.items():
        path = product / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="latin-1")
        os.utime(path, ns=(10**18, 10**18 + len(name)))
    (product / "link").symlink_to("scene.yaml")


def acts_of(house: Any, clock: Clock) -> dict[str, Any]:
    """What happens behind the requests."""
    from service.engine.attempts import Attempt
    from service.engine.cluster import SchedulerHealth

    table, settings, held = house.table, house.context.settings, SimpleNamespace(job=None)

    def claim(most: str = "9") -> str:
        held.job = table.claim(team_limit=int(most))
        return repr(held.job and (held.job.team, held.job.number, held.job.attempt))

    def finish(phase: str, error: str = "null", kept: str = "0") -> None:
        told = json.loads(error.replace("~", " "))
        values = {"error": told} if told else {"content_digest": "d" * 64}
        table.finish(held.job, Phase(phase), bytes_kept=int(kept), **values)

    def run() -> None:
        Attempt(settings, table, held.job, lambda: True, SchedulerHealth("threads")).run()

    def revoke(team: str) -> None:
        revoke_key(table.engine, house.tokens[team], "test")

    return {
        "follow": lambda: answer_told(house.client.get(house.href)),
        "tick": lambda s: setattr(clock, "now", clock.now + float(s)),
        "claim": claim,
        "progress": lambda done, total: table.progress(held.job, int(done), int(total)),
        "finish": finish,
        "run": run,
        "revoke": revoke,
        "fill": lambda n, note="": fill(settings.product(f"{n:0>32}"), note),
        "sweep": lambda: [table.delete(i, actor="service") for i in table.overdue()],
        "forget": lambda: [table.forget(i) for i in table.deleted()],
    }


def scene(**changes: Any) -> dict[str, Any]:
    return changed(SMALL, {name.replace("__", "."): value for name, value in changes.items()})


SWEEP = {
    "schema": "nightglass/sweep/1",
    "name": "two",
    "scene": SMALL,
    "axes": [{"field": "sensor.read_noise_e", "values": [1, 2]}],
}
FAULT = '{"kind":"fault","message":"it~broke","errors":[]}'
BAD = (
    '{"kind":"bad~input","message":"seed:~2","errors":'
    '[{"pointer":"/seed","value":"2","allowed":"a~whole~number"}]}'
)
BODIES: dict[str, Any] = {
    "scene": SMALL,
    "other": scene(name="other", exposure__frames=3),
    "big": scene(sensor__shape=[99, 99]),
    "wide": scene(sensor__shape=[40, 40], exposure__frames=2),
    "sweep": SWEEP,
    "yaml": "seed: 1\nname: [a, 0x10, no, ~]\n",
    "formrun": {"SCENE": json.dumps(SMALL), "PHASE": "run", "RUNID": "r 1"},
    "form": {
        "scene": json.dumps(scene(name="form")),
        "EXECUTIONDURATION": "90",
        "DESTRUCTION": "2023-11-15T00:00:00",
    },
    "formless": {"PHASE": "RUN"},
    "formtwo": f"SCENE={json.dumps(SMALL)}&scene=2",
    "formbad": "SCENE=%FF",
    "formrunid": {"RUNID": "again"},
    "formabort": {"PHASE": "ABORT"},
    "formodd": {"PHASE": "DONE"},
    "formdelete": {"ACTION": "DELETE"},
    "formunknown": {"SCENE": "{}", "ZED": "1"},
    "formlang": {"LANG": "x"},
    "formtimes": {"EXECUTIONDURATION": "-1"},
    "formwhen": {"DESTRUCTION": "soon"},
    "formname": {"RUNID": "\t"},
    "formlate": {"DESTRUCTION": "2023-11-14T22:30:00+00:00", "EXECUTIONDURATION": "0", "RUNID": ""},
    "formscene": {"QUERY": json.dumps(scene(name="anew", exposure__frames=4))},
    "formyaml": {"SCENE": "a: 1"},
    "ogc": {"inputs": {"scene": {"value": SMALL}}, "response": "document"},
    "ogcbare": {"inputs": {"scene": SMALL}},
    "ogcnone": {"inputs": {}},
    "ogchref": {"inputs": {"scene": {"href": "http://x.test"}}},
    "ogccall": {"inputs": {"scene": SMALL}, "subscriber": {"successUri": "http://x.test"}},
    "file": "wavelength_nm,value\n400,0.5\n900,0.9\n",
    "more": "x" * 601,
    "npy": b"\x93NUMPY",
    "gz": b"\x1f\x8b",
    "named": scene(sensor__bandpass={"kind": "table", "path": f"upload:{FILE}"}),
    "ticket": {"path": f"/v1/jobs/{1:032x}/report"},
    "noticket": {"path": "/healthz"},
    "odd": {"place": 1},
}

TALK = """
- GET /healthz; - GET /readyz; - GET /v1/jobs
- GET /v1/jobs authorization=Bearer~ng_000000000001_kkk; - GET /v1/jobs authorization=Basic~abc
red GET /v1/usage; red POST /v1/jobs @scene idempotency-key=a
red POST /v1/jobs @scene idempotency-key=a; red POST /v1/jobs @other idempotency-key=a
blue POST /v1/jobs @other idempotency-key=a; red GET /v1/jobs/<2>; blue GET /v1/jobs/<2>
blue GET /v1/jobs/<1>
blue POST /v1/jobs/<1>/cancel; blue POST /v1/jobs/<1>/retry; blue DELETE /v1/jobs/<1>
blue GET /v1/jobs/<1>/scene; blue GET /v1/jobs/<1>/plan; blue GET /v1/jobs/<1>/frames
blue POST /uws/async/<1> @formrunid; blue POST /uws/async/<1>/phase @formless
blue DELETE /ogc/jobs/<1>; blue GET /uws/async/<1>/phase; blue GET /uws/async
blue GET /ogc/jobs; blue GET /v1/queue; blue GET /v1/jobs; blue GET /v1/usage
red GET /v1/jobs/<1> if-none-match="1"
red GET /v1/jobs/<1>?wait=9 if-none-match="1"; red GET /v1/jobs/<1>?wait=9 if-none-match="7"
red GET /v1/jobs/<1>/scene; red GET /v1/jobs/<1>/results; red GET /v1/jobs/<1>/plan
red GET /v1/jobs/<1>/frames; red POST /v1/jobs/<1>/retry; ! tick 1.5; ! claim; ! progress 1 4
red GET /v1/jobs/<1>; red GET /ogc/jobs/<1>; red GET /uws/async/<1>; ! tick 2.25; ! fill 1
! finish COMPLETED null 700; red GET /v1/jobs/<1>; red GET /v1/jobs/<1> if-none-match="4"
red POST /v1/jobs/<1>/cancel; red POST /v1/jobs/<1>/retry; red GET /v1/jobs/<1>/events
red GET /v1/jobs/<1>/events last-event-id=4; red GET /v1/jobs/<1>/results
red GET /v1/jobs/<1>/results?limit=3; red GET /v1/jobs/<1>/results?limit=3&after=plan.json
red HEAD /v1/jobs/<1>/results/plan.json; red GET /v1/jobs/<1>/results/plan.json
red GET /v1/jobs/<1>/results/truth/a%20b.txt range=bytes=0-0
red GET /v1/jobs/<1>/results/.begun.json; red GET /v1/jobs/<1>/results/link
red GET /v1/jobs/<1>/results/truth; red GET /v1/jobs/<1>/preview.png; red GET /v1/jobs/<1>/report
red GET /v1/jobs/<1>/plan; red GET /v1/jobs/<1>/record; red GET /v1/jobs/<1>/product.tar
blue GET /v1/jobs/<1>/report; red GET /ogc/jobs/<1>; red GET /ogc/jobs/<1>/results
red GET /uws/async/<1>; red GET /uws/async/<1>/results; red GET /uws/async/<1>/results/product
red GET /uws/async/<1>/results/zed; blue POST /v1/jobs/<2>/cancel; blue POST /v1/jobs/<2>/cancel
blue GET /ogc/jobs/<2>; blue GET /ogc/jobs/<2>/results; blue DELETE /v1/jobs/<2>
blue GET /v1/jobs/<2>; ! forget; red POST /uws/async @formrun; red POST /uws/async @form
red GET /uws/async/<4>; red GET /uws/async/<4>/parameters
red GET /uws/async/<4>/executionduration; red GET /uws/async/<4>/destruction
red GET /uws/async/<4>/owner; red GET /uws/async/<4>/quote; red GET /uws/async/<4>/zed
red POST /uws/async/<4>/parameters @formscene; red POST /uws/async/<4> @formrunid
red POST /uws/async/<4>/executionduration @formlate; red GET /v1/usage
red GET /uws/async/<4>?WAIT=1&PHASE=QUEUED; red POST /uws/async/<4>/phase @formless
red POST /uws/async/<4>/phase @formless; red GET /uws/async/<4>/phase
red POST /uws/async/<4>/parameters @formscene; red GET /uws/async?PHASE=QUEUED&LAST=1
red GET /uws/async?AFTER=2023-11-14T22:13:22Z; red GET /uws/async/<4>?WAIT=-1&PHASE=queued
red POST /uws/async/<4>/phase @formabort; red POST /uws/async/<4>/phase @formless
red POST /uws/async/<4>/zed @formless; red POST /uws/async/<3> @formdelete
red DELETE /uws/async/<4>; ! forget; red POST /ogc/processes/render/execution @ogc
red GET /ogc/jobs; red DELETE /ogc/jobs/<5>; red DELETE /ogc/jobs/<5>; red GET /ogc/jobs/<5>
! forget; red POST /v1/sweeps @sweep idempotency-key=s
red POST /v1/sweeps @sweep idempotency-key=s; ! claim; red POST /v1/jobs/<6>/cancel
red POST /v1/jobs/<6>/cancel; ! finish ERROR FAULT 100; red GET /v1/jobs/<6>
red GET /uws/async/<6>/error; red GET /uws/async/<6>; red GET /ogc/jobs/<6>/results
red POST /v1/jobs/<6>/retry; ! claim; ! finish ERROR BAD; red GET /uws/async/<6>/error
red GET /uws/async/<6>; red POST /v1/jobs/<6>/retry; ! claim; red GET /v1/jobs?limit=1
red GET /v1/jobs?limit=1&phase=ERROR&phase=COMPLETED; red GET /v1/jobs?after=5&phase=ERROR
red GET /v1/queue?limit=1; red GET /v1/usage; red POST /v1/files?name=band.csv @file
red POST /v1/files?name=band.csv @file; blue POST /v1/files?name=b.csv @file
red POST /v1/files?name=c.csv @more; red POST /v1/files?name=c.zip @file
red POST /v1/files?name=c.npy @npy; red POST /v1/files?name=c.txt @gz; red GET /v1/files
red POST /v1/jobs @named; red DELETE /v1/files/FILE; blue POST /v1/jobs @named
blue DELETE /v1/files/upload:FILE; blue POST /v1/jobs @named; red POST /v1/jobs/<7>/cancel
red DELETE /v1/files/FILE; red DELETE /v1/files/FILE; red GET /v1/catalogues
red GET /v1/queue?limit=2; red POST /v1/tickets @ticket; ! follow
- GET /v1/jobs/<2>/report?ticket=abc.0; ! tick 61; ! follow; red POST /v1/tickets @noticket
red POST /v1/tickets @odd; - GET /v1/jobs/<1>/report?ticket=abc.0
red POST /v1/schema/scene/read @yaml content-type=application/yaml; red POST /v1/jobs @wide
red POST /v1/jobs @wide; ! claim; ! progress 0 0; blue GET /ogc/jobs/<8>; ! fill 8 NOTE
! finish COMPLETED null 5000; red POST /v1/jobs @scene; red POST /v1/files?name=band.csv @file
! tick 86400; blue POST /v1/jobs @scene; red POST /v1/jobs @scene; red POST /v1/jobs @scene
red POST /uws/async @form; red POST /v1/jobs @scene; ! claim 1; ! claim 1; ! revoke blue
blue GET /v1/usage; ! tick 2.5; blue GET /v1/usage; old GET /v1/usage; - HEAD /
- GET /page/icon.svg; - GET /page/zed.js
"""


def test_a_long_talk(clock: Clock, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Jobs, results, UWS, OGC, files, quotas and keys, of two teams."""
    with served(tmp_path, ("red", "blue")) as house:
        script = TALK.replace("FAULT", FAULT).replace("BAD", BAD).replace("FILE", FILE)
        told = talk(house, script, BODIES, acts_of(house, clock))
        audit = house.table.engine.connect().exec_driver_sql("select * from audit").all()
    check_told("service/talk", "\n".join(told), home=tmp_path)
    check_told("service/audit", short("\n".join(map(repr, audit))))


WRONG = """
- GET /v1/jobs host=evil.test; - POST /v1/jobs @scene origin=http://evil.test
- POST /v1/jobs @scene sec-fetch-site=cross-site
- DELETE /v1/jobs/x origin=http://127.0.0.1 sec-fetch-site=same-origin
- GET /v1/jobs host=NIGHT.test:8080; - DELETE /v1/jobs/x host=127.0.0.1:8 origin=http://127.0.0.1:8
- DELETE /v1/jobs/x host=127.0.0.1:8 origin=http://127.0.0.1
- GET /v1/zed; - PUT /v1/jobs; - TRACE /v1/jobs
- POST /v1/jobs; - POST /v1/jobs @scene content-type=text/plain
- POST /v1/jobs @scene content-type=application/json;charset=latin-1
- POST /v1/jobs @scene content-type=application/json;charset="UTF-8" content-encoding=gzip
- POST /v1/jobs @scene idempotency-key=a~b; - POST /v1/jobs?dry_run=perhaps @scene
- POST /v1/jobs @long; - POST /v1/jobs @list; - POST /v1/jobs @none; - POST /v1/jobs @two
- POST /v1/jobs @big; - POST /v1/jobs @bytes; - POST /v1/jobs @cpu; - POST /v1/jobs @dwells
- POST /v1/jobs @targets; - POST /v1/jobs @named; - POST /v1/jobs @path; - POST /v1/jobs @stars
- POST /v1/jobs @starlist; - POST /v1/jobs @sky; - POST /v1/sweeps @sweepfile
- POST /v1/sweeps @sweepshape; - POST /v1/sweeps @sweeptargets; - POST /v1/sweeps @sweeppath
- POST /v1/sweeps @sweepmany; - POST /v1/sweeps @scene
- POST /v1/sweeps @sweep idempotency-key=a~b; - GET /v1/jobs?limit=0; - GET /v1/jobs?limit=1001
- GET /v1/jobs?after=-1; - GET /v1/jobs?phase=DONE; - GET /v1/jobs/x?wait=nan
- GET /v1/jobs/x?wait=3601; - GET /v1/queue?limit=0; - GET /v1/jobs/x/results?limit=10001
- GET /v1/jobs/x/frames/-1; - GET /v1/jobs/x/frames/0/tiles/0/a
- GET /v1/jobs/x/frames/0/tiles/0/0?bin=65
- GET /v1/jobs/x/frames/0/tiles/0/0/picture.png?stretch=none&low=a
- GET /v1/jobs/x/frames/0/truth?limit=-1; - GET /v1/jobs/x/events; - GET /v1/jobs/x/zed
- POST /v1/files @file; - POST /v1/files?name=.a.csv @file; - DELETE /v1/files/zed
- GET /ogc/processes/zed; - POST /ogc/processes/zed/execution @ogc
- POST /ogc/processes/plan/execution @ogcnone; - POST /ogc/processes/render/execution @ogchref
- POST /ogc/processes/render/execution @ogccall; - POST /ogc/processes/render/execution @list
- GET /ogc/jobs?limit=0; - GET /ogc/jobs/x; - DELETE /ogc/jobs/x
- POST /uws/async content-length=0; - POST /uws/async @formless; - POST /uws/async @formtwo
- POST /uws/async @formbad; - POST /uws/async @formunknown; - POST /uws/async @formlang
- POST /uws/async @formyaml; - POST /uws/async @scene; - POST /uws/async/x @formrunid
- GET /uws/async?PHASE=zed; - GET /uws/async?AFTER=soon; - GET /uws/async?LAST=0
- GET /uws/async?last=1234567890; - POST /uws/async @form; - GET /uws/async/<1>?WAIT=x
- GET /uws/async/<1>?WAIT=-2; - POST /uws/async/<1> @formname; - POST /uws/async/<1> @formtimes
- POST /uws/async/<1> @formwhen; - POST /uws/async/<1> content-length=0
- POST /uws/async/<1>/phase @formodd; - GET /uws/async/<1>/results/result; - GET /metrics
"""
BODIES |= {
    "long": " " * 6001,
    "list": [],
    "none": "",
    "two": '{"a": 1, "a": 2}',
    "bytes": scene(exposure__frames=9, output={"layers": ["dn", "mean_e"]}),
    "cpu": scene(exposure__frames=9),
    "dwells": scene(dwells=[{"frames": 4}, {"frames": 9}]),
    "targets": scene(targets=SMALL["targets"] * 3),
    "path": scene(sensor__bandpass={"kind": "table", "path": "/etc/passwd"}),
    "stars": scene(stars={"catalogue": "zed"}),
    "starlist": scene(stars={"catalogue": ["good", "../x"]}),
    "sky": scene(epoch="1800-01-01T00:00:00Z"),
    "sweepfile": SWEEP | {"scene": "base.yaml"},
    "sweepshape": SWEEP | {"axes": [{"field": "sensor.shape", "values": [[8, 8]]}]},
    "sweeptargets": SWEEP
    | {"axes": [{"kind": "list", "fields": ["targets.0.body.albedo", "output"], "rows": [[1, 2]]}]},
    "sweeppath": SWEEP | {"axes": [{"field": "sensor.bandpass.path", "values": ["x"]}]},
    "sweepmany": SWEEP | {"axes": [{"field": "seed", "values": [1, 2, 3, 4, 5]}]},
}


def test_wrong_requests(clock: Clock, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """What is refused on an open service, in words; what is counted and logged of it."""
    (tmp_path / "catalogues" / "good").mkdir(parents=True)
    (tmp_path / "catalogues" / "good" / MANIFEST_NAME).write_text("{}")
    with (
        served(tmp_path, job_cpu_s=4.45) as house,
        caplog.at_level(logging.DEBUG, "nightglass.requests"),
    ):
        house.context.dispatcher._busy = dict.fromkeys("ab", SimpleNamespace(ident=None))
        told = talk(house, WRONG, BODIES, acts_of(house, clock))
    metrics = house.last.text.splitlines()
    left_out = "_created|disk_free_bytes \\d|uptime_seconds [-\\d]|"
    left_out += '_answer_seconds_.*(/jobs|/ogc|/uws|/files|e"})'
    kept = [line for line in metrics if not re.search(left_out, line)]
    names = ("levelname", "method", "path", "status", "ms", "team", "job")
    logged = Counter(
        " ".join(str(getattr(r, name)) for name in names)
        for r in caplog.records
        if r.name == "nightglass.requests"
    )
    lines = [f"{n} x {line}" for line, n in sorted(logged.items())]
    check_told("service/wrong", "\n".join(told[:-1]))
    check_told("service/counted", short("\n".join([*kept, *lines])))


FRAMES = """
- GET /v1/jobs/<1>/frames; - GET /v1/jobs/<1>/frames/1; - GET /v1/jobs/<1>/frames/2
- GET /v1/jobs/<1>/frames/0/tiles/0/0; - GET /v1/jobs/<1>/frames/1/tiles/0/0?bin=5
- GET /v1/jobs/<1>/frames/0/tiles/1/0; - GET /v1/jobs/<1>/frames/0/tiles/0/1
- GET /v1/jobs/<1>/frames/0/tiles/0/0?layer=zed; - GET /v1/jobs/<1>/frames/0/tiles/0/0/picture.png
- GET /v1/jobs/<1>/frames/0/tiles/0/0/picture.png?stretch=log&low=90&high=500
- GET /v1/jobs/<1>/frames/0/tiles/0/0/picture.png?stretch=linear&low=100&bin=2
- GET /v1/jobs/<1>/frames/0/tiles/0/0/picture.png?low=5&high=5; - GET /v1/jobs/<1>/frames/1/truth
- GET /v1/jobs/<1>/frames/1/fits; - GET /v1/jobs/<1>/frames/1/fits?layer=zed
- GET /v1/jobs/<1>/product.tar; - GET /uws/async/<1>/results/result; - GET /v1/jobs/<2>/frames
- GET /v1/jobs/<2>/frames/0; - GET /v1/jobs/<2>/frames/1; - GET /v1/jobs/<2>/frames/1/tiles/0/0
- GET /v1/jobs/<2>/frames/0/fits
"""


def test_a_drawn_job(clock: Clock, tmp_path: Path) -> None:
    """One small scene, drawn in this process: its frames, and what the client makes of it."""
    with served(tmp_path / "home", heartbeat_s=0.01) as house:
        acts = acts_of(house, clock)
        client = Client("http://127.0.0.1", "key")
        client.http.close()
        client.http = house.client
        drawn = scene(name="Ab..c-", output={"layers": ["dn", "mean_e"]})
        jobs = [client.submit(drawn), client.submit(SMALL, "k"), client.sweep(SWEEP)]
        told = [repr(jobs), acts["claim"]()]
        acts["run"]()
        shutil.copytree(
            house.context.settings.product(jobs[0].id), house.context.settings.product(jobs[1].id)
        )
        begun = house.context.settings.product(jobs[1].id)
        (begun / "_COMPLETE").unlink()
        (begun / "markers" / "f000001_r000_c000.json").unlink()
        told += [acts["claim"](), *talk(house, FRAMES, {}, acts)]
        told += client_told(client, jobs, tmp_path)
        plan, size = client.plan(drawn), house.client.post("/v1/sweeps?dry_run=1", json=SWEEP)
        ogc = house.client.post("/ogc/processes/plan/execution", json=BODIES["ogc"]).json()
        told += [f"{[*plan]}", f"{size.json() | {'base': 0}}", f"{[*ogc]} {ogc['plan']['frames']}"]
        told += house.portal.call(events_told, house, jobs[1].id)
    check_told("service/drawn", re.sub(r"<\w+> 0o644", "", short("\n".join(told))), folder=tmp_path)


def client_told(client: Client, jobs: list[RemoteJob], folder: Path) -> list[str]:
    """What the client says of jobs, and what it brings."""
    heard: list[str] = []
    job, begun, sweep = jobs

    def attempt(what: Any, *given: Any, **more: Any) -> None:
        try:
            heard.append(f"{what.__name__}: {what(*given, **more)!r}"[:700])
        except Exception as error:
            heard.append(f"{what.__name__}: {type(error).__name__}: {error}")

    job.wait(progress=lambda facts: heard.append(f"{facts['phase']} {facts['tiles_total']}"))
    attempt(job.fetch, folder / "got", progress=lambda facts: heard.append(repr(facts)))
    heard[1:] = sorted(set(heard[1:]))
    kept = next((folder / "got" / "cube.zarr" / "dn").rglob("c/0/0/0"))
    kept.write_bytes(kept.read_bytes()[:-1] + b"!")
    attempt(job.fetch, folder / "got", 1, False)
    attempt(job.fetch, folder / "got", 1, False)
    cut = kept.with_name("0.part")
    cut.write_bytes(kept.read_bytes()[:7])
    kept.unlink()
    attempt(job.fetch, folder / "got", 1, False)
    heard.append(f"{sorted(p.name for p in (folder / 'got').iterdir())} {cut.exists()}")
    heard.append(f"{dict(job.open(folder / 'got').sizes)}")
    for what, given in (
        (job.fetch, (folder,)),
        (begun.fetch, (folder / "no",)),
        (sweep.points, ()),
        (job.points, ()),
        (job.fetch_sweep, (folder / "s",)),
        (begun.cancel, ()),
        (begun.wait, (0.0, False)),
        (sweep.cancel, ()),
        (sweep.wait, (None, False)),
        (sweep.retry, ()),
        (sweep.delete, ()),
        (sweep.refresh, ()),
        (client.job, (job.id,)),
        (client.job, ("a/b",)),
        (client.catalogues, ()),
        (client.submit, (SMALL | {"seed": -1, "name": 5},)),
        (client.submit, (folder / "no.yaml",)),
        (begun.report, ()),
    ):
        attempt(what, *given)
    heard.append(f"{[j.name for j in client.jobs('EXECUTING')]} {[*job.report()]}")
    return [*heard, job.scene()["name"]]


async def events_told(house: Any, job_id: str) -> list[str]:
    """A stream of events: beats, a change, and the end of a job that is deleted."""
    from service.jobs.changes import Changes
    from service.routes.jobs import _events

    table, settings = house.table, SimpleNamespace(heartbeat_s=0.01)
    changes = Changes(table, 2)

    def change(job: Any, limit_s: float) -> Any:
        return changes.after(job.id, job.version, limit_s)

    context = SimpleNamespace(store=table, settings=settings, change=change)
    stream = _events(context, table.get(job_id), None)
    told = [await anext(stream) for _ in range(3)]
    settings.heartbeat_s = 9.0
    table.amend(job_id, run_id="changed")
    told += [await anext(stream)]
    table.delete(job_id)
    return [*told, await anext(stream), f"{[last async for last in stream]}"]


def test_the_document(tmp_path: Path) -> None:
    """OpenAPI, in short: parameters, bodies, answers; a job and a problem whole."""
    from service.openapi import REFUSALS

    document = create_app(Settings(tmp_path)).openapi()
    lines, usual = [], set(REFUSALS)
    for path, methods in document["paths"].items():
        for method, told in methods.items():
            lines.append(f"{method.upper()} {path}: {told['summary']} {told.get('tags')}")
            for given in told.get("parameters", []):
                form = {
                    k: v for k, v in given["schema"].items() if k not in ("title", "description")
                }
                need = "!" if given["required"] else ""
                lines.append(f"    {given['in']} {given['name']}{need} {json.dumps(form)}")
            body = told.get("requestBody", {})
            if body:
                lines.append(f"    body {body['description']} {[*body['content']]}")
            answers = told["responses"]
            for status, answer in answers.items():
                if status not in usual:
                    content = {k: v.get("schema") for k, v in answer.get("content", {}).items()}
                    lines.append(f"    {status} {answer['description']} {json.dumps(content)}")
            lines.append(f"    refusals {' '.join(s for s in sorted(answers) if s in usual)}")
    told = document["components"]["schemas"] | {"refusals": REFUSALS}
    lines += [f"{name}: {json.dumps(form)}" for name, form in sorted(told.items())]
    lines.append(json.dumps(document["components"].get("securitySchemes")))
    check_told("service/openapi", "\n".join(lines))
