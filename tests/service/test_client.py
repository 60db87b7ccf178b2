"""The Python client and the command line's --server against a running server, through a kill."""

from __future__ import annotations

import json
import os
import pickle
import socket
import subprocess
import sys
import tarfile
import threading
from io import BytesIO
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from pipeline.errors import BadInput, Damaged, exit_code
from pipeline.store.cube import open_cube
from pipeline.store.product import check
from service.client import Client, JobFailed, Refused, ServiceError
from service.settings import Settings


@pytest.fixture
def client(server: Any) -> Any:
    with Client(server.url, patience_s=20.0) as client:
        yield client


def nightglass(*words: str, **variables: str) -> subprocess.CompletedProcess[str]:
    code = "from pipeline.cli import main; main()"
    return subprocess.run(
        [sys.executable, "-c", code, *words], capture_output=True, text=True,
        env=os.environ | variables, timeout=120,
    )  # fmt: skip


def test_a_plan_is_waited_for_as_long_as_the_server_gives_it(tmp_path: Path) -> None:
    """Its place in the queue and the planning itself; other answers come sooner."""
    asked, settings = [], Settings(tmp_path)

    def answer(request: httpx.Request) -> httpx.Response:
        asked.append(request.extensions["timeout"]["read"])
        return httpx.Response(200, json={})

    with Client("http://h") as client:
        client.http._transport = httpx.MockTransport(answer)
        for look in (client.plan, client.observe):
            look({})
        client.ask("GET", "/v1/jobs")
    assert min(asked[:2]) > settings.plan_s + settings.answer_s > asked[2]


def test_an_answer_that_is_cut_off_is_asked_for_again() -> None:
    """A connection that breaks in an answer, or before it; told where none comes whole."""
    whole = b"HTTP/1.1 200 OK\r\nContent-Length: 2\r\nConnection: close\r\n\r\n[]"
    answers = [whole[:-1], b"", whole]
    with socket.create_server(("127.0.0.1", 0)) as listening:

        def serve() -> None:
            for answer in [*answers, b"", b""]:
                connection, _ = listening.accept()
                with connection:
                    connection.recv(65536)
                    connection.sendall(answer)

        threading.Thread(target=serve, daemon=True).start()
        with Client(f"http://127.0.0.1:{listening.getsockname()[1]}", patience_s=20.0) as client:
            assert client.ask("GET", "/v1/catalogues").json() == []
            client.patience_s = 0.3
            with pytest.raises(ServiceError, match="does not answer"):
                client.ask("GET", "/v1/catalogues")


@pytest.mark.parametrize(
    ("lost", "status"),
    [(httpx.ReadError, 404), (None, 404), (httpx.ReadError, 409), (httpx.ConnectError, 404)],
)
def test_a_job_deleted_by_a_request_whose_answer_was_lost_is_deleted(
    lost: Any, status: int
) -> None:
    asked = 0

    def answer(request: httpx.Request) -> httpx.Response:
        nonlocal asked
        asked += 1
        if lost and asked == 1:
            raise lost("broken")
        return httpx.Response(status, json={"detail": "no such job"})

    with Client("http://h", patience_s=5.0) as client:
        client.http = httpx.Client(transport=httpx.MockTransport(answer), base_url="http://h")
        if lost is httpx.ReadError and status == 404:
            client.ask("DELETE", "/v1/jobs/x")
        else:
            with pytest.raises(ServiceError, match="no such job"):
                client.ask("DELETE", "/v1/jobs/x")
        asked = 0
        with pytest.raises(ServiceError, match="no such job"):
            client.ask("GET", "/v1/jobs/x")


def test_submit_wait_open_fetch(
    client: Client, server: Any, scene: dict[str, Any], tmp_path: Path
) -> None:
    seen: list[dict[str, Any]] = []
    job = client.submit(scene).wait(60, progress=seen.append)
    assert job.phase == "COMPLETED"
    assert seen[-1]["tiles_done"] == 2
    over_http = job.open()
    local = job.open(tmp_path / "product")
    assert over_http.sizes["frame"] == 2
    np.testing.assert_array_equal(over_http.dn.values, local.dn.values)
    assert check(tmp_path / "product").whole
    assert job.report()["content_digest"] == job.facts["content_digest"]
    assert job.scene()["name"] == "small"
    assert job.id in [j.id for j in client.jobs("COMPLETED")]
    [chunk] = server.home.rglob(f"{job.id}/**/dn/c/1/0/0")
    chunk.unlink()
    with pytest.raises(Damaged, match=rf"{job.id}.*dn/c/1/0/0: damaged: this chunk is lost"):
        job.open().dn[1].load()
    job.delete()
    with pytest.raises(ServiceError) as error:
        client.job(job.id)
    assert error.value.status == 404


def test_fetch_goes_on_and_proves(client: Client, finished: str, tmp_path: Path) -> None:
    job, folder = client.job(finished.rpartition("/")[2]), tmp_path / "product"
    job.fetch(folder)
    chunk = folder / "cube.zarr/dn/c/0/0/0"
    whole = chunk.read_bytes()
    chunk.with_name(chunk.name + ".part").write_bytes(whole[:100])  # as cut off there
    chunk.unlink()
    job.fetch(folder)
    assert chunk.read_bytes() == whole
    assert not list(folder.rglob("*.part"))
    chunk.write_bytes(whole[:-1] + bytes([whole[-1] ^ 1]))
    with pytest.raises(Damaged, match="checksum"):
        job.fetch(folder)
    assert not (folder / "_COMPLETE").exists()
    job.fetch(folder)  # the damaged file was let go, and comes anew
    assert check(folder).whole
    other = tmp_path / "other"
    other.mkdir()
    (other / "mine.txt").write_text("keep me")
    with pytest.raises(BadInput, match="a new folder"):
        job.fetch(other)
    assert (other / "mine.txt").read_text() == "keep me"


def test_a_product_of_other_content_than_the_jobs_is_not_kept_as_whole(
    client: Client, finished: str, tmp_path: Path
) -> None:
    job, folder = client.job(finished.rpartition("/")[2]), tmp_path / "product"
    right = job.facts["content_digest"]
    job.facts["content_digest"] = "0" * 64
    with pytest.raises(Damaged, match="the content differs from what the job made") as error:
        job.fetch(folder)
    assert error.value.path == str(folder)
    assert not folder.exists()  # so that all of it comes anew
    job.facts["content_digest"] = right
    job.fetch(folder)
    assert check(folder).whole


def test_the_tar_is_a_product(server: Any, finished: str, tmp_path: Path) -> None:
    answer = server.client.get(f"{finished}/product.tar")
    assert int(answer.headers["content-length"]) == len(answer.content)
    with tarfile.open(fileobj=BytesIO(answer.content)) as tar:
        tar.extractall(tmp_path, filter="data")
    [product] = tmp_path.iterdir()
    assert check(product).whole
    assert open_cube(product).sizes["frame"] == 2


def test_mistakes_come_by_field(client: Client, scene: dict[str, Any], tmp_path: Path) -> None:
    scene["sensor"]["shape"] = [0, 64]
    scene["sensr"] = {}
    for ask in (client.submit, client.plan):
        with pytest.raises(Refused) as error:
            ask(scene)
        assert "sensr: " in str(error.value)
        assert "allowed: " in str(error.value)
        assert error.value.status == 422
    with pytest.raises(BadInput, match="--server"):
        Client("localhost:8765")
    with pytest.raises(BadInput, match="existing scene file"):
        client.submit(tmp_path / "nowhere.yaml")
    with pytest.raises(ServiceError, match="does not answer") as gone:
        Client("http://127.0.0.1:9", patience_s=0.5).catalogues()
    assert gone.value.status == 0
    with pytest.raises(ServiceError, match="does not answer"):
        Client("http://127.0.0.1:9", patience_s=3600.0).catalogues()  # never met: not for an hour


@pytest.mark.parametrize(
    ("url", "said"),
    [
        ("http://[1::2::3]:80", "Invalid IPv6 address"),
        ("http://h/\x7f", "non-printable ASCII character"),
        ("http://" + "h" * 70_000, "URL too long"),
    ],
)
def test_what_only_looks_like_an_address_is_refused(url: str, said: str) -> None:
    with pytest.raises(BadInput, match="--server") as error:
        Client(url)
    assert (error.value.field, error.value.value) == ("--server", url)
    assert error.value.allowed.startswith("an address; ")
    assert said in error.value.allowed


def test_a_refusal_survives_the_way_from_another_process() -> None:
    """With all its mistakes and its status."""
    refused = Refused([("seed", "-1", "0 or more"), ("name", "''", "a text")], 422)
    again = pickle.loads(pickle.dumps(refused))
    assert (again.mistakes, again.status, again.field) == (refused.mistakes, 422, "seed")
    assert str(again) == str(refused)


def test_what_the_server_cannot_read_is_an_error(client: Client) -> None:
    deep: Any = 1
    for _ in range(40):
        deep = [deep]
    for ask in (client.submit, client.plan):
        with pytest.raises(ServiceError, match="nested deeper") as error:
            ask({"targets": deep})
        assert error.value.status == 400


def test_failed_and_cancelled_jobs_raise(client: Client, scene: dict[str, Any]) -> None:
    scene["sensor"]["shape"], scene["exposure"]["frames"] = [640, 640], 50
    job = client.submit(scene)
    job.cancel()
    with pytest.raises(JobFailed, match="cancelled"):
        job.wait(60)
    with pytest.raises(JobFailed):
        job.open()


@pytest.mark.slow
def test_the_wait_outlives_a_killed_server(
    make_server: Any, scene: dict[str, Any], tmp_path: Path
) -> None:
    own_server = make_server()
    scene["sensor"]["shape"], scene["exposure"]["frames"] = [512, 512], 6
    port = own_server.url.rpartition(":")[2]
    with Client(own_server.url, patience_s=60.0) as client:
        job = client.submit(scene)
        done: list[Any] = []
        waiting = threading.Thread(target=lambda: done.append(job.wait(90, progress=False)))
        waiting.start()
        own_server.kill()
        own_server.start(int(port))
        waiting.join(100)
        assert done
        assert done[0].phase == "COMPLETED"
        assert check(job.fetch(tmp_path / "product")).whole


@pytest.mark.slow
def test_command_line(server: Any, scene: dict[str, Any], tmp_path: Path) -> None:
    file = tmp_path / "scene.json"
    file.write_text(json.dumps(scene))
    there = ("--server", server.url)
    made = nightglass("render", str(file), "-o", str(tmp_path / "p"), *there, "--set", "seed=8")
    assert made.returncode == 0, made.stderr
    assert check(tmp_path / "p").whole
    assert open_cube(tmp_path / "p").attrs["seed"] == 8
    plan = nightglass("plan", str(file), *there, "--json")
    assert json.loads(plan.stdout)["tiles"] == 2
    listed = nightglass("jobs", "list", NIGHTGLASS_SERVER=server.url)
    job = next(line.split()[0] for line in reversed(listed.stdout.splitlines()) if "small" in line)
    shown = json.loads(nightglass("jobs", "show", job, *there, "--json").stdout)
    assert shown["phase"] == "COMPLETED"
    fetched = nightglass("jobs", "fetch", job, "-o", str(tmp_path / "q"), *there)
    assert fetched.returncode == 0, fetched.stderr
    assert check(tmp_path / "q").whole
    late = nightglass("jobs", "cancel", job, *there)
    assert late.returncode == 2, late.stderr


def test_a_server_that_is_not_there_may_be_later(tmp_path: Path) -> None:
    assert exit_code(ServiceError("away")) == exit_code(ServiceError("full", 503)) == 4
    assert exit_code(ServiceError("ended", 409)) == 2
    assert exit_code(ServiceError("a fault", 500)) == 1


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("jobs", "show", "0" * 32), "there is no such job"),
        (("jobs", "show", "../../x"), "the id of a job"),
        (("render", "SCENE", "-o", "OUT", "--resume"), "without --resume"),
        (("render", "SCENE", "-o", "OUT", "--set", "sensor.shape=[0,1]"), "sensor.shape"),
        (("render", "SCENE", "-o", "."), "a path that does not exist yet"),
        (("plan", "SCENE", "--set", "sensor.shape=[0,1]"), "sensor.shape"),
    ],
    ids=("no-job", "no-id", "resume", "bad-shape", "output-there", "plan-bad-shape"),
)
def test_command_line_mistakes(
    server: Any, scene: dict[str, Any], tmp_path: Path, words: tuple[str, ...], said: str
) -> None:
    file = tmp_path / "scene.json"
    file.write_text(json.dumps(scene))
    places = {"SCENE": str(file), "OUT": str(tmp_path / "out")}
    answer = nightglass(*(places.get(w, w) for w in words), "--server", server.url)
    assert answer.returncode == 2
    assert said in answer.stderr
    assert "Traceback" not in answer.stderr
    assert not (tmp_path / "out").exists()
