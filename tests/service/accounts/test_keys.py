"""API keys and tokens: who gets in, whose jobs they see, and where secrets must never appear."""

from __future__ import annotations

import asyncio
import inspect
import json
import logging
import os
import re
import secrets
import socket
import stat
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime, timedelta
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx
import jwt
import psutil
import pytest
import sqlalchemy as sa
from cryptography.hazmat.primitives.asymmetric import ec, rsa

from pipeline.errors import BadInput
from service.accounts import commands
from service.accounts.auth import Authenticator, Caller
from service.accounts.keys import TOKEN, any_key, create_key, list_keys, matches, revoke_key
from service.accounts.oidc import Verifier
from service.app import ROOMS
from service.engine import processes
from service.logs import JsonLines, redact
from service.main import bind
from service.problems import Forbidden, NoProvider, Unauthenticated
from service.settings import Settings, read_settings
from service.store.database import connect, sqlite_url
from service.store.tables import audit
from tests.command import nightglass
from tests.service.conftest import bearer

ISSUER, AUDIENCE = "https://id.example", "nightglass"
PUBLIC = {  # health, the page itself, and what OGC's landing page says of any such service
    "/healthz", "/readyz", "/metrics", "/", "/page/{name}",
    "/ogc", "/ogc/", "/ogc/conformance", "/ogc/processes", "/ogc/processes/{process}",
}  # fmt: skip


@pytest.fixture
def engine(tmp_path: Path) -> Any:
    return connect(sqlite_url(tmp_path / "jobs.sqlite"))


def test_a_key_is_stored_as_a_hash_and_revoked_for_good(engine: Any, tmp_path: Path) -> None:
    assert not any_key(engine)
    token = create_key(engine, "red", "a note")
    found = TOKEN.fullmatch(token)
    assert found
    [row] = list_keys(engine)
    assert (row["id"], row["team"], row["name"]) == (found[1], "red", "a note")
    secret = found[2].encode()
    assert not any(secret in file.read_bytes() for file in tmp_path.iterdir())
    revoke_key(engine, found[1])
    revoke_key(engine, token)  # again is no error
    assert list_keys(engine)[0]["revoked_s"]
    assert any_key(engine)
    with pytest.raises(BadInput):
        revoke_key(engine, "nothing")


def test_only_the_secret_itself_matches(engine: Any) -> None:
    from service.accounts.keys import find_key

    token = create_key(engine, "red")
    row = find_key(engine, token[3:15])
    assert row.hash.startswith("$argon2id$")
    assert matches(row, token[16:])
    assert not matches(row, token[16:-1] + ("A" if token[-1] != "A" else "B"))


def test_a_key_ends_with_its_days(engine: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Accepted until the moment that it was made for, then refused, also where it is known."""
    token = create_key(engine, "red", days=2.0)
    [row] = list_keys(engine)
    assert row["expires_s"] - row["created_s"] == pytest.approx(2 * 86_400)
    now = [row["expires_s"] - 1.0]
    monkeypatch.setattr("service.accounts.keys.time", SimpleNamespace(time=lambda: now[0]))
    monkeypatch.setattr("service.accounts.auth.FRESH_S", 0.0)
    door = Authenticator(Settings(Path()), engine)

    def caller() -> Caller:
        return asyncio.run(door.caller(f"Bearer {token}"))

    assert caller() == caller() == Caller("red", f"key:{row['id']}")
    for late_s in (0.0, 1.0, 1e9):
        now[0] = row["expires_s"] + late_s
        with pytest.raises(Unauthenticated):
            caller()
        with pytest.raises(Unauthenticated):  # and by a process that has not seen it before
            asyncio.run(Authenticator(Settings(Path()), engine).caller(f"Bearer {token}"))
    lasting = create_key(engine, "red")
    assert asyncio.run(door.caller(f"Bearer {lasting}")).team == "red"


def test_no_key_no_secret_and_no_use_take_the_same_time(engine: Any) -> None:
    """The time of a refusal does not tell whether there is a key of that id."""
    good, revoked = create_key(engine, "red"), create_key(engine, "red")
    revoke_key(engine, revoked)
    door = Authenticator(Settings(Path()), engine)

    def refusal_s(token: str) -> float:
        began = time.process_time()  # of the processor: others' work beside this one counts not
        with pytest.raises(Unauthenticated):
            asyncio.run(door.caller(f"Bearer {token}"))
        return time.process_time() - began

    wrong: dict[str, list[float]] = {"key": [], "secret": [], "use": []}
    for _ in range(9):
        secret = secrets.token_urlsafe(32)
        wrong["key"].append(refusal_s(f"ng_{secrets.token_hex(6)}_{secret}"))
        wrong["secret"].append(refusal_s(f"{good[:16]}{secret}"))
        wrong["use"].append(refusal_s(f"{revoked[:16]}{secret}"))
    least = {name: min(times) for name, times in wrong.items()}
    assert max(least.values()) < 2.0 * min(least.values()), least
    assert asyncio.run(door.caller(f"Bearer {good}")).team == "red"


def test_a_home_made_beforehand_is_closed(tmp_path: Path) -> None:
    home = tmp_path / "home"
    home.mkdir(mode=0o755)
    (home / "jobs.sqlite").touch(mode=0o644)
    Settings(home).make_folders()
    engine = connect(sqlite_url(home / "jobs.sqlite"))
    create_key(engine, "red")
    made = {file.name: stat.S_IMODE(file.stat().st_mode) for file in home.glob("jobs.sqlite*")}
    assert stat.S_IMODE(home.stat().st_mode) == 0o700
    assert len(made) == 3  # with its log and the index of it
    assert set(made.values()) == {0o600}
    engine.dispose()


@pytest.mark.parametrize("team", ["", "Red", "a/b", "../x", "a" * 65, "a b", "é"])
def test_bad_team_names_are_refused(engine: Any, team: str) -> None:
    with pytest.raises(BadInput, match="--team"):
        create_key(engine, team)


def test_limits_of_a_key_and_its_line_in_the_audit(engine: Any) -> None:
    """Names of one printable line, days of a life; what is refused leaves nothing."""
    for field, values in (
        ("name", ("a" * 129, "two\nlines", "\x1b[2J")),
        ("days", (0.0, -1.0, 36_500.0, float("nan"), float("inf"))),
    ):
        for value in values:
            with pytest.raises(BadInput, match=f"--{field}"):
                create_key(engine, "red", **{field: value})
    assert list_keys(engine) == []
    made = create_key(engine, "red", "é" * 128, 36_499.0, "key:ann")
    [row] = list_keys(engine)
    assert row["name"] == "é" * 128
    assert row["expires_s"] - row["created_s"] == pytest.approx(36_499.0 * 86_400.0)
    revoke_key(engine, row["id"], "key:bob")
    columns = (audit.c.team, audit.c.actor, audit.c.action, audit.c.thing, audit.c.detail)
    with engine.connect() as db:
        lines = db.execute(sa.select(*columns).order_by(audit.c.number)).all()
    assert lines[0] == ("red", "key:ann", "key.create", made[3:15], "é" * 128)
    assert lines[1][:4] == ("red", "key:bob", "key.revoke", made[3:15])


def test_a_key_is_revoked_once(engine: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """A later try changes neither the moment nor who did it."""
    create_key(engine, "red")
    [row] = list_keys(engine)
    for now, who in ((1000.0, "key:ann"), (2000.0, "key:bob")):
        monkeypatch.setattr("service.accounts.keys.now_s", lambda _, now=now: now)
        revoke_key(engine, row["id"], who)
    assert list_keys(engine)[0]["revoked_s"] == 1000.0
    with engine.connect() as db:
        query = sa.select(audit.c.actor).where(audit.c.action == "key.revoke")
        assert list(db.execute(query).scalars()) == ["key:ann"]


def test_the_command(tmp_path: Path) -> None:
    def run(*words: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "pipeline", "keys", *words, "--home", str(tmp_path)]
        return subprocess.run(command, capture_output=True, text=True, timeout=120)

    made = run("create", "--team", "red", "--name", "ann")
    assert TOKEN.fullmatch(made.stdout.strip()), made.stderr
    key_id = made.stdout[3:15]
    assert f"{key_id}  usable" in run("list").stdout
    gone = run("revoke", key_id)
    assert (gone.returncode, gone.stdout, "revoked" in gone.stderr) == (0, "", True)
    assert json.loads(run("list", "--json").stdout)[0]["revoked_s"]
    wrong = run("revoke", "x")
    assert (wrong.returncode, "KEY" in wrong.stderr) == (2, True)


def test_the_list_tells_when_keys_end(
    engine: sa.Engine, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, days in (("ann", None), ("bob", 30.0)):
        create_key(engine, "red", name, days)
    monkeypatch.setattr(commands, "_engine", lambda _: (engine, Path()))
    commands.listing(None, False)
    without, until = capsys.readouterr().out.splitlines()
    day = datetime.now(UTC).date() + timedelta(days=30)
    assert re.fullmatch(r"\w{12}  usable   \S+ on  +red  ann", without)
    assert re.fullmatch(r"\w{12}  usable   \S+ to \S+  +red  bob", until)
    # a midnight may have passed in between
    assert any(f"to {day - timedelta(days=n)} " in until for n in (0, 1))


def test_the_list_tells_revoked_from_expired(
    engine: sa.Engine, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A key that was revoked before its days were over did not just run out."""
    for days in (None, 30.0):
        create_key(engine, "red", days=days)
    revoked = [row["id"] for row in list_keys(engine)]
    for key_id in revoked:
        revoke_key(engine, key_id)
    create_key(engine, "red", days=1.0)
    later_s = time.time() + 2 * 86_400
    monkeypatch.setattr("service.accounts.keys.time", SimpleNamespace(time=lambda: later_s))
    monkeypatch.setattr(commands, "_engine", lambda _: (engine, Path()))
    commands.listing(None, False)
    words = [line.split()[:2] for line in capsys.readouterr().out.splitlines()]
    told = dict(words)
    assert len(told) == 3
    assert {told.pop(key_id) for key_id in revoked} == {"revoked"}
    assert list(told.values()) == ["expired"]


@pytest.fixture(scope="module")
def guarded(keep_server: Callable[..., Any]) -> Any:
    """A server that was open, until a key was made while it ran."""
    server = keep_server()
    assert server.client.get("/v1/jobs").status_code == 200
    red, blue = server.make_keys("red", "blue")
    server.keys = {"red": red, "blue": blue}
    server.engine = connect(sqlite_url(server.home / "jobs.sqlite"))
    server.spare = create_key(server.engine, "red", "to be revoked")
    return server


def every_route() -> list[tuple[str, str]]:
    """(method, path) of every route of the application, in its OpenAPI document or not."""
    return [
        (method, route.path.replace(":path", ""))
        for room in ROOMS for route in room.router.routes for method in sorted(route.methods)
    ]  # fmt: skip


def place(path: str, job: str = "x", file_id: str = "z") -> str:
    """A path with something in the place of each parameter."""
    values = {"job_id": job, "file_id": file_id, "path": "plan.json", "part": "phase"}
    values |= {"frame": "0", "row": "0", "column": "0", "process": "render", "name": "page.js"}
    return path.format(**values)


def test_every_route_needs_a_key(guarded: Any) -> None:
    bad = guarded.keys["red"][:-3] + "xyz"
    for method, path in every_route():
        url = place(path)
        for headers in ({}, bearer("nonsense"), bearer(bad), {"authorization": "Basic eDp5"}):
            answer = guarded.client.request(method, url, headers=headers)
            assert (answer.status_code == 401) == (path not in PUBLIC), (method, path)
            if path not in PUBLIC and method != "HEAD":
                assert answer.headers["www-authenticate"] == "Bearer"
                assert answer.headers["content-type"] == "application/problem+json"


def test_no_route_shows_or_touches_another_teams_job(guarded: Any, scene: dict[str, Any]) -> None:
    red, blue = (bearer(guarded.keys[team]) for team in ("red", "blue"))
    made = guarded.client.post("/v1/jobs", json=scene, headers=red | {"idempotency-key": "k"})
    assert made.status_code == 202
    job = made.json()["id"]
    assert made.json()["owner"] == f"key:{guarded.keys['red'][3:15]}"
    deadline = time.monotonic() + 60
    while guarded.client.get(f"/v1/jobs/{job}", headers=red).json()["phase"] != "COMPLETED":
        assert time.monotonic() < deadline
        time.sleep(0.2)
    sent = guarded.client.post("/v1/files?name=a.csv", content=b"1,2\n", headers=red)
    file_id = sent.json()["id"]
    touched = 0
    for method, path in every_route():
        if "{job_id}" not in path and "{file_id}" not in path:
            continue
        url = place(path, job, file_id)
        theirs = guarded.client.request(method, url, headers=blue)
        nobody = guarded.client.request(method, url.replace(job, "0" * 32), headers=blue)
        assert theirs.status_code in (404, 422), (method, path)
        if "job_id" in path:
            assert theirs.content == nobody.content  # not even that there is one
        touched += 1
    assert touched >= 30
    for path in ("/v1/jobs", "/v1/files", "/v1/usage", "/v1/queue", "/uws/async", "/ogc/jobs", "/"):
        assert job not in guarded.client.get(path, headers=blue).text
        assert file_id not in guarded.client.get(path, headers=blue).text
    used = guarded.client.get("/v1/usage", headers=blue).json()
    assert (used["team"], used["jobs"]["COMPLETED"]) == ("blue", 0)
    own = guarded.client.post("/v1/jobs", json=scene, headers=blue | {"idempotency-key": "k"})
    assert own.status_code == 202  # a key of another team's is free
    refused = []
    for name in (file_id, f"upload:{0:032x}.csv"):
        scene["sensor"]["bandpass"] = {"kind": "table", "path": name}
        answer = guarded.client.post("/v1/jobs", json=scene, headers=blue)
        assert (answer.status_code, "there is no such file" in answer.text) == (422, True)
        refused.append(answer.text.replace(name, ""))
    assert refused[0] == refused[1]  # not even that another team has it
    assert guarded.client.get(f"/v1/jobs/{job}", headers=red).json()["phase"] == "COMPLETED"
    assert file_id in guarded.client.get("/v1/files", headers=red).text


def test_a_revoked_key_stops_working(guarded: Any, scene: dict[str, Any]) -> None:
    """New requests, and those that wait for changes of a job: by the key, and by its ticket."""
    get, spare = guarded.client.get, bearer(guarded.spare)
    made = guarded.client.post("/uws/async", data={"SCENE": json.dumps(scene)}, headers=spare)
    job = f"/v1/jobs/{made.headers['location'].rpartition('/')[2]}"  # it waits to be started
    ask = guarded.client.post("/v1/tickets", json={"path": f"{job}/events"}, headers=spare)
    ticket = ask.json()["href"]
    with ThreadPoolExecutor() as pool:
        streams = [pool.submit(get, f"{job}/events", headers=spare), pool.submit(get, ticket)]
        poll = pool.submit(get, job, params={"wait": 20}, headers=spare)
        time.sleep(0.7)
        assert not any(asked.done() for asked in (*streams, poll))
        revoke_key(guarded.engine, guarded.spare)
        revoked = time.monotonic()
        for stream in streams:
            assert "event: job" in stream.result().text
        assert poll.result().status_code == 401
    assert get("/v1/jobs", headers=spare).status_code == 401
    assert get(ticket).status_code == 401
    assert time.monotonic() - revoked < 4.0  # two seconds on a quiet machine


def test_secrets_are_nowhere(guarded: Any) -> None:
    """Not in answers, metrics, logs, the database; also where they come in odd places."""
    token = guarded.keys["red"]
    for path in (f"/v1/jobs/{token}", f"/v1/jobs?phase={token}", f"/{token}", "/v1/usage"):
        answer = guarded.client.get(path, headers=bearer(token))
        if path != f"/v1/jobs?phase={token}":  # a parameter that was refused is told back, cut
            assert token[16:] not in answer.text
    guarded.client.get("/v1/jobs", headers={"authorization": f"Bearer {token}x"})
    assert token[16:] not in guarded.client.get("/metrics").text
    assert token[16:] not in guarded.logged()
    assert not any(token[16:].encode() in f.read_bytes() for f in guarded.home.glob("jobs.sqlite*"))


def test_log_lines_are_json(guarded: Any) -> None:
    lines = [line for line in guarded.logged().splitlines() if line.startswith("{")]
    told = [json.loads(line) for line in lines]
    assert any(line.get("job") and line.get("attempt") == 1 for line in told)
    assert all({"time", "level", "message"} <= set(line) for line in told)


@pytest.mark.parametrize(
    "text",
    [
        "key ng_0123456789ab_" + "s3cret" * 7 + "x",
        "Authorization: Bearer s3cretS3cret",
        "postgresql://user:s3cret@host/db",
        "eyJhbGciOiJIUzI1NiJ9.eyJzdWIiOiJzM2NyZXQifQ.s3cret",
    ],
)
def test_redaction(text: str) -> None:
    assert "s3cret" not in redact(text)


def test_what_stands_in_a_log_line_is_redacted() -> None:
    """The message, what stands beside it, and the traceback."""
    secret = "ng_0123456789ab_" + "s3cret" * 7
    try:
        raise ValueError(f"no such key: {secret}")
    except ValueError:
        told = sys.exc_info()
    record = logging.LogRecord("nightglass", logging.ERROR, "f", 1, "for %s", (secret,), told)
    record.path, record.status = f"/v1/jobs?key={secret}", 500
    line = json.loads(JsonLines().format(record))
    assert "s3cret" not in json.dumps(line)
    assert (line["level"], line["status"]) == ("error", 500)
    assert line["path"] == "/v1/jobs?key=ng_0123456789ab_***"
    assert "ValueError: no such key: ng_0123456789ab_***" in line["traceback"]


@pytest.mark.parametrize("separator", ["\n", "\r\n", "\x85", "\u2028"])
def test_a_log_record_is_one_line_whatever_it_tells(separator: str) -> None:
    """A path is decoded before it is logged: it may hold whatever ends a line."""
    path = f"/v1/jobs/a{separator}b"
    record = logging.LogRecord("nightglass", logging.INFO, "f", 1, "%s", (path,), None)
    record.path = path
    text = JsonLines().format(record)
    assert len(text.splitlines()) == 1
    line = json.loads(text)
    assert (line["message"], line["path"]) == (path, path)


def test_only_this_machine_is_served_unless_asked_otherwise() -> None:
    from pipeline.commands.serve import serve

    assert inspect.signature(serve).parameters["host"].default == "127.0.0.1"


def test_beyond_loopback_only_with_keys() -> None:
    for host in ("0.0.0.0", "::"):
        with pytest.raises(BadInput, match="--host"):
            bind(host, 0, guarded=False)
    bind("0.0.0.0", 0, guarded=lambda: True).close()
    with pytest.raises(BadInput):
        bind("example.org", 0, guarded=True)


def test_a_scheduler_beyond_this_machine_needs_tls(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="scheduler"):
        read_settings(tmp_path, {"NIGHTGLASS_SCHEDULER": "tcp://10.1.2.3:8786"})
    far = read_settings(tmp_path, {"NIGHTGLASS_SCHEDULER": "tls://10.1.2.3:8786"})
    assert far.scheduler.startswith("tls://")
    assert read_settings(tmp_path, {"NIGHTGLASS_SCHEDULER": "tcp://127.0.0.1:8786"})


# Tokens of an identity provider


@pytest.fixture(scope="module")
def provider(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], Path]:
    """Private keys by id, and the published set of public ones."""
    private = {
        "rsa": rsa.generate_private_key(65537, 2048),
        "ec": ec.generate_private_key(ec.SECP256R1()),
        "unpublished": rsa.generate_private_key(65537, 2048),
    }
    rsa_key = json.loads(jwt.algorithms.RSAAlgorithm.to_jwk(private["rsa"].public_key()))
    ec_key = json.loads(jwt.algorithms.ECAlgorithm.to_jwk(private["ec"].public_key()))
    octets = {"kty": "oct", "k": "c2VjcmV0c2VjcmV0c2VjcmV0c2VjcmV0", "kid": "oct", "alg": "HS256"}
    published = [rsa_key | {"kid": "rsa"}, ec_key | {"kid": "ec"}, octets]
    path = tmp_path_factory.mktemp("provider") / "jwks.json"
    path.write_text(json.dumps({"keys": published}))
    return private, path


def signed(private: dict[str, Any], kid: str = "rsa", alg: str = "RS256", **claims: Any) -> str:
    now = int(time.time())
    told = {"iss": ISSUER, "aud": AUDIENCE, "sub": "ann", "team": "red", "exp": now + 60} | claims
    told = {name: value for name, value in told.items() if value is not None}
    return jwt.encode(told, private[kid], algorithm=alg, headers={"kid": kid})


def test_good_tokens(provider: tuple[dict[str, Any], Path]) -> None:
    private, path = provider
    verifier = Verifier(ISSUER, AUDIENCE, str(path), "team")
    assert verifier.verify(signed(private)) == ("red", "oidc:ann")
    assert verifier.verify(signed(private, "ec", "ES256")) == ("red", "oidc:ann")
    assert verifier.verify(signed(private, team=["blue"])) == ("blue", "oidc:ann")


def test_a_token_need_not_name_the_only_key(
    provider: tuple[dict[str, Any], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """OpenID Connect Core, 10.1; nor need the key have an id. A new one is found all the same."""
    monkeypatch.setattr("service.accounts.oidc.READ_AGAIN_S", 0.0)
    private, path = provider
    key, other, octets = json.loads(path.read_text())["keys"]
    nameless = {name: value for name, value in key.items() if name != "kid"}
    path = tmp_path / "jwks.json"
    token = jwt.encode(jwt.decode(signed(private), options={"verify_signature": False}),
                       private["rsa"], "RS256")  # fmt: skip
    path.write_text(json.dumps({"keys": [other, octets]}))
    verifier = Verifier(ISSUER, AUDIENCE, str(path), "team")
    for keys, good in (
        ([other, octets], False), ([key, octets], True), ([nameless], True),
        ([key, other], False), ([nameless, nameless], False),
    ):  # fmt: skip
        path.write_text(json.dumps({"keys": keys}))
        if good:
            assert verifier.verify(token) == ("red", "oidc:ann")
        else:
            with pytest.raises(Unauthenticated):
                verifier.verify(token)


def test_what_is_wrong_with_a_signed_token_is_told(
    provider: tuple[dict[str, Any], Path],
) -> None:
    private, path = provider
    verifier, now = Verifier(ISSUER, AUDIENCE, str(path), "team"), int(time.time())
    for claims, told in (
        ({"exp": now - 3600}, "has expired"), ({"nbf": now + 3600}, "not valid yet"),
        ({"iss": f"{ISSUER}/"}, "another issuer"), ({"aud": "other"}, "another audience"),
        ({"sub": ""}, "'sub'"), ({"sub": "a\0b"}, "'sub'"), ({"sub": "\ud800"}, "'sub'"),
    ):  # fmt: skip
        with pytest.raises(Unauthenticated, match=told):
            verifier.verify(signed(private, **claims))


def test_bad_tokens(provider: tuple[dict[str, Any], Path]) -> None:
    private, path = provider
    verifier = Verifier(ISSUER, AUDIENCE, str(path), "team")
    good = signed(private)
    header, payload, signature = good.split(".")
    none = jwt.encode({"sub": "x", "aud": AUDIENCE, "iss": ISSUER, "exp": 1 << 40, "team": "red"},
                      None, algorithm="none", headers={"kid": "rsa"})  # fmt: skip
    symmetric = jwt.encode({"sub": "x", "aud": AUDIENCE, "iss": ISSUER, "exp": 1 << 40},
                           "secret" * 6, algorithm="HS256", headers={"kid": "oct"})  # fmt: skip
    now = int(time.time())
    bad = {
        "none": none, "symmetric": symmetric,
        "cut": good[:-10], "two parts": f"{header}.{payload}", "empty": "..", "text": "x" * 5000,
        "other payload": f"{header}.{payload[::-1]}.{signature}",
        "expired": signed(private, exp=now - 3600), "no exp": signed(private, exp=None),
        "not yet": signed(private, nbf=now + 3600),
        "issuer": signed(private, iss="https://evil.example"),
        "no issuer": signed(private, iss=None),
        "audience": signed(private, aud="other"), "no audience": signed(private, aud=None),
        "no subject": signed(private, sub=None),
        "unknown key": jwt.encode({"sub": "x"}, private["unpublished"], "RS256", {"kid": "other"}),
        "wrong key": jwt.encode({"sub": "x"}, private["unpublished"], "RS256", {"kid": "rsa"}),
        "no kid": jwt.encode({"sub": "x"}, private["rsa"], "RS256"),
        "odd kid": jwt.encode({"sub": "x"}, private["rsa"], "RS256", {"kid": "../../etc/passwd"}),
    }  # fmt: skip
    for name, token in bad.items():
        with pytest.raises(Unauthenticated) as caught:
            verifier.verify(token)
        assert not any(len(p) > 8 and p in str(caught.value) for p in token.split(".")), name
    for team in (None, "", "Red/../x", ["a", "b"], 5):
        with pytest.raises(Forbidden):
            verifier.verify(signed(private, team=team))


def test_keys_of_a_provider_that_cannot_be_read_stay(
    provider: tuple[dict[str, Any], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A token of an unknown key makes the set be read again; a key for encryption signs none."""
    monkeypatch.setattr("service.accounts.oidc.READ_AGAIN_S", 0.0)
    private, published = provider
    told = json.loads(published.read_text())
    told["keys"] = [key | ({"use": "enc"} if key["kid"] == "ec" else {}) for key in told["keys"]]
    path = tmp_path / "jwks.json"
    path.write_text(json.dumps(told))
    verifier = Verifier(ISSUER, AUDIENCE, str(path), "team")
    assert verifier.verify(signed(private)) == ("red", "oidc:ann")
    with pytest.raises(Unauthenticated):
        verifier.verify(signed(private, "ec", "ES256"))
    path.unlink()
    with pytest.raises(NoProvider):  # whether it has that key now is not known
        verifier.verify(signed(private, "ec", "ES256"))
    assert verifier.verify(signed(private)) == ("red", "oidc:ann")


@pytest.mark.parametrize(
    "published", [b"", b"[]", b"null", b"[" * 100_000, b'{"keys": [{"kid": ["x"]}]}', b"\xff"],
    ids=["nothing", "list", "null", "deep", "odd key", "bytes"],
)  # fmt: skip
def test_what_is_no_key_set(
    published: bytes, provider: tuple[dict[str, Any], Path], tmp_path: Path
) -> None:
    path = tmp_path / "jwks.json"
    path.write_bytes(published)
    with pytest.raises(NoProvider):
        Verifier(ISSUER, AUDIENCE, str(path), "team").verify(signed(provider[0]))


def test_a_provider_that_speaks_no_http(provider: tuple[dict[str, Any], Path]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener, ThreadPoolExecutor(1) as pool:
        place = f"http://127.0.0.1:{listener.getsockname()[1]}/jwks"
        verifier = Verifier(ISSUER, AUDIENCE, place, "team")
        told = pool.submit(verifier.verify, signed(provider[0]))
        connection = listener.accept()[0]
        connection.recv(4096)
        connection.sendall(b"220 mail.example ESMTP\r\n")
        connection.close()
        with pytest.raises(NoProvider):
            told.result(10)


@pytest.mark.parametrize("moved", [False, True])
def test_keys_are_read_where_they_are_and_nowhere_else(
    provider: tuple[dict[str, Any], Path], moved: bool
) -> None:
    """A provider that sends elsewhere is not followed: it could lead inside this network."""
    private, published = provider
    asked = []

    class Provider(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            asked.append(self.path)
            elsewhere = moved and self.path == "/jwks"
            self.send_response(302 if elsewhere else 200)
            self.send_header("Location", "/elsewhere")
            self.end_headers()
            self.wfile.write(b"" if elsewhere else published.read_bytes())

        def log_message(self, *_: Any) -> None:
            pass

    with HTTPServer(("127.0.0.1", 0), Provider) as http:
        threading.Thread(target=http.serve_forever, args=(0.02,), daemon=True).start()
        place = f"http://127.0.0.1:{http.server_port}/jwks"
        verifier = Verifier(ISSUER, AUDIENCE, place, "team")
        if moved:
            with pytest.raises(NoProvider):
                verifier.verify(signed(private))
        else:
            assert verifier.verify(signed(private)) == ("red", "oidc:ann")
        http.shutdown()
    assert set(asked) == {"/jwks"}


def test_a_provider_that_is_silent_holds_up_no_key(
    make_server: Callable[..., Any], provider: tuple[dict[str, Any], Path]
) -> None:
    """Tokens wait for it, and are answered with 503; all else goes on meanwhile."""
    with socket.create_server(("127.0.0.1", 0)) as silent, ThreadPoolExecutor(8) as pool:
        server = make_server(
            NIGHTGLASS_OIDC_ISSUER=ISSUER, NIGHTGLASS_OIDC_AUDIENCE=AUDIENCE,
            NIGHTGLASS_OIDC_JWKS=f"http://127.0.0.1:{silent.getsockname()[1]}/jwks",
            NIGHTGLASS_REQUEST_THREADS="4",
        )  # fmt: skip
        [key] = server.make_keys("red")

        def usage(token: str) -> httpx.Response:
            return httpx.get(f"{server.url}/v1/usage", headers=bearer(token), timeout=30)

        waiting = [pool.submit(usage, signed(provider[0])) for _ in range(8)]
        with silent.accept()[0]:
            assert usage(key).status_code == 200
            assert not any(one.done() for one in waiting)
            answers = [one.result() for one in waiting]
        for answer in answers:
            assert answer.status_code == 503
            assert "identity provider" in answer.json()["detail"]


def test_an_engine_is_told_no_secret(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What forks its workers has none of these in its environment, and what they need."""
    secret = {f"NIGHTGLASS_{name}": "s3cret" for name in ("DATABASE", "OIDC_JWKS", "TLS_KEY")}
    for name, value in (secret | {"NIGHTGLASS_DATA": "here"}).items():
        monkeypatch.setenv(name, value)
    settings = Settings(tmp_path)
    settings.make_folders()
    monkeypatch.setattr(processes, "_forks", forks := processes.Forks())
    with processes.worker(settings, {"do": "judge", "scene": {}}):
        assert forks._process is not None
        environment = psutil.Process(forks._process.pid).environ()
    assert not secret.keys() & environment.keys()
    assert environment["NIGHTGLASS_DATA"] == "here"
    forks._process.kill()
    forks._process.wait()


def test_a_place_for_keys_must_be_safe(tmp_path: Path) -> None:
    odd = ("https://[id", "https://id.example:99999/jwks", "https:///jwks")
    for place in ("http://id.example/jwks", str(tmp_path / "absent"), "ftp://x/y", *odd):
        with pytest.raises(BadInput):
            Verifier(ISSUER, AUDIENCE, place, "team")
    environment = {"OIDC_ISSUER": ISSUER, "OIDC_AUDIENCE": AUDIENCE, "OIDC_JWKS": "https://[id"}
    command = [sys.executable, "-m", "pipeline", "serve", "--port", "0", "--home", str(tmp_path)]
    told = subprocess.run(
        command, capture_output=True, text=True, timeout=60,
        env=os.environ | {f"NIGHTGLASS_{name}": text for name, text in environment.items()},
    )  # fmt: skip
    assert (told.returncode, told.stdout) == (2, "")
    assert told.stderr.startswith("nightglass: NIGHTGLASS_OIDC_JWKS"), told.stderr
    with pytest.raises(BadInput, match="OIDC"):
        read_settings(tmp_path, {"NIGHTGLASS_OIDC_ISSUER": ISSUER})


def test_tokens_over_http(
    make_server: Callable[..., Any], provider: tuple[dict[str, Any], Path]
) -> None:
    private, path = provider
    server = make_server(
        NIGHTGLASS_OIDC_ISSUER=ISSUER, NIGHTGLASS_OIDC_AUDIENCE=AUDIENCE,
        NIGHTGLASS_OIDC_JWKS=str(path),
    )  # fmt: skip
    client: httpx.Client = server.client
    assert client.get("/v1/usage").status_code == 401
    good = signed(private)
    assert client.get("/v1/usage", headers=bearer(good)).json()["team"] == "red"
    assert client.get("/v1/usage", headers=bearer(signed(private, team=None))).status_code == 403
    assert client.get("/v1/usage", headers=bearer(good[:-4])).status_code == 401
    assert not re.search(r"eyJ[\w-]+\.", server.logged())
    assert Settings(server.home).oidc_issuer is None


@pytest.mark.parametrize("words", [("list",), ("revoke", "0123456789ab")], ids=["list", "revoke"])
def test_keys_of_a_service_that_is_not_there(words: tuple[str, ...], tmp_path: Path) -> None:
    """A mistyped folder is not a service without keys, and is not made."""
    ran = nightglass("keys", *words, "--home", tmp_path / "mistyped")
    assert ran.returncode == 2
    assert "--home" in ran.stderr
    assert not (tmp_path / "mistyped").exists()
    assert "nightglass keys" in nightglass("keys", words[0], "--help").stdout
