"""Uploaded files and the jobs that name them: what a job was accepted with, it keeps."""

from __future__ import annotations

import bz2
import gzip
import io
import lzma
import time
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
import sqlalchemy as sa

from service.accounts.auth import Caller
from service.jobs.jobs import Phase, Queue
from service.jobs.submissions import Ask, TeamLimits, submit_many
from service.problems import NotAllowed, NotReady, NotThere
from service.scenes.uploads import Uploads, check_content
from service.settings import Settings
from service.store.database import writing
from service.store.tables import uploads

RED, BLUE = Caller("red", "key:1"), Caller("blue", "key:2")
FILE = "f" * 32 + ".npy"


def npy(folder: Path, values: Any) -> bytes:
    np.save(folder / "image.npy", values)
    return (folder / "image.npy").read_bytes()


def test_a_file_that_a_job_waits_for_is_kept(
    make_server: Callable[..., Any], scene: dict[str, Any], tmp_path: Path
) -> None:
    server = make_server()
    long = scene | {"sensor": scene["sensor"] | {"shape": [640, 640]}}
    long["exposure"] = scene["exposure"] | {"frames": 300}
    running = server.submit(long)
    flat = npy(tmp_path, np.linspace(0.9, 1.1, 64 * 64).reshape(64, 64))
    file_id = server.client.post("/v1/files?name=FLAT.NPY", content=flat).json()["id"]
    assert file_id.endswith(".npy")  # some cameras write their endings in capitals
    scene["sensor"]["flat"] = file_id
    job = server.submit(scene)
    refused = server.client.delete(f"/v1/files/{file_id}")
    assert (refused.status_code, job.rpartition("/")[2] in refused.text) == (409, True)
    server.client.post(f"{running}/cancel")
    assert server.ended(job)["phase"] == "COMPLETED"
    assert server.client.delete(f"/v1/files/{file_id}").status_code == 204


@pytest.mark.parametrize("kind", ["jobs", "sweeps"])
def test_a_key_that_was_used_is_answered_when_its_file_is_gone(
    make_server: Callable[..., Any], scene: dict[str, Any], tmp_path: Path, kind: str
) -> None:
    """Whose answer was lost asks again: the job stands, whatever it named. A new key is refused."""
    server = make_server()
    flat = npy(tmp_path, np.ones((64, 64)))
    file_id = server.client.post("/v1/files?name=flat.npy", content=flat).json()["id"]
    scene["sensor"]["flat"] = file_id
    axes = [{"field": "sensor.read_noise_e", "values": [1.0]}]
    sweep = {"schema": "nightglass/sweep/1", "name": "one", "scene": scene, "axes": axes}
    body, path = scene if kind == "jobs" else sweep, f"/v1/{kind}"
    first = server.client.post(path, json=body, headers={"Idempotency-Key": "k"})
    assert first.status_code == 202, first.text
    assert server.ended(first.headers["location"])["phase"] == "COMPLETED"
    assert server.client.delete(f"/v1/files/{file_id}").status_code == 204
    again = server.client.post(path, json=body, headers={"Idempotency-Key": "k"})
    assert (again.status_code, again.json()["id"]) == (200, first.json()["id"])
    for headers in ({"Idempotency-Key": "other"}, {}):
        assert server.client.post(path, json=body, headers=headers).status_code == 422
    assert server.client.post(
        f"{path}?dry_run=1", json=body, headers={"Idempotency-Key": "k"}
    ).status_code == 422


def test_an_upload_may_take_longer_than_an_answer(
    make_server: Callable[..., Any], tmp_path: Path
) -> None:
    """A slow line is given `upload_s` for the file, beside the `answer_s` of every request."""
    server = make_server(NIGHTGLASS_ANSWER_S="1", NIGHTGLASS_UPLOAD_S="60")
    content = npy(tmp_path, np.ones((8, 8)))

    def slowly() -> Iterator[bytes]:
        yield content[:9]
        time.sleep(1.6)
        yield content[9:]

    sent = server.client.post("/v1/files?name=flat.npy", content=slowly())
    assert sent.status_code == 201, sent.text


@pytest.fixture
def store(database: str) -> Any:
    queue = Queue(database)
    with writing(queue.engine) as db:
        for team in ("red", "blue"):
            row = {"team": team, "id": FILE, "name": "flat.npy", "bytes": 1, "created_s": 0.0}
            db.execute(sa.insert(uploads), [row])
    yield queue
    queue.close()


def ask(phase: Phase = Phase.QUEUED, **scene: Any) -> Ask:
    return Ask("x", scene, "0" * 64, team="red", phase=phase)


@pytest.mark.parametrize("phase", [Phase.PENDING, Phase.QUEUED])
def test_removing_and_submitting_never_cross(store: Queue, tmp_path: Path, phase: Phase) -> None:
    """Both look in their own transaction, so that one of the two is refused."""
    settings = Settings(tmp_path)
    settings.make_folders()
    files, named = Uploads(settings, store.engine), {"sensor": {"flat": f"upload:{FILE}"}}
    asks = [ask(phase, **named), ask(name=f"upload:{FILE}"), ask(phase, scene=named, axes=[])]
    jobs = [job.id for job, _ in submit_many(store, asks, TeamLimits())]  # type: ignore[misc]
    with pytest.raises(NotReady) as told:
        files.remove(RED, FILE)
    assert (jobs[0] in str(told.value), jobs[1] in str(told.value)) == (True, False)
    assert jobs[2] in str(told.value)  # a sweep names it in its base scene
    files.remove(BLUE, FILE)  # another team's is its own
    store.cancel(jobs[0])
    store.delete(jobs[2])
    files.remove(RED, FILE)
    with pytest.raises(NotThere):
        files.remove(RED, FILE)
    late, plain = submit_many(store, [ask(phase, **named), ask()], TeamLimits())
    assert isinstance(late, NotAllowed)
    assert "sensor.flat" in str(late)
    assert not isinstance(plain, Exception)
    waiting = submit_many(store, [ask(Phase.PENDING)], TeamLimits())[0][0]  # type: ignore[index]
    with pytest.raises(NotAllowed, match=r"sensor\.flat"):
        store.amend(waiting.id, scene=named)


@pytest.mark.parametrize(("count", "told"), [(7, ""), (8, ""), (9, " and 1 more")])
def test_jobs_that_hold_a_file_are_named_up_to_eight(
    store: Queue, tmp_path: Path, count: int, told: str
) -> None:
    """In their order, and how many there are beside them."""
    settings = Settings(tmp_path)
    asks = [ask(sensor={"flat": f"upload:{FILE}"}) for _ in range(count)]
    jobs = [job.id for job, _ in submit_many(store, asks, TeamLimits())]  # type: ignore[misc]
    with pytest.raises(NotReady) as caught:
        Uploads(settings, store.engine).remove(RED, FILE)
    assert str(caught.value).endswith(f"name this file: {', '.join(jobs[:8])}{told}")


def zipped() -> bytes:
    held = io.BytesIO()
    with zipfile.ZipFile(held, "w") as file:
        file.writestr("a", "1,2")
    return held.getvalue()


CARDS = b"SIMPLE  =                    T".ljust(80)
GOOD = np.arange(6, dtype=np.float32)
REFUSED = {
    "gzip": ("csv", gzip.compress(b"1,2")), "bzip2": ("csv", bz2.compress(b"1,2")),
    "xz": ("csv", lzma.compress(b"1,2")), "zip": ("csv", zipped()),
    "zstd": ("csv", pa.compress(b"1,2" * 99, "zstd", asbytes=True)),
    "truth values": ("npy", np.array([True])), "texts": ("npy", np.array(["a"])),
    "complex": ("npy", np.array([1j])), "too long": ("npy", (GOOD, b"x")),
    "too short": ("npy", (GOOD, None)), "no FITS": ("fits", b"x" * 80),
    "packed FITS": ("fits", CARDS + b"ZIMAGE  =".rjust((1 << 20) - 75) + b"T"),
}  # fmt: skip


@pytest.mark.parametrize(("kind", "content"), REFUSED.values(), ids=REFUSED.keys())
def test_contents_that_are_refused(tmp_path: Path, kind: str, content: Any) -> None:
    """By real packers; images whose header does not tell what the file holds, or not numbers; a
    keyword that lies across the border of two pieces is seen."""
    if not isinstance(content, bytes):
        values, more = content if isinstance(content, tuple) else (content, b"")
        whole = npy(tmp_path, values)
        content = whole[:-1] if more is None else whole + more
    (tmp_path / "file").write_bytes(content)
    with pytest.raises(NotAllowed):
        check_content(tmp_path / "file", kind)


@pytest.mark.parametrize("values", [GOOD, GOOD.reshape(2, 3).T, np.array([[7]], ">u2")])
def test_images_that_are_taken(tmp_path: Path, values: Any) -> None:
    (tmp_path / "file").write_bytes(npy(tmp_path, values))
    check_content(tmp_path / "file", "npy")
    (tmp_path / "file").write_bytes(CARDS + b"END".ljust(1 << 20))
    check_content(tmp_path / "file", "fits")
