"""Pinned courses of the service: attempts at jobs, the client's patience, keys, tokens, starts."""

from __future__ import annotations

import asyncio
import contextlib
import fcntl
import io
import json
import queue
import sqlite3
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx
import jwt
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import sqlalchemy as sa
from cryptography.hazmat.primitives.asymmetric import ed25519
from sqlalchemy.exc import OperationalError
from typer.testing import CliRunner

from catalog_tools.catalogue import MANIFEST_NAME
from catalog_tools.engine.code import code_digest
from catalog_tools.storage.durable import file_digest
from pipeline.errors import BadInput, Damaged
from pipeline.spec.sweep import ListAxis
from service import app as app_module
from service import fetching, main, problems
from service.accounts import oidc
from service.accounts.auth import Authenticator, Caller
from service.accounts.commands import app as keys_app
from service.accounts.keys import create_key, revoke_key
from service.accounts.tickets import Tickets
from service.client import Client, RemoteJob
from service.engine import attempts, looks, orders, processes, runner, worker
from service.engine.cluster import SchedulerHealth
from service.http.wire import bounded
from service.jobs.jobs import Phase, Queue
from service.jobs.shares import Shares
from service.jobs.submissions import Ask, TeamLimits, submit_many
from service.problems import NotReady
from service.products import archive, frames, pixels
from service.routes import health
from service.scenes import catalogues, sweeps
from service.scenes.accepted import Acceptance
from service.settings import Settings
from service.store import database
from service.store.database import connect, sqlite_url
from service.store.tables import metadata
from tests.pins.test_told_service import (
    SMALL,
    Clock,
    acts_of,
    answer_told,
    clock,
    fill,
    served,
    short,
)
from tests.pins.test_told_service_parts import brief, check, db_row, request, told

__all__ = ["clock"]
ENDS = {
    "done": [{"done": 1, "total": 4}, {"outcome": "done", "tiles": 4, "content_digest": "c"}],
    "unsealed": [{"outcome": "done", "tiles": 4, "content_digest": None}],
    "dies": [None],
    "dies later": [{"done": 3, "total": 4}, None],
    "bad": [{"outcome": "error", "error": {"kind": "bad input", "message": "m", "errors": []}}],
    "later": [
        {"outcome": "error", "error": {"kind": "try later", "message": "gone", "errors": []}}
    ],
    "some, later": [
        {"done": 2, "total": 4},
        {"outcome": "error", "error": {"kind": "try later", "message": "g"}},
    ],
    "silent": [],
}


def test_attempts(clock: Clock, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What becomes of a job as its worker ends one way after the other; orders; the dispatcher."""
    settings = Settings(tmp_path, scheduler_s=400.0, lease_s=5.0, slots=1, workers=2, job_cpu_s=7.0)
    settings.make_folders()
    table, lines, orders, script = Queue(settings.database_url), [], [], []

    @contextmanager
    def scripted(_: Any, order: dict[str, Any]) -> Iterator[Any]:
        orders.append(
            {k: v for k, v in order.items() if k != "scene"} | {"scene": [*order["scene"]]}
        )
        answers: Any = queue.Queue()
        name = script.pop(0) if len(script) > 1 else script[0]
        for answer in ENDS[name]:
            answers.put(answer)
        if name == "done":
            fill(settings.product(order["job"]))
        if name == "silent":
            answers = SimpleNamespace(get=lambda timeout: clock.sleep(timeout) or _empty())
        yield answers

    monkeypatch.setattr("service.engine.attempts.worker", scripted)
    jobs = {}
    for course, more in (
        ("done", {}),
        ("unsealed", {}),
        ("dies", {}),
        ("dies;dies later;dies;dies", {}),
        ("bad", {}),
        ("later;later;later;done", {}),
        ("later", {}),
        ("some, later;later;done", {}),
        ("silent", {"duration_s": 3.5}),
        ("done", {"kind": "sweep"}),
    ):
        scene = {"scene": dict(SMALL)} if more else dict(SMALL)
        scene = scene if more.get("kind") else dict(SMALL)
        [(job, _)] = submit_many(table, [Ask("n", scene, "0" * 64, **more)], TeamLimits())  # type: ignore[misc]
        jobs[course], script[:], begun = job, course.split(";"), clock.now
        for _ in range(6):
            claimed = table.claim()
            if claimed is None:
                break
            attempts.Attempt(
                settings, table, claimed, lambda: True, SchedulerHealth("threads")
            ).run()
        lines.append(f"{course} {more}: {clock.now - begun:.1f} s {brief(table.get(job.id))}")
    lines += [json.dumps(order) for order in orders[:1] + orders[-1:]]
    lines.append(attempts.bytes_of(settings.products) and f"{attempts.bytes_of(tmp_path / 'no')}")
    table.engine.dispose()
    lines += _led(clock, settings, script)
    check("attempts", [short(line) for line in lines])


def _empty() -> Any:
    raise queue.Empty


def _led(clock: Clock, settings: Settings, script: list[str]) -> list[str]:
    """A dispatcher without its threads: who leads, what it takes up, what it removes."""
    table, lines = Queue(settings.database_url), []
    asks = [
        Ask(f"n{i}", SMALL, "0" * 64, team=team) for i, team in enumerate(("red", "red", "blue"))
    ]
    made = [m[0] for m in submit_many(table, asks, TeamLimits()) if isinstance(m, tuple)]
    led = runner.Dispatcher(settings, table)
    led.holder = "me"
    script[:] = ["done"]

    def state(what: str) -> None:
        names = [j.name for j in table.listing((Phase.COMPLETED,), 0, 99) if j.name != "n"]
        lines.append(
            f"{what}: leads {led.leads} {led.leaderless_s:g} {led.running} {led.alive} {names}"
        )

    state("new")
    lines.append(f"step {led._step()}")
    clock.now += 15.5
    state("alone")
    led.stopping.wait = lambda _: led.stopping.set()  # one round of each thread
    led._renew()
    state("renewed")
    led.stopping.clear()
    for _ in range(4):
        lines.append(f"step {led._step()} {sorted(led._turns)}")
        for thread in list(led._busy.values()):
            thread.join()
        state("stepped")
    lines.append(f"goes on {led._go_on()}")
    table.delete(made[0].id)
    table.amend(made[1].id, destruction_s=clock.now - 1.0)
    rounds = iter((False, True))
    led.stopping.wait = lambda _: next(rounds)
    led._keep()
    lines.append(f"left {[brief(j)[:60] for j in table.listing((), 0, 99) if j.name != 'n']}")
    lines.append(f"{settings.product(made[0].id).exists()} {db_row(table.engine, 'leases')}")
    clock.now += 4.9
    state("before its end")
    clock.now += 0.2
    state("after it")
    lines.append(f"claims {table.claim(holder=led.holder)}")
    led.stop()
    return [*lines, str(db_row(table.engine, "leases"))[-6:]]


def test_the_process_of_the_engine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where it works, what it is told, what it may not know; what its answers mean."""
    settings = Settings(tmp_path)
    settings.make_folders()
    lines: list[str] = []
    code = (
        "import sys,json;o=json.loads(sys.stdin.readline());print('{cut');"
        "print(json.dumps(o['say']))"
    )

    def begin(folder: Path, files: tuple[int, int]) -> Any:
        lines.append(f"in {folder.name}")
        command = [sys.executable, "-S", "-E", "-c", code]
        started = subprocess.Popen(command, stdin=files[0], stdout=files[1])
        return lambda: (started.kill(), started.wait())

    monkeypatch.setattr(processes, "_forks", SimpleNamespace(begin=begin))
    with processes.worker(settings, {"say": {"outcome": "done"}}) as answers:
        lines += [f"{answers.get(timeout=20)}" for _ in range(2)]
    lines += [
        f"{k}: {processes._secret(k)}"
        for k in ("NIGHTGLASS_TLS_CERT", "NIGHTGLASS_OIDC", "NIGHTGLASS_KEY")
    ]
    for said in (
        {"outcome": "done", "plan": 1},
        {"error": {"kind": "bad input", "message": "m", "errors": [1]}},
        {"error": {"kind": "fault", "message": "f"}},
        None,
        "nothing",
    ):

        @contextmanager
        def answering(*_: Any, said: Any = said) -> Iterator[Any]:
            answers: Any = queue.Queue()
            if said != "nothing":
                answers.put(said)
            yield answers

        monkeypatch.setattr(processes, "worker", answering)
        monkeypatch.setattr(processes, "POLL_S", 0.001)
        lines.append(
            told(processes.look_at, settings, {}, -1.0, lambda: False, shown=f"look {said}")
        )
    lines.append(told(processes.look_at, settings, {}, 1.0, lambda: True, shown="stopped"))
    check("process", lines)


def test_the_client_is_patient(
    clock: Clock, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """How long it asks a server that fails, and what it takes from one that is odd."""
    monkeypatch.setenv("NIGHTGLASS_KEY", "from-env")
    lines = [
        told(lambda url=url: Client(url).url, shown=url)
        for url in ("ftp://x", "http://h:8/", "http://[", "https://h")
    ]
    lines += [
        str(Client("http://h").headers),
        str(Client("http://h", "").headers),
        str(Client("http://h", "k").headers),
    ]
    for script, patience_s in (
        ("200", 9),
        ("503 200", 9),
        ("x x 200", 9),
        ("x", 60),
        ("200 x", 60),
        ("503", 7),
        ("429", 0.2),
        ("500", 9),
        ("404", 9),
    ):
        client, clock.slept = _odd(script.split(), patience_s), 0.0
        found = [
            told(client.ask, "GET", "/v1/jobs", shown="")[:90]
            for _ in range(1 + script.startswith("200 "))
        ]
        lines.append(
            f"{script} for {patience_s}: {found} slept {clock.slept:g} asked {len(client.asked)}"
        )
    job = RemoteJob(
        _odd(["200"], 1),
        {"id": "a", "name": "n", "phase": "COMPLETED", "kind": "scene", "content_digest": None},
    )
    part = tmp_path / "f.part"
    for have, status, sent in (
        (0, 200, b"abc"),
        (2, 206, b"c"),
        (2, 200, b"c"),
        (0, 200, b"abcd"),
        (0, 503, b""),
        (0, 404, b"{}"),
    ):
        part.write_bytes(b"ab"[:have])
        job.client.http = _transport([(status, sent)])
        counted: list[int] = []
        did = told(
            fetching._go_on,
            job,
            "x y/f",
            part,
            have,
            3,
            counted.append,
            shown=f"{have} {status} {sent}",
        )
        lines.append(f"{did} {counted} {part.read_bytes()} {job.client.http.asked}")
    job.facts["phase"], waits = (
        "QUEUED",
        [
            (200, b'{"phase": "QUEUED", "name": "n"}'),
            (304, b""),
            (200, b'{"phase": "COMPLETED", "name": "n"}'),
        ],
    )
    job.client.http = _transport(waits)
    job.facts["name"] = "n"
    lines += [told(job.wait, 30.0, False, shown="wait"), f"{job.client.http.asked} {job.facts}"]
    pages = {"link": '</v1/jobs/a/results?after=x>; rel="next"'}
    page = (
        b'{"files": [{"path": "a", "bytes": 1}], "jobs": [{"id": "b", "name": "n", "phase": "E"}]}'
    )
    job.client.http = _transport([(200, page, pages), (200, page)])
    lines += [told(lambda: list(fetching._listing(job)), shown="pages"), f"{job.client.http.asked}"]
    job.client.http = _transport([(200, page, pages), (200, page)])
    lines += [told(lambda: list(job.client.jobs("E")), shown="jobs"), f"{job.client.http.asked}"]
    for files in (["a/b", "c d"], ["../x"], ["a//b"], [".x"], ["/x"], ["a\0"]):
        body = json.dumps({"files": [{"path": p, "bytes": 1} for p in files]}).encode()
        job.client.http = _transport([(200, body)])
        lines.append(told(lambda: list(fetching._listing(job)), shown=str(files)))
    for name, contents in (
        ("new", {}),
        ("file", None),
        ("other", {"x": "1"}),
        ("same", {".begun.json": "r", "_COMPLETE": ""}),
        ("differs", {".begun.json": "s"}),
    ):
        folder = tmp_path / name
        if contents is None:
            folder.write_text("")
        else:
            folder.mkdir()
            for key, text in contents.items():
                (folder / key).write_text(text)
        did = told(fetching._take_folder, folder, b"r", shown=name)
        lines.append(f"{did} {sorted(p.name for p in folder.iterdir()) if folder.is_dir() else ''}")
    lines += _sizes(job, tmp_path) + _fetched_sweep(clock, tmp_path)
    check("client", lines, folder=tmp_path)


def _transport(script: list[Any]) -> Any:
    """A client whose server answers from a script; its last line again and again."""
    asked: list[str] = []

    def answer(sent: httpx.Request) -> httpx.Response:
        shown = " ".join(sent.headers.get(name, "") for name in ("range", "if-none-match"))
        asked.append(f"{sent.method} {sent.url.raw_path.decode()} {shown}".strip())
        status, content, *more = script.pop(0) if len(script) > 1 else script[0]
        if status == "x":
            raise httpx.ConnectError("refused")
        headers = {"etag": '"5"'} | (more[0] if more else {})
        return httpx.Response(int(status), headers=headers, stream=httpx.ByteStream(content))

    client = httpx.Client(transport=httpx.MockTransport(answer), base_url="http://h")
    client.asked = asked  # type: ignore[attr-defined]
    return client


def _odd(script: list[str], patience_s: float) -> Any:
    client: Any = Client("http://h", patience_s=patience_s)
    client.http = _transport([(status, b'{"jobs":[]}') for status in script])
    client.asked = client.http.asked
    return client


def _sizes(job: RemoteJob, folder: Path) -> list[str]:
    """Bytes as they are counted; a file that is longer, whole, empty, or never comes."""
    lines = []
    for have, size, script in (
        (None, 3, [(200, b"abc")]),
        (5, 3, [(200, b"abc")]),
        (3, 3, [(200, b"")]),
        (2, 3, [(206, b"c")]),
        (None, 0, [(200, b"")]),
        (None, 3, [("x", b""), (200, b"{}"), (200, b"abc")]),
        (None, 3, [(503, b""), (200, b"{}")] * 9),
    ):
        target, counted = folder / f"sized{len(lines)}", []
        if have is not None:
            (target if have == size else target.with_name(target.name + ".part")).write_bytes(
                b"abcde"[:have]
            )
        job.client.http = _transport(script)
        did = told(
            fetching._fetch,
            job,
            folder,
            target.name,
            size,
            counted.append,
            shown=f"{have} of {size}",
        )
        lines.append(f"{did} {counted} {target.is_file()} {len(job.client.http.asked)}")
    return lines


def _fetched_sweep(clock: Clock, folder: Path) -> list[str]:
    """A sweep whose files are there is fetched, and its table read; damage is named."""
    with served(folder / "home") as house:
        client = Client("http://127.0.0.1")
        client.http = house.client
        sweep = {
            "schema": "nightglass/sweep/1",
            "scene": "base.json",
            "axes": [{"field": "seed", "values": [1]}],
        }
        (folder / "base.json").write_text(json.dumps(SMALL))
        (folder / "sweep.json").write_text(json.dumps(sweep | {"name": "s"}))
        job, acts = client.sweep(folder / "sweep.json"), acts_of(house, clock)
        acts["claim"]()
        made = house.context.settings.product(job.id)
        made.mkdir()
        pq.write_table(pa.table({"seed": [1]}), made / "points.parquet")
        (made / "report.json").write_text("{}")
        seal = {
            "files": {name: file_digest(made / name) for name in ("points.parquet", "report.json")}
        }
        (made / "_COMPLETE").write_text(json.dumps(seal))
        acts["finish"]("COMPLETED")
        lines = [
            told(job.fetch_sweep, folder / "swept", shown="fetch"),
            str(job.points().to_pydict()),
        ]
        lines.append(f"{sorted(p.name for p in (folder / 'swept').iterdir())}")
        lines.append(told(job.fetch_sweep, folder / "swept", shown="again"))
        (made / "report.json").write_text("[]")
        lines.append(told(job.fetch_sweep, folder / "damaged", shown="damaged"))
        return lines


def test_who_may(clock: Clock, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Keys by the command and over time; tokens of a provider; tickets; places shared by teams."""
    monkeypatch.setenv("NIGHTGLASS_HOME", str(tmp_path / "home"))
    lines: list[str] = []
    for words in (
        "list",
        "create --team red --name me",
        "create --team blue --days 1",
        "create --team Red",
        "create --team a --days 0",
        "create --team a --days 36500",
        "create --team a --name \t",
        "list",
        "revoke 000000000001",
        "revoke zed",
        f"revoke ng_000000000001_{'k' * 43}",
        "list",
        "list --json",
    ):
        ran = CliRunner().invoke(keys_app, words.split(" "))
        lines.append(f"{words}: {ran.exit_code} {ran.output}{ran.exception or ''}")
        clock.now += 40_000.0 * (words[:6] == "revoke")
    settings = Settings(tmp_path / "home")
    engine = connect(settings.database_url)
    lines += [
        db_row(engine, "audit"),
        *_keys_over_time(clock, settings, engine),
        *_tokens(clock, tmp_path),
    ]
    (tmp_path / "tickets.key").write_bytes(bytes(32))
    tickets = Tickets(tmp_path)
    href = tickets.make(Caller("red", "key:1"), "/v1/jobs/x/a?b=1")
    lines.append(href)
    for asked, method, step in (
        (href, "GET", 0),
        (href, "HEAD", 59.9),
        (href, "POST", 0),
        (href + "0", "GET", 0),
        (href.replace("/x/", "/y/"), "GET", 0),
        ("/v1/jobs/x", "GET", 0),
        (href, "GET", 0.2),
    ):
        clock.now += step
        lines.append(told(tickets.caller, request(method, asked), shown=f"{method} {step}"))
    for place in (
        "/v1/jobs/",
        "/v1/jobs/a b",
        "/v1/jobs/x#y",
        "/v1/jobs/x?ticket=1",
        "/v1/files/x",
        "/v1/jobs/" + "x" * 2001,
    ):
        lines.append(told(tickets.make, Caller("red", "k"), place)[:200])
    lines += asyncio.run(_shared())
    check("who", [short(line) for line in lines], folder=tmp_path)


def _keys_over_time(clock: Clock, settings: Settings, engine: sa.Engine) -> list[str]:
    """Headers that show keys, before and after a revocation; how many are hashed at once."""
    auth, key = Authenticator(settings, engine), create_key(engine, "green")
    shown = (
        "",
        "Basic x",
        "Bearer",
        "Bearer " + "x" * 8193,
        "bearer  x",
        f"Bearer {key}",
        f"bEARER {key} ",
        f"Bearer {key[:-1]}z",
        f"Bearer ng_{'0' * 12}_{'k' * 43}",
    )
    lines = [told(lambda s=s: asyncio.run(auth.caller(s)), shown=s[:30]) for s in shown]
    revoke_key(engine, key)
    for step in (1.9, 0.2):
        clock.now += step
        lines.append(told(lambda: asyncio.run(auth.caller(f"Bearer {key}")), shown=f"{step}"))
    auth._in_line = 64
    lines.append(told(lambda: asyncio.run(auth.caller(f"Bearer {key[:-1]}y")), shown="in line"))
    return lines


def _tokens(clock: Clock, folder: Path) -> list[str]:
    """Tokens signed by a made key, good and bad."""
    private = ed25519.Ed25519PrivateKey.from_private_bytes(bytes(range(32)))
    key = json.loads(jwt.algorithms.OKPAlgorithm.to_jwk(private.public_key())) | {"alg": "EdDSA"}
    octets = {"kty": "oct", "k": "c2VjcmV0" * 6, "kid": "oct", "alg": "HS256"}
    jwks = folder / "jwks.json"
    jwks.write_text(
        json.dumps({"keys": [key | {"kid": "a"}, key | {"kid": "b", "use": "enc"}, octets]})
    )
    verifier, lines = oidc.Verifier("https://id", "ng", str(jwks), "team"), []
    good = {"iss": "https://id", "aud": "ng", "sub": "ann", "team": "red", "exp": 1 << 40}
    for changes, kid in (
        ({}, "a"),
        ({"team": ["blue"]}, "a"),
        ({"team": ["a", "b"]}, "a"),
        ({"team": "Red"}, "a"),
        ({"team": None}, "a"),
        ({"exp": 5}, "a"),
        ({"exp": None}, "a"),
        ({"iss": "x"}, "a"),
        ({"aud": "x"}, "a"),
        ({"sub": None}, "a"),
        ({"nbf": 1 << 40}, "a"),
        ({}, "b"),
        ({}, "c"),
        ({"sub": "s" * 200}, "a"),
        ({"aud": ["x", "ng"]}, "a"),
    ):
        claims = {k: v for k, v in (good | changes).items() if v is not None}
        token = jwt.encode(claims, private, "EdDSA", {"kid": kid})
        lines.append(told(verifier.verify, token, shown=f"{changes} {kid}"[:80]))
    for late_s in (25, 40):  # by the real clock
        token = jwt.encode(good | {"exp": time.time() - late_s}, private, "EdDSA", {"kid": "a"})
        lines.append(told(verifier.verify, token, shown=f"late {late_s}"))
    secret = jwt.encode(good, "secret" * 6, "HS256", {"kid": "oct"})
    lines += [told(verifier.verify, t, shown=t[:9]) for t in (secret, "x", token[:-8], "a.b.c")]
    jwks.write_text(json.dumps({"keys": [key | {"kid": "c"}]}))
    for step in (29.0, 2.0):
        clock.now += step
        token = jwt.encode(good, private, "EdDSA", {"kid": "c"})
        lines.append(told(verifier.verify, token, shown=f"after {step}"))
    jwks.unlink()
    clock.now += 4000.0
    lines.append(told(verifier.verify, token, shown="gone"))
    places = (
        "https://id.test/k",
        "http://localhost/k",
        "http://127.0.0.2:8/k",
        "http://[::1]/k",
        "http://id.test/k",
        "ftp://x",
        str(folder / "no"),
        "http://0.0.0.0/k",
    )
    return lines + [told(oidc.check_place, place) for place in places]


async def _shared() -> list[str]:
    """Places taken, refused, waited for and handed on, teams in turn."""
    shares, lines, tasks = Shares(4, "looks"), [], {}

    async def hold(name: str, until: asyncio.Event) -> None:
        async with shares.place(name[0]):
            lines.append(f"{name} in, {shares.held} held")
            await until.wait()

    ends = {name: asyncio.Event() for name in ("a1", "a2", "b1", "c1", "a3", "a4", "b2", "c2")}
    for name in ends:
        tasks[name] = asyncio.create_task(hold(name, ends[name]))
        await asyncio.sleep(0)
    lines.append(told(shares.take, "a"))
    tasks["a3"].cancel()
    for name in ("a1", "b1", "a2", "c1"):
        ends[name].set()
        for _ in range(4):
            await asyncio.sleep(0)
        lines.append(f"{name} ends, {shares.held} held")
    for task in tasks.values():
        task.cancel()
    await asyncio.gather(*tasks.values(), return_exceptions=True)
    one = Shares(1, "looks")
    with one.taken("a"):
        waits = [asyncio.create_task(_waits(one)) for _ in range(65)]
        await asyncio.sleep(0)
        lines.append(told(waits[-1].result, shown="the 65th"))
        for task in waits:
            task.cancel()
        await asyncio.gather(*waits, return_exceptions=True)
    return [*lines, f"{shares.held} {one.held}"]


async def _waits(shares: Shares) -> None:
    async with shares.place("a"):
        pass


def test_starts(clock: Clock, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Addresses, databases, the tables and an older form of them, faults of the table, heads."""
    lines = [
        told(lambda given=given: main.bind(*given).close(), shown=str(given))
        for given in (
            ("0.0.0.0", 0),
            ("example.org", 0),
            ("127.0.0.1", -1),
            ("::1", 70000),
            ("localhost", 0),
            ("", 0),
            ("192.0.2.1", 0, True),
            ("192.0.2.1", 0, False),
        )
    ]
    lines.append(told(lambda: main.bind("192.0.2.1", 0, lambda: False), shown="asked")[:90])
    monkeypatch.chdir(tmp_path)
    for kind, text in (
        ("sqlite", "is locked"),
        ("sqlite", "x"),
        ("postgresql", "x"),
        ("postgresql", "authentication failed"),
        ("postgresql", "does not exist"),
    ):
        error = OperationalError("s", {}, Exception(text))
        lines.append(f"{kind} {text}: may come {database._may_come(kind, error, text)}")
    for text in ("disk is full", "disk I/O error", "unable to open", "locked"):
        lines.append(f"{text}: no room {bool(database._no_room(str(tmp_path / 'x'), text))}")
    lines += [
        told(connect, url) for url in ("no url", "mysql://u:secret@h/x", "sqlite:///no/x.sqlite")
    ]
    lines.append(told(connect, "postgresql://u:secret@127.0.0.1:1/x")[:140])
    (tmp_path / "later.sqlite").write_bytes(b"")
    with sqlite3.connect(tmp_path / "later.sqlite") as db:
        db.execute("pragma user_version = 9")
    (tmp_path / "odd.sqlite").write_bytes(b"no database" * 99)
    lines += [told(connect, f"sqlite:///{name}.sqlite") for name in ("later", "odd")]
    lines += _older(tmp_path)
    engine = connect(sqlite_url(tmp_path / "new.sqlite"))
    for name, columns in sorted((t.name, t.columns) for t in metadata.tables.values()):
        found = {
            c["name"]: (str(c["type"]), c["nullable"]) for c in sa.inspect(engine).get_columns(name)
        }
        lines.append(f"{name}: {[*columns.keys()] == [*found]} {found}")
    with engine.connect() as db:
        asked = ("journal_mode", "synchronous", "busy_timeout", "trusted_schema", "user_version")
        lines.append(f"{[db.exec_driver_sql(f'pragma {name}').scalar() for name in asked]}")
    lines.append(oct((tmp_path / "new.sqlite").stat().st_mode))
    create_key(engine, "red", "one row of the audit table")
    for asked in ("delete from audit", "update audit set team=''"):
        with engine.connect() as db:
            lines.append(told(db.exec_driver_sql, asked)[:150])
    for text in (
        "database or disk is full",
        "database disk image is malformed",
        "database is locked",
        "secret odd",
    ):
        kind = OperationalError if "odd" not in text else sa.exc.IntegrityError
        lines.append(_problem(kind("select 1", {}, Exception(text))))
    lines += [
        _problem(Damaged("x", "y")),
        _problem(ValueError("secret")),
        _problem(sa.exc.TimeoutError()),
    ]
    lines += [f"{kind.__name__}: {status}" for kind, status in app_module.HTTP_STATUS]
    lines += asyncio.run(_heads()) + _health(clock, tmp_path) + _started(tmp_path, monkeypatch)
    check("starts", lines, folder=tmp_path)


def _problem(error: Exception) -> str:
    answer = asyncio.run(app_module.answer_problem(request(), error))
    body = json.loads(answer.body)
    return f"{type(error).__name__}: {body} {dict(answer.headers).get('retry-after')}"


def _older(folder: Path) -> list[str]:
    """A job table of the first form, brought to this one."""
    path = folder / "first.sqlite"
    names = (
        "number integer primary key, id text, name text, phase text, scene text, "
        "idempotency_key text, body_sha256 text, submitted_s float, started_s float, "
        "ended_s float, tiles_done int, tiles_total int, attempt int, deaths int, "
        "cancel_asked boolean, deleted boolean, error json, content_digest text, version int "
    )
    with contextlib.closing(sqlite3.connect(path)) as db, db:
        db.execute("pragma user_version = 1")
        db.execute(f"create table jobs ({names})")
        for i, error in ((3, None), (7, '{"kind": "fault", "message": "m", "errors": []}')):
            row = (
                i,
                f"{i:032x}",
                "old",
                "ERROR" if error else "QUEUED",
                '{"seed": 1}',
                None,
                "0" * 64,
                1.5,
                None,
                None,
                None,
                None,
                0,
                1,
                0,
                1 if error else 0,
                error,
                None,
                2,
            )
            db.execute(f"insert into jobs values ({','.join('?' * 19)})", row)
    table = Queue(path)
    kept = [brief(table.seen(SimpleNamespace(id=f"{i:032x}"))) for i in (3, 7)]
    new = submit_many(table, [Ask("n", {}, "0")], TeamLimits())[0]
    return [short(line) for line in (*kept, brief(new))]


async def _heads() -> list[str]:
    """Heads of requests in pieces: whole, too long, too slow."""
    import uvicorn
    from uvicorn.server import ServerState

    lines, loop = [], asyncio.get_running_loop()
    config = uvicorn.Config(
        _hello, log_config=None, ws="none", server_header=False, date_header=False
    )
    config.load()
    for pieces, pause_s in (
        ([b"GET / HTTP/1.1\r\n", b"host: x\r\n\r\n"], 0),
        ([b"GET / HTTP/1.1\r\nx: ", b"y" * 65536], 0),
        ([b"GET / HTTP/1.1\r\n"], 0.03),
        ([b"GET / HTTP/1.1\r\nx: " + b"y" * 40_000, b"\r\n\r\n"] * 2, 0),
        ([], 0.03),
        ([b"POST / HTTP/1.1\r\ncontent-length: 9\r\n\r\nabc"], 0.03),
    ):
        wire: Any = SimpleNamespace(sent=b"", closed=False)
        wire.write = lambda data, wire=wire: setattr(wire, "sent", wire.sent + data)
        wire.close = lambda wire=wire: setattr(wire, "closed", True)
        wire.is_closing = lambda wire=wire: wire.closed
        wire.get_extra_info = lambda *_: None
        wire.set_write_buffer_limits = wire.pause_reading = wire.resume_reading = lambda *_: None
        wire.set_protocol = wire.get_protocol = lambda *_: None
        talk = bounded(0.01)(config, ServerState(), {}, loop)  # type: ignore[call-arg]
        talk.connection_made(wire)
        for piece in pieces:
            talk.data_received(piece)  # type: ignore[attr-defined]
            for _ in range(5):
                await asyncio.sleep(0)
        await asyncio.sleep(pause_s or 0.004)
        lines.append(
            f"{[p[:30] for p in pieces]}: closed {wire.closed} {wire.sent!r} {talk._timer is None}"
        )
        talk.connection_lost(None)
    return lines


async def _hello(scope: Any, _: Any, send: Any) -> None:
    await send({"type": "http.response.start", "status": 204, "headers": []})
    await send({"type": "http.response.body", "body": b""})


def _health(clock: Clock, folder: Path) -> list[str]:
    """What is said where the service cannot work; bodies kept; a file cut while it is sent."""
    sick = SimpleNamespace(
        table=SimpleNamespace(counts=lambda: 1 / 0),
        settings=SimpleNamespace(home=folder, free_bytes=1 << 60),
        dispatcher=SimpleNamespace(
            alive=False, leaderless_s=0.0, scheduler=SimpleNamespace(fault=lambda: "x")
        ),
    )
    lines = [health.ready(sick).body.decode()]  # type: ignore[arg-type]
    sick.dispatcher.alive, sick.dispatcher.leaderless_s = True, 20.6
    lines.append(health.ready(sick).body.decode())  # type: ignore[arg-type]
    kept = Acceptance(Settings(folder / "home"), kept_bytes=12_000)
    for team, seed in (("a", 1), ("a", 1), ("b", 1), ("a", 2), ("a", 3), ("a", 1), ("a", 3)):
        body = json.dumps(SMALL | {"seed": seed}).encode()
        found = asyncio.run(kept.read(team, body, lambda _: False))
        lines.append(
            f"{team}{seed} reused {kept.reused} keeps {len(kept._kept)} {found.body_sha256[:6]}"
        )
    fill(folder / "p")
    length, pieces = archive.archive(folder / "p", "n")
    (folder / "p" / "truth" / "long").write_text("short")
    first = next(pieces)
    lines += [
        f"{length} {len(first)} {first[512:520]!r}",
        told(lambda: len(b"".join(pieces)), shown="cut"),
    ]
    health_ = SchedulerHealth("tcp://127.0.0.1:1")
    asked: list[str] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            "catalog_tools.engine.clusters.ask", lambda *given: asked.append(str(given)) or _gone()
        )
        for step in (0.0, 1.9, 0.2):
            clock.now += step
            lines.append(f"{health_.fault()} {len(asked)}")
    return [*lines, asked[0], SchedulerHealth("threads").fault()]


def _gone() -> None:
    raise Damaged("scheduler", "gone")


def _started(folder: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What a server is started with."""
    import uvicorn

    said: list[str] = []
    server = SimpleNamespace(run=lambda sockets: said.append(f"{len(sockets)} socket"))
    monkeypatch.setattr(
        uvicorn, "Server", lambda config: said.append(_configured(config)) or server
    )
    monkeypatch.setattr(main, "gc", SimpleNamespace(freeze=int))
    collects = SimpleNamespace(set_threshold=lambda *n: said.append(f"gc {n}"))
    monkeypatch.setattr("catalog_tools.engine.heap.gc", collects)
    monkeypatch.setattr("service.logs.set_up", lambda: None)
    main.serve(home=folder / "served", port=0)
    lines = [
        *said,
        f"{main._guarded(Settings(folder / 'served'))}",
        f"{main._guarded(Settings(folder, oidc_issuer='i'))}",
    ]
    monkeypatch.undo()
    return lines


def _configured(config: Any) -> str:
    names = (
        "backlog",
        "timeout_graceful_shutdown",
        "timeout_keep_alive",
        "ws",
        "access_log",
        "server_header",
        "ssl_certfile",
    )
    return f"{[(name, getattr(config, name)) for name in names]} head {config.http.head_s}"


def test_the_rest(
    clock: Clock, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: Any
) -> None:
    """Rarer courses: what is damaged, gone, cancelled or full, and what the log says of it."""
    caplog.set_level("INFO", "nightglass")
    lines: list[str] = []
    settings = Settings(tmp_path, body_bytes=5000)
    settings.make_folders()
    lines += _attempts_that_stop(clock, settings) + _workers_told(settings, monkeypatch)
    (settings.catalogues / "cat").mkdir()
    (settings.catalogues / "cat" / MANIFEST_NAME).write_text("{}")
    lines.append(str(catalogues.catalogue_facts(settings.catalogues, "cat")))
    monkeypatch.setattr(catalogues, "open_catalogue", str)
    monkeypatch.setattr(
        catalogues, "info", lambda place: {name: name for name in (*catalogues.SHOWN, "path")}
    )
    lines.append(str(catalogues.catalogue_facts(settings.catalogues, "cat")))
    _truth(tmp_path / "t")
    for one in (frames, pixels):
        monkeypatch.setattr(one, "describe", lambda _: {"frames": 2})
    lines += [
        str(pixels.truth_of(tmp_path / "t", frame, most))
        for frame, most in ((0, 1), (0, 9), (1, 2))
    ]
    for name in (
        "f000001_r000_c000",
        "f000001_r000_c001",
        "f000003_r000_c001",
        "f000002_r000_c000",
        "odd",
    ):
        (tmp_path / "t" / "markers").mkdir(exist_ok=True)
        (tmp_path / "t" / "markers" / f"{name}.json").write_text("")
        about = {"complete": False, "shape": [8, 9], "tile_shape": [8, 5]}
        watched = frames.frame_to_watch(tmp_path / "t", about)
        lines.append(f"watch {watched} {frames.grid_of(about)}")
    tiles = {"complete": False, "frames": 2, "shape": [8, 9], "tile_shape": [4, 4]}
    for one in (frames, pixels):
        monkeypatch.setattr(one, "describe", lambda _: tiles)
    (tmp_path / "t" / "markers" / "f000001_r000_c002.json").write_text("")
    lines.append(str(pixels.frame_facts(tmp_path / "t", 1)))
    big = {
        "frames": 1,
        "layers": {"dn": 1},
        "complete": True,
        "tile_shape": [1 << 14, 1 << 14],
        "shape": [1 << 14, 9000],
    }
    for one in (frames, pixels):
        monkeypatch.setattr(one, "describe", lambda _: big)
    lines += [
        told(pixels.tile_values, tmp_path, 0, 0, 0, "dn", n, shown=f"bin {n}") for n in (2, 64)
    ]
    lines.append(told(pixels.frame_fits, tmp_path, 0, "dn", shown="fits"))
    monkeypatch.setattr(pixels, "MAX_READ", 1 << 26)
    lines += [told(pixels.tile_values, tmp_path, 0, 0, 0, "dn", 64, shown="too large")]
    lines += [told(pixels.frame_fits, tmp_path, 0, "dn", shown="fits")]
    with served(tmp_path / "home", body_bytes=9000, upload_bytes=9) as house:
        for path in (
            "/ogc",
            "/ogc/",
            "/ogc/conformance",
            "/ogc/processes",
            "/ogc/processes/plan",
            "/v1/catalogues",
        ):
            lines.append(f"{path} {answer_told(house.client.get(path))}")
        lines.append(f"{[*house.client.get('/v1/schema/scene').json()['properties']]}")
        lines += _answers_that_fail(house, monkeypatch)
        lines += house.portal.call(_looked_at, house)
    lines += [
        f"{r.levelname} {r.getMessage()} {getattr(r, 'attempt', '')}"
        for r in caplog.records
        if r.name in ("nightglass.service", "nightglass.engine")
    ]
    check("rest", [short(line) for line in lines], folder=tmp_path, version=house.app.version)


def _attempts_that_stop(clock: Clock, settings: Settings) -> list[str]:
    """An attempt cancelled, or left by its dispatcher; a product that is held or cut off."""
    table, lines = Queue(settings.database_url), []

    def attempt(what: str, go_on: bool = True, **changes: Any) -> None:
        submit_many(table, [Ask(what, SMALL, "0" * 64)], TeamLimits())
        job: Any = table.claim()
        product = settings.product(job.id)
        if what in ("held", "unfinished"):
            fill(product)
            (product / ".lock").write_text("")
            (product / ".begun.json").write_text(json.dumps({"code": code_digest()}))
        if what == "cut off":
            product.mkdir()
        if what == "cancelled":
            table.cancel(job.id)
            job = table.seen(job)
        made = attempts.Attempt(settings, table, job, lambda: go_on, SchedulerHealth("threads"))
        if what == "fails":
            made.fail()
        elif what in ("unfinished", "cut off"):
            lines.append(f"{made._alone()} {made._order()['resume']} {product.exists()}")
            made.count_death()
        elif what == "held":
            with (product / ".lock").open() as lock:
                fcntl.flock(lock, fcntl.LOCK_EX)
                made._go_on = lambda: clock.slept < 0.6
                lines.append(f"{made._alone()} {clock.slept:.1f}")
        else:
            made.run()
        lines.append(f"{what}: {brief(table.seen(job))}")
        with contextlib.suppress(NotReady):
            table.finish(table.seen(job), Phase.ABORTED)

    for what in ("cancelled", "fails", "held", "unfinished", "cut off"):
        attempt(what)
    attempt("left", go_on=False)
    led = runner.Dispatcher(settings, table)
    submit_many(table, [Ask("guarded", SMALL, "0" * 64)], TeamLimits())
    for error in (NotReady("over"), ValueError("odd"), OperationalError("s", {}, Exception("x"))):
        job: Any = table.claim()
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(
                attempts.Attempt, "run", lambda self, error=error: (_ for _ in ()).throw(error)
            )
            led.stopping.wait = lambda s: lines.append(f"waits {s}")
            led._guarded(job)
        lines.append(f"{type(error).__name__}: {brief(table.seen(job))}")
        submit_many(table, [Ask("guarded", SMALL, "0" * 64)], TeamLimits())
    led._renewed_s, led._store = clock.now, SimpleNamespace(claim=lambda *_: 1 / 0, engine=None)
    lines.append(f"{led._step()}")
    both = [submit_many(table, [Ask("n", {}, "0", "key")], TeamLimits())[0] for _ in range(2)]
    return [*lines, *map(brief, both)]


def _workers_told(settings: Settings, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What the engine's process makes of orders; a sweep as it is run."""
    monkeypatch.chdir(settings.catalogues)
    said, lines = io.BytesIO(), []
    scene = {
        "seed": 1,
        "stars": {"catalogue": ["a", "b"]},
        "sensor": {"bandpass": {"path": "upload:x.csv"}},
    }
    axes = [{"field": "seed", "values": [1, 2]}]
    sweep = {"schema": "nightglass/sweep/1", "name": "s", "scene": scene, "axes": axes}
    stored = sweeps.engine_sweep(sweep, settings)

    def runs(course: Any, out: Path, options: Any, again: bool, listen: Any) -> dict[str, Any]:
        lines.append(f"{json.dumps(course.data)} {out} {options} {again}")
        for done, doing in ((0, "start"), (1, ""), (2, "start")):
            listen(SimpleNamespace(done=done, total=3, doing=doing))
        return {"points": 5}

    monkeypatch.setattr("pipeline.sweep.run.run_course", runs)
    order = {
        "scene": stored,
        "product": "../products/z",
        "scheduler": "threads",
        "workers": 1,
        "resume": True,
        "most_cpu_s": 9.0,
    }
    lines += [
        str(orders._sweep(order, partial(worker._say, said))),
        said.getvalue().decode(),
        f"{[*settings.products.glob('z*')]}",
    ]
    lines.append(told(sweeps.engine_sweep, {"scene": "x"}, settings))
    lines.append(told(orders._plan, {"scene": SMALL, "most_cpu_s": 0.5}, said, shown="plan")[:300])
    lines.append(told(orders._judge, {"scene": SMALL}, said, shown="judge"))
    for error in (ValueError("odd"), BadInput("a", 1, "b")):
        with contextlib.suppress(Exception), orders._tiles_told({"job": "j", "attempt": 2}):
            raise error
    for field in (
        "targets.0",
        "targets.0.body",
        "targets",
        "sensor",
        "sensor.shape.0",
        "exposure.frames",
        "exposure.cadence_s",
        "seed",
        "output.layers",
        "stars.catalogue",
        "stars",
    ):
        axis = ListAxis(field=field, values=(1,))
        lines.append(told(sweeps._check_axis, 2, axis)[:150])
    return [*lines, told(sweeps.accept_sweep, {}, settings)]


def _truth(product: Path) -> None:
    (product / "truth").mkdir(parents=True)
    stars = {
        "frame": [0, 0, 0, 1],
        "in_frame": [True, True, False, True],
        "source_id": [1 << 60, 2, 3, 4],
        "electrons": [5.0, 9.0, 99.0, float("nan")],
        "x_px": [1.5, 2.5, 3.5, 4.5],
        "other": [0] * 4,
    }
    pq.write_table(pa.table(stars), product / "truth" / "stars.parquet")


def _answers_that_fail(house: Any, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Requests that meet a full disk, a fault, a deadline; what is known of a damaged job table."""
    lines = []
    full = OperationalError("s", {}, Exception("database or disk is full"))
    for error in (full, ValueError("secret"), TimeoutError(), problems.EngineFault("e")):
        with monkeypatch.context() as patch:
            patch.setattr(
                house.table, "listing", lambda *_, error=error: (_ for _ in ()).throw(error)
            )
            lines.append(answer_told(house.client.get("/v1/jobs")))
    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", lambda *_: (_ for _ in ()).throw(OSError(28, "full")))
        lines.append(answer_told(house.client.post("/v1/files?name=a.csv", content=b"x")))
    lines.append(
        answer_told(house.client.post("/v1/files?name=a.csv", content=iter([b"12345", b"67890"])))
    )
    submit_many(house.table, [Ask("n", {}, "0")], TeamLimits())
    with house.table.engine.connect().execution_options(writes=True) as db, db.begin():
        db.execute(sa.text("update jobs set name='z', bytes_kept=5000"))
    lines.append(answer_told(house.client.post("/v1/files?name=a.csv", content=b"x")))
    return lines


async def _looked_at(house: Any) -> list[str]:
    """Looks that are slow, break, or whose caller goes; each scene is judged once."""
    lines: list[str] = []
    named = dict(
        SMALL, sensor=SMALL["sensor"] | {"bandpass": {"kind": "table", "path": "upload:x"}}
    )
    script: list[Any] = [problems.PlanTooSlow("slow"), problems.EngineFault("broke"), {}, {}]
    made = looks.Looks(
        house.context.settings, house.context.files, house.context.dispatcher.stopping
    )

    def look(_: Any, order: dict[str, Any], limit_s: float, stopped: Any) -> Any:
        lines.append(
            f"{sorted(order)} {order['do']} {order['scene']['sensor']['bandpass']}"
            f" {limit_s} {stopped()}"
        )
        found = script.pop(0)
        if isinstance(found, Exception):
            raise found
        return found | {"plan": {"a": 1}}

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(looks, "look_at", look)
        for seed in (1, 2, 3, 4):
            await made.judge(request(), "red", named | {"seed": seed})
            lines.append(f"{seed} kept {len(made._judged)}")
        lines.append(str(await made.plan(request(), "red", named)))
    try:
        await looks.unless_gone(request("GET", "/", None), asyncio.sleep(5))  # type: ignore[arg-type]
    except Exception as error:
        lines.append(f"{type(error).__name__} {error}")
    return lines
