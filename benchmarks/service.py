"""The service under load: durable submissions, bursts with keys, health behind half-open sockets.

    python -m benchmarks.service [--seconds 5] [-o benchmarks/service.json]

Everything is measured in one run on one machine, server and client in processes of their own. The
yardstick is the same server with the same checks whose submissions are answered without storage.
Once the same body comes again and again, as from a client in a loop (its scene is judged once), and
once every body is another (every scene is judged).
"""

from __future__ import annotations

import argparse
import asyncio
import itertools
import json
import os
import platform
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from service.openapi import SCENE

CONNECTIONS, BURST, HALF_OPEN, LOOKS = 32, 1000, 2000, 300
SEED = 100_000_000  # of as many digits as those that follow it
SERVE = """
import sys
from pathlib import Path
from service import main; from service.jobs import submissions
kind, home = sys.argv[1:]
if kind == "bare":
    from service.jobs.jobs import job_of
    async def put(self, ask):
        return job_of(submissions._row(ask, 1e9)), True
    submissions.Intake.put = put
from service.engine.runner import Dispatcher
Dispatcher._step = lambda self: False  # jobs are taken in, none is run
main.serve("127.0.0.1", 0, Path(home))
"""


class Server:
    """A server process: `durable`, or `bare`."""

    def __init__(self, kind: str, home: Path) -> None:
        environment = os.environ | {"NIGHTGLASS_QUEUED_JOBS": "10000000"}
        self.process = subprocess.Popen(
            [sys.executable, "-c", SERVE, kind, str(home)], stderr=subprocess.PIPE, text=True,
            env=environment | {"NIGHTGLASS_HEAD_S": "60"},
        )  # fmt: skip
        assert self.process.stderr is not None
        found = re.search(r"http://\S+", self.process.stderr.readline())
        assert found
        place = urlsplit(found[0])
        self.host, self.port = place.hostname or "", place.port or 0
        self._drain = subprocess.Popen(
            ["cat"], stdin=self.process.stderr, stdout=subprocess.DEVNULL
        )

    def __enter__(self) -> Server:
        return self

    def __exit__(self, *_: object) -> None:
        self.process.terminate()
        self.process.wait(30)
        self._drain.wait(30)

    def cpu_s(self) -> float:
        """Seconds of processor that the server has used."""
        import psutil

        times = psutil.Process(self.process.pid).cpu_times()
        return times.user + times.system


async def ask(
    reader: asyncio.StreamReader, writer: asyncio.StreamWriter, request: bytes
) -> tuple[int, bytes]:
    """One request on a connection that stays open: (status, body)."""
    writer.write(request)
    head = await reader.readuntil(b"\r\n\r\n")
    length = re.search(rb"content-length: (\d+)", head, re.IGNORECASE)
    return int(head[9:12]), await reader.readexactly(int(length[1]) if length else 0)


def post(server: Server, key: str | None = None, seed: int = SEED) -> bytes:
    body = json.dumps(SCENE | {"seed": seed}).encode()
    head = f"POST /v1/jobs HTTP/1.1\r\nHost: 127.0.0.1:{server.port}\r\n"
    head += f"Content-Type: application/json\r\nContent-Length: {len(body)}\r\n"
    head += f"Idempotency-Key: {key}\r\n" if key else ""
    return head.encode() + b"\r\n" + body


async def submissions_a_second(
    server: Server, seconds: float, distinct: bool = False
) -> dict[str, float]:
    """POSTs a second over 32 connections, and the server's processor time for each."""
    same = post(server)
    before, after = same.split(str(SEED).encode())
    seeds = itertools.count(SEED + 1)

    def another() -> bytes:
        return before + str(next(seeds)).encode() + after if distinct else same

    counts = [0] * CONNECTIONS
    await one_connection(server, another, time.monotonic() + 1.0, counts, 0)  # warm
    counts = [0] * CONNECTIONS
    cpu, began = server.cpu_s(), time.monotonic()
    end = began + seconds
    await asyncio.gather(
        *(one_connection(server, another, end, counts, i) for i in range(CONNECTIONS))
    )
    took, done = time.monotonic() - began, sum(counts)
    return {
        "per_s": done / took, "cpu_ms_each": (server.cpu_s() - cpu) / done * 1000,
        "per_cpu_s": done / (server.cpu_s() - cpu),
    }  # fmt: skip


async def jobs_per_commit(server: Server) -> float:
    """How many submissions shared a commit so far, from the server's own metrics."""
    reader, writer = await asyncio.open_connection(server.host, server.port)
    request = f"GET /metrics HTTP/1.1\r\nHost: 127.0.0.1:{server.port}\r\n\r\n".encode()
    _, text = await ask(reader, writer, request)
    writer.close()
    jobs, commits = (
        float(re.search(rf"(?m)^nightglass_{name}_total (\S+)", text.decode())[1])  # type: ignore[index]
        for name in ("submissions", "commits")
    )
    return jobs / commits


async def one_connection(
    server: Server, request: Callable[[], bytes], end: float, counts: list[int], which: int
) -> None:
    reader, writer = await asyncio.open_connection(server.host, server.port)
    while time.monotonic() < end:
        status, body = await ask(reader, writer, request())
        assert status == 202, body
        counts[which] += 1
    writer.close()


async def burst(server: Server) -> dict[str, Any]:
    """1,000 submissions at once on connections of their own; each key comes twice."""

    async def one(key: str) -> tuple[int, str]:
        reader, writer = await asyncio.open_connection(server.host, server.port)
        status, body = await ask(reader, writer, post(server, key))
        writer.close()
        return status, json.loads(body)["id"]

    keys = [f"burst-{i % (BURST // 2)}" for i in range(BURST)]
    cpu, began = server.cpu_s(), time.monotonic()
    answers = await asyncio.gather(*(one(key) for key in keys))
    took, cpu = time.monotonic() - began, server.cpu_s() - cpu
    by_key: dict[str, set[str]] = {}
    for key, (_, job) in zip(keys, answers, strict=True):
        by_key.setdefault(key, set()).add(job)
    return {
        "seconds": took, "server_cpu_s": cpu, "accepted": sum(s == 202 for s, _ in answers),
        "replayed": sum(s == 200 for s, _ in answers),
        "one_job_per_key": all(len(ids) == 1 for ids in by_key.values()),
    }  # fmt: skip


async def health_behind_half_open(server: Server) -> dict[str, float]:
    """99th percentile of /healthz while 2,000 connections hold a request that never ends."""
    held = []
    for i in range(HALF_OPEN):
        _, writer = await asyncio.open_connection(server.host, server.port)
        writer.write(b"POST /v1/jobs HTTP/1.1\r\nHost: 127.0.0.1\r\n" if i % 2 else b"GET")
        held.append(writer)
    took = []
    request = f"GET /healthz HTTP/1.1\r\nHost: 127.0.0.1:{server.port}\r\n\r\n".encode()
    reader, writer = await asyncio.open_connection(server.host, server.port)
    for _ in range(LOOKS):
        began = time.monotonic()
        status, _ = await ask(reader, writer, request)
        assert status == 200
        took.append(time.monotonic() - began)
        await asyncio.sleep(0.005)
    for writer in held:
        writer.close()
    took.sort()
    return {"p50_ms": took[LOOKS // 2] * 1000, "p99_ms": took[int(LOOKS * 0.99)] * 1000}


async def measure(folder: Path, seconds: float) -> dict[str, Any]:
    with Server("bare", folder / "bare") as server:
        bare = await submissions_a_second(server, seconds)
        bare_distinct = await submissions_a_second(server, seconds, distinct=True)
    with Server("durable", folder / "durable") as server:
        durable = await submissions_a_second(server, seconds)
        durable["jobs_per_commit"] = await jobs_per_commit(server)
        distinct = await submissions_a_second(server, seconds, distinct=True)
        together = await burst(server)
        health = await health_behind_half_open(server)
    return {
        "bare_post": bare, "durable_post": durable,
        "durable_over_bare": durable["per_s"] / bare["per_s"],
        "durable_over_bare_by_cpu": durable["per_cpu_s"] / bare["per_cpu_s"],
        "bare_post_distinct": bare_distinct, "durable_post_distinct": distinct,
        "durable_over_bare_distinct": distinct["per_s"] / bare_distinct["per_s"],
        "burst_of_1000": together, "health_behind_2000_half_open": health,
        "connections": CONNECTIONS, "load_average": os.getloadavg()[0],
        "machine": f"{platform.machine()}, {os.cpu_count()} cores",
    }  # fmt: skip


def main() -> None:
    """Measure, print, and write the figures."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("-o", type=Path)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        found = asyncio.run(measure(Path(folder), given.seconds))
    text = json.dumps(found, indent=2) + "\n"
    print(text, end="")
    if given.o:
        given.o.write_text(text)


if __name__ == "__main__":
    main()
