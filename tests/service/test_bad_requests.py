"""Bodies and requests that must be refused: the right status, problem+json, never a 500."""

from __future__ import annotations

import json
import socket
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import anyio
import httpx
import pytest

from pipeline.errors import BadInput
from pipeline.spec.load import PATH_FIELDS
from pipeline.spec.scene import Scene
from pipeline.spec.study import Study
from pipeline.spec.sweep import Sweep
from service.app import create_app
from service.main import bind
from service.settings import Settings, read_settings

JSON = {"content-type": "application/json"}


@pytest.fixture(scope="module")
def client(server: Any) -> httpx.Client:
    """Real requests to a real server with small limits."""
    return server.client


def refused(answer: Any, status: int) -> dict[str, Any]:
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    assert len(answer.content) < 30_000
    problem = answer.json()
    assert problem["status"] == status
    assert problem["title"]
    assert problem["detail"]
    return problem


NOT_JSON = {
    "nothing": b"",
    "not JSON": b"{name: x}",
    "YAML": b"schema: nightglass/scene/1\n",
    "NaN": b'{"seed": NaN}',
    "Infinity": b'{"seed": -Infinity}',
    "beyond float64": b'{"seed": 1e400}',
    "4301 digits": b'{"seed": ' + b"9" * 4301 + b"}",
    "lone surrogate": b'{"name": "\\ud800"}',
    "lone surrogate as key": b'{"\\udfff": 1}',
    "not UTF-8": b'{"name": "\xff"}',
    "UTF-16": '{"name": "x"}'.encode("utf-16"),
    "NUL": b"\0" * 100,
    "deep": b"[" * 100_000,
    "deep and whole": b"[" * 40 + b"]" * 40,
    "deep objects": b'{"a":' * 5000 + b"1" + b"}" * 5000,
    "key twice": b'{"seed": 1, "seed": 2}',
    "cut off": b'{"seed": 1',
}


@pytest.mark.parametrize("body", NOT_JSON.values(), ids=NOT_JSON.keys())
def test_malformed_body_is_400(client: httpx.Client, body: bytes) -> None:
    refused(client.post("/v1/jobs", content=body, headers=JSON), 400)


WRONG: dict[str, tuple[tuple[Any, ...], Any, str]] = {
    "unknown key": (("sensor", "colour"), 1, "/sensor/colour"),
    "negative": (("sensor", "focal_length_m"), -1, "/sensor/focal_length_m"),
    "text": (("sensor", "full_well_e"), "x" * 100_000, "/sensor/full_well_e"),
    "zero size": (("sensor", "shape"), [0, 64], "/sensor/shape/0"),
    "in a list": (("targets", 0, "body", "albedo"), 2, "/targets/0/body/albedo"),
    "null byte": (("name",), "a\0b", "/name"),
    "huge integer": (("seed",), 10**4000, "/seed"),
    "too many targets": (("targets",), [1] * 60, "/targets"),
    "bad targets": (("targets",), [{"name": "x" * 500}] * 50, "/targets/0/name"),
    "too many pixels": (("exposure", "frames"), 99_999, "/exposure/frames"),
    "a giant key": (("k" * 100_000,), 1, "/kkk"),
    "a URL": (("sensor", "flat"), "http://127.0.0.1/x.npy", "/sensor/flat"),
    "a file": (("sensor", "dark_e_per_s"), "/etc/passwd", "/sensor/dark_e_per_s"),
    "a table": (
        ("sensor", "bandpass"),
        {"kind": "table", "path": "a.csv"},
        "/sensor/bandpass/path",
    ),
    "efficiency": (("sensor", "quantum_efficiency"), "file:///etc/passwd", "/sensor/quantum"),
    "no such catalogue": (("stars",), {"catalogue": "gaia"}, "/stars/catalogue"),
    "a path": (("stars",), {"catalogue": "../../etc"}, "/stars/catalogue"),
    "the registry": (("stars",), {"catalogue": "."}, "/stars/catalogue"),
    "a URL as catalogue": (("stars",), {"catalogue": "s3://bucket/x"}, "/stars/catalogue"),
    "a path in a list": (("stars",), {"catalogue": ["/etc"]}, "/stars/catalogue"),
    "an empty list": (("stars",), {"catalogue": []}, "/stars/catalogue"),
    "one name twice": (("stars",), {"catalogue": ["x", "x"]}, "/stars/catalogue/1"),
}


@pytest.mark.parametrize(("place", "value", "pointer"), WRONG.values(), ids=WRONG.keys())
def test_wrong_scene_is_422_and_names_the_field(
    client: httpx.Client, scene: dict[str, Any], place: tuple[Any, ...], value: Any, pointer: str
) -> None:
    holder: Any = scene
    for part in place[:-1]:
        holder = holder[part]
    holder[place[-1]] = value
    problem = refused(client.post("/v1/jobs", json=scene), 422)
    assert any(error["pointer"].startswith(pointer) for error in problem["errors"]), problem
    assert all(len(error["value"]) <= 80 for error in problem["errors"])


def test_of_very_many_mistakes_fifty_are_told(client: httpx.Client, scene: dict[str, Any]) -> None:
    scene["dwells"] = [{"frames": -1}] * 500
    assert len(refused(client.post("/v1/jobs", json=scene), 422)["errors"]) == 50


@pytest.mark.parametrize("body", ["[]", "null", '"text"', "1", "{}", "[" + "1," * 100_000 + "1]"])
def test_other_json_is_422(client: httpx.Client, body: str) -> None:
    refused(client.post("/v1/jobs", content=body, headers=JSON), 422)


@pytest.mark.parametrize("field", PATH_FIELDS, ids=".".join)
def test_no_path_field_takes_a_file(
    client: httpx.Client, scene: dict[str, Any], field: tuple[str, ...], tmp_path: Path
) -> None:
    """Also where the file is there and could be read."""
    file = tmp_path / "image.npy"
    file.write_bytes(b"x")
    if "psfs" in field:
        places = {"rows_px": [0], "columns_px": [0], "psfs": [[{"kind": "table"}]]}
        scene["sensor"]["psf"] = {"kind": "field"} | places
    elif field[-1] == "path" and field[0] == "sensor":
        kind = "file" if field[-2] == "distortion" else "table"
        scene["sensor"][field[-2]] = {"kind": kind}
    orbit = {"kind": "omm", "path": ""}
    if field[0] == "observer":
        scene["observer"] = {"kind": "orbit", "orbit": orbit}
    if "orbit" in field and field[0] == "targets":
        scene["targets"] = [dict(scene["targets"][0], orbit=orbit)]
    table = {"mode": "table", "frame": "icrs", "scalar": "last"}
    if field == ("pointing", "path"):
        scene["pointing"] = table
    if field[0] == "dwells":
        scene["dwells"] = [{"pointing": table}]
    if field[0] == "background":
        pst = {"kind": "table", "path": "x.csv"} if field[-1] == "path" else HARVEY
        scene["background"] = {"stray_light": {"pst": dict(pst)}}
    if field == ("stars", "colour_fit"):  # without a catalogue it is refused before its files
        scene["stars"] = {"catalogue": "none"}
    if field[0] == "cosmic_rays":
        scene["cosmic_rays"] = {"kind": "library"}
    if field[0] == "populations":
        ball = scene["targets"][0]["body"]
        scene["populations"] = [{"name": "p", "path": "a.tle", "body": ball}]
    if "body" in field:
        scene["targets"][0]["body"] = {"kind": "mesh", "unit": "m", "path": "a.obj"}
    if field == ("stars", "colour_fit"):
        scene["stars"] = {"catalogue": "sky"}
    holder: Any = scene
    for part, after in pairwise(field):
        several: Any = [{"name": "a", "path": "b.obj"}]
        if part == "jitter":
            several = [{"kind": "table"}]
        if part == "materials":
            several = {"0": {"kind": "table"}}
        made = several if after == "*" else {"kind": "table"} if part == "surface" else {}
        if part == "*":
            holder = holder[0] if isinstance(holder, list) else holder["0"]
        else:
            holder = holder.setdefault(part, made)
    holder[field[-1]] = f" {file} "
    problem = refused(client.post("/v1/jobs", json=scene), 422)
    pointers = [error["pointer"] for error in problem["errors"]]
    assert "/" + "/".join(field).replace("*", "0") in pointers


HARVEY = {"kind": "harvey", "b0_per_sr": 0.1, "shoulder": 0.01, "slope": -1.5}
TEXTS_THAT_ARE_NO_PATHS = {
    "name", "epoch", "line1", "line2", "target", "schema", "kind", "mode", "adc_rounding",
    "compression", "layers", "object", "frame", "shadow", "third_bodies", "source",
    "time_of_perigee", "centre", "bus", "closed", "phase_law", "near_sun", "starlight",
    "unit", "arrival", "on", "objects", "digest", "towards", "inside", "beyond", "scalar",
    "rotation", "interpolation", "profile", "axis", "moonlight", "twilight",
    "name_contains", "left_out", "unmet", "edges", "first", "accept", "object_name",
}  # fmt: skip


def test_every_text_of_a_scene_is_known_here() -> None:
    """A new field that takes text must be put among PATH_FIELDS, or here as harmless."""
    schema = Scene.model_json_schema(by_alias=True)

    def texts(node: Any, at: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
        if "$ref" in node:
            yield from texts(schema["$defs"][node["$ref"].rpartition("/")[2]], at)
        if node.get("type") == "string":
            yield at
        for inner in (*node.get("anyOf", ()), *node.get("oneOf", ())):
            yield from texts(inner, at)
        several = (node.get(key) for key in ("items", "additionalProperties"))
        for inner in (*several, *node.get("prefixItems", ())):
            if isinstance(inner, dict):
                yield from texts(inner, (*at, "*"))
        for name, inner in node.get("properties", {}).items():
            yield from texts(inner, (*at, name))

    def named(at: tuple[str, ...]) -> str:
        return next(name for name in reversed(at) if name != "*")

    found = {at for at in texts(schema) if named(at) not in TEXTS_THAT_ARE_NO_PATHS}
    assert found == set(PATH_FIELDS) | {
        ("stars", "catalogue", "*"),  # as one catalogue
        ("dwells", "*", "pointing", "attitude", "jitter", "*", "path"),  # refused in dwells
    }


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"content-type": "text/yaml"}, 415),
        ({"content-type": "application/json; charset=latin-1"}, 415),
        ({"content-type": "multipart/form-data; boundary=x"}, 415),
        ({}, 415),
        (JSON | {"content-encoding": "gzip"}, 415),
        (JSON | {"idempotency-key": "a b"}, 400),
        (JSON | {"idempotency-key": "k" * 300}, 400),
        (JSON | {"host": "evil.example"}, 421),
        (JSON | {"host": "evil.example:80"}, 421),
        (JSON | {"host": ""}, 421),
    ],
)
def test_wrong_headers(client: httpx.Client, headers: dict[str, str], status: int) -> None:
    refused(client.post("/v1/jobs", content=b"{}", headers=headers), status)


@pytest.mark.parametrize("name", ["127.0.0.1", "localhost", "LocalHost", "[::1]"])
@pytest.mark.parametrize("port", ["", ":80"])
def test_the_service_answers_to_each_of_its_names(
    client: httpx.Client, name: str, port: str
) -> None:
    assert client.get("/healthz", headers={"host": name + port}).status_code == 200


def test_large_bodies_are_413(client: httpx.Client) -> None:
    def chunks() -> Iterator[bytes]:
        for _ in range(100):
            yield b" " * 10_000

    refused(client.post("/v1/jobs", content=chunks(), headers=JSON), 413)
    refused(client.post("/v1/jobs", content=b" " * (1 << 19), headers=JSON), 413)


def test_a_lying_length_is_413_before_the_body_comes(server: Any) -> None:
    with raw_request(server, b"Content-Length: 99999999999\r\n\r\n{") as wire:
        assert wire.recv(100).startswith(b"HTTP/1.1 413 ")


@pytest.mark.parametrize(
    ("method", "path", "status"),
    [
        ("GET", "/nowhere", 404),
        ("GET", "/v1/jobs/nosuchjob", 404),
        ("GET", "/v1/jobs/%2e%2e", 404),
        ("POST", "/v1/jobs/nosuchjob/cancel", 404),
        ("DELETE", "/v1/jobs/nosuchjob", 404),
        ("GET", "/v1/jobs/nosuchjob/events", 404),
        ("GET", "/v1/jobs/nosuchjob/results", 404),
        ("GET", "/v1/jobs/nosuchjob/plan", 404),
        ("PUT", "/v1/jobs", 405),
        ("GET", "/v1/jobs?limit=0", 422),
        ("GET", "/v1/jobs?limit=1e9", 422),
        ("GET", "/v1/jobs?after=-1", 422),
        ("GET", "/v1/jobs?after=" + "9" * 400, 422),
        ("GET", "/v1/jobs?phase=DONE", 422),
        ("GET", "/v1/jobs/x?wait=nan", 422),
        ("POST", "/v1/jobs?dry_run=perhaps", 422),
    ],
)
def test_wrong_requests(client: httpx.Client, method: str, path: str, status: int) -> None:
    refused(client.request(method, path), status)


@pytest.mark.parametrize(
    ("method", "path", "name", "allowed"),
    [
        ("POST", "/v1/jobs?dryrun=1", "dryrun", "dry_run"),
        ("POST", "/v1/sweeps?dry_run=1&dry-run=1", "dry-run", "dry_run"),
        ("POST", "/v1/observe?foo=1", "foo", "times, snr"),
        ("GET", "/v1/jobs?Limit=5", "Limit", "phase, after, limit"),
        ("GET", "/v1/jobs/x/frames/0/tiles/0/0/picture.png?low=1&hi=2", "hi",
         "stretch, low, high, layer, bin"),
        ("GET", "/v1/usage?team=red", "team", "no parameter at this address"),
        ("POST", "/v1/tickets?ticket=1", "ticket", "no parameter at this address"),
    ],
)  # fmt: skip
def test_parameters_that_a_route_does_not_take(
    client: httpx.Client, method: str, path: str, name: str, allowed: str
) -> None:
    """`POST /v1/jobs?dryrun=1` queued a job that was meant to be planned alone."""
    answer = client.request(method, path, json={})
    refused(answer, 422)
    (told,) = answer.json()["errors"]
    assert (told["pointer"], told["allowed"]) == (f"?{name}", allowed)


def test_each_parameter_in_the_openapi_document_is_taken(client: httpx.Client) -> None:
    """The document is made of the routes by FastAPI: no parameter of it is called unknown."""
    paths, tried = client.get("/openapi.json").json()["paths"], 0
    for path, methods in paths.items():
        for method, told in methods.items():
            names = [p["name"] for p in told.get("parameters", ()) if p["in"] == "query"]
            if not path.startswith("/v1") or not names:
                continue
            at = path.replace("{", "").replace("}", "")
            answer = client.request(method, at, params=dict.fromkeys(names, "\u00e9"))
            problem = answer.json()
            assert "parameter at this" not in answer.text
            assert not {e["allowed"] for e in problem["errors"]} & {", ".join(names)}
            tried += 1
    assert tried >= 8


def test_405_names_what_all_routes_of_a_path_take(client: httpx.Client) -> None:
    """RFC 9110, section 15.5.6: submitting and listing are routes of their own."""
    assert client.put("/v1/jobs").headers["allow"] == "GET, POST"


def test_a_body_that_does_not_come_is_408(tmp_path: Path) -> None:
    app = create_app(Settings(tmp_path, body_s=0.1))

    async def ask() -> httpx.Response:
        async def body() -> Any:
            yield b"{"
            await anyio.sleep(1.0)
            yield b"}"

        transport = httpx.ASGITransport(app)
        async with (
            app.router.lifespan_context(app),
            httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1") as client,
        ):
            return await client.post("/v1/jobs", content=body(), headers=JSON)

    refused(anyio.run(ask), 408)


def raw_request(server: Any, rest: bytes) -> socket.socket:
    """A connection on which a POST of a job was begun, as no HTTP library would send it."""
    where = urlsplit(server.url)
    head = f"POST /v1/jobs HTTP/1.1\r\nHost: {where.netloc}\r\nContent-Type: application/json\r\n"
    wire = socket.create_connection((where.hostname or "", where.port or 0), timeout=10)
    wire.sendall(head.encode() + rest)
    return wire


def test_a_truncated_request_leaves_the_server_well(server: Any) -> None:
    with raw_request(server, b"Content-Length: 1000\r\n\r\n{"):
        pass
    assert server.client.get("/healthz").status_code == 200
    assert server.client.get("/v1/jobs").status_code == 200


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.1.1", "example.org", ""])
def test_only_loopback_is_served(host: str) -> None:
    with pytest.raises(BadInput, match="--host"):
        bind(host, 0)


def test_a_port_in_use_is_bad_input() -> None:
    with bind("127.0.0.1", 0) as taken, pytest.raises(BadInput, match="--port"):
        bind("127.0.0.1", taken.getsockname()[1])


def test_settings_come_from_the_environment(tmp_path: Path) -> None:
    environ = {"NIGHTGLASS_HOME": str(tmp_path), "NIGHTGLASS_TARGETS": "5"}
    environ["NIGHTGLASS_HOSTS"] = "a.example, b.example"
    settings = read_settings(None, environ)
    assert (settings.home, settings.targets) == (tmp_path, 5)
    assert settings.hosts == ("a.example", "b.example")
    assert read_settings(tmp_path / "x", environ).home == tmp_path / "x"
    for name, value in {"TARGETS": "many", "BODY_BYTES": "-1", "WAIT_S": "inf"}.items():
        with pytest.raises(BadInput, match=name):
            read_settings(None, environ | {f"NIGHTGLASS_{name}": value})


@pytest.mark.parametrize("model", [Scene, Sweep, Study])
def test_schema_is_that_of_the_command(client: httpx.Client, model: Any) -> None:
    answer = client.get(f"/v1/schema/{model.__name__.lower()}")
    assert answer.status_code == 200
    assert answer.headers["content-type"] == "application/schema+json"
    assert answer.json() == json.loads(json.dumps(model.model_json_schema(by_alias=True)))
