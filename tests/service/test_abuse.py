"""Abuse is refused cheaply: huge, slow, lying, packed and pointing requests; memory stays small."""

from __future__ import annotations

import contextlib
import gzip
import io
import json
import resource
import socket
import sqlite3
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import httpx
import numpy as np
import psutil
import pytest

from pipeline.route.run import render
from pipeline.spec.load import PATH_FIELDS, parse_scene

JSON = {"content-type": "application/json"}
MOST_GROWTH = 64 << 20
HUGE = 200 << 20


@pytest.fixture(scope="module")
def hasty(keep_server: Callable[..., Any]) -> Any:
    """A server that waits for nobody."""
    server = keep_server(
        NIGHTGLASS_HEAD_S="1.5", NIGHTGLASS_BODY_S="1.5", NIGHTGLASS_UPLOAD_BYTES=str(1 << 20)
    )
    for _ in range(3):  # imports and pools are there before memory is looked at
        server.client.post("/v1/jobs", content=b"{}", headers=JSON)
        server.client.post("/v1/files?name=a.csv", content=b"x" * 50_000)
    return server


class Growth:
    """Peak growth of a process's memory while the block runs."""

    def __init__(self, server: Any) -> None:
        self.process = psutil.Process(server.process.pid)
        self.peak, self._end = 0, threading.Event()

    def __enter__(self) -> Growth:
        self.start = self.process.memory_info().rss
        self._thread = threading.Thread(target=self._watch)
        self._thread.start()
        return self

    def _watch(self) -> None:
        while not self._end.wait(0.01):
            self.peak = max(self.peak, self.process.memory_info().rss - self.start)

    def __exit__(self, *_: object) -> None:
        self._end.set()
        self._thread.join()


def pieces(total: int) -> Iterator[bytes]:
    piece = b" " * (1 << 20)
    for _ in range(total >> 20):
        yield piece


@pytest.mark.parametrize("path", ["/v1/jobs", "/v1/files?name=a.csv"])
@pytest.mark.parametrize("chunked", [True, False])
def test_200_mb_cost_nothing(hasty: Any, path: str, chunked: bool) -> None:
    headers = dict(JSON) if chunked else JSON | {"content-length": str(HUGE)}
    with Growth(hasty) as growth:
        try:
            answer = hasty.client.post(path, content=pieces(HUGE), headers=headers)
            assert answer.status_code == 413
        except httpx.TransportError:
            pass  # it closed on us while we still sent
    assert growth.peak < MOST_GROWTH
    assert hasty.client.get("/healthz").status_code == 200


@pytest.mark.parametrize(("more", "status"), [(0, 201), (1, 413)])
def test_a_file_of_the_most_bytes_is_taken_and_no_byte_more(
    hasty: Any, more: int, status: int
) -> None:
    content = b"1\n" * (1 << 19) + b"1" * more
    assert hasty.client.post("/v1/files?name=a.csv", content=content).status_code == status


def test_200_mb_where_no_body_is_wanted(hasty: Any) -> None:
    with Growth(hasty) as growth:
        for method, path in (
            ("DELETE", "/v1/jobs/x"),
            ("GET", "/healthz"),
            ("POST", "/v1/jobs/x/cancel"),
        ):
            with contextlib.suppress(httpx.TransportError):
                hasty.client.request(method, path, content=pieces(HUGE))
    assert growth.peak < MOST_GROWTH


def connect(server: Any) -> socket.socket:
    where = urlsplit(server.url)
    return socket.create_connection((where.hostname or "", where.port or 0), timeout=20)


def test_endless_heads_are_cut_off(hasty: Any) -> None:
    for start in (b"GET /" + b"a" * 100, b"GET / HTTP/1.1\r\nX-A: ", b"\r\n" * 40):
        with Growth(hasty) as growth, connect(hasty) as wire:
            try:
                wire.sendall(start)
                for _ in range(200):
                    wire.sendall((b"\r\n" if start[:2] == b"\r\n" else b"b") * (1 << 18))
            except OSError:
                pass
            else:
                pytest.fail("a head of 50 MB was read to its end")
        assert growth.peak < MOST_GROWTH


@pytest.mark.parametrize(
    "said",
    [b"", b"G", b"GET / HTTP/1.1\r\nHost: x\r\n", b"\r\n", b"POST /v1/jobs HTTP/1.1\r\nHo"],
)
def test_half_open_connections_are_closed(hasty: Any, said: bytes) -> None:
    with connect(hasty) as wire:
        wire.sendall(said)
        began = time.monotonic()
        assert wire.recv(4096) == b""
        assert time.monotonic() - began < 15


def test_drops_do_not_keep_a_connection(hasty: Any) -> None:
    """A byte now and then does not move the deadline, not before and not after an answer."""
    with connect(hasty) as wire:
        wire.sendall(b"GET /healthz HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
        assert b"200" in wire.recv(4096)
        deadline = time.monotonic() + 15
        try:
            while True:
                wire.sendall(b"\r\n")
                time.sleep(0.3)
                assert time.monotonic() < deadline
        except OSError:
            pass


def test_slow_bodies_are_408(hasty: Any) -> None:
    host = urlsplit(hasty.url).netloc
    for path, kind in (("/v1/jobs", "application/json"),):
        with connect(hasty) as wire:
            head = f"POST {path} HTTP/1.1\r\nHost: {host}\r\nContent-Type: {kind}\r\n"
            wire.sendall(head.encode() + b"Content-Length: 100\r\n\r\n{")
            assert wire.recv(4096).startswith(b"HTTP/1.1 408 ")


def test_lying_lengths(hasty: Any) -> None:
    host = urlsplit(hasty.url).netloc
    head = f"POST /v1/jobs HTTP/1.1\r\nHost: {host}\r\nContent-Type: application/json\r\n"
    for rest in (
        b"Content-Length: -1\r\n\r\n{}", b"Content-Length: 1\r\nContent-Length: 2\r\n\r\n{}",
        b"Content-Length: 99999999999999999999999\r\n\r\n{}", b"Content-Length: abc\r\n\r\n{}",
        b"Transfer-Encoding: chunked\r\nContent-Length: 5\r\n\r\n0\r\n\r\n",
        b"Transfer-Encoding: chunked\r\n\r\nffffffffffffffffff\r\n{}",
        b"Transfer-Encoding: gzip, chunked\r\n\r\n2\r\n{}\r\n0\r\n\r\n",
    ):  # fmt: skip
        with connect(hasty) as wire:
            wire.sendall(head.encode() + rest)
            answer = wire.recv(4096)
            assert answer[:10] in (b"HTTP/1.1 4", b""), (rest, answer)
    assert hasty.client.get("/healthz").status_code == 200


def test_bombs_are_not_unpacked(hasty: Any) -> None:
    bomb = gzip.compress(b" " * (50 << 20))
    with Growth(hasty) as growth:
        for encoding in ("gzip", "deflate", "br", "zstd", "gzip, gzip"):
            answer = hasty.client.post(
                "/v1/jobs", content=bomb, headers=JSON | {"content-encoding": encoding}
            )
            assert answer.status_code == 415
        answer = hasty.client.post("/v1/files?name=a.npy", content=bomb)
        assert answer.status_code == 422
        numbers = b"[" + b"1," * 120_000 + b"1]"
        assert hasty.client.post("/v1/jobs", content=numbers, headers=JSON).status_code == 422
    assert growth.peak < MOST_GROWTH


def npy(header: str, values: bytes = b"") -> bytes:
    padded = header.encode() + b" " * (118 - len(header) % 64) + b"\n"
    return b"\x93NUMPY\x01\x00" + len(padded).to_bytes(2, "little") + padded + values


def told(descr: str, shape: str) -> str:
    return f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}}}"


class Canary:
    """Whoever unpickles this leaves a file behind."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (self.path,)


def test_images_that_lie(hasty: Any, tmp_path: Path) -> None:
    canary = tmp_path / "hatched"
    pickled = io.BytesIO()
    np.save(pickled, np.array([Canary(canary)], dtype=object), allow_pickle=True)
    fits = b"SIMPLE  =                    T".ljust(80) + b"ZIMAGE  =                    T".ljust(80)
    lies = {
        "pickle": ("a.npy", pickled.getvalue()),
        "huge": ("a.npy", npy(told("'<f8'", "(9999999, 9999999)"))),
        "short": ("a.npy", npy(told("'<f8'", "(2,)"), b"x" * 8)),
        "long": ("a.npy", npy(told("'<f8'", "(2,)"), b"x" * 80)),
        "negative": ("a.npy", npy(told("'<f8'", "(-1, -1)"), b"x" * 8)),
        "code": ("a.npy", npy("__import__('os').system('touch x')")),
        "record": ("a.npy", npy(told("[('a', 'O')]", "(1,)"), b"x" * 8)),
        "void": ("a.npy", npy(told("'|V8'", "(1,)"), b"x" * 8)),
        "deep": ("a.npy", npy("(" * 3000)),
        "no npy": ("a.npy", b"hello"), "empty": ("a.npy", b""),
        "zip": ("a.csv", b"PK\x03\x04" + b"x" * 100),
        "packed fits": ("a.fits", fits.ljust(2880)), "no fits": ("a.fits", b"hello"),
        "kind": ("a.pickle", pickled.getvalue()), "npz": ("a.npz", b"x"), "no kind": ("a", b"x"),
        "path": ("../../a.npy", b"x"), "hidden": (".a.npy", b"x"), "nul": ("a\0.npy", b"x"),
    }  # fmt: skip
    with Growth(hasty) as growth:
        for name, (file, content) in lies.items():
            answer = hasty.client.post("/v1/files", params={"name": file}, content=content)
            assert answer.status_code == 422, (name, answer.text)
            assert answer.json()["errors"][0]["allowed"], name
    assert growth.peak < MOST_GROWTH
    assert not canary.exists()
    assert [p.name for p in (hasty.home / "uploads").iterdir() if p.suffix != ".csv"] == []


@pytest.mark.slow
def test_an_uploaded_image_gives_the_same_bits(
    server: Any, scene: dict[str, Any], tmp_path: Path
) -> None:
    flat = tmp_path / "flat.npy"
    np.save(flat, np.linspace(0.9, 1.1, 64 * 64).reshape(64, 64))
    sent = server.client.post("/v1/files?name=flat.npy", content=flat.read_bytes())
    assert sent.status_code == 201
    file_id = sent.json()["id"]
    again = server.client.post("/v1/files?name=other.npy", content=flat.read_bytes())
    assert again.json()["id"] == file_id
    scene["sensor"]["flat"] = file_id
    dry = server.client.post("/v1/jobs?dry_run=1", json=scene)
    assert dry.status_code == 200, dry.text
    job = server.submit(scene)
    done = server.ended(job)
    assert done["phase"] == "COMPLETED", done
    assert server.client.get(f"{job}/scene").json()["sensor"]["flat"] == file_id
    local = json.loads(json.dumps(scene))
    local["sensor"]["flat"] = str(flat)
    alone = render(parse_scene(local), tmp_path / "alone")
    assert done["content_digest"] == alone["content_digest"]
    for file in server.client.get(f"{job}/results").json()["files"]:
        assert str(server.home).encode() not in server.client.get(file["href"]).content, file
    assert server.client.delete(f"/v1/files/{file_id}").status_code == 204
    assert server.client.delete(f"/v1/files/{file_id}").status_code == 404
    assert server.client.post("/v1/jobs", json=scene).status_code == 422


def test_nothing_is_read_and_nobody_is_called(
    server: Any, scene: dict[str, Any], tmp_path: Path
) -> None:
    """A listener that counts who comes, and a pipe that would block whoever reads it."""
    called: list[Any] = []
    with socket.create_server(("127.0.0.1", 0)) as listener:
        listener.settimeout(0.1)
        port = listener.getsockname()[1]
        ways = [
            f"http://127.0.0.1:{port}/x.npy", f"https://localhost:{port}/x", f"ftp://[::1]:{port}/x",
            "http://169.254.169.254/latest/meta-data", "file:///etc/passwd", "/etc/passwd",
            "../jobs.sqlite", "upload:../jobs.sqlite", "upload:" + "0" * 32 + ".npy",
            "upload:/etc/passwd", "~/x", "s3://bucket/x", "memory://x", "\\\\host\\share", "|id",
            "github://a:b@/x", "simplecache::http://127.0.0.1/x", "/proc/self/environ",
            "/dev/stdin",
        ]  # fmt: skip
        for way in ways:
            for holder, key in (("sensor", "flat"), ("sensor", "quantum_efficiency")):
                changed = json.loads(json.dumps(scene))
                changed[holder][key] = way
                for query in ("", "?dry_run=1"):
                    answer = server.client.post(f"/v1/jobs{query}", json=changed)
                    assert answer.status_code == 422, (way, answer.text)
            changed = scene | {"stars": {"catalogue": way}}
            assert server.client.post("/v1/jobs", json=changed).status_code == 422
            assert server.client.delete(f"/v1/files/{way}").status_code in (404, 405)
        with pytest.raises(TimeoutError):
            called.append(listener.accept())
    assert called == []
    assert len(PATH_FIELDS) >= 20


def test_linked_uploads_and_products_are_not_followed(server: Any, finished: str) -> None:
    product = server.home / "products" / finished.rpartition("/")[2]
    (product / "report.link").symlink_to("/etc/passwd")
    try:
        assert server.client.get(f"{finished}/results/report.link").status_code == 404
        assert "report.link" not in server.client.get(f"{finished}/results").text
    finally:
        (product / "report.link").unlink()


@pytest.mark.parametrize(
    "headers",
    [
        {"origin": "https://evil.example"}, {"origin": "null"},
        {"sec-fetch-site": "cross-site"}, {"sec-fetch-site": "same-site"},
        {"origin": "http://["}, {"origin": ""},
    ],
)  # fmt: skip
def test_other_peoples_pages_change_nothing(
    server: Any, finished: str, headers: dict[str, str]
) -> None:
    for method, path in (
        ("POST", f"{finished}/cancel"),
        ("DELETE", finished),
        ("POST", "/v1/jobs"),
    ):
        assert server.client.request(method, path, headers=headers).status_code == 403
    assert server.client.get(finished, headers=headers).status_code == 200
    own = {"origin": server.url, "sec-fetch-site": "same-origin"}
    assert server.client.post("/v1/jobs", content=b"{}", headers=own | JSON).status_code == 422


def test_quotas_over_http(make_server: Callable[..., Any], scene: dict[str, Any]) -> None:
    server = make_server(
        NIGHTGLASS_QUEUED_JOBS="3", NIGHTGLASS_PIXEL_FRAMES_DAY=str(64 * 64 * 2 * 6),
        NIGHTGLASS_BYTES_KEPT="123456789", NIGHTGLASS_SLOTS="1",
    )  # fmt: skip
    scene["exposure"]["frames"] = 2
    answers = [server.client.post("/v1/jobs", json=scene) for _ in range(12)]
    refused = [a for a in answers if a.status_code == 429]
    assert refused
    assert refused[0].headers["retry-after"]
    assert refused[0].headers["content-type"] == "application/problem+json"
    used = server.client.get("/v1/usage").json()["quotas"]
    assert used["pixel_frames_today"]["used"] <= used["pixel_frames_today"]["limit"]
    assert used["queued_jobs"]["limit"] == 3
    assert used["bytes_kept"]["limit"] == 123_456_789


@pytest.mark.slow
def test_a_full_disk_is_named_and_loses_nothing(
    make_server: Callable[..., Any], scene: dict[str, Any]
) -> None:
    """First no file may grow beyond 1.5 MB: an image is too large. Then the job table's own log."""
    server = make_server()
    assert server.client.get("/readyz").status_code in (200, 503)
    table = server.home / "jobs.sqlite"
    with sqlite3.connect(table) as reader:  # an open reader: the log is not begun anew
        reader.execute("BEGIN").close()
        assert reader.execute("SELECT count(*) FROM jobs").fetchone() == (0,)
        limit(server, 1_500_000)
        noisy = {"shape": [1024, 1024], "read_noise_e": 8000.0, "bias_dn": 30000, "adc_bits": 16}
        scene["sensor"] |= noisy  # nothing that a codec could make smaller
        job = server.ended(server.submit(scene))
        assert (job["phase"], job["error"]["kind"]) == ("ERROR", "disk full"), job
        assert "disk is full" in job["error"]["message"]
        scene["sensor"]["shape"] = [64, 64]
        held, refused = [], None
        limit(server, Path(f"{table}-wal").stat().st_size + 400_000)
        while refused is None:
            answer = server.client.post("/v1/jobs", json=scene)
            if answer.status_code == 202:
                held.append(answer.json()["id"])
            else:
                refused = answer
            assert len(held) < 500
    assert refused.status_code == 503, refused.text
    assert "disk" in refused.json()["detail"], refused.text
    assert held
    limit(server, resource.RLIM_INFINITY)
    listed = {j["id"] for j in server.client.get("/v1/jobs?limit=1000").json()["jobs"]}
    assert set(held) <= listed
    assert server.client.post("/v1/jobs", json=scene).status_code == 202
    server.kill()
    server.start()
    listed = {j["id"] for j in server.client.get("/v1/jobs?limit=1000").json()["jobs"]}
    assert set(held) <= listed


def limit(server: Any, most: int) -> None:
    """No file of a server may grow beyond this, nor of the workers that it starts from now on."""
    resource.prlimit(server.process.pid, resource.RLIMIT_FSIZE, (most, resource.RLIM_INFINITY))
