"""Fetch a product from a server: files in parallel, continued by Range, sealed when verified."""

from __future__ import annotations

import json
import shutil
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Protocol

import httpx

from catalog_tools.documents import JsonObject
from catalog_tools.storage.durable import file_digest
from pipeline.errors import NOT_NOW, BadInput, Damaged, Incomplete, check_new
from pipeline.store import layout
from pipeline.store.product import Verdict, check, content_digest, is_begun
from service.answers import problem_of

PART = ".part"
TRIES = 8
Listener = Callable[[JsonObject], None]


class Asking(Protocol):
    """What asks a server, with patience."""

    http: httpx.Client

    def ask(self, method: str, path: str, **request: Any) -> httpx.Response: ...


class Fetched(Protocol):
    """A job whose files are fetched."""

    facts: JsonObject
    path: str

    @property
    def client(self) -> Asking: ...


def fetch_product(job: Fetched, folder: Path, parallel: int, listen: Listener | None) -> Path:
    """Bring a complete product into `folder`; it opens as one only when all of it was proved.

    Files already there in full are kept, cut ones continued. Raises BadInput for a folder that
    holds something else, Damaged for bytes that differ, Incomplete where the server went away.
    """
    record = job.client.ask("GET", f"{job.path}/record").content
    _take_folder(folder, record)
    files = [(path, size) for path, size in _listing(job) if path != layout.COMPLETE]
    total, lock, done = sum(size for _, size in files), threading.Lock(), [0]

    def count(size: int) -> None:
        with lock:
            done[0] += size
            if listen is not None:
                listen({"tiles_done": done[0] // 10**6, "tiles_total": total // 10**6})

    with ThreadPoolExecutor(max(1, parallel)) as pool:
        list(pool.map(lambda file: _fetch(job, folder, file[0], file[1], count), files))
    seal = job.client.ask("GET", f"{job.path}/results/{layout.COMPLETE}").content
    _prove(job, folder, seal)
    return folder


def fetch_sweep(job: Fetched, folder: Path, parallel: int = 8) -> Path:
    """Bring what a sweep or a study made (tables, report, page) into `folder`, each file of its
    seal proved by its digest; the seal comes last. Raises as `fetch_product` does."""
    check_new(folder, empty=True)
    if not folder.name:
        raise BadInput("-o", str(folder), "a folder below this one: it takes its name when whole")
    stage = folder.with_name(f".{folder.name}{PART}")  # of an earlier try: begun anew
    shutil.rmtree(stage, ignore_errors=True)
    stage.mkdir(parents=True)
    seal = job.client.ask("GET", f"{job.path}/results/{layout.COMPLETE}").content
    files = [(path, size) for path, size in _listing(job) if path != layout.COMPLETE]
    with ThreadPoolExecutor(parallel) as pool:
        list(pool.map(lambda file: _fetch(job, stage, file[0], file[1], lambda _: None), files))
    for sealed in sorted((stage / layout.CUBES).glob(f"{7 * '[0-9]'}/{layout.COMPLETE}")):
        _prove_cube(job, sealed.parent)
    for name, digest in json.loads(seal)["files"].items():
        if not (stage / name).is_file() or file_digest(stage / name) != digest:
            raise Damaged(name, "not what was made; fetch it again")
    layout.write_atomically(stage / layout.COMPLETE, seal)
    stage.replace(folder)  # over an empty folder too
    return folder


def _prove_cube(job: Fetched, cube: Path) -> None:
    """Bring the record of a kept point's product, and check all of it."""
    record = job.client.ask("GET", f"{job.path}/record?point={int(cube.name)}").content
    layout.write_atomically(cube / layout.BEGUN, record)
    if not is_begun(cube):  # an older server gives that of the sweep
        (cube / layout.BEGUN).unlink()
        return
    if fault := _fault_of(check(cube)):
        raise Damaged(f"{layout.CUBES}/{cube.name}", f"{fault}; fetch it again")


def _take_folder(folder: Path, record: bytes) -> None:
    """An empty folder, or one with an earlier part of the same product."""
    begun = folder / layout.BEGUN
    if folder.exists() and not folder.is_dir():
        raise BadInput("-o", str(folder), "a folder")
    if folder.is_dir() and any(folder.iterdir()):
        if not begun.is_file() or begun.read_bytes() != record:
            raise BadInput("-o", str(folder), "a new folder, or one with a part of this product")
        (folder / layout.COMPLETE).unlink(missing_ok=True)  # until it is proved again
    folder.mkdir(parents=True, exist_ok=True)
    layout.write_atomically(begun, record)


def _listing(job: Fetched) -> Iterator[tuple[str, int]]:
    """(path, bytes) of every file; a path that would leave the folder is refused."""
    address = f"{job.path}/results?limit=10000"
    while address:
        answer = job.client.ask("GET", address)
        for file in answer.json()["files"]:
            path, size = str(file["path"]), int(file["bytes"])
            parts = path.split("/")
            if any(p in ("", ".", "..") or p.startswith(".") or "\0" in p for p in parts):
                raise Damaged(path, "the server names a path outside of its product")
            yield path, size
        address = answer.links.get("next", {}).get("url", "")


def _fetch(job: Fetched, folder: Path, path: str, size: int, count: Callable[[int], None]) -> None:
    """One file, continued after every interruption until it has its length."""
    target = folder / path
    part = target.with_name(target.name + PART)
    if target.is_file() and target.stat().st_size == size:
        count(size)
        return
    target.parent.mkdir(parents=True, exist_ok=True)
    have = part.stat().st_size if part.is_file() else 0
    if have > size:
        part.unlink()
        have = 0
    count(have)
    for _ in range(TRIES):
        try:
            have += _go_on(job, path, part, have, size, count)
        except httpx.TransportError:
            have = part.stat().st_size if part.is_file() else 0
        if have == size:
            part.replace(target)
            return
        job.client.ask("GET", "/healthz")  # waits for a server that restarts, with patience
    raise Incomplete(f"{path}: {have} of {size} bytes came; the same command goes on from there")


def _go_on(
    job: Fetched, path: str, part: Path, have: int, size: int, count: Callable[[int], None]
) -> int:
    """Append what comes of the rest of a file, if any; returns how many bytes that was."""
    if have == size:
        part.touch()
        return 0
    headers = {"Range": f"bytes={have}-"} if have else {}
    came = 0
    address = f"{job.path}/results/{httpx.URL(path=f'/{path}').raw_path.decode()[1:]}"
    with job.client.http.stream("GET", address, headers=headers) as answer:
        if answer.status_code in NOT_NOW:
            return 0
        problem = problem_of(answer)
        if problem is not None:
            raise problem
        if have and answer.status_code != 206:
            raise Damaged(path, "the server does not go on where the file was cut off")
        with part.open("ab") as file:
            for piece in answer.iter_raw():  # all that came before a break stays
                if have + came + len(piece) > size:
                    raise Damaged(path, f"more than the {size} bytes that were announced")
                file.write(piece)
                came += len(piece)
                count(len(piece))
    return came


def _prove(job: Fetched, folder: Path, seal: bytes) -> None:
    """Every chunk, marker and table against its checksum, the whole against the job's digest."""
    complete = folder / layout.COMPLETE
    layout.write_atomically(complete, seal)
    verdict = check(folder)
    faults = list(verdict.faults)
    wanted = job.facts.get("content_digest")
    if not faults and wanted and content_digest(folder) != wanted:
        shutil.rmtree(folder)  # which of its files differ is not known
        raise Damaged(str(folder), "the content differs from what the job made; fetch it again")
    if fault := _fault_of(verdict):
        complete.unlink()
        for one in faults:
            _forget(folder, one)
        raise Damaged(str(folder), f"{fault}; fetch it again")


def _fault_of(verdict: Verdict) -> str:
    """The first fault of a product, empty where it is whole."""
    return next(iter(verdict.faults), "" if verdict.whole else "not whole")


def _forget(folder: Path, fault: str) -> None:
    """Remove the file that a fault names, so that the next fetch brings it anew."""
    for name in (fault.split(": ")[0], fault.split(": ")[0].removeprefix(f"{folder}/")):
        path = folder / name
        if path.is_file() and path.resolve().is_relative_to(folder.resolve()):
            path.unlink()
            return
